"""Outputs and inputs in the rows that a step of HAL's drives writes and reads, without HAL."""

import ctypes

import numpy as np
import pytest

from cnc_interp.machine import hal_step
from cnc_interp.machine.hal_pins import columns_of
from cnc_interp.machine_model.signals import signals

SIGNALS = signals({'signals': 'milling'})
N, OUTPUTS, INPUTS = 3, SIGNALS.wired, len(SIGNALS.inputs)
ANGLE = [signal.name for signal in SIGNALS.inputs].index('spindle_angle')
PACKED, SUMMED = (
    2 * N + sum(s.is_number for s in each) for each in (SIGNALS.wires, SIGNALS.inputs)
)
ROW, SAMPLE = PACKED + 1, SUMMED + 1
C_CALL = ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_void_p] * 3)


def row_at(address):
    return np.ctypeslib.as_array((ctypes.c_double * 40).from_address(address))


@C_CALL
def write(stream, row, _number):
    """Keep the row, as the FIFO of streamer does."""
    row_at(stream)[:ROW] = row_at(row)[:ROW]
    return 0


@C_CALL
def read(stream, row, _number):
    """Hand out the sample once; the first value of the stream says whether there is one."""
    kept = row_at(stream)
    if kept[0] == 0.0:
        return -1
    row_at(row)[:SAMPLE] = kept[1 : 1 + SAMPLE]
    kept[0] = 0.0
    return 0


@C_CALL
def zero(_stream, _row, _number):
    return 0


class Stand:
    """The memory of a step, with streams that keep one row each."""

    def __init__(self):
        self.memory = np.zeros(hal_step.block_size(N, OUTPUTS, INPUTS))
        self.words = self.memory.view(np.int64)
        self.words[[hal_step.OUTPUTS, hal_step.INPUTS]] = OUTPUTS, INPUTS
        self.words[hal_step.TURNS] = ANGLE
        self.block = hal_step.block_at(self.memory.ctypes.data, N)
        self.block.units[:], self.block.limits[:], self.block.home[:] = 1.0, np.inf, -1
        both = *SIGNALS.wires, *SIGNALS.inputs
        self.block.is_number[:] = [signal.is_number for signal in both]
        self.sent, self.sampled = np.zeros(40), np.zeros(40)
        for word, function in (
            (hal_step.WRITE, write),
            (hal_step.READ, read),
            (hal_step.DEPTH, zero),
            (hal_step.OVERRUNS, zero),
        ):
            self.words[word] = ctypes.cast(function, ctypes.c_void_p).value
        streams = self.sent.ctypes.data, self.sampled.ctypes.data
        self.words[[hal_step.STREAM, hal_step.SAMPLES]] = streams
        self.words[[hal_step.WANTED, hal_step.PERIOD]] = 1, 1_000_000
        self.setpoint, self.feedback = np.zeros((2, N)), np.zeros((4, N))
        self.bits = self.sampled[1 + SUMMED :].view(np.int64)
        self.tell(N + 1)  # the FIFO was empty
        step = hal_step.step_hal.address
        self._step = ctypes.CFUNCTYPE(ctypes.c_int64, *[ctypes.c_int64] * 4)(step)

    def tell(self, bit, on=True):
        self.bits[0] = self.bits[0] & ~(1 << bit) | on << bit

    def step(self, actual=None):
        if actual is not None:
            self.sampled[1 : 1 + N] = self.sent[:N]
            self.sampled[1 + N : 1 + 2 * N] = actual
            self.sampled[0] = 1.0
        columns = (self.memory, self.setpoint, self.feedback)
        return self._step(*(column.ctypes.data for column in columns), N)


def test_outputs_leave_with_the_row_of_their_period_and_inputs_come_with_the_sample():
    stand = Stand()
    block = stand.block
    for values, answers in (
        ([6e3, 1, 0, 1, 0, 5, 0, 1], [1, 0, 0, 0]),
        ([100, 0, 1, 0, 0, 6, 1, 0], [0, 7.25, 1, 1]),
    ):
        block.outputs[:] = values
        stand.sampled[1 + 2 * N], bit = answers[ANGLE], N + 2
        for signal, answer in zip(SIGNALS.inputs, answers, strict=True):
            if not signal.is_number:
                stand.tell(bit, answer)
                bit += 1
        stand.sampled[0] = 1.0
        for _ in range(2):  # the first step begins to count rows
            stand.step()
        column, bit, packed = 2 * N, 1, stand.sent[PACKED : PACKED + 1].view(np.int64)[0]
        for signal, value in zip(SIGNALS.wires, values, strict=True):
            found = stand.sent[column] if signal.is_number else packed >> bit & 1
            column, bit = column + signal.is_number, bit + (not signal.is_number)
            assert found == value, signal.name
        assert block.inputs.tolist() == answers
    assert columns_of(N, SIGNALS) == ('fffffffffu', 'fffffffs')


def test_axes_that_are_counted_anew_stay_where_they_are_until_the_machine_knows():
    stand = Stand()
    block, here = stand.block, np.array([1.0, 2.0, 3.0])
    block.home[0] = 2
    for _ in range(2):
        stand.step(here)
    stand.tell(N)
    stand.tell(N + 1, False)
    stand.words[hal_step.POWER] = hal_step.HOLD
    stand.setpoint[0] = here
    stand.tell(N + 2 + 1)
    for actual in ([1.25, 2, 3], [1.5, 2, 3]):
        assert stand.step(np.array(actual)) == 0
    stand.tell(N + 2 + 1, False)
    for actual in ([1.125, 2, 3], here):
        assert stand.step(np.array(actual)) == 0
    assert block.released.tolist() == [1.125, 0.0, 0.0]
    before, by = stand.sent[: 2 * N].copy(), np.array([-7.5, 0.0, 0.25])
    block.shift[:], stand.words[hal_step.SHIFT_ASKED] = by, 1
    for at in (here, here + by, here + by):  # the machine knows a period later
        stand.setpoint[0] = at
        assert stand.step(here) == 0 and stand.words[hal_step.SHIFT_ASKED] == 0
        assert np.array_equal(stand.sent[: 2 * N], before)
        assert np.array_equal(stand.feedback[0], here + by) and not stand.feedback[1].any()
        assert np.array_equal(stand.feedback[2], here + by)
    assert stand.words[hal_step.POWER] == hal_step.FOLLOW
    stand.setpoint[0, 0] += 0.5
    stand.step(here)
    assert np.array_equal(stand.sent[:N], here + [0.5, 0.0, 0.0])


@pytest.mark.parametrize('powered', [True, False])
def test_a_fault_of_an_amplifier_without_power_ends_the_motion_at_once(powered):
    """Else the FIFO was drained, and axes sped up in between; with power the path is kept."""
    stand, here = Stand(), np.array([1.0, 2.0, 3.0])
    for _ in range(2):
        stand.step(here)
    stand.tell(N)
    stand.tell(N + 1, False)
    stand.words[hal_step.POWER] = hal_step.HOLD
    stand.setpoint[0] = here
    for _ in range(4):
        assert stand.step(here) == 0
    stand.setpoint[1, 0] = 500.0
    stand.tell(0)  # the amplifier of X
    stand.tell(N, powered)
    assert stand.step(here) == (-1 if powered else 1) * hal_step.AMPLIFIER
    stand.setpoint[1] = 0.0
    assert stand.step(here) == -hal_step.AMPLIFIER  # at rest it is an alarm


def test_rows_at_rest_are_brought_to_those_wanted_one_by_one():
    words, patience = np.zeros(24, np.int64), hal_step.PATIENCE
    words[hal_step.WANTED] = 3
    for waiting, last in ((4, 0), (1, 2)):
        pushed = [hal_step._rows_to_push(words, waiting, False) for _ in range(2 * patience)]
        assert pushed == 2 * [*[1] * (patience - 1), last]
        assert hal_step._rows_to_push(words, waiting, True) == 1
