"""Nodes lost in each phase of a run: rows of ``benchmarks/losses.py``, which tries all of them."""

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from losses import PARAMETERS, ROWS, Row, fault_of, try_row
from operated import Bench

#: Some of each phase, and the one after which the machine held a run that nobody sent any more.
TRIED = [*ROWS[::5], Row('check', 'freeze', ('machine_node',))]


@pytest.fixture(scope='module')
def bench():
    bench = Bench(PARAMETERS)
    yield bench
    bench.close()


@pytest.mark.thorough
@pytest.mark.parametrize('row', TRIED, ids=lambda row: row.name)
def test_after_a_loss_the_goal_ends_and_the_next_program_runs(bench, row):
    assert not fault_of(row, try_row(bench, row))
