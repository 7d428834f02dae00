"""Rotary axes from touches of one ball: what is found, how sure it is, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from cnc_interp.client.rotary_probing import fit_rotary_centres
from cnc_interp.core import InterpError
from cnc_interp.machine_model.machine import Machine, with_geometry
from cnc_interp.machine_model.transform_port import Transform

REACH, BEYOND, UM = 14e-3, -1.5e-3, 1e-6
BALL = np.array([30e-3, -20e-3, 10e-3])
NAMES = ['xyzac_trt', 'xyzbc', 'bc_trunnion', 'head_table', 'head_head']


def real_one(machine, rng):
    """Return a machine with other offsets than its file says."""
    offsets = np.concatenate([machine.offsets, machine.tool_offset])
    offsets[1:3] += rng.normal(0.0, 50 * UM, (2, 3))
    if any(machine.rotary_on_head):
        offsets[3:] += rng.normal(0.0, 50 * UM, (2, 3))
    return replace(machine, offsets=offsets[:3], tool_offset=offsets[3:])


def touches(machine, rng, poses, noise=UM, pretravel=UM):
    """Return the axis positions at which a ball is touched, from above and from two sides."""
    transform, found = Transform.of(machine), []
    for k, pose in enumerate(poses):
        rotary = np.array(pose)
        o = transform.tool_axis(rotary[None])[0]
        u = np.cross(o, [1.0, 0.3, 0.2])
        u /= np.linalg.norm(u)
        v = np.cross(o, u)
        for way in (o, u, -u, v, -v) if k == 0 else (o, u, v):
            centre = BALL + way * (REACH - pretravel + rng.normal(0.0, noise))
            tip = centre + BEYOND * o
            found.append([*transform.linear(tip[None], rotary[None])[0], *rotary])
    return np.array(found)


POSES = [(0.0, 0.0), *((a, c) for a in (0.5, -0.5) for c in (0.0, 1.5, -1.5))]


@pytest.mark.parametrize('name', NAMES)
def test_the_tool_ends_within_five_micrometres_of_where_it_should(name):
    machine, rng = Machine.load(name), np.random.default_rng(5)
    real = real_one(machine, rng)
    fit = fit_rotary_centres(machine, touches(real, rng, POSES), REACH, BEYOND)
    rotary, beside = rng.uniform(-0.5, 0.5, (40, 2)), rng.uniform(-0.05, 0.05, (40, 3))
    wanted = Transform.of(real).linear(BALL + beside, rotary)

    def error(machine, ball):
        return np.abs(Transform.of(machine).linear(ball + beside, rotary) - wanted).max()

    assert error(fit.machine, fit.ball) < 5 * UM < error(machine, BALL)


def test_the_uncertainty_told_is_that_of_many_trials():
    machine, rng = Machine.load('xyzac_trt'), np.random.default_rng(6)
    fits = [
        fit_rotary_centres(machine, touches(machine, rng, POSES), REACH, BEYOND)
        for _ in range(150)
    ]
    errors = np.std([fit.machine.offsets for fit in fits], axis=0)
    told = np.mean([fit.spread[:3] for fit in fits], axis=0)
    seen = told > 0.01 * UM
    assert seen.sum() == 5  # two numbers of each line, and X, in which C is beside A
    assert np.allclose(errors[seen] / told[seen], 1.0, atol=0.25)
    assert (np.abs(fits[0].machine.offsets - machine.offsets)[~seen] < 1e-9).all()


def test_too_few_poses_are_refused():
    machine, rng = Machine.load('xyzac_trt'), np.random.default_rng(7)
    with pytest.raises(InterpError, match='do not determine'):
        fit_rotary_centres(machine, touches(machine, rng, POSES[:1]), REACH, BEYOND)
    with pytest.raises(InterpError, match='no rotary axes'):
        fit_rotary_centres(Machine.load('xyz'), np.zeros((5, 3)), REACH, BEYOND)


@pytest.mark.parametrize('name', NAMES)
def test_the_file_that_is_written_is_that_machine(tmp_path, name):
    real = real_one(Machine.load(name), np.random.default_rng(8))
    with_geometry(name, tmp_path / 'new.yaml', real)
    again = Machine.load(tmp_path / 'new.yaml')
    assert np.allclose(again.offsets, real.offsets, atol=1e-12)
    assert np.allclose(again.tool_offset, real.tool_offset, atol=1e-12)
