"""Outputs and inputs in the rows that a step of HAL's drives writes and reads, without HAL."""

import ctypes

import numpy as np
from numba import carray, cfunc, types

from cnc_interp.core.native import pointer
from cnc_interp.machine import hal_step
from cnc_interp.machine.hal_file import columns_of
from cnc_interp.machine_model.signals import signals

SIGNALS = signals({'signals': 'milling'})
N, OUTPUTS, INPUTS = 3, len(SIGNALS.outputs), len(SIGNALS.inputs)
ROW, SAMPLE = 2 * N + 1 + OUTPUTS, 3 * N + 2 + INPUTS
C_CALL = types.int32(types.uintp, types.uintp, types.uintp)


@cfunc(C_CALL)
def write(stream, row, _number):
    """Keep the row, as the FIFO of streamer does."""
    carray(pointer(stream), 40)[:ROW] = carray(pointer(row), 40)[:ROW]
    return 0


@cfunc(C_CALL)
def read(stream, row, _number):
    """Hand out the sample once; the first value of the stream says whether there is one."""
    kept = carray(pointer(stream), 40)
    if kept[0] == 0.0:
        return -1
    carray(pointer(row), 40)[:SAMPLE] = kept[1 : 1 + SAMPLE]
    kept[0] = 0.0
    return 0


@cfunc(C_CALL)
def zero(_stream, _row, _number):
    return 0


def test_outputs_leave_with_the_row_of_their_period_and_inputs_come_with_the_sample():
    memory = np.zeros(hal_step.block_size(N, OUTPUTS, INPUTS))
    words = memory.view(np.int64)
    words[[hal_step.OUTPUTS, hal_step.INPUTS]] = OUTPUTS, INPUTS
    block = hal_step.block_at(memory.ctypes.data, N)
    block.units[:], block.limits[:] = 1.0, np.inf
    block.is_number[:] = [signal.is_number for signal in SIGNALS.outputs]
    sent, sampled = np.zeros(40), np.zeros(40)
    for word, function in (
        (hal_step.WRITE, write), (hal_step.READ, read), (hal_step.DEPTH, zero),
        (hal_step.OVERRUNS, zero),
    ):  # fmt: skip
        words[word] = function.address
    words[[hal_step.STREAM, hal_step.SAMPLES]] = sent.ctypes.data, sampled.ctypes.data
    words[[hal_step.WANTED, hal_step.PERIOD]] = 1, 1_000_000
    setpoint, feedback = np.zeros((2, N)), np.zeros((4, N))
    step = ctypes.CFUNCTYPE(ctypes.c_int64, *[ctypes.c_int64] * 4)(hal_step.step_hal.address)
    bits = sampled[1 + 2 * N :].view(np.int64)
    bits[N + 1] = 1  # the FIFO was empty
    for values, answers in (
        ([6e3, 1, 0, 1, 0, 5, 0, 1], [1, 0, 0]),
        ([100, 0, 1, 0, 0, 6, 1, 0], [0, 1, 1]),
    ):
        block.outputs[:] = values
        bits[N + 2 : N + 2 + INPUTS] = answers
        sampled[0] = 1.0
        for _ in range(2):  # the first step begins to count rows
            step(memory.ctypes.data, setpoint.ctypes.data, feedback.ctypes.data, N)
        told = sent[2 * N + 1 : ROW]
        for k, (signal, value) in enumerate(zip(SIGNALS.outputs, values, strict=True)):
            found = told[k] if signal.is_number else told[k : k + 1].view(np.int64)[0]
            assert found == value, signal.name
        assert block.inputs.tolist() == answers
    assert columns_of(N, SIGNALS) == ('ffffffbfbbbbfbf', 'ffffff' + 'b' * (N + 2 + INPUTS))
