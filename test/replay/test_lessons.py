"""What a recorded run cannot teach is refused in one line that says what to record instead."""

from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from record import record

from cnc_interp.client.bag import Bag
from cnc_interp.client.recorded_lesson import recorded_lesson
from cnc_interp.core.errors import InterpError

FAULTY = Path(__file__).parent / 'faulty'
COMPENSATED = {'machine_node.machine': 'xyzac', 'machine_node.compensation': 'xyzac_tired'}


@pytest.fixture(scope='module')
def held(tmp_path_factory):
    """Record a run with a hold in it."""
    bag = tmp_path_factory.mktemp('bags') / 'held'
    record(bag, 0.0, hold=True)
    return bag


def refused(path, parameters, told):
    with Bag(path) as bag:
        bag.parameters.update(parameters)
        with pytest.raises(InterpError) as refusal:
            recorded_lesson(bag)
    assert str(refusal.value).startswith(f'{path}: ') and told in str(refusal.value)
    assert '\n' not in str(refusal.value)


def test_a_run_that_teaches_nothing_is_refused(held):
    refused(held, {}, 'record a run with --compensate MODEL')
    refused(held, COMPENSATED, 'the run was held, stopped, or had an override; record one without')
    other = COMPENSATED | {'machine_node.machine': 'xyz'}
    refused(held, other, 'was recorded on a machine with other axes than xyz')
    refused(FAULTY, COMPENSATED, 'feedback of setpoint 0 was not recorded; record the run again')
