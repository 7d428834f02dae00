"""An arm over the real nodes: motion by hand, lines by hand, a program with hold and stops."""

import json
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

import rclpy
from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState, SetpointChunk
from cnc_interp_msgs.srv import MoveAxes
from limit_use import limit_use
from nodes_under_test import NodesUnderTest
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from cnc_interp.client.recorder import Recorder
from cnc_interp.commands.cli import main
from cnc_interp.core import MM
from cnc_interp.machine_model.machine import Machine
from cnc_interp.nodes import qos
from cnc_interp.processes.node_processes import NODES
from cnc_interp.proof.own_chain import OwnChain

ARM = Machine.load('ur10e')
LIMITS = (ARM.max_velocity, ARM.max_acceleration, ARM.max_jerk)
PROGRAM = """FEDRAT/1500,MMPM
GOTO/-60,-40,20,0,0,1
GOTO/-60,-40,0,0,0,1
GOTO/60,-40,0,0.1,0,0.994987437
GOTO/60,40,0,0,0.1,0.994987437
GOTO/-60,40,5,0,0,1
FINI
"""


class ArmBench(NodesUnderTest):
    def __init__(self):
        super().__init__({node: {'machine': 'ur10e'} for node in NODES})
        self.executed = self.listen('executed_setpoints', SetpointChunk, qos.STREAM)
        self.joints = self.listen('joint_states', JointState, qos.JOINTS)
        self.mover = self.node.create_client(MoveAxes, 'move_axes')
        self.override = self.node.create_publisher(Float64, 'feed_override', qos.OVERRIDE)
        self.spin_until(
            lambda: self.mover.service_is_ready() and self.override.get_subscription_count() > 0
        )

    @property
    def state(self):
        return self.peers.state

    @property
    def place(self):
        """Where the joints rest, once every setpoint that led there was heard."""
        rests = MachineState.IDLE, MachineState.HELD
        self.spin_until(lambda: self.next_state().state in rests)
        place = np.array(self.state.commanded_positions)
        self.spin_until(lambda: np.abs(self.last_heard - place).max() < 1e-9)
        return place

    @property
    def last_heard(self):
        return np.array(self.executed[-1].positions[-6:]) if self.executed else ARM.arm.home

    def move(self, **request):
        answer = self.mover.call_async(MoveAxes.Request(**request))
        self.spin_until(answer.done)
        return answer.result()

    def moved(self, **request):
        """Move by hand; returns tips and axes on the way, by the chain of the proof."""
        start, heard = self.place, len(self.executed)
        found = self.move(**request)
        assert found.success, found.message
        goal = np.array(found.positions)
        self.spin_until(lambda: np.abs(self.next_state().commanded_positions - goal).max() < 1e-9)
        assert np.abs(self.place - goal).max() < 1e-9
        return OwnChain.of(ARM).forward(self.heard(start, heard))

    def begin(self):
        """Start the program, and see the tool on its way."""
        count = len(self.loaded)
        handle = self.start(text=PROGRAM, name='part.apt')
        self.spin_until(lambda: len(self.loaded) > count)
        ours = self.loaded[-1].program_id
        self.spin_until(lambda: self.state.program_id == ours and self.state.path_position > 0.03)
        return handle

    def heard(self, start, first):
        """All setpoints from a rest on, whose messages begin with one, within the limits."""

        def rows():
            parts = [np.reshape(m.positions, (-1, 6)) for m in self.executed[first:]]
            return np.concatenate([start[None], *parts])

        self.spin_until(lambda: len(self.executed) > first)
        end = self.place
        assert np.array_equal(rows()[-1], end)
        assert limit_use(rows(), LIMITS) <= 1.001
        return rows()


@pytest.fixture(scope='module')
def bench():
    bench = ArmBench()
    yield bench
    codes = bench.close()
    assert codes == dict.fromkeys(codes, 0)


def test_it_stands_at_home_and_its_joints_have_the_names_of_the_urdf(bench):
    assert np.abs(bench.place - ARM.arm.home).max() < 1e-12
    bench.spin_until(lambda: bench.joints)
    assert tuple(bench.joints[-1].name) == ARM.arm.joints


def test_the_tool_moves_along_its_axis_and_to_a_pose(bench):
    bench.moved(axes=['J1', 'J6'], values=[0.1, -0.2], relative=True)
    tips, axes = bench.moved(tool=0.05)
    assert np.abs(np.cross(tips - tips[0], axes[0])).max() < 1e-9
    assert np.abs(axes - axes[0]).max() < 1e-9
    assert abs((tips[-1] - tips[0]) @ axes[0] - 0.05) < 1e-9
    wanted = np.array([0.1, 0.2, 0.97])
    tips, axes = bench.moved(tip=[0.02, 0.03, 0.1], axis=wanted.tolist())
    assert np.abs(tips[-1] - [0.02, 0.03, 0.1]).max() < 1e-9
    assert np.abs(axes[-1] - wanted / np.linalg.norm(wanted)).max() < 1e-9


def test_moves_that_it_cannot_make_are_refused(bench):
    bench.spin_until(lambda: bench.next_state().state == MachineState.IDLE)
    found = bench.move(tip=[5.0, 0.0, 0.0])
    assert not found.success and 'no configuration of ur10e reaches this pose' in found.message
    found = bench.move(tool=3.0)
    assert not found.success and 'along its axis' in found.message
    found = bench.move(axes=['J3'], values=[4.0])
    assert not found.success and 'J3 would go to' in found.message


@pytest.mark.thorough
def test_hold_away_override_and_emergency_stop(bench, tmp_path, capsys):
    start, first = bench.place, len(bench.executed)
    listener = rclpy.create_node('recorder', namespace=bench.namespace, context=bench.context)
    bench.executor.add_node(listener)
    recorder = Recorder(listener, tmp_path / 'bag')
    bench.spin_until(recorder.ready)
    handle = bench.begin()
    assert bench.press('feed_hold').success
    bench.spin_until(lambda: bench.state.state == MachineState.HELD)
    place = np.array(bench.place)
    bench.moved(axes=['J1', 'J5'], values=[0.05, 0.05], relative=True)
    assert bench.press('cycle_start').success
    bench.spin_until(lambda: bench.state.state == MachineState.RUNNING)
    result = bench.result_of(handle)
    assert (result.code, result.blocks_executed) == (RunProgram.Result.SUCCEEDED, 4)
    q = bench.heard(start, first)
    # It comes back to the place along the tool.
    back = int(np.flatnonzero(np.abs(q - place).max(axis=1) < 1e-9)[-1])
    tips, axes = OwnChain.of(ARM).forward(q[back - 500 : back + 1])
    assert np.linalg.norm(np.cross(tips - tips[-1], axes[-1]), axis=1).max() < 1e-9
    assert np.ptp((tips - tips[-1]) @ axes[-1]) > 1e-4
    tips, axes = OwnChain.of(ARM).forward(q[-1:])
    assert np.abs(tips - [-0.06, 0.04, 0.005]).max() < 1e-9
    assert np.abs(axes - [0.0, 0.0, 1.0]).max() < 1e-9
    bench.spin_until(recorder.complete)
    bench.executor.remove_node(listener)
    listener.destroy_node()
    recorder.close()
    assert main(['check', str(tmp_path / 'bag')]) == 0
    assert capsys.readouterr().out.endswith('proven\n')
    handle = bench.begin()
    bench.override.publish(Float64(data=0.5))
    bench.spin_until(lambda: bench.state.path_position > 0.1)
    bench.override.publish(Float64(data=1.0))
    assert bench.press('emergency_stop').success
    bench.spin_until(lambda: bench.state.state == MachineState.FAULT)
    bench.result_of(handle)
    assert bench.press('reset').success
    bench.heard(start, first)


def test_a_table_of_poses_gives_the_turn_of_the_tool(bench):
    """From wherever the arm stands, and with what the tool turns to at each pose."""
    turns = Rotation.from_euler('xz', [[180, 0], [180, 20], [175, -15]], degrees=True)
    places = np.array([[-40.0, 0.0, 5.0], [20.0, 10.0, 5.0], [30.0, -20.0, 0.0]])
    rows = np.hstack([places, turns.as_quat()]).tolist()
    lines = [' '.join(map(str, [*row, 1500])) for row in rows]
    text = '\n'.join(['x y z qx qy qz qw feed', *lines])
    start, first = bench.place, len(bench.executed)
    result = bench.run(text=text, name='part.csv')
    assert result.code == RunProgram.Result.SUCCEEDED, result.message
    frames = OwnChain.of(ARM).poses(bench.heard(start, first))
    for place, wanted in zip(places * MM, turns, strict=True):
        away = np.linalg.norm(frames[:, :3, 3] - place, axis=1)
        off = Rotation.from_matrix(frames[away.argmin(), :3, :3]).inv() * wanted
        assert away.min() < 0.03 * MM and off.magnitude() < np.radians(0.1)


def test_an_emergency_stop_before_the_first_motion_ends_the_program(bench):
    """The machine had no setpoint of it, and the goal stayed for ever."""
    stands = bench.place
    bench.override.publish(Float64(data=0.0))
    bench.spin_until(lambda: bench.state.feed_override == 0.0)
    heard = len(bench.diagnostics)
    handle = bench.start(text=PROGRAM, name='part.apt')
    bench.spin_until(lambda: any(t.startswith('planning') for _, t in bench.diagnostics[heard:]))
    assert bench.press('emergency_stop').success
    result = bench.result_of(handle)
    assert (result.code, result.samples) == (RunProgram.Result.STOPPED, 0)
    bench.override.publish(Float64(data=1.0))
    bench.spin_until(lambda: bench.state.feed_override == 1.0)
    assert bench.press('reset').success
    bench.spin_for(1.0)
    assert np.array_equal(bench.place, stands)


def test_lines_by_hand_begin_where_the_tool_stands(bench):
    bench.moved(tip=[0.02, 0.03, 0.1], axis=[0.1, 0.2, 0.97])
    start, first = bench.place, len(bench.executed)
    result = bench.run(text='G91 G1 X10 F600', mdi=True)
    assert result.code == RunProgram.Result.SUCCEEDED, result.message
    q = bench.heard(start, first)
    tips, axes = OwnChain.of(ARM).forward(q)
    assert np.abs(tips[-1] - [0.03, 0.03, 0.1]).max() < 1e-9
    assert np.abs(tips[:, 1:] - [0.03, 0.1]).max() < 1e-9
    assert np.abs(axes - axes[0]).max() < 1e-9


def test_offsets_are_those_of_the_tool_tip(bench):
    tip = OwnChain.of(ARM).forward(bench.place[None])[0][0]
    words = ['offsets', '--json', '--namespace', bench.namespace, '--domain', str(bench.domain)]
    command = [sys.executable, '-m', 'cnc_interp', *words]
    asked = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    bench.spin_until(lambda: asked.poll() is not None)
    told = json.loads(asked.stdout.read())
    assert told['machine'] == {}
    assert [told['work'][letter] for letter in 'XYZ'] == pytest.approx(tip.tolist(), abs=1e-9)
