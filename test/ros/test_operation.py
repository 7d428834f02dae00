"""Real processes: hold, override, single block, stops, nodes frozen and killed in motion."""

import os
import signal

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState, SetpointChunk
from nodes_under_test import NodesUnderTest
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from cnc_interp.kinematics.axis_path import AxisPath, evaluate
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.kinematics.transform import Transform
from cnc_interp.nodes import qos
from cnc_interp.pipeline import ChainOptions, smoothing_options
from cnc_interp.program import ReadOptions, read_text
from cnc_interp.smoothing.lookahead import LookAhead

Result = RunProgram.Result
T = 0.001
MACHINE = Machine.load('xyzac')
TRANSFORM = Transform.of(MACHINE)
LIMITS = (MACHINE.max_velocity, MACHINE.max_acceleration, MACHINE.max_jerk)
WAVES = 6
PROGRAM = (
    'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A15 C30\n'
    + ''.join(
        f'G1 X{20 * k + 10} Y{8 * (k % 2)} A{14 + k % 3} C{30 + 3 * k} F3000\n'
        f'G1 X{20 * k + 20} Y4\n'
        for k in range(WAVES)
    )
    + 'M30\n'
)
BLOCKS = len(read_text(PROGRAM, 'waves.ngc', TRANSFORM, ReadOptions()).blocks) - 1


def path_of_program():
    blocks = read_text(PROGRAM, 'waves.ngc', TRANSFORM, ReadOptions()).blocks
    lookahead = LookAhead(smoothing_options(TRANSFORM, ChainOptions()))
    builder = AxisPathBuilder(TRANSFORM, 0.03)
    parts = [builder.push(lookahead.push(blocks)), builder.push(lookahead.finish())]
    return AxisPath.join([part for part in parts if part is not None])


class Bench(NodesUnderTest):
    """The nodes, the operator's panel, and the record of what the drives were told."""

    def __init__(self):
        super().__init__()
        self.executed = []
        self.node.create_subscription(
            SetpointChunk, 'executed_setpoints', self.executed.append, qos.STREAM
        )
        names = ('feed_hold', 'cycle_start', 'reset', 'emergency_stop')
        self.buttons = {name: self.node.create_client(Trigger, name) for name in names}
        self.switch = self.node.create_client(SetBool, 'single_block')
        self.override = self.node.create_publisher(Float64, 'feed_override', qos.OVERRIDE)
        self.spin_until(lambda: all(c.service_is_ready() for c in self.buttons.values()))

    def press(self, button):
        answer = self.buttons[button].call_async(Trigger.Request())
        self.spin_until(answer.done)
        return answer.result()

    def single_block(self, on):
        answer = self.switch.call_async(SetBool.Request(data=on))
        self.spin_until(answer.done)

    @property
    def state(self):
        return self.peers.state

    def kill(self, node):
        self.watching = False
        os.kill(self.children.process_ids[node], signal.SIGKILL)
        self.spin_until(lambda: self.children.exit_codes[node] is not None)

    def begin(self):
        self.executed.clear()
        self.single_block(False)
        self.override.publish(Float64(data=1.0))
        return self.start(text=PROGRAM)

    def until_at(self, length):
        """Spin until the machine has run so far [m]."""
        self.spin_until(
            lambda: (
                self.state.state == MachineState.RUNNING
                and self.state.approach_samples
                and self.state.path_position > length
            )
        )

    def until_state(self, state):
        self.spin_until(lambda: self.state.state == state)

    def recorded(self):
        """Everything the drives were told in this run, proven."""
        count = self.next_state().samples
        self.spin_until(lambda: sum(len(m.sequences) for m in self.executed) >= count)
        q = np.concatenate([np.reshape(m.positions, (-1, 5)) for m in self.executed])
        s = np.concatenate([m.path_positions for m in self.executed])
        held = np.concatenate([q[:1].repeat(3, 0), q, q[-1:].repeat(3, 0)])
        for order, limit in enumerate(LIMITS, start=1):
            use = np.abs(np.diff(held, order, axis=0)).max(axis=0) / T**order / limit
            assert use.max() <= 1.001, (order, use)
        path = path_of_program()
        on = s >= 0.0
        assert np.abs(q[on] - evaluate(path, s[on])[0]).max() < 1e-9
        assert (np.diff(s) >= -1e-12).all()
        return q, s

    def finish(self, handle):
        result = self.result_of(handle)
        assert (result.code, result.message) == (Result.SUCCEEDED, 'executed to the end')
        assert result.blocks_sent == result.blocks_executed == BLOCKS
        q, s = self.recorded()
        path = path_of_program()
        assert abs(s[-1] - path.s[-1]) < 1e-12 and np.abs(q[-1] - path.q[-1]).max() < 1e-12
        return result, s


@pytest.fixture
def bench():
    running = Bench()
    yield running
    running.close()


def test_hold_and_resume(bench):
    handle = bench.begin()
    for length in (0.01, 0.05, 0.09):
        bench.until_at(length)
        before = bench.state
        assert bench.press('feed_hold').success
        bench.until_state(MachineState.HELD)
        held = bench.next_state()
        assert held.path_position > before.path_position and held.plan_over
        bench.spin_until(lambda plan=held.plan: bench.state.plan == plan + 1)
        assert bench.state.commanded_positions == held.commanded_positions
        assert bench.press('cycle_start').success
    bench.finish(handle)


def test_override_up_and_down_and_zero(bench):
    handle = bench.begin()
    for length, value in ((0.01, 0.3), (0.02, 1.5), (0.04, 0.0)):
        bench.until_at(length)
        bench.override.publish(Float64(data=value))
    bench.spin_until(lambda: bench.state.path_position > 0.04)
    seen = []

    def rests():
        seen.append(bench.state.path_position)
        return len(seen) > 40 and seen[-1] == seen[-40]

    bench.spin_until(rests)
    assert bench.state.state == MachineState.RUNNING
    bench.override.publish(Float64(data=9.0))
    bench.spin_until(lambda: any('9 refused' in text for _, text in bench.diagnostics))
    bench.override.publish(Float64(data=1.0))
    bench.finish(handle)


def test_single_block_rests_behind_every_block(bench):
    handle = bench.begin()
    bench.until_at(0.03)
    bench.single_block(True)
    lines = []
    for _ in range(3):
        bench.until_state(MachineState.HELD)
        lines.append(bench.next_state().line_number)
        assert bench.press('cycle_start').success
        bench.spin_until(lambda: bench.state.state != MachineState.HELD)
    assert lines == list(range(lines[0], lines[0] + 3))
    bench.single_block(False)
    bench.spin_until(
        lambda: bench.state.state != MachineState.HELD or bench.press('cycle_start') is None
    )
    while bench.state.state != MachineState.IDLE:
        if bench.next_state().state == MachineState.HELD:
            bench.press('cycle_start')
    bench.finish(handle)


def test_emergency_stop_ends_on_the_path_and_reset_allows_the_next_run(bench):
    handle = bench.begin()
    bench.until_at(0.03)
    assert bench.press('emergency_stop').success
    result = bench.result_of(handle)
    assert result.code == Result.STOPPED and 'emergency stop' in result.message
    bench.recorded()
    assert not bench.press('cycle_start').success
    assert bench.run(text=PROGRAM).code == Result.STOPPED
    assert bench.press('reset').success
    bench.until_state(MachineState.IDLE)
    bench.finish(bench.begin())


def test_cancelling_holds_on_the_path_and_gives_the_run_up(bench):
    handle = bench.begin()
    bench.until_at(0.03)
    handle.cancel_goal_async()
    result = bench.result_of(handle)
    assert result.code == Result.CANCELED
    assert 0 < result.blocks_executed < BLOCKS
    bench.until_state(MachineState.IDLE)
    bench.finish(bench.begin())


@pytest.mark.parametrize('node', ['feedrate_node', 'lookahead_node', 'program_node'])
def test_a_frozen_node_leaves_the_machine_on_the_path_and_goes_on(bench, node):
    handle = bench.begin()
    bench.until_at(0.01)
    process = bench.children.process_ids[node]
    os.kill(process, signal.SIGSTOP)
    try:
        if node == 'feedrate_node':
            bench.until_state(MachineState.STARVED)
            bench.spin_until(lambda: bench.state.plan_over)
        else:
            bench.spin_until(lambda: bench.state.path_position > 0.05)
    finally:
        os.kill(process, signal.SIGCONT)
    bench.finish(handle)


@pytest.mark.parametrize('node', ['feedrate_node', 'lookahead_node'])
def test_a_killed_node_is_restarted_and_cycle_start_goes_on_from_the_stopped_point(bench, node):
    handle = bench.begin()
    bench.until_at(0.01)
    bench.kill(node)
    if node == 'lookahead_node':  # short enough to be planned to its end without more segments
        bench.press('feed_hold')
    bench.spin_until(lambda: bench.state.plan_over)
    stopped = bench.next_state()
    assert bench.children.revive() == [node]
    bench.spin_until(lambda: any('was restarted' in text for _, text in bench.diagnostics))
    assert bench.next_state().commanded_positions == stopped.commanded_positions
    assert bench.press('cycle_start').success
    bench.finish(handle)


def test_a_killed_program_node_asks_for_reset(bench):
    bench.begin()
    bench.until_at(0.01)
    bench.kill('program_node')
    bench.press('feed_hold')
    bench.spin_until(lambda: bench.state.plan_over)
    assert bench.children.revive() == ['program_node']
    bench.press('cycle_start')
    bench.spin_until(lambda: any('not known here' in text for _, text in bench.diagnostics))
    bench.recorded()
