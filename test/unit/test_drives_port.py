"""Playback with drives that are not the simulated ones: it knows only the port."""

from dataclasses import replace

import numpy as np
from numba import carray, cfunc, types

from cnc_interp.core.native import pointer
from cnc_interp.machine.drives import (
    AxisFeedback,
    CycleDrives,
    DelayedDrives,
    DriveFaultError,
    Drives,
)
from cnc_interp.machine.playback import Playback
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.run.motion_plan import MotionStream
from cnc_interp.run.run_state import Reason, RunId, State
from cnc_interp.run.setpoints import Wait
from cnc_interp.run.start_place import approach

T = 0.001
MACHINE = Machine.load('xyzac')
START, TARGET = np.array([0.01, 0.0, 0.0, 0.0, 0.5]), np.array([0.03, 0.01, 0.0, 0.1, 0.0])


class RecordingDrives(DelayedDrives):
    """Ideal axes that stand somewhere and write down what they are told."""

    outputs = inputs = np.zeros(0)
    position = None

    def __init__(self, position, fails_at=None, alarms_at=None):
        self.position, self.fails_at, self.alarms_at = position, fails_at, alarms_at
        self.told, self.on, self.stops = [], False, []

    def switch_on(self):
        self.on, self.alarm = True, ''

    def switch_off(self):
        self.on, self.alarm = False, ''

    def close(self):
        self.on = False

    def follow(self, played, stop):
        if self.on:
            if self.fails_at is not None and len(self.told) + len(played) > self.fails_at:
                self.on, self.fails_at = False, None
                raise DriveFaultError('C: encoder lost')
            self.told += zip(played.position, played.velocity, strict=True)
            self.stops.append((len(self.told), stop))
            if self.alarms_at is not None and len(self.told) > self.alarms_at:
                self.alarm, self.alarms_at = 'X: too slow', None
            self.position = played.position[-1]
        return AxisFeedback(played.position, played.velocity, played.position)


def playback_with(drives: Drives) -> Playback:
    return Playback(MACHINE, T, drives, 50)


def chunks():
    stream = MotionStream(MACHINE, T)
    stream.push(approach(Transform.of(MACHINE), 0.03, START, TARGET))
    stream.end_leg(Wait.END)
    found = []
    plan = stream.current
    while plan.can_plan or plan.can_sample:
        found += plan.sample() if plan.can_sample else plan.plan() or []
    return found


def play(drives):
    playback, planned = playback_with(drives), chunks()
    playback.switch_on()
    playback.begin(RunId('p'))
    for chunk in planned:
        playback.push(chunk)
    for _ in range(sum(len(chunk.samples) for chunk in planned) + 5):
        playback.step()
    return playback, planned


def test_other_drives_get_every_setpoint_with_its_velocity_and_nothing_else():
    drives = RecordingDrives(START)
    playback, planned = play(drives)
    assert playback.state.completed and playback.state.state is State.IDLE
    for column, name in enumerate(('position', 'velocity')):
        expected = np.concatenate([getattr(chunk.samples, name) for chunk in planned])
        told = np.array([row[column] for row in drives.told])
        assert np.array_equal(told[: len(expected)], expected)
        held = TARGET if name == 'position' else np.zeros(5)
        assert (told[len(expected) :] == held).all()
    assert not playback.figures.largest_following_error.any()
    assert np.array_equal(playback.feedback.position[-1], TARGET)
    playback.switch_off()
    assert not drives.on and playback.state.state is State.INACTIVE


def test_a_fault_of_a_drive_ends_the_motion_at_once_and_is_named():
    drives = RecordingDrives(START, fails_at=120)
    playback, _ = play(drives)
    assert (playback.state.state, playback.state.reason) == (State.FAULT, Reason.DRIVE_FAULT)
    assert 'C: encoder lost' in playback.state.text
    assert len(drives.told) == playback.plans.played == 120 and not drives.on
    playback.reset()
    assert playback.state.state is State.IDLE and drives.on


def test_an_alarm_of_delayed_drives_stops_on_the_path_they_were_told():
    drives = RecordingDrives(START, alarms_at=120)
    playback, planned = play(drives)
    assert (playback.state.state, playback.state.reason) == (State.FAULT, Reason.DRIVE_FAULT)
    assert 'X: too slow' in playback.state.text
    before, stop = next((n, stop) for n, stop in drives.stops if n == 121)
    stopped = np.array([row[0] for row in drives.told[before:]])
    assert len(stopped) >= len(stop) > 50 and not drives.on
    assert np.array_equal(stopped[: len(stop)], stop.position)
    assert playback.plans.played == before + len(stop) < sum(len(each.samples) for each in planned)
    playback.reset()
    assert playback.state.state is State.IDLE


def test_axes_are_taken_over_where_the_drives_hold_them_at_power_on():
    drives = RecordingDrives(np.zeros(5))
    playback = playback_with(drives)
    drives.position = START  # moved by hand while they were off
    playback.switch_on()
    assert np.array_equal(playback.axes.setpoints[-1], START)
    assert np.array_equal(playback.plans.buffer.newest, np.tile(START, (3, 1)))


def test_a_setpoint_outside_the_travel_never_reaches_the_drives():
    drives = RecordingDrives(START)
    playback, (first, *_) = playback_with(drives), chunks()
    playback.switch_on()
    playback.begin(RunId('p'))
    position = np.tile([2.0, 0, 0, 0, 0], (len(first.samples), 1))
    outside = replace(first, samples=replace(first.samples, position=position), wait=Wait.END)
    playback.push(outside)
    for _ in range(5):
        playback.step()
    assert playback.state.reason is Reason.SETPOINT_REFUSED
    assert 'soft limit: X to 2' in playback.state.text and not np.any(drives.told[-1][0] != START)


@cfunc(types.int64(*[types.uintp] * 3, types.int64))
def fails_after_120(memory, setpoint, feedback, n):
    count, wanted = carray(pointer(memory), 1), carray(pointer(setpoint), 2 * n)
    told = carray(pointer(feedback), 2 * n)
    for i in range(2 * n):
        told[i] = wanted[i]
    moves = 0.0
    for i in range(n):
        moves += abs(wanted[n + i])
    count[0] += moves > 0.0
    return 7 if count[0] > 120.0 else 0


class CompiledDrives(CycleDrives):
    """Ideal axes with a step of their own that fails."""

    outputs = inputs = np.zeros(0)
    position, step = None, int(fails_after_120.address)

    def __init__(self, position):
        self.position, self.memory = position, np.zeros(1)

    def fault(self, number):
        return f'C: error {number}'


def test_the_cycle_stops_at_a_fault_of_a_compiled_drive():
    playback, planned = play(CompiledDrives(START))
    assert playback.state.reason is Reason.DRIVE_FAULT and 'C: error 7' in playback.state.text
    moving = np.concatenate([np.abs(chunk.samples.velocity).max(axis=1) > 0 for chunk in planned])
    assert np.sum(moving[: playback.plans.played]) == 120
    playback.reset()
    assert playback.state.state is State.IDLE
