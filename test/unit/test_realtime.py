"""The record of a periodic thread: quantiles against NumPy's; what it catches up."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from numba import carray, cfunc, types

from cnc_interp.core import StreamError
from cnc_interp.core.native import pointer, time_now
from cnc_interp.machine.cycle import Cycle
from cnc_interp.machine.cycle_kernels import REST, SOURCE
from cnc_interp.machine.realtime import CLASS, CLASSES, RECORD, Lateness, note_lateness
from cnc_interp.nodes.kernel_warmup import resting_chunk
from cnc_interp.run.setpoints import Wait

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
    began = []
    thread = threading.Thread(target=lambda: (began.append(time.monotonic()), cycle.run()))
    thread.start()
    time.sleep(0.2)
    # No period is lost: when the computer lets it, it has executed as many as time has passed.
    for _ in range(500):
        elapsed, lateness = time.monotonic() - began[0], cycle.lateness()
        missing = elapsed / 1e-3 - lateness.count - lateness.caught_up
        if missing < 4:
            break
        time.sleep(0.02)
    cycle.quit()
    thread.join()
    assert missing < 4, 'what a busy computer delays comes later, what is lost never'
    assert lateness.caught_up >= 5
    assert lateness.largest >= 4e-3, 'it was held up while it ran, not while it slept'


class StandingClock(Cycle):
    """A cycle that plays some periods just after a plan has joined."""

    def link(self, after, serial):
        super().link(after, serial)
        for _ in range(self.periods):
            self.step()


@pytest.mark.parametrize(('periods', 'stands'), [(4, False), (6, False), (7, True)])
def test_a_plan_that_joins_does_not_wait_for_ever_for_a_clock_that_stands(periods, stands):
    travel = np.array([[-1.0, 1.0]])
    cycle = StandingClock(1e-3, travel, np.ones(1), 4, hesitate.address, np.zeros(1))
    cycle.periods, chunk = 0, replace(resting_chunk(np.zeros(1), 1e-3), wait=Wait.NOTHING)
    first, second, joins = (cycle.push(chunk) for _ in range(3))
    cycle.link(first, second)
    cycle.start(first)
    cycle.step()
    cycle.periods = periods  # until the first setpoint of the second chunk, its third, its last
    if not stands:
        assert cycle.relink(second, joins)
        return
    with pytest.raises(StreamError, match='machine clock has stopped'):
        cycle.relink(second, joins)
    cycle.step()
    assert cycle._control[SOURCE] == REST
