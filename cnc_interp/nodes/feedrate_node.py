"""The feedrate node: ``segments`` in, ``setpoints`` out, never further ahead than the window."""

from __future__ import annotations

import sys
import time
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from importlib import import_module
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import MachineState, PathSegment, SetpointChunk
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn

from cnc_interp.errors import InterpError, StreamError
from cnc_interp.feedrate.window import PlannedPiece
from cnc_interp.interpolator import Setpoints
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.nodes import parameters
from cnc_interp.nodes.diagnostics import Diagnostics
from cnc_interp.nodes.endpoints import Inlet, Outlet
from cnc_interp.nodes.messages import chunk_message, segments_from
from cnc_interp.nodes.planning import RunPlanner, part_of
from cnc_interp.nodes.qos import STATE
from cnc_interp.nodes.running import run_node, start_lifecycle, transition
from cnc_interp.nodes.soundness import check_segment
from cnc_interp.nodes.streams import WindowedReceiver
from cnc_interp.nodes.warming import warm_all

#: Segments planned together, and setpoints that wait for sending.
BATCH, QUEUE = 64, 500
AT_REST = (MachineState.IDLE, MachineState.STARVED)


class FeedrateNode(LifecycleNode):
    """Plans the motion along one program after another."""

    def __init__(self) -> None:
        super().__init__('feedrate_node')
        self._values = parameters.declare(self, parameters.FEEDRATE)
        self._active = False
        self._segments: deque[PathSegment] = deque()
        self._planner: RunPlanner | None = None
        self._state: MachineState | None = None
        self._pieces: deque[PlannedPiece] = deque()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix='plan')
        self._job: Future[list[PlannedPiece]] | None = None
        self._batch = 0
        self._end_wanted = self._ended = self._all_planned = False
        self._heard = 0.0
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
        self._outlet = Outlet(
            self, 'setpoints', SetpointChunk, values['resend_after'], self._encode
        )
        self._inlet = Inlet(
            self, WindowedReceiver('segments', values['segment_window']), PathSegment,
            self._check, self._take, self._end, self._diagnostics,
        )  # fmt: skip
        self.create_subscription(MachineState, 'machine_state', self._see_machine, STATE)
        self.create_timer(0.005, self._work)

    def on_activate(self, state: Any) -> TransitionCallbackReturn:
        """Begin to take programs."""
        self._active = True
        return super().on_activate(state)

    def on_deactivate(self, state: Any) -> TransitionCallbackReturn:
        """Take no more segments; what the machine holds is executed."""
        self._active = False
        return super().on_deactivate(state)

    def _see_machine(self, state: MachineState) -> None:
        """Keep what the machine said last."""
        self._state = state

    def _check(self, segment: PathSegment) -> None:
        """Let segments in while the node is active."""
        if not self._active:
            raise StreamError(f'{self.get_name()} is not active; activate it, then start again')
        check_segment(segment)

    def _take(self, segment: PathSegment) -> None:
        """Queue a sound segment; the first one begins a run."""
        if segment.sequence == 0:
            self._planner, self._state, self._job = None, None, None
            self._end_wanted = self._ended = False
            self._segments.clear()
            self._pieces.clear()
            self._outlet.sender.begin(segment.program_id)
        self._segments.append(segment)
        self._end_wanted = self._end_wanted or segment.end_of_program
        self._heard = time.monotonic()

    def _end(self) -> None:
        """Bring the motion to rest at the end of the path known so far."""
        self._end_wanted = True

    def _work(self) -> None:
        """Send what may be sent, and plan on when the plan gets short."""
        self._fill()
        self._outlet.pump()
        receiver = self._inlet.receiver
        if self._outlet.refusal:
            self._segments.clear()
            if not receiver.refusal:
                self._inlet.refuse(receiver.program_id, self._outlet.refusal)
        elif self._job is not None:
            self._collect()
        elif self._segments:
            self._plan_on()
        elif self._end_wanted and not self._ended and self._planner is not None:
            self._ended = True
            self._job = self._worker.submit(self._planner.finish)
        elif receiver.active:
            self._watch_sender()

    def _plan_on(self) -> None:
        """Begin the run once the machine has said where it stands at rest; then plan ahead."""
        if self._planner is None:
            state = self._state
            if state is None or state.state not in AT_REST:
                return
            self._planner = RunPlanner(
                self._transform,
                self._segments[0].flank_height,
                self._period,
                np.array(state.commanded_positions),
            )
        if self._planned_ahead() < self._values['plan_ahead']:
            batch = [self._segments.popleft() for _ in range(min(BATCH, len(self._segments)))]
            self._batch = len(batch)
            self._job = self._worker.submit(self._planner.push, segments_from(batch))

    def _planned_ahead(self) -> float:
        """Return the motion time that is planned but not sent [s]."""
        waiting = self._outlet.sender.unsent * self._period
        if self._pieces:
            waiting += self._pieces[-1].law.end_time - float(self._pieces[0].law.time[0])
        return waiting

    def _collect(self) -> None:
        """Take over what the planning thread has finished, or refuse what cannot be run."""
        job = self._job
        if job is None or not job.done():
            return
        self._job = None
        try:
            self._pieces.extend(job.result())
            self._inlet.receiver.consume(self._batch)
        except InterpError as problem:
            self._inlet.refuse(self._inlet.receiver.program_id, str(problem))
        self._batch = 0
        self._all_planned = self._ended
        self._fill()

    def _watch_sender(self) -> None:
        """Give a program up whose segments stopped coming although the window is open."""
        silence = time.monotonic() - self._heard
        if silence > self._values['peer_timeout']:
            reason = f'no segments for {silence:.1f} s; lookahead_node is lost, start it again'
            self._inlet.refuse(self._inlet.receiver.program_id, reason)

    def _fill(self) -> None:
        """Interpolate the next stretches and cut them into chunks for sending."""
        sender = self._outlet.sender
        while self._planner is not None and self._pieces and sender.unsent < QUEUE:
            self._queue(self._planner.samples_of(self._pieces.popleft()), end=False)
        if self._planner is not None and self._all_planned and not self._pieces:
            self._all_planned = False
            last = self._planner.last_sample()
            if last is not None:
                self._queue(last, end=True)

    def _queue(self, samples: Setpoints, end: bool) -> None:
        """Cut setpoints into chunks."""
        size = self._values['chunk_size']
        for first in range(0, len(samples), size):
            part = part_of(samples, first, min(first + size, len(samples)))
            self._outlet.sender.put((part, end), len(part))
        self._outlet.pump()

    def _encode(self, item: tuple[Setpoints, bool], first: int) -> SetpointChunk:
        """Make the message of one chunk."""
        samples, end = item
        assert self._planner is not None
        return chunk_message(
            samples, self._planner.lines_of(samples), self._outlet.sender.program_id, first,
            self._period, end,
        )  # fmt: skip

    def close(self) -> None:
        """End: what was sent is complete, nothing more follows."""
        self._active = False
        self._worker.shutdown(wait=False, cancel_futures=True)


def main(arguments: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(FeedrateNode, arguments)


if __name__ == '__main__':
    sys.exit(main())
