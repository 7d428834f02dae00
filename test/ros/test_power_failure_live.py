"""A power failure over the real nodes: the next start knows where the axes are."""

import numpy as np
import pytest
import yaml

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import MachineSignals, MachineState
from cnc_interp_msgs.srv import MoveAxes
from operated import Bench, Result

from cnc_interp.commands.cli import main
from cnc_interp.machine_model.machine import find_machine_file
from cnc_interp.nodes.parameters import NODES
from cnc_interp.nodes.qos import STATE

pytestmark = pytest.mark.thorough

MORE = """
homing:
  switches: {X: -20.0, Z: 15.0}
  order: [[X, Z]]
  required: true
signals:
  inputs: {power_fails: , handwheel: , handwheel_step: , handwheel_x: }
"""


def started(folder):
    file = folder / 'homed.yaml'
    file.write_text(find_machine_file('xyzac').read_text() + MORE)
    given = {'machine': f"'{file}'"}
    takes = [n for n, declared in NODES.items() if any(p.name == 'machine' for p in declared)]
    parameters = {node: dict(given) for node in takes}
    parameters['machine_node'] |= {'position_file': f"'{folder / 'kept.yaml'}'"}
    bench = Bench(parameters)
    bench.inputs = bench.node.create_publisher(MachineSignals, 'machine_inputs', STATE)
    bench.spin_until(bench.inputs.get_subscription_count)
    return bench


def tell(bench, **values):
    message = MachineSignals(inputs=list(values), input_values=list(map(float, values.values())))
    bench.inputs.publish(message)


def test_axes_that_were_homed_need_no_homing_after_a_power_failure(tmp_path, capfd):
    file, bench = tmp_path / 'kept.yaml', started(tmp_path)
    try:
        place = ['--namespace', bench.namespace, '--domain', str(bench.domain)]
        assert main(['home', *place]) == 0, capfd.readouterr().err
        # A handwheel over the same topic: 20 counts of 0.5 mm.
        begins = bench.next_state().positions[0]
        tell(bench, handwheel_step=0.5, handwheel_x=1)
        tell(bench, handwheel=20)
        bench.spin_until(lambda: abs(bench.state.positions[0] - begins - 0.01) < 1e-6)
        slow = MoveAxes.Request(axes=['X', 'C'], values=[0.4, 1.0], speed=0.01)
        bench.mover.call_async(slow)
        bench.spin_until(lambda: bench.next_state().positions[0] > begins + 0.011)
        assert not file.exists()
        tell(bench, power_fails=1)
        bench.until_state(MachineState.FAULT)
        state = bench.next_state()
        assert 'the power fails' in state.message and begins + 0.011 < state.positions[0] < 0.39
        bench.spin_until(file.exists)
        bench.press('reset')  # the mains are still gone
        bench.until_state(MachineState.FAULT)
        stands = np.array(bench.next_state().positions)
    finally:
        bench.close()
    kept = yaml.safe_load(file.read_text())
    assert kept['X'] == pytest.approx(1e3 * stands[0], abs=1e-9)
    bench = started(tmp_path)
    try:
        state = bench.next_state()
        assert state.positions == pytest.approx(stands, abs=1e-12)
        assert all(state.homed) and not state.must_home
        assert not file.exists()  # the axes may move now
        result = bench.run(text='G0 X0 Z0\nG1 X10 Z5 F1000')
        assert result.code == Result.SUCCEEDED, result.message
    finally:
        bench.close()
    assert file.exists()  # an orderly end keeps them, too
