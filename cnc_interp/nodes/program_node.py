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

from cnc_interp.core.errors import StreamError
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.nodes import parameters
from cnc_interp.nodes.diagnostics import CHECKED, OK, WAITING, WARN, Diagnostics
from cnc_interp.nodes.kernel_warmup import warm_kinematics
from cnc_interp.nodes.node_main import run_node
from cnc_interp.nodes.peers import Peers
from cnc_interp.nodes.program_check import prepare
from cnc_interp.nodes.program_queue import Queue
from cnc_interp.nodes.program_run import ProgramRun
from cnc_interp.nodes.qos import LOADED
from cnc_interp.nodes.stream_outlet import Outlet
from cnc_interp.run.run_id import NO_RUN
from cnc_interp.settings.choices import Settings
from cnc_interp.wire.path_messages import block_messages
from cnc_interp.wire.settings_messages import pairs_of

Result = RunProgram.Result
#: Blocks queued for sending at a time, and time between feedbacks [s].
QUEUE, FEEDBACK = 512, 0.1
#: How often a button is pressed until it has had its effect [s].
PRESS_AGAIN = 0.25
#: After a longer pause of its own the node has slept, not the others [s].
FROZEN = 0.5


class ProgramNode(Node):
    """Runs one program after another; goals that come meanwhile wait."""

    def __init__(self) -> None:
        super().__init__('program_node')
        self._values = parameters.declare(self, parameters.PROGRAM)
        self._settings = parameters.settings_of(self._values)
        self._transform = Transform.of(Machine.load(self._values['machine']))
        warm_kinematics(self._transform, Settings())  # a goal may have other settings
        self._run: ProgramRun | None = None
        self._worker = ThreadPoolExecutor(1, thread_name_prefix='prepare')
        self._diagnostics = Diagnostics(self)
        self._peers = Peers(self)
        self._outlet = Outlet(self, 'blocks', G1Block, self._values['resend_after'], self._encode)
        self._loaded = self.create_publisher(LoadedProgram, 'loaded_program', LOADED)
        self._feedback_at = self._worked_at = self._pressed_at = 0.0
        self._queue = Queue(self._answer)
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
        Read the program of a goal and put it into the queue; the timer brings it forward.

        rclpy polls an awaiting execute callback without pause, at most of a core. So the goal is
        only handed to ``execute`` when its result is there.
        """
        run = ProgramRun(handle.request)
        run.preparing = self._worker.submit(
            prepare, handle.request, self._transform, self._settings, run.has_checked
        )
        self._queue.add(run, handle)

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
        if self._run is None and (following := self._queue.next()) is not None:
            self._run, self._goal = following
            self._run.take_turn()
        self._queue.watch()
        run = self._run
        if run is None:
            self._see_unknown_run()
            return
        now = time.monotonic()
        if now - self._worked_at > FROZEN:
            self._peers.trust(now)
        self._worked_at = now
        run.cancelled = run.cancelled or self._goal.is_cancel_requested
        if run.prepared is None:
            outcome = run.see_prepared()
        elif not run.started:
            outcome = run.may_start(self._peers, now, self._values['peer_timeout'])
            if run.started:
                self._outlet.sender.begin(run.run_id)
                self._loaded.publish(run.loaded())
        else:
            run.fill(self._outlet.sender, QUEUE)
            self._outlet.pump()
            outcome = run.watch(self._peers, now, self._values['peer_timeout'])
            self._tell_progress(run, now)
        self._tell_programs(run)
        if outcome is not None:
            self._finish(run, *outcome)
        elif run.started:
            self._help(run)

    def _see_unknown_run(self) -> None:
        """Say what to do where cycle_start was asked for a run that this node has not begun."""
        state = self._peers.state
        if state is not None and state.start_wanted and state.program_id:
            text = 'the program of this run is not known here any more; reset, then run it again'
            self._diagnostics.say('program', WARN, text)

    def _help(self, run: ProgramRun) -> None:
        """Bring a cancelled run to its end, and one that lost a node on again."""
        if run.cancelled:
            self._press('reset' if run.rests else 'feed_hold')
        elif run.may_go_on():
            run.begin_again(self._outlet.sender)

    def _tell_programs(self, run: ProgramRun) -> None:
        """Say what runs, what waits behind it, and what keeps it from going on."""
        waiting = ', '.join(self._queue.names)
        values: dict[str, object] = {WAITING: waiting}
        text = f'running {run.name}'
        if not run.started:
            text = f'checking the program {run.name}: {run.checked:.0%}'
            values[CHECKED] = run.checked
        text += f'; then {waiting}' if waiting else ''
        level, text = (WARN, run.trouble) if run.trouble else (OK, text)
        self._diagnostics.say('program', level, text, **values)

    def _press(self, button: str) -> None:
        """Use a service of the machine, now and then: what goes to a lost node has no answer."""
        now = time.monotonic()
        if now - self._pressed_at > PRESS_AGAIN:
            self._pressed_at = now
            self._buttons[button].call_async(Trigger.Request())

    def _encode(self, row: int, sequence: int) -> G1Block:
        """Make the message of one block."""
        run = self._run
        if run is None or run.prepared is None:
            raise StreamError('a block was asked for after its run')
        blocks = run.prepared.blocks
        (message,) = block_messages(
            blocks[row : row + 1], run.run_id, sequence, run.prepared.settings.flank_height,
            end=sequence == run.last_sequence,
        )  # fmt: skip
        if sequence == 0:
            message.continue_at = run.continue_at
            message.settings = pairs_of(run.prepared.settings)
        return message

    def _tell_progress(self, run: ProgramRun, now: float) -> None:
        """Publish feedback now and then."""
        state = self._peers.state
        if now - self._feedback_at < FEEDBACK or state is None or run.prepared is None:
            return
        if state.program_id != run.run_id.program_id:
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
        self._diagnostics.say('program', level, message, **{WAITING: ''})
        self._outlet.sender.begin(NO_RUN)
        run.close()
        self._run = None
        self._answer(self._goal, result)
        if code != Result.SUCCEEDED:
            self._queue.give_up(run.name)

    def close(self) -> None:
        """End: blocks that were sent are executed, the look-ahead ends the path after them."""
        self._worker.shutdown(wait=False, cancel_futures=True)
        self._server.destroy()


def main(arguments: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(ProgramNode, arguments)


if __name__ == '__main__':
    sys.exit(main())
