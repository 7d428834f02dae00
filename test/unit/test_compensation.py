"""Drives behind their inverse model: what is sent, what is left at the table and at the tool."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plan_directories import stroke

from cnc_interp.core import MM, UM, MachineError
from cnc_interp.drives.compensation import LATER, Compensation, compensate_all
from cnc_interp.drives.tool_error import tool_error
from cnc_interp.machine.cycle import Cycle
from cnc_interp.machine.simulated_drives import CompensatedDrives, SimulatedDrives, simulate
from cnc_interp.machine_model.axis_drives import AxisDrive
from cnc_interp.machine_model.machine import Machine
from cnc_interp.run.setpoints import Chunk, Setpoints, Wait

TIRED = Machine.load('xyzac_tired')
PERIODS = [2.5e-4, 1e-3, 4e-3]
WAYS = np.array([20 * MM, -8 * MM, 5 * MM, 0.05, -0.1])


def there_and_back(period, rest=0.1):
    """Jerk-limited motion of all axes that turns back three times, then rests."""
    x = stroke(1.0, 2.0, 10.0, 60.0)[0]
    way = np.concatenate([x, x[-1] - x, 0.4 * x, 0.4 * (x[-1] - x)])
    time = np.arange(0.0, len(way) * 1e-3 + rest, period)
    way = np.interp(time, np.arange(len(way)) * 1e-3, way)
    return np.outer(way, WAYS), np.outer(np.gradient(way, period), WAYS)


def left(machine, model, period, q, rate):
    """What the axes are off the setpoints, which they follow later by the same time."""
    found = simulate(machine, period, q, rate, model)
    lead = Compensation(model, period, q[0]).lead
    time = np.arange(len(q)) * period
    late = np.stack([np.interp(time - lead, time, column) for column in q.T], axis=1)
    return late - found.position


@pytest.mark.parametrize('period', PERIODS)
def test_the_positions_that_are_sent_are_the_setpoints_bit_for_bit(period):
    q, _ = there_and_back(period)
    compensation = Compensation(TIRED, period, q[0])
    sent, rates = compensate_all(compensation.words, compensation.known, q)
    for j, words in enumerate(compensation.words):
        n, drive = int(words[LATER]), TIRED.drives[j]
        assert np.array_equal(sent[n:, j], q[:-n, j]) and np.all(sent[:n, j] == q[0, j])
        # With its dead time every axis is later by the same.
        assert n * period + drive.delay == pytest.approx(compensation.lead, abs=0.51 * period)
    assert np.isfinite(rates).all()
    # Where the axes are cut off from it, it is their velocity, about.
    limits = TIRED.max_velocity
    assert np.all(np.abs(rates) < 1.3 * np.abs(np.diff(q, axis=0)).max() / period + 0.05 * limits)


@pytest.mark.parametrize('period', PERIODS)
def test_linear_drives_follow_almost_exactly(period):
    drive = AxisDrive(45.0, 0.9, 5e-3, delay=1.3e-3, mode_frequency=35.0, mode_damping=0.06)
    machine = replace(TIRED, drives=dict.fromkeys(range(5), drive)).having(load={})
    q, rate = there_and_back(period)
    plain = np.abs(q - simulate(machine, period, q, rate).position).max(axis=0)
    off = np.abs(left(machine, machine, period, q, rate)).max(axis=0)
    # At 4 ms the drive sees chords of the setpoints.
    chord = np.abs(np.diff(q, 2, axis=0)).max(axis=0) / 8
    assert np.all(off < 0.01 * plain + 2.0 * chord)


@pytest.mark.parametrize(('period', 'share'), [(2.5e-4, 0.1), (1e-3, 0.1), (4e-3, 0.3)])
def test_tired_drives_keep_a_tenth_of_their_error(period, share):
    q, rate = there_and_back(period)
    plain = np.abs(q - simulate(TIRED, period, q, rate).position)
    off = np.abs(left(TIRED, TIRED, period, q, rate))
    assert np.all(off.max(axis=0) < share * plain.max(axis=0))
    assert np.all(off[-1] < 0.1 * plain[-1] + 1.0 * UM)  # also at rest


def test_a_model_that_is_wrong_by_a_fifth_still_helps():
    q, rate = there_and_back(1e-3)
    plain = tool_error(TIRED, 1e-3, q, rate)
    names = ('position_gain', 'time_constant', 'backlash', 'static', 'delay')
    for factor in (0.8, 1.2):
        drives = {
            j: replace(drive, **{name: factor * getattr(drive, name) for name in names})
            for j, drive in TIRED.drives.items()
        }
        loads = {j: replace(x, coulomb=factor * x.coulomb) for j, x in TIRED.limits.loads.items()}
        wrong = replace(TIRED, drives=drives).having(load=loads)
        found = tool_error(TIRED, 1e-3, q, rate, wrong)
        assert found.tip.max() < 0.5 * plain.tip.max()
        assert found.axis.mean() < 0.5 * plain.axis.mean()


def test_the_error_at_the_tool_is_a_small_part():
    q, rate = there_and_back(1e-3)
    plain = tool_error(TIRED, 1e-3, q, rate)
    found = tool_error(TIRED, 1e-3, q, rate, TIRED)
    assert plain.tip.max() > 50 * UM and found.tip.max() < 0.1 * plain.tip.max()
    assert found.axis.max() < 0.2 * plain.axis.max()
    # Ideal drives with equal lags stay near the path, and their lag is no error.
    ideal = replace(TIRED, drives={}).having(load={})
    assert tool_error(ideal, 1e-3, q, rate).tip.max() < 8 * UM


def chunk(q, rate, tail, tail_rate):
    zeros = np.zeros((len(q) + len(tail), 5))
    ones, times = np.ones(len(zeros), dtype=int), np.zeros(len(zeros))
    parts = [
        Setpoints(
            times[: len(p)],
            p,
            v,
            zeros[: len(p)],
            zeros[: len(p)],
            ones[: len(p)],
            times[: len(p)],
        )
        for p, v in ((q, rate), (tail, tail_rate))
    ]
    return Chunk(*parts, Wait.PROGRAM_STOP)


def test_the_cycle_does_as_the_simulation_and_a_stop_tail_is_compensated_too():
    q, rate = there_and_back(1e-3, rest=0.3)
    after = 300  # what comes then is the tail of a chunk that was left
    drives = CompensatedDrives(SimulatedDrives(TIRED, 1e-3, q[0]), TIRED, 1e-3)
    endless = np.tile([-np.inf, np.inf], (5, 1))
    cycle = Cycle(1e-3, endless, np.full(5, np.inf), 4, drives.step, drives.memory)
    cycle.place(q[0])
    cycle.start(cycle.push(chunk(q[:after], rate[:after], q[after:], rate[after:])))
    cycle.leave()
    for _ in q:
        cycle.step()
    played = cycle.read()
    assert np.array_equal(played.position, simulate(TIRED, 1e-3, q, rate, TIRED).position)
    assert np.array_equal(drives.position, q[-1])
    assert len(np.unique(played.source)) == 2


def test_a_drive_without_feed_forward_cannot_be_compensated():
    drive = AxisDrive(50.0, 0.1, 3e-3)
    machine = replace(TIRED, drives={**TIRED.drives, 2: drive})
    with pytest.raises(MachineError, match=r'drives\.Z\.feed_forward: 0\.1 is too little'):
        Compensation(machine, 1e-3, np.zeros(5))
