"""The blocks of a run on their way to the look-ahead, a batch at a time."""

from __future__ import annotations

from cnc_interp_msgs.msg import G1BlockBatch

from cnc_interp.core.errors import StreamError
from cnc_interp.nodes.program_check import Prepared
from cnc_interp.run.run_id import NO_RUN, RunId
from cnc_interp.wire.path_messages import block_messages
from cnc_interp.wire.settings_messages import pairs_of
from cnc_interp.wire.window_protocol import WindowedSender

#: Blocks queued for sending at a time; not the whole program.
MOST_QUEUED = 512
#: Most blocks in one message.
MOST_TOGETHER = 64


class BlockFeed:
    """Queue the rows of one program after the other, and make their messages."""

    def __init__(self) -> None:
        self._prepared: Prepared | None = None
        self._run_id, self._continue_at = NO_RUN, 0.0
        self._queued = 0

    def begin(
        self, prepared: Prepared, run_id: RunId, continue_at: float, sender: WindowedSender[slice]
    ) -> None:
        """Begin a run, or begin it again."""
        self._prepared, self._run_id, self._continue_at = prepared, run_id, continue_at
        self._queued = 0
        sender.begin(run_id)

    def fill(self, sender: WindowedSender[slice]) -> None:
        """Queue the next rows."""
        rows = 0 if self._prepared is None else len(self._prepared.blocks)
        while self._queued < rows and sender.unsent < MOST_QUEUED:
            after = min(self._queued + MOST_TOGETHER, rows)
            sender.put(slice(self._queued, after), after - self._queued)
            self._queued = after

    def end(self, sender: WindowedSender[slice]) -> None:
        """Stop sending blocks of the run."""
        self._prepared = None
        sender.begin(NO_RUN)

    def message(self, rows: slice, first: int) -> G1BlockBatch:
        """Make the message of some rows; ``first`` is their number in the stream, too."""
        prepared = self._prepared
        if prepared is None:
            raise StreamError('a block was asked for after its run')
        blocks = prepared.blocks
        made = block_messages(
            prepared[rows], self._run_id, first, prepared.settings.flank_height,
            end=rows.stop == len(blocks),
        )  # fmt: skip
        if first == 0:
            made[0].continue_at = self._continue_at
            made[0].settings = pairs_of(prepared.settings)
        return G1BlockBatch(blocks=made)
