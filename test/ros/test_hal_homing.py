"""Homing over HAL: wherever HAL counts from, the machine knows its place by the switches."""

import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

sys.path.append(str(Path(__file__).parents[2] / 'benchmarks'))

import hal_session
from cnc_interp_msgs.msg import MachineState
from cnc_interp_msgs.srv import MoveAxes
from operated import Bench, Result

from cnc_interp.commands.cli import main
from cnc_interp.machine.hal_pins import pins_of
from cnc_interp.machine.homing import BACK
from cnc_interp.machine_model.machine import Machine, find_machine_file
from cnc_interp.machine_model.signals import signals
from cnc_interp.nodes.parameters import NODES

pytestmark = pytest.mark.thorough

HOMING = """
homing:
  switches: {X: -20.0, Z: 15.0}
  order: [[Z], [X]]
signals:
  inputs: {home_x: , home_z: , power_fails: , handwheel: , handwheel_step: , handwheel_x: }
"""
#: Inputs that HAL's signals of these names give.
WIRED = 'power_fails', 'handwheel', 'handwheel_step', 'handwheel_x'
#: Where HAL has the switches [mm]: X is pressed below, Z above it. HAL counts from 0 at its start.
AT = {'x': -35.0, 'z': 4.0}


@pytest.fixture(scope='module')
def hal():
    reason = hal_session.why_not()
    if reason:
        pytest.skip(reason)
    with hal_session.Session(signals=signals(yaml.safe_load(HOMING))) as session:
        session.tell('loadrt', 'comp', 'names=x-home,z-home')
        for k, (axis, at) in enumerate(AT.items()):
            moves, stands = ('in0', 'in1') if axis == 'x' else ('in1', 'in0')
            session.tell('net', f'{axis}-fb', f'{axis}-home.{moves}')
            session.tell('setp', f'{axis}-home.{stands}', str(at))
            session.tell('setp', f'{axis}-home.hyst', '0')
            session.tell('net', f'home-{axis}', f'{axis}-home.out', f'wsum.0.bit.{7 + k}.in')
            session.tell('addf', f'{axis}-home', 'servo-thread')
        pins = pins_of(5, signals(yaml.safe_load(HOMING)))[1]
        for name in WIRED:
            session.tell('net', name, pins[name])
        yield session


@pytest.fixture(scope='module')
def bench(hal, tmp_path_factory):
    running = started(tmp_path_factory.mktemp('machine'))
    yield running
    if running.watching:
        running.close()


def started(folder):
    file = folder / 'homed.yaml'
    file.write_text(find_machine_file('xyzac').read_text() + HOMING)
    given = {'machine': f"'{file}'"}
    takes = [n for n, declared in NODES.items() if any(p.name == 'machine' for p in declared)]
    parameters = {node: dict(given) for node in takes}
    kept = f"'{folder / 'kept.yaml'}'"
    parameters['machine_node'] |= {'drives': 'hal', 'hal_depth': 300, 'position_file': kept}
    bench = Bench(parameters)
    bench.kept = folder / 'kept.yaml'
    return bench


def test_positions_are_those_of_the_switches_and_programs_run_by_them(hal, bench, capfd):
    refused = bench.run(text='G0 X0\nG1 X10 F500')
    assert refused.code == Result.REFUSED and 'X Z must be homed' in refused.message
    command = ['home', '--namespace', bench.namespace, '--domain', str(bench.domain)]
    hal.forget()
    assert main(command) == 0, capfd.readouterr().err
    commanded = hal.periods().commanded
    # No jump at the pins: nothing moves where the positions are counted anew.
    most = Machine.load('xyzac').max_velocity / hal_session.UNITS * 1e-3
    assert (np.abs(np.diff(commanded, axis=0)) <= most).all()

    def compare():
        state = bench.next_state()
        while state.positions != (state := bench.next_state()).positions:
            continue  # what waits in HAL's FIFO is played
        # The switch is seen in the first period after it: two steps at the speed of the way back.
        for i, axis, at in ((0, 'x', -20.0), (2, 'z', 15.0)):
            pin = float(hal.tell('getp', f'{axis}-axis.out'))
            assert abs(1e3 * state.positions[i] - pin - (at - AT[axis])) < 2.0 * BACK * most[i]
        return state

    state = compare()
    assert all(state.homed) and not state.must_home and state.state == MachineState.IDLE
    result = bench.run(text='G0 X0 Z0\nG1 X10 Z5 F1000')
    assert result.code == Result.SUCCEEDED, result.message
    moved = np.subtract(compare().positions, state.positions)[[0, 2]]
    assert (np.abs(moved) > 5e-3).all()
    # From a switch that is pressed, an axis only moves back.
    bench.mover.call_async(MoveAxes.Request(axes=['X'], values=[-0.025]))
    bench.spin_until(lambda: bench.state.positions[0] < -0.0249)
    compare()
    hal.forget()
    assert main([*command, 'X']) == 0
    way = hal.periods().commanded[:, 0]
    assert (np.diff(way) >= -1e-9).all() and np.ptp(way) > 4.0


def at_rest(bench):
    """Return positions that no longer change: what waits in HAL's FIFO is played."""
    state = bench.next_state()
    while state.positions != (state := bench.next_state()).positions:
        continue
    return np.array(state.positions)


def test_a_handwheel_in_hal_moves_by_its_counts(hal, bench):
    before = at_rest(bench)
    hal.tell('sets', 'handwheel_step', '0.2')
    hal.tell('sets', 'handwheel_x', '1')
    hal.tell('sets', 'handwheel', '12')
    wanted = before[0] + 12 * 0.2e-3
    bench.spin_until(lambda: abs(bench.next_state().positions[0] - wanted) < 1e-9)
    hal.tell('sets', 'handwheel_x', '0')
    hal.tell('sets', 'handwheel', '99')
    assert np.array_equal(np.delete(at_rest(bench), 0), np.delete(before, 0))


def test_after_a_power_failure_the_next_start_knows_the_positions_that_hal_counts(hal, bench):
    slow = MoveAxes.Request(axes=['X', 'Z'], values=[0.3, -0.2], speed=0.01)
    begins = at_rest(bench)
    bench.mover.call_async(slow)
    bench.spin_until(lambda: bench.next_state().positions[0] > begins[0] + 1e-3)
    hal.tell('sets', 'power_fails', '1')
    bench.until_state(MachineState.FAULT)
    bench.spin_until(bench.kept.exists)
    stands = at_rest(bench)
    assert begins[0] + 1e-3 < stands[0] < 0.29
    pins = [float(hal.tell('getp', f'{axis}-axis.out')) for axis in 'xz']
    bench.watching = False  # it is closed here already
    bench.close()
    hal.tell('sets', 'power_fails', '0')
    again = started(bench.kept.parent)
    try:
        state = again.next_state()
        assert all(state.homed) and not state.must_home and not bench.kept.exists()
        assert at_rest(again) == pytest.approx(stands, abs=1e-9)
        result = again.run(text='G0 X0 Z0\nG1 X10 Z5 F1000')
        assert result.code == Result.SUCCEEDED, result.message
        moved = at_rest(again)[[0, 2]] - stands[[0, 2]]
        now = [float(hal.tell('getp', f'{axis}-axis.out')) for axis in 'xz']
        # HAL prints seven digits.
        assert np.subtract(now, pins) == pytest.approx(1e3 * moved, abs=2e-5)
    finally:
        again.close()
