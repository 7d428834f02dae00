"""Blocks and path segments <-> ROS messages, bit for bit; ``message_checks`` checks them first."""

from __future__ import annotations

from array import array
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import BSpline, G1Block, G1BlockBatch, PathSegment

from cnc_interp.core.arrays import FloatArray
from cnc_interp.program.blocks import Blocks
from cnc_interp.run.run_id import RunId
from cnc_interp.smoothing.segments import CORNER, POINTS, SPLINE, PathSegments

CUBIC_KNOTS = array('d', [0.0, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0])
LINEAR_KNOTS = array('d', [0.0, 0.0, 1.0, 1.0])
QUINTIC_KNOTS = array('d', [0.0] * 6 + [1.0] * 6)
#: Degree, knots and number of control points of each kind's curves.
CURVES = {CORNER: (3, CUBIC_KNOTS, 5), SPLINE: (5, QUINTIC_KNOTS, 6)}
LINE_CURVE = (1, LINEAR_KNOTS, 2)
#: Bezier points of a connection, quintic or septic, and degree of the parametrization's spans.
CONNECTION_POINTS = (6, 8)
SPAN_DEGREE = 6

FIELDS = {'extra': 'extra_axes'}  #: Columns of ``Blocks`` by another name.


def block_messages(
    blocks: Blocks, run_id: RunId, first_sequence: int, flank_height: float, end: bool
) -> list[G1Block]:
    """Convert rows to messages; ``end``: the last row ends the program; flank height [m]."""
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
    """Convert consecutive segments to messages; ``end`` marks the last one of the program."""
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
        kind=kind,
        bottom=_spline(segments.bottom[i], kind),
        flank_height=height,
        axis=segments.axis[i],
        rotation=segments.rotation[i],
        interpolation=int(segments.interpolation[i]),
        rotary=segments.rotary[i].ravel(),
        extra_axes=packed(segments.extra[i]),
        length=float(segments.length[i]),
        feedrate=segments.feed[i],
        contour_deviation=float(segments.deviation[i, 0]),
        orientation_deviation=float(segments.deviation[i, 1]),
        orientation_room=float(segments.room[i]),
        first_block=int(segments.block[i, 0]),
        last_block=int(segments.block[i, 1]),
        line_number=int(segments.line_number[i]),
        stop=bool(segments.stop[i]),
        end_of_program=end,
    )
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
    """Describe the spans of u_top = f(u), shape (k, 8), as a B-spline; without spans empty."""
    if not len(spans):
        return BSpline()
    inner = np.repeat(spans[1:, 0], SPAN_DEGREE)
    knots = np.concatenate([np.zeros(SPAN_DEGREE + 1), inner, np.ones(SPAN_DEGREE + 1)])
    points = np.concatenate([spans[:, 1:-1].ravel(), spans[-1:, -1]])
    return BSpline(
        degree=SPAN_DEGREE, dimension=1, knots=packed(knots), control_points=packed(points)
    )


def _spans_of(spline: BSpline) -> FloatArray:
    """Divide a parametrization into its spans, shape (k, 8)."""
    points = np.frombuffer(spline.control_points)
    first = np.arange(0, len(points) - 1, SPAN_DEGREE)
    starts = np.frombuffer(spline.knots)[first + SPAN_DEGREE]
    values = points[first[:, None] + np.arange(SPAN_DEGREE + 1)]
    return np.concatenate([starts[:, None], values], axis=1)


def packed(values: FloatArray) -> array[float]:
    """Flatten an array to the array type of messages, bit for bit."""
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
    count = len(messages[0].extra_axes) // POINTS if n else 0
    extra = np.array([m.extra_axes for m in messages], dtype=float).reshape(n, POINTS, count)
    return PathSegments(
        kind=np.array([m.kind for m in messages], dtype=np.int64),
        bottom=bottom,
        top=top,
        connection=connection,
        parametrization=parametrization,
        axis=np.array([m.axis for m in messages]),
        rotation=np.array([m.rotation for m in messages]),
        rotary=np.array([m.rotary for m in messages]).reshape(n, POINTS, 2),
        interpolation=np.array([m.interpolation for m in messages], dtype=np.int64),
        length=np.array([m.length for m in messages]),
        feed=np.array([m.feedrate for m in messages]),
        block=np.array([(m.first_block, m.last_block) for m in messages], dtype=np.int64),
        line_number=np.array([m.line_number for m in messages], dtype=np.int64),
        stop=np.array([m.stop for m in messages], dtype=np.bool_),
        deviation=np.array([(m.contour_deviation, m.orientation_deviation) for m in messages]),
        room=np.array([m.orientation_room for m in messages], dtype=float),
        extra=extra,
    )
