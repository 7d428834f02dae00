"""Runs that teach the next one: through the compiled cycle, on drives that the model has wrong."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from plan_directories import stroke

from cnc_interp.core import MM, InterpError
from cnc_interp.drives.compensation import FADE, HEAD, LEFT, ROW, Compensation, compensate_all
from cnc_interp.drives.drive_model import follow_all, words_of
from cnc_interp.drives.learning import (
    HELD,
    LearntMotion,
    hash_of,
    learnt_for,
    learnt_rates,
    measured_error,
    start_of,
    with_hold,
)
from cnc_interp.machine.cycle import Cycle
from cnc_interp.machine.simulated_drives import CompensatedDrives, SimulatedDrives, simulate
from cnc_interp.machine_model.axis_drives import AxisDrive
from cnc_interp.machine_model.machine import Machine, find_machine_file
from cnc_interp.run.setpoints import Chunk, Setpoints, Wait

T = 1e-3
TIRED = Machine.load('xyzac_tired')


def program():
    """A circle there and back, with both rotary axes; two setpoints at rest come first."""
    x = stroke(1.0, 2.0, 6.0, 30.0)[0]
    p = np.concatenate([[0.0, 0.0], x, x[-1] - x]) / x[-1]
    turn = 2 * np.pi * p
    return np.stack(
        [
            15 * MM * np.sin(turn),
            15 * MM * (1 - np.cos(turn)),
            5 * MM * np.sin(2 * turn),
            0.1 * (1 - np.cos(turn)),
            0.3 * p,
        ],
        axis=1,
    )


def wrong(up_and_down):
    """A model whose values are 20 % too large, or too large and too small in turn."""
    kept = ('resolution', 'feed_forward')
    names = [field.name for field in fields(AxisDrive) if field.name not in kept]
    drives, loads = {}, {}
    for j, drive in TIRED.drives.items():
        factors = [0.8 if up_and_down and (j + k) % 2 else 1.2 for k in range(len(names))]
        told = {name: f * getattr(drive, name) for name, f in zip(names, factors, strict=True)}
        drives[j] = replace(drive, **told)
        factor = 0.8 if up_and_down and j % 2 else 1.2
        loads[j] = replace(TIRED.limits.loads[j], coulomb=factor * TIRED.limits.loads[j].coulomb)
    return replace(TIRED, drives=drives).having(load=loads)


def motion_of(setpoint, rate, **other):
    told = {'period': T, 'error': np.zeros((1, 2)), 'axes': 'X Y Z A C'}
    hashes = {'machine': hash_of('xyzac_tired'), 'model': hash_of('xyzac_tired')}
    return LearntMotion(setpoint, rate, **(told | hashes | other))


def chunk(q):
    """All setpoints as one chunk without a tail."""
    rate = np.gradient(q, T, axis=0)
    zeros, ones, times = np.zeros_like(q), np.ones(len(q), dtype=int), np.zeros(len(q))
    whole = Setpoints(times, q, rate, zeros, zeros, ones, times)
    tail = Setpoints(*(column[:1] for column in (times, q[-1:], rate, zeros, zeros, ones, times)))
    return Chunk(whole, tail, Wait.PROGRAM_STOP)


def played(model, q, periods, learnt=None):
    """Positions of the tables in so many periods; q is played after ten at rest."""
    inner = SimulatedDrives(TIRED, T, q[0])
    drives = CompensatedDrives(inner, model, T, learnt)
    endless = np.tile([-np.inf, np.inf], (5, 1))
    cycle = Cycle(T, endless, np.full(5, np.inf), 4, drives.step, drives.memory)
    cycle.place(q[0])
    for _ in range(10):
        cycle.step()
    cycle.start(cycle.push(chunk(q)))
    weights = []
    for _ in range(periods):
        cycle.step()
        weights.append((drives.memory.view(np.int64)[ROW], drives.memory.view(np.int64)[LEFT]))
    return cycle.read().position[10:], np.array(weights), drives


def error(model, setpoint, feedback):
    return measured_error(TIRED, T, Compensation(model, T, setpoint[0]).lead, setpoint, feedback)


@pytest.mark.parametrize('up_and_down', [True, False])
def test_two_runs_take_four_fifths_of_the_error_out(up_and_down):
    model, q = wrong(up_and_down), program()
    setpoint, learnt, tips = with_hold(q, T), None, []
    lead, first = Compensation(model, T, q[0]).lead, start_of(q)
    assert first == 2 and np.any(setpoint[1] != setpoint[0])
    assert start_of(q[:2]) == 1, 'nothing moves yet'
    for _ in range(4):
        found = played(model, q, len(q) + round(HELD / T), learnt)[0][first:]
        tips.append(error(model, setpoint, found)[:, 0].max())
        # As in a bag: feedback ends with the last setpoint of the program.
        known, before = found[: len(q) - first], learnt.rate if learnt else None
        learnt = motion_of(setpoint, learnt_rates(model, T, lead, setpoint, known, before))
        assert not learnt.rate[0].any() and not learnt.rate[-1].any()
    assert tips[2] < 0.2 * tips[0]
    assert tips[3] < 0.22 * tips[0]  # it does not come back


def test_what_is_learnt_moves_a_drive_with_friction_by_its_error():
    plain = {'static': 0.0, 'backlash': 0.0, 'mode_frequency': 0.0, 'resolution': 0.0}
    drive, load = replace(TIRED.drives[0], **plain), replace(TIRED.limits.loads[0], coulomb=0.0)
    viscous = 0.5 * load.inertia / drive.time_constant
    model = replace(TIRED, drives={0: drive}).having(load={0: replace(load, viscous=viscous)})
    setpoint, error = np.zeros((1200, 5)), np.zeros((1200, 5))
    error[300:700, 0] = 1e-4 * np.sin(np.linspace(0.0, np.pi, 400)) ** 4
    rates = learnt_rates(model, T, Compensation(model, T, setpoint[0]).lead, setpoint, -error)
    moved = follow_all(words_of(model, T, setpoint[0]), setpoint, rates)[0]
    assert np.abs(moved - error).max() < 1e-3 * error.max()


def test_the_cycle_adds_each_learnt_row_to_its_setpoint_bit_for_bit():
    q, model = program(), wrong(True)
    setpoint = with_hold(q, T)
    rate = 1e-3 * np.sin(np.linspace(0.0, np.pi * 5, len(setpoint)))[:, None] * np.ones(5)
    rate[-1] = 0.0
    found, rows, drives = played(model, q, len(q) + 320, motion_of(setpoint, rate))
    assert drives.lag == Compensation(model, T, q[0]).lead
    count, first = len(q) - 2 + round(HELD / T), start_of(q)
    # From rest, all rows in order; at the end it plays none.
    assert np.array_equal(rows[first : first + count, 0], np.arange(count))
    assert not rows[first + count :, 0].any() and np.all(rows[:, 1] == 15.0)
    compensation = Compensation(model, T, setpoint[0])
    sent, rates = compensate_all(compensation.words, compensation.known, setpoint)
    x = follow_all(words_of(TIRED, T, setpoint[0]), sent, rates + rate)[0]
    assert np.array_equal(found[first : first + count], x)


def test_other_setpoints_are_played_as_if_nothing_were_learnt():
    q, model = program(), wrong(True)
    rate = np.full((len(with_hold(q, T)), 5), 1e-3)
    rate[[0, -1]] = 0.0
    other = q + 1e-12
    plain, *_ = played(model, other, len(q))
    found, rows, _ = played(model, other, len(q), motion_of(with_hold(q, T), rate))
    assert np.array_equal(found, plain) and not rows[:, 0].any()
    # Without it, the cycle is that of the simulation.
    assert np.array_equal(plain, simulate(TIRED, T, other, None, model).position)


def slowed(q, at, way=60):
    """A program whose path time stops at a row, rests, and goes on."""
    slow = at + way / 2 * (1 - (1 - np.linspace(0, 1, way)) ** 2)
    fast = slow[-1] + way / 2 * np.linspace(0, 1, way) ** 2
    rest = np.full(300, slow[-1])
    time = np.concatenate([np.arange(at), slow, rest, fast, np.arange(fast[-1] + 1, len(q))])
    row = np.arange(len(q))
    q = np.stack([np.interp(time, row, column) for column in q.T], axis=1)
    return q


def test_a_hold_fades_what_was_learnt_and_leaves_the_error_of_the_model():
    q, model = program(), wrong(True)
    setpoint, first, lead = with_hold(q, T), start_of(q), Compensation(model, T, q[0]).lead
    rate = None
    for _ in range(2):
        learnt = None if rate is None else motion_of(setpoint, rate)
        found = played(model, q, len(q), learnt)[0][first:]
        rate = learnt_rates(model, T, lead, setpoint, found, rate)
    held = slowed(q, 230)
    plain, *_ = played(model, held, len(held) + 300)
    kept, rows, drives = played(model, held, len(held) + 300, motion_of(setpoint, rate))
    # The position setpoints that the drives get are the same; only rates differ.
    assert np.array_equal(drives.position, held[-1])
    left, at = round(FADE / T), int(np.argmax(rows[:, 1] < 15.0))
    assert 225 < at < 240 and np.array_equal(rows[at : at + left, 1] % 15, np.arange(left)[::-1])
    assert not rows[at + left :, 0].any()
    steps = np.abs(np.diff(0.5 - 0.5 * np.cos(np.pi * np.arange(left + 1) / left)))
    assert steps.max() < 2.0 / left
    tips = [error(model, with_hold(held, T), x)[:, 0] for x in (plain, kept)]
    assert tips[1].max() < 1.05 * tips[0].max()
    assert tips[1][first:at].max() < 0.3 * tips[0][first:at].max()
    # Long after it the motion is that of the model alone.
    assert tips[1][at + 200 :].max() < 1.05 * tips[0][at + 200 :].max()


def test_the_positions_that_are_sent_do_not_depend_on_what_was_learnt():
    q, model = program(), wrong(True)
    setpoint = with_hold(q, T)
    rate = np.full_like(setpoint, 2e-3)
    rate[[0, -1]] = 0.0
    told = []
    for learnt in (None, motion_of(setpoint, rate)):
        drives = CompensatedDrives(SimulatedDrives(TIRED, T, q[0]), model, T, learnt)
        endless = np.tile([-np.inf, np.inf], (5, 1))
        cycle = Cycle(T, endless, np.full(5, np.inf), 4, drives.step, drives.memory)
        cycle.place(q[0])
        cycle.start(cycle.push(chunk(q)))
        rows = []
        for _ in q:
            cycle.step()
            rows.append(drives.memory[-10:].reshape(2, 5).copy())
        told.append(np.array(rows))
    assert np.array_equal(told[0][:, 0], told[1][:, 0])
    added = told[1][3:, 1] - told[0][3:, 1]
    assert np.allclose(added, 2e-3, atol=1e-15)
    assert len(drives.memory) > HEAD


def test_a_file_is_read_back_and_one_for_something_else_is_refused(tmp_path):
    q = program()
    rate = np.zeros_like(with_hold(q, T))
    rate[5:9] = 1e-3
    motion, file = motion_of(with_hold(q, T), rate), tmp_path / 'learnt.npz'
    motion.save(file)
    found = learnt_for(file, 'xyzac_tired', 'xyzac_tired', T)
    assert np.array_equal(found.setpoint, motion.setpoint)
    assert np.array_equal(found.rate, rate) and found.rate.flags.c_contiguous
    other = tmp_path / 'other.yaml'
    other.write_text(find_machine_file('xyzac_tired').read_text() + '\n# changed\n')
    for told, match in (
        (('xyzac_tired', '', T), 'name its model with --compensate'),
        (('xyzac_tired', str(other), T), 'with another model than'),
        ((str(other), 'xyzac_tired', T), 'on another machine than'),
        (('xyz', 'xyzac_tired', T), 'on another machine than'),
        (('xyzac_tired', 'xyzac_tired', 2 * T), 'with a period of 1 ms, not 2 ms'),
    ):
        with pytest.raises(InterpError, match=match):
            learnt_for(file, *told)
    fast = rate.copy()
    fast[7, 0] = 1e3
    for what, match in (
        (motion_of(motion.setpoint, fast), 'more than the largest velocity'),
        (motion_of(motion.setpoint, rate + 1e-3), 'begin and end with 0'),
        (motion_of(motion.setpoint, np.where(rate > 0, np.nan, rate)), 'is not a file'),
        (motion_of(motion.setpoint, rate[:-1]), 'is not a file'),
    ):
        what.save(file)
        with pytest.raises(InterpError, match=match):
            learnt_for(file, 'xyzac_tired', 'xyzac_tired', T)
    file.write_bytes(b'PK\x03\x04 no file')
    with pytest.raises(InterpError, match='is not a file that `learn` wrote'):
        LearntMotion.load(file)
    with pytest.raises(InterpError, match='cannot be read'):
        LearntMotion.load(tmp_path / 'none.npz')
