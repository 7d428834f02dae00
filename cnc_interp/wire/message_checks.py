"""Check received messages: values must be finite and possible, arrays of the right shape."""

from __future__ import annotations

import math
from array import array

import numpy as np
from cnc_interp_msgs.msg import BSpline, G1Block, MachineState, PathSegment, SetpointChunk

from cnc_interp.core import FloatArray, SettingsError, StreamError
from cnc_interp.machine.axis_motion import refuse_setpoints
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import Signals
from cnc_interp.run.overrides import OVERRIDES, sound_override
from cnc_interp.run.setpoints import Setpoints
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.segments import CORNER, LINE, POINTS, ROTATION, SPLINE
from cnc_interp.wire.path_messages import (
    CONNECTION_POINTS,
    CURVES,
    LINE_CURVE,
    SETPOINT_FIELDS,
    SPAN_DEGREE,
    check_functions,
)
from cnc_interp.wire.run_messages import settings_from

UNIT = 1e-9  #: Accepted deviation of a tool axis's length from 1 [-].


NO_SIGNALS = Signals()


def check_block(
    message: G1Block, extra_count: int = 0, signals: Signals = NO_SIGNALS, spins: bool = False
) -> None:
    """Raise StreamError for a block with impossible values or a wrong number of extra axes.

    With ``spins``, the spin of an arm may be appended to the extra axes.
    """
    name = f'block {message.sequence} (line {message.line_number})'
    _check_pose(name, message.tip, message.axis, message.rotary)
    _check_interpolation(name, message)
    _check_control_point(name, message)
    _check_extra(name, message.extra_axes, extra_count, spins)
    for field in ('contour_tolerance', 'orientation_tolerance', 'flank_height'):
        value = getattr(message, field)
        if not 0.0 < value < np.inf:
            raise StreamError(f'{name}: {field} is {value:g} m; it must be greater than 0')
    if message.program_stop > G1Block.OPTIONAL_STOP:
        raise StreamError(f'{name}: program_stop is {message.program_stop}; it must be 0, 1 or 2')
    if message.corner > G1Block.CORNER_WITHIN_MOTION:
        raise StreamError(f'{name}: corner is {message.corner}; it must be 0, 1, 2 or 3')
    check_functions(name, message.functions, signals)
    if message.settings and message.sequence > 0:
        raise StreamError(f'{name}: settings belong to block 0')
    if message.sequence == 0:
        try:
            settings_from(message.settings, Settings())
        except SettingsError as problem:
            raise StreamError(f'{name}: {problem}') from None
        return
    timed = not np.isnan(message.duration)
    value = message.duration if timed else message.feedrate
    if not value > 0.0 or (timed and value == np.inf):
        word = 'duration' if timed else 'feedrate'
        raise StreamError(f'{name}: {word} is {value:g}; it must be greater than 0')


def _check_pose(name: str, tip: FloatArray, axis: FloatArray, rotary: FloatArray) -> None:
    # Lists are several times faster than arrays of two or three values, and blocks come by the
    # thousand in a second.
    if not all(map(math.isfinite, tip.tolist())):
        raise StreamError(f'{name}: the tool tip is not finite; send numbers')
    length = math.hypot(*axis.tolist())
    if not abs(length - 1.0) <= UNIT:
        raise StreamError(f'{name}: the tool axis has length {length:.6g}; it must be 1')
    turns = rotary.tolist()
    if any(map(math.isinf, turns)) or len(set(map(math.isnan, turns))) > 1:
        raise StreamError(f'{name}: name both rotary axes, or none (NaN)')


def _check_interpolation(name: str, message: G1Block) -> None:
    if message.interpolation == G1Block.POSES:
        return
    if message.interpolation > G1Block.AXES_LINEAR or message.spline or message.sequence == 0:
        text = 'send 0 for splines and for the first block, otherwise 0, 1 or 2'
        raise StreamError(f'{name}: interpolation {message.interpolation} is not possible: {text}')
    if not np.isfinite([*message.rotary, *message.rotary_from]).all():
        text = 'linear motion of rotary axes needs their positions at both ends'
        raise StreamError(f'{name}: {text}; send numbers')


def _check_extra(name: str, values: array[float], count: int, spare: int) -> None:
    if len(values) not in (count, count + spare):
        told = f'extra_axes holds {len(values)} values, the machine needs {count}'
        raise StreamError(f'{name}: {told}')
    if not all(map(math.isfinite, values)):
        raise StreamError(f'{name}: extra_axes is not finite; send numbers')


def _check_control_point(name: str, message: G1Block) -> None:
    if not message.spline:
        return
    if not 0.0 <= message.knot_interval < np.inf:
        raise StreamError(
            f'{name}: knot_interval is {message.knot_interval:g}; it must not be negative'
        )
    tool = message.top - message.tip
    length = float(np.sqrt(tool @ tool))
    if not np.abs(tool - length * message.axis).max() <= UNIT * length:
        raise StreamError(f'{name}: top must be a point on the tool axis above the tip')


def check_segment(
    message: PathSegment, extra_count: int = 0, signals: Signals = NO_SIGNALS, spins: bool = False
) -> None:
    """Raise StreamError if a segment has wrong fields for its kind, or wrong extra axes."""
    name = f'segment {message.sequence} (line {message.line_number})'
    kind, curved = message.kind, message.kind in CURVES
    if kind not in (LINE, CORNER, ROTATION, SPLINE):
        raise StreamError(f'{name}: kind {kind} is unknown; send LINE, CORNER, ROTATION or SPLINE')
    _check_spline(f'{name}: bottom', message.bottom, kind)
    if curved:
        _check_spline(f'{name}: top', message.top, kind)
        if len(message.connection) not in [3 * points for points in CONNECTION_POINTS]:
            raise StreamError(f'{name}: connection must hold 6 or 8 points of 3 values')
    if kind == CORNER:
        _check_parametrization(f'{name}: parametrization', message.parametrization)
    _check_extra(name, message.extra_axes, POINTS * extra_count, POINTS * spins)
    check_functions(name, message.functions, signals)
    rotary = message.rotary.reshape(POINTS, 2)
    for place in rotary[:2]:
        _check_pose(name, np.zeros(3), message.axis, place)
    if message.interpolation != G1Block.POSES:
        used = CURVES.get(kind, LINE_CURVE)[2]
        if message.interpolation > G1Block.AXES_LINEAR or kind not in (LINE, CORNER):
            raise StreamError(f'{name}: interpolation does not fit the kind')
        if not np.isfinite(rotary[:used]).all():
            raise StreamError(f'{name}: control values of the rotary axes are not finite')
    values = [*message.rotation, message.contour_deviation, message.orientation_deviation]
    values += [message.orientation_room, *message.connection]
    if not np.isfinite(values).all():
        raise StreamError(f'{name}: a value is not finite; send numbers')
    if not 0.0 < message.flank_height < np.inf:
        raise StreamError(f'{name}: flank_height must be greater than 0')
    if not (message.feedrate > 0.0).all():
        raise StreamError(f'{name}: the feedrate must be greater than 0')
    if not (curved or 0.0 <= message.length < np.inf):
        raise StreamError(f'{name}: length is {message.length:g} m; it must not be negative')


def _check_spline(name: str, spline: BSpline, kind: int) -> None:
    degree, knots, points = CURVES.get(kind, LINE_CURVE)
    count = 3 * points
    if (spline.degree, spline.dimension, spline.knots) != (degree, 3, knots):
        raise StreamError(f'{name} must be of degree {degree} in 3-D with knots {knots.tolist()}')
    if len(spline.control_points) != count:
        raise StreamError(f'{name} needs {count} values, not {len(spline.control_points)}')
    if not np.isfinite(np.frombuffer(spline.control_points)).all():
        raise StreamError(f'{name} has a control point that is not finite')


def _check_parametrization(name: str, spline: BSpline) -> None:
    """Raise StreamError unless the spline f of u_top = f(u) is sextic and rises from 0 to 1."""
    knots, values = np.array(spline.knots), np.array(spline.control_points)
    if not len(knots) and not len(values):
        return
    spans, left_over = divmod(len(values) - 1, SPAN_DEGREE)
    if spline.degree != SPAN_DEGREE or spline.dimension != 1 or left_over or spans < 1:
        raise StreamError(f'{name} must be scalar, of degree {SPAN_DEGREE}, in whole spans')
    inner = np.array(knots[SPAN_DEGREE + 1 : -SPAN_DEGREE - 1]).reshape(-1, SPAN_DEGREE)
    ends = np.concatenate([[0.0], inner[:, 0], [1.0]])
    expected = np.repeat(ends, [SPAN_DEGREE + 1, *[SPAN_DEGREE] * len(inner), SPAN_DEGREE + 1])
    if (
        len(inner) != spans - 1
        or not np.array_equal(knots, expected)
        or (np.diff(ends) <= 0).any()
    ):
        raise StreamError(f'{name} needs rising knots from 0 to 1, {SPAN_DEGREE} at each break')
    rises = values[0] == 0.0 and values[-1] == 1.0 and (np.diff(values[::SPAN_DEGREE]) > 0).all()
    if not np.isfinite(values).all() or not rises:
        raise StreamError(f'{name} must rise from 0 to 1')


def check_chunk(
    message: SetpointChunk, machine: Machine, period: float, before: FloatArray
) -> None:
    """Raise StreamError for setpoints with wrong shape, machine or period, or beyond limits.

    ``before`` (3, n): positions of the three setpoints before this chunk.
    """
    name = f'setpoints from {message.first_sample}'
    n, axis_count = len(message.sequences), len(machine.axis_names)
    if message.period != period:
        raise StreamError(
            f'{name}: period {message.period:g} s, but the machine runs at {period:g} s; '
            'give both nodes the same interpolation_period'
        )
    if n == 0:
        raise StreamError(f'{name}: the chunk is empty; send at least one setpoint')
    for prefix in ('', 'tail_'):
        check_setpoints(message, axis_count, prefix)
    check_functions(name, message.functions, machine.signals)
    if message.wait > SetpointChunk.FUNCTION or message.end_of_program != (
        message.wait == SetpointChunk.END
    ):
        raise StreamError(f'{name}: wait {message.wait} does not fit end_of_program')
    rows = np.concatenate(
        [np.frombuffer(message.positions), np.frombuffer(message.tail_positions)]
    ).reshape(-1, axis_count)
    try:
        refuse_setpoints(machine, period, before, rows)
    except StreamError as fault:
        raise StreamError(f'{name}: {fault}') from None


def check_state(message: MachineState, axis_count: int | None = None) -> None:
    """Raise StreamError if nothing can be planned from a state; axis count None: any."""
    name = 'machine_state'
    count = len(message.commanded_positions) if axis_count is None else axis_count
    if len(message.positions) != count:
        raise StreamError(f'{name}: positions has {len(message.positions)} values, not {count}')
    _check_rows(f'{name}: commanded_positions', message.commanded_positions, count)
    if len(message.resume_positions):
        _check_rows(f'{name}: resume_positions', message.resume_positions, count)
    if message.state > MachineState.JOGGING or not message.interpolation_period > 0.0:
        raise StreamError(f'{name}: a working machine has no such state')
    for field in ('interpolation_period', 'path_position'):
        if not math.isfinite(getattr(message, field)):
            raise StreamError(f'{name}: {field} is not finite')
    for field in OVERRIDES:
        value = getattr(message, field)
        if sound_override(field, value) != value:
            raise StreamError(f'{name}: {field} is {value:g}; no machine reports that')


def check_setpoints(message: SetpointChunk, axis_count: int, prefix: str = '') -> None:
    """Raise StreamError if setpoints, or a stop tail, have a wrong shape or number of axes."""
    name, n = f'setpoints from {message.first_sample}', len(getattr(message, f'{prefix}sequences'))
    if message.axis_count != axis_count:
        raise StreamError(f'{name}: {message.axis_count} axes, but the machine has {axis_count}')
    for field, column in SETPOINT_FIELDS.items():
        values = n * axis_count if Setpoints.declared[column].tail else n
        _check_rows(f'{name}: {prefix}{field}', getattr(message, prefix + field), values)


def _check_rows(name: str, values: array[float], count: int) -> None:
    if len(values) != count:
        raise StreamError(f'{name} has {len(values)} values, not {count}')
    if not np.isfinite(np.asarray(values)).all():
        raise StreamError(f'{name} has a value that is not finite')
