"""Blocks of one program -> segments of its rounded path, as messages; no ROS calls."""

from __future__ import annotations

from collections import deque

from cnc_interp_msgs.msg import G1Block, PathSegment

from cnc_interp.core.errors import InterpError
from cnc_interp.run.run_id import RunId
from cnc_interp.smoothing.path_smoother import PathSmoother
from cnc_interp.smoothing.segments import PathSegments
from cnc_interp.wire.path_messages import blocks_from, segment_messages
from cnc_interp.wire.run_messages import run_id_of

BATCH = 256
"""Blocks smoothed together."""


class SmoothingRun:
    """The smoothing of one run, by a smoother that has seen no blocks."""

    def __init__(self, first: G1Block, smoother: PathSmoother):
        self.run_id: RunId = run_id_of(first)
        self.blocks: deque[G1Block] = deque()
        self.complete = False  # the last block of the program is smoothed
        self._smoother: PathSmoother | None = smoother
        self._flank_height, self._continue_at = first.flank_height, first.continue_at
        self._sequence = 0
        self._newest: PathSegments | None = None  # held back: it may be the last one
        self._program_stops: dict[int, int] = {}  # by block

    @property
    def can_smooth(self) -> bool:
        """Tell whether there are blocks to smooth."""
        return self._smoother is not None and bool(self.blocks)

    def take(self, block: G1Block) -> None:
        """Queue a block."""
        self.blocks.append(block)
        if block.program_stop:
            self._program_stops[block.sequence] = block.program_stop

    def smooth(self) -> tuple[int, list[PathSegment]]:
        """Smooth the next batch; return its blocks' number and the segments that are complete."""
        assert self._smoother is not None
        batch = [self.blocks.popleft() for _ in range(min(BATCH, len(self.blocks)))]
        self.complete = batch[-1].end_of_program
        return len(batch), self._complete(self._smoother.push(blocks_from(batch)))

    def end(self) -> tuple[list[PathSegment], str]:
        """End the path at rest with the last valid block; return segments, and a fault."""
        if self._smoother is None:
            return [], ''
        smoother, self._smoother = self._smoother, None
        messages, problem = [], ''
        try:
            if self.blocks:
                messages += self._complete(smoother.push(blocks_from(list(self.blocks))))
            messages += self._complete(smoother.finish())
        except InterpError as fault:
            problem = str(fault)
        self.blocks.clear()
        if self._newest is not None:
            messages += self._messages(self._newest, end=True)
            self._newest = None
        return messages, problem

    def _complete(self, segments: PathSegments) -> list[PathSegment]:
        if not len(segments):
            return []
        if self._newest is not None:
            segments = PathSegments.concatenate([self._newest, segments])
        self._newest = segments[-1:]
        return self._messages(segments[:-1], end=False)

    def _messages(self, segments: PathSegments, end: bool) -> list[PathSegment]:
        messages = segment_messages(segments, self.run_id, self._sequence, self._flank_height, end)
        self._sequence += len(messages)
        for message in messages:
            if message.sequence == 0:
                message.continue_at = self._continue_at
            if message.stop:
                message.program_stop = self._stop_after(message.last_block)
        return messages

    def _stop_after(self, block: int) -> int:
        """Return the kind of program stop after a block; M0 where several meet there."""
        passed = [k for k in self._program_stops if k <= block]
        return min((self._program_stops.pop(k) for k in passed), default=G1Block.GO_ON)
