"""Convert blocks, functions, segments and setpoints to messages and back, bit for bit."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import (
    BSpline,
    Function,
    G1Block,
    G1BlockBatch,
    PathSegment,
    SetpointChunk,
)

from cnc_interp.core import FloatArray, StreamError
from cnc_interp.machine.switching import Act
from cnc_interp.machine_model.signals import Signals
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.blocks.functions import Functions
from cnc_interp.run.overrides import OperatorSettings
from cnc_interp.run.run_state import NO_RUN, RunId
from cnc_interp.run.setpoints import Chunk, Setpoints, Wait
from cnc_interp.smoothing.segments import CORNER, POINTS, SPLINE, PathSegments
from cnc_interp.wire.run_messages import run_id_of

CUBIC_KNOTS = array('d', [0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0])
LINEAR_KNOTS = array('d', [0.0, 0.0, 1.0, 1.0])
QUINTIC_KNOTS = array('d', [0.0] * 6 + [1.0] * 6)
#: Kind of segment -> degree, knots and number of control points of its curves.
CURVES = {CORNER: (3, CUBIC_KNOTS, 5), SPLINE: (5, QUINTIC_KNOTS, 6)}
LINE_CURVE = (1, LINEAR_KNOTS, 2)
#: Numbers of Bezier points of a quintic and of a septic connection; degree of spans of u_top.
CONNECTION_POINTS = (6, 8)
SPAN_DEGREE = 6

FIELDS = {'extra': 'extra_axes'}  #: Column of ``Blocks`` -> message field with another name.
#: Columns of ``PathSegments`` that have a message field of the same name; and columns of two
#: values, with the fields of both.
ALIKE = {
    'kind': 'kind',
    'axis': 'axis',
    'rotation': 'rotation',
    'interpolation': 'interpolation',
    'length': 'length',
    'feed': 'feedrate',
    'room': 'orientation_room',
    'stop': 'stop',
    'line_number': 'line_number',
}
PAIRS = {
    'block': ('first_block', 'last_block'),
    'deviation': ('contour_deviation', 'orientation_deviation'),
}


def block_messages(
    blocks: Blocks, run_id: RunId, first_sequence: int, flank_height: float, end: bool
) -> list[G1Block]:
    """Return a message for each block; ``end``: whether the last block ends the program."""
    columns: dict[str, list[Any]] = {'spline': blocks.on_spline.tolist()}
    for name, declared in Blocks.declared.items():
        values = getattr(blocks, name)
        columns[FIELDS.get(name, name)] = list(values) if declared.tail else values.tolist()
    columns['extra_axes'] = [packed(row) for row in blocks.extra]
    return [
        G1Block(
            program_id=run_id.program_id,
            attempt=run_id.attempt,
            sequence=first_sequence + i,
            flank_height=flank_height,
            end_of_program=end and i == len(blocks) - 1,
            **{field: values[i] for field, values in columns.items()},
        )
        for i in range(len(blocks))
    ]


def blocks_of(message: G1Block | G1BlockBatch) -> list[G1Block]:
    return message.blocks if isinstance(message, G1BlockBatch) else [message]


def blocks_from(messages: list[G1Block]) -> Blocks:
    columns = {
        name: np.array([getattr(m, FIELDS.get(name, name)) for m in messages], declared.kind)
        for name, declared in Blocks.declared.items()
    }
    linear = np.array([not message.spline for message in messages])
    columns['top'][linear] = columns['knot_interval'][linear] = np.nan
    return Blocks(**columns)


def segment_messages(
    segments: PathSegments, run_id: RunId, first_sequence: int, flank_height: float, end: bool
) -> list[PathSegment]:
    """Return a message for each segment; ``end``: whether the last one ends the program."""
    last = len(segments) - 1
    return [
        _segment_message(segments, i, run_id, first_sequence + i, flank_height, end and i == last)
        for i in range(len(segments))
    ]


def _segment_message(
    segments: PathSegments, i: int, run_id: RunId, sequence: int, height: float, end: bool
) -> PathSegment:
    kind = int(segments.kind[i])
    message = PathSegment(
        program_id=run_id.program_id,
        attempt=run_id.attempt,
        sequence=sequence,
        bottom=_spline(segments.bottom[i], kind),
        flank_height=height,
        rotary=segments.rotary[i].ravel(),
        extra_axes=packed(segments.extra[i]),
        end_of_program=end,
        **{field: getattr(segments, name)[i].tolist() for name, field in ALIKE.items()},
    )
    for name, pair in PAIRS.items():
        for field, value in zip(pair, getattr(segments, name)[i].tolist(), strict=True):
            setattr(message, field, value)
    if kind in CURVES:
        message.top = _spline(segments.top[i], kind)
        message.connection = packed(segments.connection[i])
        if not segments.interpolation[i]:
            message.parametrization = _parametrization(segments.parametrization[i])
    return message


def _spline(points: FloatArray, kind: int) -> BSpline:
    degree, knots, count = CURVES.get(kind, LINE_CURVE)
    return BSpline(degree=degree, dimension=3, knots=knots, control_points=packed(points[:count]))


def _parametrization(spans: FloatArray) -> BSpline:
    """Return the spans of u_top = f(u), shape (k, 8), as a B-spline message; empty if k = 0."""
    if not len(spans):
        return BSpline()
    inner = np.repeat(spans[1:, 0], SPAN_DEGREE)
    knots = np.concatenate([np.zeros(SPAN_DEGREE + 1), inner, np.ones(SPAN_DEGREE + 1)])
    points = np.concatenate([spans[:, 1:-1].ravel(), spans[-1:, -1]])
    rows = {'knots': packed(knots), 'control_points': packed(points)}
    return BSpline(degree=SPAN_DEGREE, dimension=1, **rows)


def _spans_of(spline: BSpline) -> FloatArray:
    points = np.frombuffer(spline.control_points)
    first = np.arange(0, len(points) - 1, SPAN_DEGREE)
    starts = np.frombuffer(spline.knots)[first + SPAN_DEGREE]
    values = points[first[:, None] + np.arange(SPAN_DEGREE + 1)]
    return np.concatenate([starts[:, None], values], axis=1)


def packed(values: FloatArray) -> array[float]:
    """Return an array, flattened, in the array type of messages, bit for bit."""
    return array('d', np.ascontiguousarray(values, dtype=np.float64).tobytes())


def segments_from(messages: list[PathSegment]) -> PathSegments:
    n = len(messages)
    bottom, top = np.zeros((n, POINTS, 3)), np.zeros((n, POINTS, 3))
    points_of_e = max([len(m.connection) // 3 for m in messages], default=0)
    spans = max([len(m.parametrization.control_points) for m in messages], default=0)
    connection = np.zeros((n, max(points_of_e, CONNECTION_POINTS[0]), 3))
    parametrization = np.zeros((n, spans // SPAN_DEGREE, SPAN_DEGREE + 2))
    for i, message in enumerate(messages):
        points = np.frombuffer(message.bottom.control_points).reshape(-1, 3)
        bottom[i, : len(points)] = points
        if message.kind in CURVES:
            top[i, : len(points)] = np.frombuffer(message.top.control_points).reshape(-1, 3)
            if len(message.connection):
                connection[i] = np.frombuffer(message.connection).reshape(-1, 3)
            if len(message.parametrization.knots):
                parametrization[i] = _spans_of(message.parametrization)
    declared = PathSegments.declared
    columns = {
        name: np.array([getattr(m, field) for m in messages], declared[name].kind)
        for name, field in ALIKE.items()
    }
    columns |= {
        name: np.array(
            [[getattr(m, field) for field in pair] for m in messages], declared[name].kind
        )
        for name, pair in PAIRS.items()
    }
    return PathSegments(
        bottom=bottom,
        top=top,
        connection=connection,
        parametrization=parametrization,
        rotary=np.array([m.rotary for m in messages]).reshape(n, POINTS, 2),
        extra=np.array([m.extra_axes for m in messages], dtype=float).reshape(n, POINTS, -1),
        **columns,
    )


def function_messages(functions: Functions, first: int, signals: Signals) -> list[Function]:
    rows = zip(*(column.tolist() for column in functions.columns().values()), strict=True)
    return [_message(number, row, signals) for number, row in enumerate(rows, first)]


def act_message(act: Act, sample: int, signals: Signals) -> Function:
    row = act.block, act.line, act.place, act.value, act.before_stop
    message = _message(act.number, row, signals)
    message.sample = sample
    return message


def _message(number: int, row: tuple[Any, ...], signals: Signals) -> Function:
    block, line, step, value, before_stop = row
    return Function(
        number=number,
        sequence=block,
        line_number=line,
        step=step,
        output=signals.outputs[signals.steps[step].output].name,
        value=value,
        before_stop=before_stop,
    )


def functions_from(messages: Sequence[Function]) -> Functions:
    rows = [(m.sequence, m.line_number, m.step, m.value, m.before_stop) for m in messages]
    return Functions.of_rows(np.array(rows, dtype=float).ravel())


def check_functions(name: str, messages: Sequence[Function], signals: Signals) -> None:
    """Raise StreamError if functions have gaps, are out of order, or not in the machine file."""
    for before, message in pairwise(messages):
        if message.number != before.number + 1 or message.sequence < before.sequence:
            raise StreamError(f'{name}: function {message.number} does not follow')
    for message in messages:
        known = message.step < len(signals.steps)
        output = signals.outputs[signals.steps[message.step].output] if known else None
        if output is None or output.name != message.output:
            text = f'function {message.number} sets {message.output!r}, which the machine file'
            raise StreamError(f'{name}: {text} does not; give all nodes the same machine')
        if fault := output.fault_of(message.value):
            raise StreamError(f'{name}: function {message.number}: {fault}')


#: Field of ``SetpointChunk`` with a value for each setpoint -> its column in ``Setpoints``.
SETPOINT_FIELDS = {
    'positions': 'position',
    'velocities': 'velocity',
    'accelerations': 'acceleration',
    'jerks': 'jerk',
    'path_positions': 's',
    'sequences': 'block',
    'line_numbers': 'line',
}
INTEGERS = {'sequences': 'Q', 'line_numbers': 'I'}  #: Integer field -> its array type.
NO_SIGNALS, AS_PROGRAMMED = Signals(), OperatorSettings()


def chunk_message(
    chunk: Chunk,
    run_id: RunId,
    first: int,
    period: float,
    joins: bool = False,
    signals: Signals = NO_SIGNALS,
    settings: OperatorSettings = AS_PROGRAMMED,
) -> SetpointChunk:
    """Return a chunk as a message.

    ``joins``: whether it is the first chunk of a plan that joins another one in motion.
    """
    samples = chunk.samples
    return SetpointChunk(
        **vars(run_id),
        joins=joins,
        feed_override=settings.override,
        rapid_override=settings.rapid,
        spindle_override=settings.spindle,
        single_block=settings.single_block,
        first_sample=first,
        period=period,
        axis_count=samples.position.shape[1],
        wait=int(chunk.wait),
        end_of_program=chunk.wait is Wait.END,
        functions=function_messages(chunk.functions, chunk.first_function, signals),
        **setpoint_fields(samples),
        **setpoint_fields(chunk.tail, 'tail_'),
    )


def settings_of_plan(message: SetpointChunk) -> OperatorSettings:
    """Return the operator's settings with which the plan of a chunk was made."""
    shares = message.rapid_override, message.spindle_override
    return OperatorSettings(message.feed_override, message.single_block, *shares)


def setpoint_fields(rows: Setpoints, prefix: str = '') -> dict[str, Any]:
    found = {}
    for field, name in SETPOINT_FIELDS.items():
        kind = INTEGERS.get(field, 'd')
        found[prefix + field] = array(kind, getattr(rows, name).astype(kind).tobytes())
    return found


def chunk_from(message: SetpointChunk) -> Chunk:
    samples = setpoints_from(message)
    tail = setpoints_from(message, 'tail_', len(samples))
    first = message.functions[0].number if message.functions else 0
    functions = functions_from(message.functions)
    return Chunk(samples, tail, Wait(message.wait), functions, first)


def setpoints_from(message: SetpointChunk, prefix: str = '', before: int = 0) -> Setpoints:
    """Return the setpoints of a message; with prefix ``tail_`` those of its stop tail."""
    n, columns = len(getattr(message, f'{prefix}sequences')), {}
    for field, name in SETPOINT_FIELDS.items():
        declared = Setpoints.declared[name]
        values = np.array(getattr(message, prefix + field), declared.kind)
        columns[name] = values.reshape((n, message.axis_count) if declared.tail else n)
    time = (message.first_sample + before + np.arange(n)) * message.period
    return Setpoints(time=time, **columns)


class JoinGate:
    """Holds back the first chunks of a joining plan until ``enough`` setpoints are there."""

    def __init__(self, enough: int):
        self._enough = enough
        self._run_id = NO_RUN
        self._kept: list[SetpointChunk] = []
        self._count = self._next = 0

    def passed(self, chunk: SetpointChunk, current: RunId, limit: int) -> list[SetpointChunk]:
        """Return the chunks to process now; ``limit``: first setpoint beyond the window."""
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
