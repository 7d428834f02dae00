"""Tool axes beside the pole by rounding: put on it within the tolerance, however they arrive."""

from dataclasses import fields, replace

import numpy as np
import pytest
from path_samples import sampled
from programs import blocks_of
from whole_plans import plan_program

from cnc_interp.core import MM, UM
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.machine_traits import traits_of
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.program.blocks import Blocks
from cnc_interp.proof.programmed_path import ProgrammedPath
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.path_smoother import PathSmoother
from cnc_interp.smoothing.segments import PathSegments
from cnc_interp.smoothing.upright import Upright

HEIGHT = 30.0 * MM
XYZAC = traits_of(Transform.of(Machine.load('xyzac')))


def nearly_upright(amplitude, count=12):
    """A straight way; the tool axes beside the pole by a random angle [rad]."""
    beside = np.random.default_rng(3).normal(size=(count, 2)) * amplitude
    axis = np.c_[beside, np.ones(count)]
    tip = np.arange(count)[:, None] * np.array([[1.0, 0.0, 0.0]]) * MM
    return blocks_of(tip, axis / np.linalg.norm(axis, axis=1)[:, None])


def moved_to_pole(blocks, batch=None, machine=XYZAC):
    """The blocks, pushed in batches."""
    upright, step = Upright(machine, HEIGHT), batch or len(blocks)
    parts = [upright.push(blocks[i : i + step]) for i in range(0, len(blocks), step)]
    last = upright.finish()
    return Blocks.concatenate(parts if last is None else [*parts, last])


def away(blocks):
    """Distance of the tool axes from the pole at flank height [m]."""
    return HEIGHT * np.hypot(*blocks.axis[:, :2].T)


@pytest.mark.parametrize('amplitude', [1e-9, 1e-6, 3e-4])
@pytest.mark.parametrize('tolerance', [1.0 * UM, 20.0 * UM])
def test_what_is_moved_is_taken_from_the_tolerance(amplitude, tolerance):
    blocks = nearly_upright(amplitude)
    allowed = np.full(len(blocks), tolerance)
    allowed[7] = 1e-3 * UM
    blocks = replace(blocks, orientation_tolerance=allowed)
    made, off = moved_to_pole(blocks), away(blocks)
    moved = np.linalg.norm(HEIGHT * (made.axis - blocks.axis), axis=1)
    least = np.minimum(allowed, np.append(allowed[1:], np.inf))
    # Both ends of block k are near.
    pair = [k > 0 and off[k - 1 : k + 1].max() <= 0.8 * allowed[k] for k in range(len(off))]
    wanders = (off <= 0.8 * least) & (np.array(pair) | np.append(pair[1:], False))
    near = (off <= np.minimum(0.05 * least, 0.5 * UM)) | wanders
    near[[0, -1]] = False  # at rest
    assert near.any() or amplitude * HEIGHT > tolerance
    assert (made.orientation_tolerance >= 0.199 * allowed).all()
    assert (away(made)[near] == 0.0).all() and (made.axis[~near] == blocks.axis[~near]).all()
    # A leg deviates by no more than its ends.
    left = blocks.orientation_tolerance - made.orientation_tolerance
    assert (left >= moved - 1e-15).all() and (left[1:] >= moved[:-1] - 1e-15).all()


def test_c_rests_where_the_tool_axis_wanders_about_the_pole_and_the_error_is_told():
    """Every tool axis lies within 0.8 of the tolerance about the pole."""
    blocks = nearly_upright(1.5e-4, 40)
    blocks = replace(blocks, orientation_tolerance=np.full(40, 20.0 * UM))
    assert 12.0 * UM < away(blocks)[1:-1].max() < 16.0 * UM
    smoother = PathSmoother(Settings(flank_height=HEIGHT), XYZAC)
    segments = PathSegments.concatenate([smoother.push(blocks), smoother.finish()])
    tip, axis = sampled(segments, 9)
    path = ProgrammedPath.of(blocks.tip, blocks.axis, blocks.rotary, HEIGHT)
    found = (
        path.deviation(
            tip.reshape(-1, 3),
            axis.reshape(-1, 3),
            np.repeat(segments.block[:, 0], 9),
            np.full(tip[..., 0].size, 10 * MM),
        )
        .orientation.reshape(-1, 9)
        .max(axis=1)
    )
    assert (found <= segments.deviation[:, 1] + 1e-12).all()
    assert 0.5 * found.max() < segments.deviation[:, 1].max() <= 20.0 * UM
    words = ['GOTO/' + ','.join(map(str, row)) for row in np.c_[blocks.tip / MM, blocks.axis]]
    text = '\n'.join(['FEDRAT/1000', *words])
    machine = Machine.load('xyzac')
    plan = plan_program(read_text(text, 't.apt', Transform.of(machine), Settings()), machine)
    assert np.abs(np.diff(plan.setpoints.position[:, 4])).sum() < np.pi


@pytest.mark.parametrize('batch', [1, 5])
@pytest.mark.parametrize('amplitude', [1e-6, 3e-4])
def test_it_does_not_depend_on_how_the_blocks_arrive(batch, amplitude):
    blocks = nearly_upright(amplitude)
    blocks = replace(blocks, orientation_tolerance=np.tile([20.0 * UM, 9.0 * UM, 12.0 * UM], 4))
    whole, parts = moved_to_pole(blocks), moved_to_pole(blocks, batch)
    for column in fields(Blocks):
        np.testing.assert_array_equal(getattr(whole, column.name), getattr(parts, column.name))


@pytest.mark.parametrize('batch', [1, None])
def test_the_tool_stands_as_programmed_at_stops_and_before_splines(batch):
    blocks = nearly_upright(1e-6)
    knots = np.full(len(blocks), np.nan)
    knots[8:] = 1.0
    stop = np.arange(len(blocks)) == 4
    top = np.where(np.isfinite(knots)[:, None], blocks.tip + HEIGHT * blocks.axis, np.nan)
    made = moved_to_pole(replace(blocks, exact_stop=stop, knot_interval=knots, top=top), batch)
    kept = [0, 4, 7, *range(8, len(blocks))]
    assert (made.axis[kept] == blocks.axis[kept]).all()
    assert (away(made)[[1, 2, 3, 5, 6]] == 0.0).all()


def test_words_and_machines_without_a_pole_keep_their_tool_axes():
    blocks = nearly_upright(1e-6)
    named = replace(blocks, rotary=np.zeros((len(blocks), 2)))
    three = traits_of(Transform.of(Machine.load('vmc')))
    for made in (moved_to_pole(named), moved_to_pole(blocks, machine=three)):
        np.testing.assert_array_equal(made.axis, blocks.axis)
        assert (made.orientation_tolerance == blocks.orientation_tolerance).all()
