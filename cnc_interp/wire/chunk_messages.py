"""Chunks of setpoints <-> ROS messages, bit for bit; ``message_checks`` checks them first."""

from array import array
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import SetpointChunk

from cnc_interp.machine_model.signals import Signals
from cnc_interp.run.run_state import NO_RUN, RunId
from cnc_interp.run.setpoints import Chunk, Setpoints, Wait
from cnc_interp.wire.path_messages import function_messages, functions_from, packed
from cnc_interp.wire.run_messages import run_id_of

#: Fields of ``SetpointChunk`` with a row for each setpoint, and their columns in ``Setpoints``.
FIELDS = {
    'positions': 'position', 'velocities': 'velocity', 'accelerations': 'acceleration',
    'jerks': 'jerk', 'path_positions': 's',
}  # fmt: skip
NO_SIGNALS = Signals()
OF_AXES = tuple(FIELDS)[:4]  #: Those that have a value for each axis.


def chunk_message(
    chunk: Chunk, lines: list[int], tail_lines: list[int], run_id: RunId, first: int,
    period: float, joins: bool = False, signals: Signals = NO_SIGNALS,
) -> SetpointChunk:  # fmt: skip
    """Convert a chunk to a message; ``joins``: the first of a plan that joins in motion."""
    samples = chunk.samples
    return SetpointChunk(
        **vars(run_id), joins=joins, first_sample=first, period=period,
        axis_count=samples.position.shape[1], line_numbers=lines, tail_line_numbers=tail_lines,
        wait=int(chunk.wait), end_of_program=chunk.wait is Wait.END,
        functions=function_messages(chunk.functions, chunk.first_function, signals),
        **setpoint_fields(samples), **setpoint_fields(chunk.tail, 'tail_'),
    )  # fmt: skip


def setpoint_fields(rows: Setpoints, prefix: str = '') -> dict[str, Any]:
    found = {prefix + field: packed(getattr(rows, name)) for field, name in FIELDS.items()}
    counts = rows.block.astype(np.uint64).tobytes()
    return found | {f'{prefix}sequences': array('Q', counts)}


def setpoints_from(message: SetpointChunk) -> Setpoints:
    return _setpoints(message, '', message.first_sample)


def chunk_from(message: SetpointChunk) -> Chunk:
    samples = setpoints_from(message)
    tail = _setpoints(message, 'tail_', message.first_sample + len(samples))
    first = message.functions[0].number if message.functions else 0
    functions = functions_from(message.functions)
    return Chunk(samples, tail, Wait(message.wait), functions, first)


def _setpoints(message: SetpointChunk, prefix: str, first: int) -> Setpoints:
    blocks = np.frombuffer(getattr(message, f'{prefix}sequences'), dtype=np.uint64)
    n = len(blocks)
    columns = {
        name: np.frombuffer(getattr(message, prefix + field)).reshape(n, message.axis_count)
        if field in OF_AXES
        else np.array(getattr(message, prefix + field))
        for field, name in FIELDS.items()
    }
    time = (first + np.arange(n)) * message.period
    return Setpoints(time=time, block=blocks.astype(np.int64), **columns)


class JoinGate:
    """Keeps the first chunks of a plan that joins until there are enough of them."""

    def __init__(self, enough: int):
        self._enough = enough
        self._run_id = NO_RUN
        self._kept: list[SetpointChunk] = []
        self._count = self._next = 0

    def passed(self, chunk: SetpointChunk, current: RunId, limit: int) -> list[SetpointChunk]:
        """Return the chunks that may pass; ``limit``: first setpoint that must not be sent."""
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
