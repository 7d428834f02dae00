"""Nodes lost in each phase of a run: rows of ``benchmarks/losses.py``, which tries all of them."""

import time
from contextlib import contextmanager

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.action import RunProgram
from losses import PARAMETERS, PROGRAM, ROWS, Row, fault_of, lose, next_program, try_row
from operated import Bench
from std_msgs.msg import Float64

from cnc_interp.nodes.lookahead_node import MOST_TOGETHER
from cnc_interp.run.run_state import RunId

Result = RunProgram.Result

#: Some of each phase, and the one after which the machine held a run that nobody sent any more.
TRIED = [*ROWS[::5], Row('check', 'freeze', ('machine_node',))]

LATE = 0.03  #: Before each message is heard [s].


@pytest.fixture(scope='module')
def benches():
    kept = []
    yield kept
    for bench in kept:
        bench.close()


@contextmanager
def bench_of(benches):
    """Lend the nodes of the row before; after a failure new ones, as its run may not be over."""
    bench = benches.pop() if benches else Bench(PARAMETERS)
    try:
        yield bench
    except BaseException:
        bench.close()
        raise
    benches.append(bench)


@pytest.mark.thorough
@pytest.mark.parametrize('row', TRIED, ids=lambda row: row.name)
def test_after_a_loss_the_goal_ends_and_the_next_program_runs(benches, row):
    with bench_of(benches) as bench:
        assert not fault_of(row, try_row(bench, row))


@pytest.mark.thorough
def test_a_row_is_proven_by_an_ear_that_is_late(benches, monkeypatch):
    """A row beside two busy loops seemed to exceed the limits: its end was not heard yet."""
    with bench_of(benches) as bench:
        spin_once = bench.executor.spin_once

        def late(**wait):
            time.sleep(LATE)
            spin_once(**wait)

        monkeypatch.setattr(bench.executor, 'spin_once', late)
        row = Row('approach', 'freeze', ('lookahead_node',))
        assert not fault_of(row, try_row(bench, row))


def test_a_reset_ends_a_run_that_a_node_forgot_before_it_moved(benches):
    """The machine knows the first attempt only, and the goal stayed."""
    with bench_of(benches) as bench:
        bench.tidy()
        bench.loaded.clear()
        bench.override.publish(Float64(data=0.0))
        bench.spin_until(lambda: bench.state.feed_override == 0.0)
        handle = bench.start(text=PROGRAM)
        bench.spin_until(lambda: bench.loaded)
        first = RunId(bench.loaded[-1].program_id)
        # What is sent together is resent together, and then the run goes on where it began.
        bench.spin_until(lambda: bench.peers.told('segments', first).next_sequence > MOST_TOGETHER)
        lose(bench, Row('start', 'kill', ('feedrate_node',)))
        bench.spin_until(lambda: bench.peers.knows('segments', first.next_attempt()))
        assert bench.press('reset').success
        result = bench.result_of(handle)
        assert (result.code, result.message) == (Result.STOPPED, 'given up by reset')
        bench.override.publish(Float64(data=1.0))
        assert next_program(bench, heard=True)[0] == Result.SUCCEEDED
