"""The feedrate node: ``segments`` in, ``setpoints`` out, never further ahead than the window."""

from __future__ import annotations

import sys
import time
from collections import deque
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import MachineState, PathSegment, SetpointChunk
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn

from cnc_interp.errors import InterpError, StreamError
from cnc_interp.interpolator import Setpoints
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.nodes import parameters
from cnc_interp.nodes.diagnostics import ERROR, Diagnostics
from cnc_interp.nodes.endpoints import Inlet, Outlet
from cnc_interp.nodes.messages import chunk_message, segments_from
from cnc_interp.nodes.planning import RunPlanner, part_of
from cnc_interp.nodes.qos import STATE
from cnc_interp.nodes.running import run_node, start_lifecycle, transition
from cnc_interp.nodes.soundness import check_segment
from cnc_interp.nodes.streams import WindowedReceiver
from cnc_interp.nodes.warming import warm_all

#: Segments planned between two looks at the line: planning must not hold up sending.
BATCH = 32
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
        self._ended = False
        self._heard = 0.0
        if self._values['autostart']:
            start_lifecycle(self)

    def on_configure(self, _state: Any) -> TransitionCallbackReturn:
        """Read the machine, load every kernel, open the streams."""
        return transition(self, self._configure)

    def _configure(self) -> None:
        values = self._values
        self._transform = Transform.of(Machine.load(values['machine']))
        warm_all(self._transform, values['interpolation_period'])
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
            self._planner, self._state, self._ended = None, None, False
            self._segments.clear()
            self._outlet.sender.begin(segment.program_id)
        self._segments.append(segment)
        self._heard = time.monotonic()

    def _work(self) -> None:
        """Send what may be sent, and plan on when the plan gets short."""
        self._outlet.pump()
        receiver = self._inlet.receiver
        if self._outlet.refusal and not receiver.refusal:
            self._inlet.refuse(receiver.program_id, self._outlet.refusal)
        ahead = self._outlet.sender.unsent * self._values['interpolation_period']
        if not self._segments:
            self._watch_sender()
        elif ahead < self._values['plan_ahead'] and self._ready():
            self._plan([self._segments.popleft() for _ in range(min(BATCH, len(self._segments)))])

    def _watch_sender(self) -> None:
        """Give a program up whose segments stopped coming although the window is open."""
        silence = time.monotonic() - self._heard
        if self._inlet.receiver.active and silence > self._values['peer_timeout']:
            reason = f'no segments for {silence:.1f} s; lookahead_node is lost, start it again'
            self._inlet.refuse(self._inlet.receiver.program_id, reason)

    def _ready(self) -> bool:
        """Begin the run once the machine has said where it stands, at rest."""
        if self._planner is None and self._state is not None and self._state.state in AT_REST:
            self._planner = RunPlanner(
                self._transform,
                self._segments[0].flank_height,
                self._values['interpolation_period'],
                np.array(self._state.commanded_positions),
            )
        return self._planner is not None

    def _plan(self, batch: list[PathSegment]) -> None:
        """Plan along some segments; a path that cannot be run is refused."""
        assert self._planner is not None
        try:
            self._queue(self._planner.push(segments_from(batch)), end=False)
        except InterpError as problem:
            self._inlet.refuse(batch[0].program_id, str(problem))
            return
        self._inlet.receiver.consume(len(batch))
        if batch[-1].end_of_program:
            self._end()

    def _end(self) -> None:
        """Bring the motion to rest at the end of the path known so far."""
        if self._planner is None or self._ended or self._outlet.refusal:
            return
        self._ended = True
        try:
            if self._segments:  # sound ones, before the one that was refused
                rest = segments_from(list(self._segments))
                self._segments.clear()
                self._queue(self._planner.push(rest), end=False)
            self._queue(self._planner.finish(), end=True)
        except InterpError as problem:
            self._diagnostics.say('plan', ERROR, str(problem))

    def _queue(self, parts: list[Setpoints], end: bool) -> None:
        """Cut setpoints into chunks for sending."""
        size = self._values['chunk_size']
        for number, part in enumerate(parts, start=1):
            for first in range(0, len(part), size):
                count = min(size, len(part) - first)
                last = end and number == len(parts) and first + count == len(part)
                self._outlet.sender.put((part, first, last), count)
        self._outlet.pump()

    def _encode(self, item: tuple[Setpoints, int, bool], first: int) -> SetpointChunk:
        """Make the message of one chunk."""
        part, row, end = item
        assert self._planner is not None
        samples = part_of(part, row, row + self._values['chunk_size'])
        return chunk_message(
            samples, self._planner.lines_of(samples), self._outlet.sender.program_id, first,
            self._values['interpolation_period'], end,
        )  # fmt: skip

    def close(self) -> None:
        """End: what was sent is complete, nothing more follows."""
        self._active = False


def main(arguments: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(FeedrateNode, arguments)


if __name__ == '__main__':
    sys.exit(main())
