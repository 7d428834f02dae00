"""Models of drives fitted to what they did; the program for it; the machine file written."""

from __future__ import annotations

import re
from dataclasses import fields, replace
from statistics import NormalDist

import numpy as np
import pytest
from plan_directories import stroke

from cnc_interp.commands.cli import main
from cnc_interp.core import MM, UM, InterpError
from cnc_interp.core.axis_limits import DriveLoad
from cnc_interp.drives.identification import (
    SIGMAS,
    excitation,
    identify_axis,
    resolution_of,
    spreads_of,
    with_drives,
)
from cnc_interp.machine.simulated_drives import simulate
from cnc_interp.machine_model.axis_drives import AxisDrive
from cnc_interp.machine_model.machine import Machine, find_machine_file
from cnc_interp.report import identified
from cnc_interp.report.identified import identified_lines, transfer, write_identified

TIRED = Machine.load('xyzac_tired')
TRUTH, LOAD = TIRED.drives[0], TIRED.limits.loads[0]
NOISE = 0.2 * UM


def excited():
    """Setpoints of X: there and back at several speeds, then a chirp on a carrier."""
    parts = [np.zeros(1)]
    for length, speed in ((4, 20), (4, 20), (10, 60), (2, 6), (0.5, 1.5)):
        x = stroke(length * MM, speed * MM, 2.5, 20.0)[0]
        parts += [x, x[-1] - x]
    time = np.arange(4000) * 1e-3
    carrier = 0.03 * (time - 0.1 * (1.0 - np.exp(-time / 0.1)))  # it starts without a jump
    wave = 12e-3 * np.sin(2 * np.pi * (3.0 * time + 7.0 * time**2)) / (8.0 + 10.0 * time) ** 2
    parts.append(carrier + wave)
    setpoint = np.concatenate(parts)
    q = np.zeros((len(setpoint), 5))
    q[:, 0] = setpoint
    return q, np.gradient(q, 1e-3, axis=0)


def fitted(machine, q, rate, noise=NOISE):
    feedback = simulate(machine, 1e-3, q, rate).position
    feedback = feedback + np.random.default_rng(5).normal(scale=noise, size=q.shape)
    # Only inertia and viscous friction of the file may be used.
    loads = {0: replace(LOAD, coulomb=0.0)} if machine.limits.loads else {}
    return identify_axis(
        replace(machine, drives={}).having(load=loads), 0, 1e-3, q, rate, feedback
    )


def test_the_model_is_found_from_noisy_feedback(tmp_path):
    machine = replace(TIRED, drives={0: TRUTH}).having(load={0: LOAD})
    found = fitted(machine, *excited())
    assert np.std(found.measured - found.modelled) < 1.05 * NOISE
    assert pytest.approx(NormalDist().inv_cdf(0.975), rel=1e-4) == SIGMAS
    for name, width in found.half_width.items():
        true = LOAD.coulomb if name == 'coulomb' else getattr(TRUTH, name)
        value = found.load.coulomb if name == 'coulomb' else getattr(found.drive, name)
        assert abs(value - true) < 3.0 * width + 1e-3 * true, name
        assert 0.0 < width < 0.25 * true, name
    # The page has every value, and the same transfer function as the truth.
    lines = '\n'.join(identified_lines(TIRED, {0: found}))
    assert 'position_gain_per_s    6' in lines and 'coulomb_N              1' in lines
    assert 'friction not fitted' not in lines
    frequency = np.array([2.0, 10.0, 30.0])
    answers = [transfer(each, 2.0, frequency) for each in (found.drive, TRUTH)]
    assert np.abs(answers[0] / answers[1] - 1.0).max() < 0.02
    late = transfer(replace(TRUTH, delay=TRUTH.delay + 2e-3), 2.0, frequency) / answers[1]
    assert np.angle(late, deg=True) == pytest.approx(-0.72 * frequency)
    write_identified(TIRED, {0: found}, 1e-3, tmp_path / 'page.html')
    assert 'coulomb_N' in (tmp_path / 'page.html').read_text(encoding='utf-8')


@pytest.mark.thorough
def test_an_axis_without_a_load_is_fitted_without_friction():
    drive = replace(TRUTH, static=0.0, stribeck_velocity=0.0)
    found = fitted(replace(TIRED, drives={0: drive}).having(load={}), *excited())
    assert found.load is None and 'coulomb' not in found.half_width
    assert found.drive.position_gain == pytest.approx(drive.position_gain, rel=0.02)
    assert found.drive.backlash == pytest.approx(drive.backlash, rel=0.05)


def test_an_axis_that_stands_or_never_turns_is_not_fitted():
    q, rate = excited()
    assert identify_axis(TIRED, 1, 1e-3, q, rate, q) is None
    with pytest.raises(InterpError, match='X reversed less than 3 times'):
        identify_axis(TIRED, 0, 1e-3, q[:300], rate[:300], q[:300])


def test_the_resolution_is_seen_in_positions():
    way = 3 * MM * np.sin(np.arange(3000) * 2e-3)
    assert resolution_of(0.5 * UM * np.round(way / (0.5 * UM))) == pytest.approx(0.5 * UM)
    assert resolution_of(way) == 0.0


@pytest.mark.parametrize('heavy', [1.0, 6.0])
def test_rounding_that_comes_back_at_each_rest_widens_the_intervals(heavy):
    """A number is fitted from rests at 40 places; within one all samples are rounded alike.

    One place may weigh as much as all others: the fit follows its error, and hides it.
    """
    rng = np.random.default_rng(3)
    rest = np.repeat(np.arange(40), 100)
    lever = rng.normal(size=(40, 1))
    lever[0] = heavy
    lever = lever[rest]
    place = rng.uniform(0.0, 1.0, 40)[rest]
    fitted_by, off, wide = np.linalg.pinv(lever)[0], [], []
    for _ in range(200):
        error = rng.uniform(-0.5, 0.5, 40)[rest] * UM + rng.normal(scale=0.1 * UM, size=len(rest))
        off.append(fitted_by @ error)
        wide.append(spreads_of(lever, error - lever[:, 0] * off[-1], place, 1)[0])
    assert 0.95 < np.mean(wide) / np.std(off) < 1.15
    assert 0.89 < np.mean(np.abs(off) < 1.96 * np.array(wide)) < 0.99


@pytest.mark.parametrize('name', ['xyzac', 'ram_mill', 'head_head', 'xyza'])
def test_the_excitation_moves_every_axis_there_and_back_within_its_travel(name):
    machine = Machine.load(name)
    text = excitation(machine)
    for axis in machine.axes:
        moves = np.array(re.findall(rf'G1 {axis.name}(\S+) F', text), dtype=float)
        if axis.travel[1] - axis.travel[0] < 1e-6:
            assert not len(moves)
            continue
        scale = 1e-3 if axis.linear else np.pi / 180.0
        way = np.concatenate([[0.0], np.cumsum(moves)]) * scale
        assert abs(way[-1]) < 2e-5 and way.min() > axis.travel[0] and way.max() < axis.travel[1]
        assert np.count_nonzero(np.diff(np.sign(moves))) > 20


def test_the_excitation_is_a_program_as_any_other(tmp_path):
    program = tmp_path / 'excite.ngc'
    assert main(['excite', '--machine', 'xyz', '--out', str(program)]) == 0
    out = tmp_path / 'plan'
    assert main(['plan', str(program), '--machine', 'xyz', '--out', str(out)]) == 0
    assert main(['check', str(out)]) == 0
    setpoints = np.load(out / 'setpoints.npz')['position']
    assert np.abs(setpoints[-1] - setpoints[0]).max() < 20 * UM
    assert np.all(np.ptp(setpoints, axis=0) > 5 * MM)


def test_the_machine_file_is_written_with_its_intervals(tmp_path):
    text = find_machine_file('xyzac').read_text(encoding='utf-8')
    drives = {0: TRUTH, 3: TIRED.drives[3]}
    loads = {0: LOAD, 3: TIRED.limits.loads[3]}
    widths = {0: {'position_gain': 0.12, 'coulomb': 3.0, 'backlash': 0.2 * UM}}
    again = tmp_path / 'again.yaml'
    for source in (text, find_machine_file('xyzac_tired').read_text(encoding='utf-8')):
        again.write_text(with_drives(source, TIRED, drives, loads, widths, 'a bag'))
        machine = Machine.load(again)
        pairs = (machine.drives, drives, AxisDrive), (machine.limits.loads, loads, DriveLoad)
        for found, wanted, kind in pairs:
            assert found.keys() == wanted.keys()
            for j, each in found.items():
                for field in fields(kind):
                    expected = getattr(wanted[j], field.name)
                    assert getattr(each, field.name) == pytest.approx(expected, rel=1e-5)
        assert np.array_equal(machine.limits.by_order, TIRED.limits.by_order)
        written = again.read_text()
        assert '+- 95 %: position_gain_per_s: 0.12, backlash_um: 0.2' in written
        assert written.count('drives:') == 1 and written.count('loads:') == 1
        assert '# The tool stands along machine +Z.' in written


def test_the_axes_of_the_page_end_with_the_motion_and_its_phases_do_not_jump():
    q, _ = excited()
    late = replace(TRUTH, delay=6e-3)  # more than half a turn of phase below 120 Hz
    columns = q[:, 0], q[:, 0], q[:, 0]
    rows = np.arange(500, 500 + len(q))
    found = identified.IdentifiedAxis(0, late, LOAD, {}, rows, *columns)
    times = identified._time_figure(TIRED, found, 1e-3)
    assert times.layout.xaxis.range == pytest.approx((rows[0] * 1e-3, rows[-1] * 1e-3))
    curves = [curve for curve in identified._bode(found, 1e-3).data if curve.yaxis == 'y2']
    measured, modelled = curves
    assert np.abs(np.diff(modelled.y)).max() < 20.0 and min(modelled.y) < -270.0
    near = np.interp(measured.x, modelled.x, modelled.y)
    assert np.abs(measured.y - near).max() <= 180.0
