"""Nodes lost in each phase of a run: rows of ``benchmarks/losses.py``, which tries all of them."""

import time

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from losses import PARAMETERS, ROWS, Row, fault_of, try_row
from operated import Bench

#: Some of each phase, and the one after which the machine held a run that nobody sent any more.
TRIED = [*ROWS[::5], Row('check', 'freeze', ('machine_node',))]

LATE = 0.03  #: Before each message is heard [s].


@pytest.fixture(scope='module')
def bench():
    bench = Bench(PARAMETERS)
    yield bench
    bench.close()


@pytest.mark.thorough
@pytest.mark.parametrize('row', TRIED, ids=lambda row: row.name)
def test_after_a_loss_the_goal_ends_and_the_next_program_runs(bench, row):
    assert not fault_of(row, try_row(bench, row))


@pytest.mark.thorough
def test_a_row_is_proven_by_an_ear_that_is_late(bench, monkeypatch):
    """A row beside two busy loops seemed to exceed the limits: its end was not heard yet."""
    spin_once = bench.executor.spin_once

    def late(**wait):
        time.sleep(LATE)
        spin_once(**wait)

    monkeypatch.setattr(bench.executor, 'spin_once', late)
    row = Row('approach', 'freeze', ('lookahead_node',))
    assert not fault_of(row, try_row(bench, row))
