"""The look-ahead node: ``blocks`` in, rounded ``segments`` out."""

from __future__ import annotations

import sys
from collections import deque

from cnc_interp_msgs.msg import G1Block, PathSegment
from rclpy.node import Node

from cnc_interp.core.errors import InterpError, Refusal
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.nodes import parameters
from cnc_interp.nodes.diagnostics import Diagnostics
from cnc_interp.nodes.kernel_warmup import warm_lookahead
from cnc_interp.nodes.node_main import run_node
from cnc_interp.nodes.peers import SenderWatch
from cnc_interp.nodes.stream_inlet import Inlet
from cnc_interp.nodes.stream_outlet import Outlet
from cnc_interp.run.path_chain import smoother_of
from cnc_interp.settings.choices import Settings
from cnc_interp.smoothing.path_smoother import PathSmoother
from cnc_interp.smoothing.segments import PathSegments
from cnc_interp.wire.message_checks import check_block
from cnc_interp.wire.path_messages import blocks_from, segment_messages
from cnc_interp.wire.run_id_messages import run_id_of
from cnc_interp.wire.settings_messages import settings_of_block
from cnc_interp.wire.window_protocol import WindowedReceiver

#: Blocks smoothed together, and segments that may wait before smoothing goes on.
BATCH, QUEUE = 256, 1024


class LookaheadNode(Node):
    """Smooths the blocks of one program after another."""

    def __init__(self) -> None:
        super().__init__('lookahead_node')
        self._values = values = parameters.declare(self, parameters.LOOKAHEAD)
        self._transform = Transform.of(Machine.load(values['machine']))
        self._settings = parameters.settings_of(values)
        warm_lookahead(self._transform, Settings())  # a run may have other settings
        self._lookahead: PathSmoother | None = None
        self._flank_height = 0.0
        self._blocks: deque[G1Block] = deque()
        self._last: PathSegments | None = None
        self._diagnostics = Diagnostics(self)
        self._watch = SenderWatch(
            self, self._diagnostics, 'blocks', 'program_node', values['peer_timeout']
        )
        self._outlet = Outlet(
            self, 'segments', PathSegment, values['resend_after'], lambda message, _: message
        )
        self._inlet = Inlet(
            self, WindowedReceiver('blocks', values['block_window']), G1Block, check_block,
            self._take, self._end, self._diagnostics,
        )  # fmt: skip
        self.create_timer(0.01, self._work)

    def _take(self, block: G1Block) -> None:
        """Queue a sound block."""
        if block.sequence == 0:
            self._begin(block)
        self._blocks.append(block)
        if block.program_stop:
            self._program_stops[block.sequence] = block.program_stop
        self._watch.hear()
        if len(self._blocks) >= BATCH:
            self._work()

    def _begin(self, block: G1Block) -> None:
        """Forget the program before."""
        settings = settings_of_block(block, self._settings)
        self._lookahead = smoother_of(self._transform, settings)
        self._flank_height = block.flank_height
        self._blocks.clear()
        self._last = None
        self._program_stops: dict[int, int] = {}
        self._continue_at = block.continue_at
        self._outlet.sender.begin(run_id_of(block))

    def _work(self) -> None:
        """Smooth a batch when the way onward is free, and send what may be sent."""
        self._outlet.pump()
        receiver, outlet = self._inlet.receiver, self._outlet
        if outlet.refused and receiver.active:
            self._inlet.refuse(receiver.run_id, outlet.refused, outlet.refusal_text)
        self._watch.look(self._inlet.receiver.active and not self._blocks)
        if self._blocks and self._lookahead is not None and self._outlet.sender.unsent <= QUEUE:
            self._smooth()

    def _smooth(self) -> None:
        """Smooth the next batch."""
        assert self._lookahead is not None
        batch = [self._blocks.popleft() for _ in range(min(BATCH, len(self._blocks)))]
        try:
            self._send(self._lookahead.push(blocks_from(batch)), end=False)
        except InterpError as problem:
            self._inlet.refuse(run_id_of(batch[0]), Refusal.BAD_PATH, str(problem))
            return
        self._inlet.receiver.consume(len(batch))
        if batch[-1].end_of_program:
            self._end()

    def _end(self) -> None:
        """Bring the path to rest at the last sound block."""
        if self._lookahead is None:
            return
        lookahead, self._lookahead = self._lookahead, None
        rest = blocks_from(list(self._blocks)) if self._blocks else None
        self._blocks.clear()
        try:
            if rest is not None:
                self._send(lookahead.push(rest), end=False)
            self._send(lookahead.finish(), end=True)
        except InterpError as problem:
            self._send_last(end=True)
            self.get_logger().error(str(problem))

    def _send(self, segments: PathSegments, end: bool) -> None:
        """Send segments; the newest waits until it is known whether it is the last."""
        if self._last is not None and len(segments):
            segments = PathSegments.concatenate([self._last, segments])
        elif self._last is not None:
            segments = self._last
        if not len(segments):
            return
        self._last = segments[-1:]
        self._queue(segments[:-1], end=False)
        if end:
            self._send_last(end=True)

    def _send_last(self, end: bool) -> None:
        """Send the segment that was held back."""
        if self._last is not None:
            last, self._last = self._last, None
            self._queue(last, end)

    def _queue(self, segments: PathSegments, end: bool) -> None:
        sender = self._outlet.sender
        for message in segment_messages(
            segments, sender.run_id, sender.next_number, self._flank_height, end
        ):
            if message.sequence == 0:
                message.continue_at = self._continue_at
            if message.stop:
                message.program_stop = self._stop_behind(message.last_block)
            sender.put(message)
        self._outlet.pump()

    def _stop_behind(self, block: int) -> int:
        """Return what the operator wants at a stop; M0 where several meet there."""
        passed = [k for k in self._program_stops if k <= block]
        return min((self._program_stops.pop(k) for k in passed), default=G1Block.GO_ON)

    def close(self) -> None:
        """End: nothing moves here."""


def main(arguments: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(LookaheadNode, arguments)


if __name__ == '__main__':
    sys.exit(main())
