"""Chunks of setpoints <-> ROS messages, bit for bit; ``message_checks`` checks them first."""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import SetpointChunk

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.run.chunk import Chunk, Wait
from cnc_interp.run.interpolator import Setpoints
from cnc_interp.run.run_id import RunId
from cnc_interp.wire.path_messages import packed


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
