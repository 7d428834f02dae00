"""The blocks of a run on their way to the look-ahead, a few at a time."""

from __future__ import annotations

from cnc_interp_msgs.msg import G1Block

from cnc_interp.core.errors import StreamError
from cnc_interp.nodes.program_check import Prepared
from cnc_interp.run.run_id import NO_RUN, RunId
from cnc_interp.wire.path_messages import block_messages
from cnc_interp.wire.settings_messages import pairs_of
from cnc_interp.wire.window_protocol import WindowedSender

#: Blocks queued for sending at a time; not the whole program.
MOST_QUEUED = 512


class BlockFeed:
    """Queue the rows of one program after the other, and make their messages."""

    def __init__(self) -> None:
        self._prepared: Prepared | None = None
        self._run_id, self._continue_at = NO_RUN, 0.0
        self._queued = 0

    def begin(
        self, prepared: Prepared, run_id: RunId, continue_at: float, sender: WindowedSender[int]
    ) -> None:
        """
        Begin a run, or begin it again.

        Parameters
        ----------
        prepared : Prepared
            The program.
        run_id : RunId
            Run and attempt.
        continue_at : float
            Path length from which the program goes on; 0 from its start [m].
        sender : WindowedSender
            The sending end of the blocks.

        """
        self._prepared, self._run_id, self._continue_at = prepared, run_id, continue_at
        self._queued = 0
        sender.begin(run_id)

    def fill(self, sender: WindowedSender[int]) -> None:
        """Queue the next rows."""
        rows = 0 if self._prepared is None else len(self._prepared.blocks)
        while self._queued < rows and sender.unsent < MOST_QUEUED:
            sender.put(self._queued)
            self._queued += 1

    def end(self, sender: WindowedSender[int]) -> None:
        """Send nothing more of the run."""
        self._prepared = None
        sender.begin(NO_RUN)

    def message(self, row: int, sequence: int) -> G1Block:
        """Make the message of one row."""
        prepared = self._prepared
        if prepared is None:
            raise StreamError('a block was asked for after its run')
        blocks = prepared.blocks
        (message,) = block_messages(
            blocks[row : row + 1], self._run_id, sequence, prepared.settings.flank_height,
            end=sequence == len(blocks) - 1,
        )  # fmt: skip
        if sequence == 0:
            message.continue_at = self._continue_at
            message.settings = pairs_of(prepared.settings)
        return message
