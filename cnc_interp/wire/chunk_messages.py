"""Chunks of setpoints <-> ROS messages, bit for bit; ``message_checks`` checks them first."""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import SetpointChunk

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.run.chunk import Chunk, Wait
from cnc_interp.run.run_id import NO_RUN, RunId
from cnc_interp.run.setpoints import Setpoints
from cnc_interp.wire.path_messages import packed
from cnc_interp.wire.run_messages import run_id_of


def chunk_message(
    chunk: Chunk,
    lines: list[int],
    tail_lines: list[int],
    run_id: RunId,
    first: int,
    period: float,
    joins: bool = False,
) -> SetpointChunk:
    """
    Convert a chunk to a message.

    Parameters
    ----------
    chunk : Chunk
        Setpoints and their stop tail.
    lines, tail_lines : list of int
        Line of the source text of each setpoint.
    run_id : RunId
        Run, attempt and plan.
    first : int
        Number of the first setpoint in the plan.
    period : float
        Interpolation period [s].
    joins : bool
        True for the first chunk of a plan that joins the one before in motion.

    """
    samples, tail = chunk.samples, chunk.tail
    return SetpointChunk(
        program_id=run_id.program_id,
        attempt=run_id.attempt,
        plan=run_id.plan,
        joins=joins,
        first_sample=first,
        period=period,
        axis_count=samples.position.shape[1],
        positions=packed(samples.position),
        velocities=packed(samples.velocity),
        accelerations=packed(samples.acceleration),
        jerks=packed(samples.jerk),
        sequences=_counts(samples.block),
        line_numbers=lines,
        path_positions=packed(samples.s),
        tail_positions=packed(tail.position),
        tail_velocities=packed(tail.velocity),
        tail_accelerations=packed(tail.acceleration),
        tail_jerks=packed(tail.jerk),
        tail_sequences=_counts(tail.block),
        tail_line_numbers=tail_lines,
        tail_path_positions=packed(tail.s),
        wait=int(chunk.wait),
        end_of_program=chunk.wait is Wait.END,
    )


def _counts(values: IntArray) -> array[int]:
    return array('Q', values.astype(np.uint64).tobytes())


def setpoints_from(message: SetpointChunk) -> Setpoints:
    """Return the setpoints of a checked message; time 0 is the first setpoint of the plan."""
    n = len(message.sequences)
    return _setpoints(
        message, n, (message.first_sample + np.arange(n)) * message.period, message.positions,
        message.velocities, message.accelerations, message.jerks, message.sequences,
        message.path_positions,
    )  # fmt: skip


def chunk_from(message: SetpointChunk) -> Chunk:
    """Return the chunk of a checked message."""
    samples, n = setpoints_from(message), len(message.tail_sequences)
    last = message.first_sample + len(samples)
    tail = _setpoints(
        message, n, (last + np.arange(n)) * message.period, message.tail_positions,
        message.tail_velocities, message.tail_accelerations, message.tail_jerks,
        message.tail_sequences, message.tail_path_positions,
    )  # fmt: skip
    return Chunk(samples, tail, Wait(message.wait))


def _setpoints(
    message: SetpointChunk, n: int, time: FloatArray, positions: Any, velocities: Any,
    accelerations: Any, jerks: Any, blocks: Any, s: Any,
) -> Setpoints:  # fmt: skip
    def table(values: Any) -> FloatArray:
        return np.frombuffer(values).reshape(n, message.axis_count)

    return Setpoints(
        time=time,
        position=table(positions),
        velocity=table(velocities),
        acceleration=table(accelerations),
        jerk=table(jerks),
        block=np.frombuffer(blocks, dtype=np.uint64).astype(np.int64),
        s=np.array(s),
    )


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
