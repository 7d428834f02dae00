"""The gate of a plan that joins in motion: it brings a reserve of motion of its own."""

from __future__ import annotations

from cnc_interp_msgs.msg import SetpointChunk

from cnc_interp.run.run_id import NO_RUN, RunId
from cnc_interp.wire.run_id_messages import run_id_of


class JoinGate:
    """
    Keeps the first chunks of a plan that joins until there are enough of them.

    Such a plan takes the place of setpoints that are buffered. With its first chunk alone the
    machine would run out of setpoints soon after that place, if the next ones were late. So the
    plan before counts until enough of the new one has come. Nothing moves before there is enough
    motion ahead: this is the same rule, for a plan that joins.
    """

    def __init__(self, enough: int):
        self._enough = enough
        self._run_id = NO_RUN
        self._kept: list[SetpointChunk] = []
        self._count = self._next = 0

    def passed(self, chunk: SetpointChunk, current: RunId, limit: int) -> list[SetpointChunk]:
        """
        Take a chunk and return the chunks that may pass, in order.

        Parameters
        ----------
        chunk : SetpointChunk
            Any chunk. If one of those that are kept is lost, the sender repeats them all.
        current : RunId
            The plan that is being received. Its chunks go on at once.
        limit : int
            Number of the first setpoint that the sender must not send yet.

        """
        run_id, first, count = run_id_of(chunk), chunk.first_sample, len(chunk.sequences)
        if run_id == current or not (chunk.joins or run_id == self._run_id):
            return [chunk]
        if chunk.joins:
            self._run_id, self._kept, self._count, self._next = run_id, [], 0, first
        if first != self._next:
            return []
        self._kept.append(chunk)
        self._count, self._next = self._count + count, first + count
        rests = chunk.wait != SetpointChunk.NOTHING
        if self._count < self._enough and self._next < limit and not rests:
            return []
        kept, self._kept, self._run_id = self._kept, [], NO_RUN
        return kept
