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
  inputs: {home_x: , home_z: }
"""
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
        yield session


@pytest.fixture(scope='module')
def bench(hal, tmp_path_factory):
    file = tmp_path_factory.mktemp('machine') / 'homed.yaml'
    file.write_text(find_machine_file('xyzac').read_text() + HOMING)
    given = {'machine': f"'{file}'"}
    takes = [n for n, declared in NODES.items() if any(p.name == 'machine' for p in declared)]
    parameters = {node: dict(given) for node in takes}
    parameters['machine_node'] |= {'drives': 'hal', 'hal_depth': 300}
    running = Bench(parameters)
    yield running
    running.close()


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
