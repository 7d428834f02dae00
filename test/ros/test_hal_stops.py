"""Outputs at HAL's pins after stops: a fault, an emergency stop, a reset, killed nodes."""

import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

sys.path.append(str(Path(__file__).parents[2] / 'benchmarks'))

import hal as stops
import hal_session

pytestmark = pytest.mark.thorough

#: Deep, because a busy computer without real-time kernel stalls HAL's thread.
DEPTH = 300
#: Outputs but the number of the tool, which never goes off.
WIRES = [k for k, name in enumerate(stops.NAMES) if name != 'tool_number']
SPINDLE, CHANGE = stops.NAMES.index('spindle_forward'), stops.NAMES.index('tool_change')


@pytest.fixture(scope='module')
def hal():
    if reason := hal_session.why_not():
        pytest.skip(reason)
    with stops.stops_session(20) as session:
        yield session


@pytest.fixture(scope='module')
def bench(hal):
    with stops.stops_bench(DEPTH) as bench:
        yield bench


def off_with_the_power(stop):
    """All outputs go off in the very period of the power, and none comes back."""
    last = int(np.flatnonzero(stop.power)[-1])
    assert stop.power[last] and stop.outputs[last, SPINDLE]
    assert not stop.outputs[last + 1 :, WIRES].any()
    return last


@pytest.mark.parametrize('kind', ['contact of the emergency stop', 'fault of an amplifier'])
def test_without_power_axes_stand_and_outputs_are_off_in_the_same_period(hal, bench, kind):
    """The FIFO was drained first: axes went on, and one sped up from 5 to 50 mm/s."""
    stops.recover(hal, bench)
    stop = stops.witnessed_stop(hal, bench, kind)
    assert off_with_the_power(stop) < stop.at
    before, after = stop.speeds
    assert after <= before and stop.stands <= 20  # the lag of the simulated drives


def test_killed_machine_node_takes_spindle_and_coolant_with_the_power(hal, bench):
    """They turned and ran on for ever; only the axes lost their power."""
    stops.recover(hal, bench)
    stop = stops.witnessed_stop(hal, bench, 'kill -9 of machine_node')
    off_with_the_power(stop)


def test_a_reset_while_m6_waits_drops_the_request_at_the_pin(hal, bench):
    stops.recover(hal, bench)
    stop = stops.witnessed_stop(hal, bench, 'reset while M6 waits')
    assert stop.outputs[stop.at - 1, CHANGE] and not stop.outputs[-1, CHANGE]
    assert stop.power[-1]
