"""The program node: action ``run_program`` in, ``blocks`` out within the window."""

from __future__ import annotations

import math
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import G1Block, LoadedProgram
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.node import Node
from std_srvs.srv import Trigger

from cnc_interp.errors import StreamError
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.nodes import parameters
from cnc_interp.nodes.diagnostics import OK, WARN, Diagnostics
from cnc_interp.nodes.endpoints import Outlet
from cnc_interp.nodes.messages import block_messages
from cnc_interp.nodes.peers import Peers
from cnc_interp.nodes.preparing import prepare
from cnc_interp.nodes.program_run import CHECKING, ProgramRun
from cnc_interp.nodes.qos import LOADED
from cnc_interp.nodes.running import run_node
from cnc_interp.nodes.streams import same_run
from cnc_interp.nodes.warming import warm_kinematics

Result = RunProgram.Result
#: Blocks queued for sending at a time, and time between feedbacks [s].
QUEUE, FEEDBACK = 512, 0.1
#: After a longer pause of its own the node has slept, not the others [s].
FROZEN = 0.5


class ProgramNode(Node):
    """Runs one program after another."""

    def __init__(self) -> None:
        super().__init__('program_node')
        self._values = parameters.declare(self, parameters.PROGRAM)
        self._transform = Transform.of(Machine.load(self._values['machine']))
        warm_kinematics(self._transform, parameters.chain_options(self._values).compression)
        self._run: ProgramRun | None = None
        self._worker = ThreadPoolExecutor(1, thread_name_prefix='prepare')
        self._diagnostics = Diagnostics(self)
        self._peers = Peers(self)
        self._outlet = Outlet(self, 'blocks', G1Block, self._values['resend_after'], self._encode)
        self._loaded = self.create_publisher(LoadedProgram, 'loaded_program', LOADED)
        self._feedback_at = self._worked_at = 0.0
        self._asked: Any = None
        self._buttons = {
            name: self.create_client(Trigger, name) for name in ('feed_hold', 'reset')
        }
        self._server = ActionServer(
            self, RunProgram, 'run_program', lambda _: Result(),
            handle_accepted_callback=self._accept,
            goal_callback=lambda _: GoalResponse.ACCEPT,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip
        self.create_timer(0.02, self._work)
        self._diagnostics.say('program', OK, 'no program')

    def _accept(self, handle: Any) -> None:
        """
        Begin the run of a goal; the timer brings it forward.

        rclpy polls an awaiting execute callback without pause, at most of a core. So the goal is
        only handed to ``execute`` when its result is there.
        """
        if self._run is not None:
            busy = f'{self._run.name} is running; wait for its end'
            self._answer(handle, Result(code=Result.BUSY, message=busy))
            return
        run = ProgramRun(handle.request)
        run.preparing = self._worker.submit(
            prepare, handle.request, self._transform, self._values, run.has_checked
        )
        self._run, self._goal = run, handle

    def _answer(self, handle: Any, result: RunProgram.Result) -> None:
        """End a goal with its result."""

        def execute(goal: Any) -> RunProgram.Result:
            if result.code == Result.SUCCEEDED:
                goal.succeed()
            elif result.code == Result.CANCELED and goal.is_cancel_requested:
                goal.canceled()
            else:
                goal.abort()
            return result

        handle.execute(execute)

    def _work(self) -> None:
        """Bring the run forward by one step."""
        run = self._run
        if run is None:
            self._see_unknown_run()
            return
        now = time.monotonic()
        if now - self._worked_at > FROZEN:
            self._peers.trust(now)
        self._worked_at = now
        if self._goal.is_cancel_requested and not run.cancelled:
            run.cancelled = True
            self._press('feed_hold')
        if run.prepared is None:
            outcome = run.see_prepared()
            if outcome is None and run.prepared is None:
                self._diagnostics.say('program', OK, f'{CHECKING}: {run.checked:.0%}')
        elif not run.started:
            outcome = run.may_start(self._peers, now, self._values['peer_timeout'])
            if run.started:
                self._outlet.sender.begin(run.program_id)
                self._loaded.publish(run.loaded())
                self._diagnostics.say('program', OK, f'running {run.name}')
        else:
            run.fill(self._outlet.sender, QUEUE)
            self._outlet.pump()
            outcome = run.watch(self._peers, now, self._values['peer_timeout'])
            self._tell_progress(run, now)
            self._help(run)
        if outcome is not None:
            self._finish(run, *outcome)

    def _see_unknown_run(self) -> None:
        """Say what to do where cycle_start was asked for a run that this node has not begun."""
        state = self._peers.state
        if state is not None and state.start_wanted and state.program_id:
            text = 'the program of this run is not known here any more; reset, then run it again'
            self._diagnostics.say('program', WARN, text)

    def _help(self, run: ProgramRun) -> None:
        """Bring a cancelled run to its end, and one that lost a node on again."""
        if run.cancelled and run.rests:
            self._press('reset')
        elif run.may_go_on():
            run.begin_again(self._outlet.sender)
        level = WARN if run.trouble else OK
        self._diagnostics.say('program', level, run.trouble or f'running {run.name}')

    def _press(self, button: str) -> None:
        """Use a service of the machine; while one is asked, the next waits."""
        if self._asked is None or self._asked.done():
            self._asked = self._buttons[button].call_async(Trigger.Request())

    def _encode(self, row: int, sequence: int) -> G1Block:
        """Make the message of one block."""
        run = self._run
        if run is None or run.prepared is None:
            raise StreamError('a block was asked for after its run')
        blocks = run.prepared.blocks
        (message,) = block_messages(
            blocks[row : row + 1], run.program_id, sequence, run.prepared.options.flank_height,
            end=sequence == run.last_sequence,
        )  # fmt: skip
        if sequence == 0:
            message.continue_at = run.continue_at
        return message

    def _tell_progress(self, run: ProgramRun, now: float) -> None:
        """Publish feedback now and then."""
        state = self._peers.state
        if now - self._feedback_at < FEEDBACK or state is None or run.prepared is None:
            return
        if not same_run(state.program_id, run.program_id):
            return
        self._feedback_at = now
        share = min(1.0, max(0.0, state.path_position / run.prepared.path_length))
        elapsed = state.samples * self._peers.period
        driven = (state.samples - state.approach_samples) * self._peers.period
        self._goal.publish_feedback(
            RunProgram.Feedback(
                sequence=state.sequence,
                line_number=state.line_number,
                progress=share,
                remaining_time=driven * (1.0 - share) / share if share > 0.0 else math.nan,
                elapsed_time=elapsed,
            )
        )

    def _finish(self, run: ProgramRun, code: int, message: str) -> None:
        """End the run and hand its result over."""
        result = run.result(code, message, self._peers, self._outlet.sender.sent)
        level = OK if code == Result.SUCCEEDED else WARN
        self._diagnostics.say('program', level, message)
        self._outlet.sender.begin('')
        run.close()
        self._run = None
        self._answer(self._goal, result)

    def close(self) -> None:
        """End: blocks that were sent are executed, the look-ahead ends the path after them."""
        self._worker.shutdown(wait=False, cancel_futures=True)
        self._server.destroy()


def main(arguments: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(ProgramNode, arguments)


if __name__ == '__main__':
    sys.exit(main())
