"""The feedrate node: ``segments`` in, ``setpoints`` out, never further ahead than the window."""

from __future__ import annotations

import math
import sys
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from importlib import import_module
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import MachineState, PathSegment, SetpointChunk
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn

from cnc_interp.core.errors import InterpError, StreamError
from cnc_interp.core.units import MS
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.nodes import parameters
from cnc_interp.nodes.diagnostics import OK, Diagnostics
from cnc_interp.nodes.kernel_warmup import warm_all
from cnc_interp.nodes.node_main import run_node, start_lifecycle, transition
from cnc_interp.nodes.operator_settings import Wishes
from cnc_interp.nodes.peers import SenderWatch
from cnc_interp.nodes.qos import STATE
from cnc_interp.nodes.stream_ends import Inlet, Outlet
from cnc_interp.run.chunk import Chunk, Wait
from cnc_interp.run.motion_plan import MotionPlan
from cnc_interp.run.run_id import NO_RUN
from cnc_interp.run.run_planner import RunPlanner
from cnc_interp.wire.chunk_messages import chunk_message
from cnc_interp.wire.message_checks import check_segment
from cnc_interp.wire.path_messages import segments_from
from cnc_interp.wire.run_id_messages import run_id_of
from cnc_interp.wire.window_protocol import WindowedReceiver

#: Segments taken over together.
BATCH = 64
#: Motion sampled beyond what was sent [s]; the rest of what is planned waits unsampled.
SAMPLED = 0.6
#: How long after a revision that failed the next is tried [s].
TRY_AGAIN = 0.02
#: The old plan goes on while a revision is still computed and the machine holds less [s]; but
#: behind so many in a row that came too late, the next is given all the time that it needs.
RESERVE, MOST_LATE = 0.1, 5
ON_HOLD = (MachineState.HELD, MachineState.STARVED)


class FeedrateNode(LifecycleNode):
    """Plans the motion along one program after another."""

    def __init__(self) -> None:
        super().__init__('feedrate_node')
        self._values = parameters.declare(self, parameters.FEEDRATE)
        self._active = False
        self._segments: deque[PathSegment] = deque()
        self._planner: RunPlanner | None = None
        self._state: MachineState | None = None
        self._run_id = NO_RUN
        self._sent_before = 0  # setpoints, in the plans of the run before this one
        self._known = False  # the run to the machine
        self._worker = ThreadPoolExecutor(1, thread_name_prefix='plan')
        self._job: Future[Any] | None = None
        self._done: Callable[[Any], None] = self._queue
        self._end_wanted = self._ended = self._end_sent = False
        self._tried = self._submitted = 0.0
        self._late = 0  # revisions in a row that came too late
        self._ready = self._longest = 0.0  # motion at hand; longest step since the last word [s]
        self._period: float = self._values['interpolation_period']
        if self._values['autostart']:
            start_lifecycle(self)

    def on_configure(self, _state: Any) -> TransitionCallbackReturn:
        """Read the machine, load every kernel, open the streams."""
        return transition(self, self._configure)

    def _configure(self) -> None:
        values = self._values
        self._transform = Transform.of(Machine.load(values['machine']))
        warm_all(self._transform, self._period)
        # Its imports take half a second; nobody needs it before a window is tried again.
        self._worker.submit(import_module, 'cnc_interp.feedrate.toppra_stage')
        self._diagnostics = Diagnostics(self)
        self._watch = SenderWatch(
            self, self._diagnostics, 'segments', 'lookahead_node', values['peer_timeout'],
            heartbeat='blocks',
        )  # fmt: skip
        self._outlet = Outlet(
            self, 'setpoints', SetpointChunk, values['resend_after'], self._encode
        )
        self._inlet = Inlet(
            self, WindowedReceiver('segments', values['segment_window']), PathSegment,
            self._check, self._take, self._end, self._diagnostics,
        )  # fmt: skip
        self.create_subscription(MachineState, 'machine_state', self._see_machine, STATE)
        self._wishes = Wishes(self, self._diagnostics, self._work)
        self.create_timer(0.005, self._work)
        self.create_timer(1.0, self._tell_planning)

    def on_activate(self, state: Any) -> TransitionCallbackReturn:
        """Begin to take programs."""
        self._active = True
        return super().on_activate(state)

    def on_deactivate(self, state: Any) -> TransitionCallbackReturn:
        """Take no more segments; what the machine holds is executed."""
        self._active = False
        return super().on_deactivate(state)

    def _see_machine(self, state: MachineState) -> None:
        """Keep what the machine said last, and whether it is on the run."""
        self._state = state
        if self._run_id and run_id_of(state).same_attempt(self._run_id):
            self._known = not state.completed

    def _check(self, segment: PathSegment) -> None:
        """Let segments in while the node is active."""
        if not self._active:
            raise StreamError(f'{self.get_name()} is not active; activate it, then start again')
        check_segment(segment)

    def _take(self, segment: PathSegment) -> None:
        """Queue a sound segment; the first one begins a run."""
        if segment.sequence == 0:
            self._planner, self._state, self._job, self._known = None, None, None, False
            self._end_wanted = self._ended = self._end_sent = False
            self._segments.clear()
            self._run_id, self._sent_before = run_id_of(segment), 0
            self._outlet.sender.begin(self._run_id)
            self._outlet.paused = False
        self._segments.append(segment)
        self._end_wanted = self._end_wanted or segment.end_of_program
        self._watch.hear()

    def _end(self) -> None:
        """Bring the motion to rest at the end of the path known so far."""
        self._end_wanted = True

    def _work(self) -> None:
        """Send what may be sent; then the most urgent thing that the planning thread can do."""
        self._outlet.pump()
        receiver, planner = self._inlet.receiver, self._planner
        if self._job is not None:
            self._collect()
            self._keep_fed()
        elif reason := self._outlet.refusal or self._given_up():
            self._segments.clear()
            self._planner = None
            self._outlet.sender.begin(NO_RUN)  # what is on its way is not sent again
            if not receiver.refusal:
                self._inlet.refuse(receiver.run_id, reason)
        elif planner is None:
            self._begin_run()
        elif self._machine_left_the_plan():
            self._resume(planner)
        elif self._must_revise(planner):
            self._revise(planner)
        else:
            self._go_on(planner)

    def _given_up(self) -> str:
        """Say that the machine has left the run for good: by a reset, or it was restarted."""
        state = self._state
        known = self._known and state is not None
        left = known and not run_id_of(state).same_attempt(self._run_id)
        return 'machine_node has given up this run; run the program again' if left else ''

    def _begin_run(self) -> None:
        """Begin the run once the machine has said where it stands at rest."""
        state = self._state
        if not self._segments or state is None:
            return
        first = self._segments[0]
        goes_on = self._run_id.attempt > 0
        # With cycle_start pressed it would have left the hold, had it enough of the old plan.
        held = state.state == MachineState.HELD and (state.plan_over or state.start_wanted)
        starved = state.state == MachineState.STARVED and state.plan_over
        if state.state == MachineState.IDLE or starved or (held and goes_on):
            # It may have executed something since the rest of the program was asked for.
            mine = goes_on and state.program_id == self._run_id.program_id
            self._planner = RunPlanner(
                self._transform, first.flank_height, self._period, self._values['chunk_size'],
                np.array(state.commanded_positions),
                state.path_position if mine else first.continue_at,
                self._wishes.settings,
            )  # fmt: skip

    def _machine_left_the_plan(self) -> bool:
        """Tell whether the machine has followed a stop tail and rests."""
        state = self._state
        return (
            state is not None
            and run_id_of(state) == self._run_id
            and state.plan_over
            and state.state in ON_HOLD
        )

    def _resume(self, planner: RunPlanner) -> None:
        """Plan anew from where the machine rests."""
        assert self._state is not None
        self._run_id = self._run_id.next_plan()
        self._sent_before += self._outlet.sender.sent
        self._end_sent = False
        self._outlet.sender.begin(self._run_id)
        self._submit(self._queue, planner.resume, self._state.path_position, self._wishes.settings)

    def _must_revise(self, planner: RunPlanner) -> bool:
        """
        Tell whether override or single block have changed for setpoints that are not sent.

        The machine is given all that it may hold first, so that a revision has time.
        """
        sender, stream = self._outlet.sender, planner.stream
        return (
            self._wishes.settings != stream.settings
            and sender.sent > 0
            and (sender.unsent > 0 or not (stream.can_sample or stream.can_plan))
            and not self._end_sent
            and time.monotonic() - self._tried > TRY_AGAIN
        )

    def _revise(self, planner: RunPlanner) -> None:
        """
        Plan anew behind the last setpoint that was sent; until then nothing is sent.

        If that takes too long the old plan goes on; from another place it is mostly faster.
        """
        self._outlet.paused = True
        self._submit(
            self._revised, planner.stream.revision, self._outlet.sender.sent - 1,
            self._wishes.settings,
        )  # fmt: skip

    def _keep_fed(self) -> None:
        """Let the old plan go on, if it does, before the machine has nothing left."""
        peer, goes_on = self._outlet.peer, self._outlet.sender.unsent > 0
        short = peer is not None and peer.buffered_time < RESERVE
        if self._outlet.paused and short and goes_on and self._late < MOST_LATE:
            self._outlet.paused = False
            self._outlet.pump()

    def _revised(self, revision: MotionPlan | None) -> None:
        late = not self._outlet.paused
        if revision is not None and not late and self._planner is not None:
            self._planner.stream.adopt(revision)
            self._outlet.sender.drop_unsent()
        self._late = self._late + 1 if late else 0
        self._outlet.paused = False
        self._tried = time.monotonic()
        self._outlet.pump()

    def _go_on(self, planner: RunPlanner) -> None:
        """Sample and plan ahead; take segments when little is left to plan."""
        unsent = self._outlet.sender.unsent * self._period
        stream = planner.stream
        sample = unsent < SAMPLED and stream.can_sample
        self._ready = unsent + stream.planned
        ahead = self._ready < self._values['plan_ahead']
        state = self._state
        mine = state is not None and run_id_of(state).same_attempt(self._run_id)
        executed = state.path_position if state is not None and mine else -math.inf
        wants = ahead and not stream.has_path
        self._watch.look(wants and not self._segments and self._inlet.receiver.active)
        if sample or (ahead and stream.can_plan):
            self._submit(self._queue, planner.work, sample, executed)
        elif wants and self._segments:
            batch = [self._segments.popleft() for _ in range(min(BATCH, len(self._segments)))]
            pauses = {int(s.last_block) for s in batch if self._wishes.pauses_behind(s)}
            self._submit(
                lambda _: self._inlet.receiver.consume(len(batch)), planner.push,
                segments_from(batch), pauses,
            )  # fmt: skip
        elif self._end_wanted and not self._ended and not self._segments:
            self._ended = True
            self._submit(lambda _: None, planner.finish)

    def _submit(self, done: Callable[[Any], None], work: Callable[..., Any], *values: Any) -> None:
        """Have something done by the planning thread."""
        self._done, self._submitted = done, time.monotonic()
        self._job = self._worker.submit(work, *values)

    def _collect(self) -> None:
        """Take over what the planning thread has finished, or refuse what cannot be run."""
        job = self._job
        if job is None or not job.done():
            return
        self._job = None
        self._longest = max(self._longest, time.monotonic() - self._submitted)
        try:
            self._done(job.result())
        except InterpError as problem:
            self._inlet.refuse(self._inlet.receiver.run_id, str(problem))
            self._planner = None
        self._work()

    def _tell_planning(self) -> None:
        """Say how much motion was ready beyond what the machine holds, and how long steps take."""
        words = 'at work' if self._planner is not None else 'no program'
        self._diagnostics.say(
            'planning', OK, words, planned_ahead_s=round(self._ready, 2),
            longest_step_ms=round(self._longest / MS, 1),
            setpoints_sent=self._sent_before + self._outlet.sender.sent,
        )  # fmt: skip
        self._longest = 0.0

    def _queue(self, chunks: list[Chunk]) -> None:
        """Give chunks to the sender."""
        for chunk in chunks:
            self._outlet.sender.put(chunk, len(chunk.samples))
        self._outlet.pump()

    def _encode(self, chunk: Chunk, first: int) -> SetpointChunk:
        """Make the message of one chunk."""
        assert self._planner is not None
        self._end_sent = self._end_sent or chunk.wait is Wait.END
        lines_of = self._planner.lines_of
        return chunk_message(
            chunk, lines_of(chunk.samples), lines_of(chunk.tail), self._run_id, first,
            self._period,
        )  # fmt: skip

    def close(self) -> None:
        """End: what was sent is complete with its stop tail."""
        self._active = False
        self._worker.shutdown(wait=False, cancel_futures=True)


def main(arguments: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(FeedrateNode, arguments)


if __name__ == '__main__':
    sys.exit(main())
