"""The record of a periodic thread: quantiles against NumPy's; what it catches up."""

import threading
import time

import numpy as np
import pytest
from numba import carray, cfunc, types

from cnc_interp.core.native import pointer, time_now
from cnc_interp.machine.cycle import Cycle
from cnc_interp.machine.realtime import CLASS, CLASSES, RECORD, Lateness, note_lateness

NANO = 1e-9


def record_of(late):
    record = np.zeros(RECORD, dtype=np.int64)
    for each in late:
        note_lateness(record, int(each))
    return Lateness(record)


@pytest.mark.parametrize('scale', [3e3, 1e5, 5e6])
def test_quantiles_are_those_of_all_wake_ups_to_one_class(scale):
    late = np.random.default_rng(1).exponential(scale, 5000).astype(int)
    record = record_of(late)
    assert record.count == 5000 and record.caught_up == 0
    assert record.largest == late.max() * NANO
    for share in (0.5, 0.99, 0.999, 1.0):
        true = np.quantile(late, share, method='inverted_cdf') * NANO
        assert true <= record.quantile(share) + 1e-12 <= true + CLASS * NANO + 1e-12


def test_too_early_counts_as_in_time_and_too_late_as_the_latest():
    assert record_of([-1_000_000]).quantile(1.0) == 0.0
    record = record_of([-1_000_000, 10 * CLASS * CLASSES])
    assert record.largest == 10 * CLASS * CLASSES * NANO


@cfunc(types.int64(*[types.uintp] * 3, types.int64))
def hesitate(memory, setpoint, feedback, n):
    """A step of drives that once takes 5.5 ms."""
    steps = carray(pointer(memory), 1)
    steps[0] += 1
    if steps[0] == 20:
        spec = np.zeros(2, dtype=np.int64)
        end = time_now(spec) + 5_500_000
        while time_now(spec) < end:
            pass
    return 0


def test_a_clock_that_is_held_up_catches_up_and_counts_that_apart():
    travel = np.array([[-1.0, 1.0]])
    cycle = Cycle(1e-3, travel, np.ones(1), 4, hesitate.address, np.zeros(1))
    cycle.quit(False)
    thread = threading.Thread(target=cycle.run)
    began = time.monotonic()
    thread.start()
    time.sleep(0.2)
    cycle.quit()
    thread.join()
    elapsed = time.monotonic() - began
    lateness = cycle.lateness()
    assert lateness.caught_up >= 5
    assert lateness.largest >= 4e-3, 'it was held up while it ran, not while it slept'
    # No period is lost: catching up, it executes as many as time has passed.
    assert lateness.count + lateness.caught_up >= 0.9 * elapsed / 1e-3
