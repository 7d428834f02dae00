"""The nodes in operation: an operator's panel, and proof of what the drives were told."""

import os
import signal
import time

import numpy as np
import whole_plans
from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState, SetpointChunk
from cnc_interp_msgs.srv import MoveAxes
from limit_use import limit_use
from nodes_under_test import PATIENCE, NodesUnderTest
from std_msgs.msg import Float64
from std_srvs.srv import SetBool

from cnc_interp.kinematics.axis_path import evaluate
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.nodes import qos
from cnc_interp.program import read_text
from cnc_interp.settings.options import Settings

Result = RunProgram.Result
T = 0.001
MACHINE = Machine.load('xyzac')
TRANSFORM = Transform.of(MACHINE)
LIMITS = (MACHINE.max_velocity, MACHINE.max_acceleration, MACHINE.max_jerk)


def waves(count):
    """A program of corners and turns, to and fro, F 3000."""
    lines = ['G21 G90 G94', 'TRAORI', 'G0 X0 Y0 Z0 A15 C30']
    for k in range(count):
        x = 20 * min(k % 12, 12 - k % 12)
        step = 1 if k % 12 < 6 else -1
        turn = 30 + 3 * min(k % 12, 12 - k % 12)
        lines.append(f'G1 X{x + 10 * step} Y{8 * (k % 2)} A{14 + k % 3} C{turn} F3000')
        lines.append(f'G1 X{x + 20 * step} Y4')
    return '\n'.join([*lines, 'M30', ''])


PROGRAM = waves(12)


def blocks_of(text):
    return read_text(text, 'waves.ngc', TRANSFORM, Settings()).blocks


def path_of(text):
    return whole_plans.path_of(blocks_of(text), TRANSFORM, Settings())


class Bench(NodesUnderTest):
    """The nodes, the operator's panel, and the record of what the drives were told."""

    def __init__(self, parameters=None, arguments=None):
        super().__init__(parameters, arguments)
        self.executed = self.listen('executed_setpoints', SetpointChunk, qos.STREAM)
        self.switches = {
            name: self.node.create_client(SetBool, name)
            for name in ('single_block', 'optional_stop')
        }
        self.override = self.node.create_publisher(Float64, 'feed_override', qos.OVERRIDE)
        self.rapid = self.node.create_publisher(Float64, 'rapid_override', qos.OVERRIDE)
        self.mover = self.node.create_client(MoveAxes, 'move_axes')
        self.spin_until(
            lambda: (
                all(s.service_is_ready() for s in (*self.switches.values(), self.mover))
                and self.rapid.get_subscription_count() > 0
            )
        )

    def tidy(self):
        """Bring all nodes to rest at full overrides, without a program."""
        self.children.revive()
        self.watching = True
        self.spin_until(lambda: not self.peers.missing(time.monotonic(), 1.0))
        self.be_known()  # to those that were started again, too
        self.optional_stop(False)
        self.single_block(False)
        self.override.publish(Float64(data=1.0))
        self.rapid.publish(Float64(data=1.0))
        self.spin_until(lambda: self.state.feed_override == self.state.rapid_override == 1.0)
        if self.next_state().state != MachineState.IDLE:
            assert self.press('emergency_stop').success
            self.until_state(MachineState.FAULT)
            assert self.press('reset').success
            self.until_state(MachineState.IDLE)
        self.diagnostics.clear()
        self.executed.clear()

    def single_block(self, on):
        self.turn('single_block', on)

    def optional_stop(self, on):
        self.turn('optional_stop', on)

    def turn(self, name, on):
        answer = self.switches[name].call_async(SetBool.Request(data=on))
        self.spin_until(answer.done)

    @property
    def state(self):
        return self.peers.state

    def kill(self, node):
        self.watching = False
        os.kill(self.children.nodes[node].process.pid, signal.SIGKILL)
        self.spin_until(lambda: self.children.nodes[node].process.exitcode is not None)

    def start_again(self, node):
        """Start a node that was told to end, which nothing else does."""
        self.children.nodes[node] = self.children._start(node)

    def begin(self, text=PROGRAM):
        self.text = text
        self.executed.clear()
        self.single_block(False)
        self.override.publish(Float64(data=1.0))
        return self.start(text=text)

    def until_at(self, length):
        """Spin until the machine has run so far [m] in the program loaded last."""

        def there():
            state = self.state
            assert state.state != MachineState.FAULT, state.message
            ours = self.loaded and state.program_id == self.loaded[-1].program_id
            runs = state.state == MachineState.RUNNING and state.samples
            return ours and runs and state.path_position > length

        self.spin_until(there)

    def until_state(self, state):
        self.spin_until(lambda: self.state.state == state)

    def heard_whole(self):
        """Wait until everything the drives were told in this run is heard; return its id."""
        self.spin_until(lambda: self.peers.at_rest)  # states heard late are not yet the last
        state = self.next_state()
        run, count = state.program_id, state.samples
        self.spin_until(lambda: sum(len(m.sequences) for m in self.told(run)) >= count)
        return run

    def recorded(self):
        """Everything the drives were told in this run, proven."""
        return self.proven(self.heard_whole(), path_of(self.text))

    def told(self, run):
        return [m for m in self.executed if m.program_id == run]

    def proven(self, run, path, cut=False):
        """What was heard of a run: within the limits, on the path, not back, from rest to rest.

        It is cut where machine_node was lost; a new one may move before it is heard.
        """
        told = self.told(run)
        late = cut and told[0].first_sample > 0
        q = np.concatenate([np.reshape(m.positions, (-1, 5)) for m in told])
        s = np.concatenate([m.path_positions for m in told])
        use = limit_use(q, LIMITS, cut=cut, late=late)
        heard = [(m.attempt, m.plan, m.first_sample, len(m.sequences)) for m in told]
        begins, ends = [m[2] for m in heard], [0, *(m[2] + m[3] for m in heard)]
        assert cut or begins == ends[:-1], ('not heard', heard)
        assert use <= 1.001, (use, heard, s[-1], self.last_words()[0])
        on = s >= 0.0
        assert np.abs(q[on] - evaluate(path, s[on])[0]).max(initial=0.0) < 1e-9
        assert (np.diff(s) >= -1e-12).all()
        return q, s

    def finish(self, handle, patience=PATIENCE):
        result = self.result_of(handle, patience)
        ended = (result.code, result.message)
        assert ended == (Result.SUCCEEDED, 'executed to the end'), ended
        blocks = result.blocks_sent, result.blocks_executed
        assert blocks == 2 * (len(blocks_of(self.text)) - 1,), blocks
        self.spin_until(lambda: self.state.completed)
        q, s = self.recorded()
        path = path_of(self.text)
        assert abs(s[-1] - path.s[-1]) < 1e-12 and np.abs(q[-1] - path.q[-1]).max() < 1e-12
        return result, s
