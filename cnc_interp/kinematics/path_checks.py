"""Checks that reject a path in machine axes: tilt, unreachable poses, rotary words, travel."""

from typing import NoReturn

import numpy as np

from cnc_interp.core import DEG, BlockError, FloatArray, IntArray, SingularityError, TravelError
from cnc_interp.core.bspline import bezier_values, divided
from cnc_interp.kinematics.sampling import SINGULAR, STANDSTILL
from cnc_interp.machine_model.joint_chain import JointChain
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.smoothing.segments import LINE, PathSegments

TRAVEL_SLACK = 1e-9  #: Allowance of the travel for rounding [m, rad].
#: Matrix from value and three derivatives, times powers of the length, to the Bezier values of the
#: near half of a septic. With ``MIRROR`` it gives those of the far half, in reverse order.
TO_BEZIER = np.array(
    [[1, 0, 0, 0], [1, 1 / 7, 0, 0], [1, 2 / 7, 1 / 42, 0], [1, 3 / 7, 1 / 14, 1 / 210]]
)
MIRROR = np.array([[1.0], [-1.0], [1.0], [-1.0]])
_PLACES = np.linspace(0.0, 1.0, 65)  #: Parameters at which the farthest position is searched [-].
#: Largest accepted difference between rotary words and the positions that the axes reach [rad].
OFF_WORDS = 15.0 * DEG


def check_words(
    transform: Transform, run: PathSegments, right: FloatArray, counts: IntArray
) -> None:
    """Reject lines where the rotary axes, following the tool axis, do not reach their words."""
    machine = transform.machine
    lines = np.flatnonzero((run.kind == LINE) & np.isfinite(run.rotary[:, 1]).all(axis=1))
    if not len(lines) or not machine.has_rotary:
        return
    reached = right[np.cumsum(counts)[lines] - 1, 0, 3:5]
    words = run.rotary[lines, :2]
    low, high = words.min(axis=1) - OFF_WORDS, words.max(axis=1) + OFF_WORDS
    off = ((reached < low) | (reached > high)).any(axis=1)
    for i in np.flatnonzero(np.isnan(words[:, 0]).any(axis=1)):  # after a tool direction
        end, gap = words[i, 1], np.abs(reached[i] - words[i, 1]).max()
        branches = [transform.five_axis.branch_at(place) for place in (end, reached[i])]
        off[i] = gap > OFF_WORDS and (gap > np.pi or branches[0] != branches[1])
    if off.any():
        i = int(off.argmax())
        raise off_words(machine, int(run.line_number[lines[i]]), words[i, 1], reached[i])


def off_words(machine: Machine, line: int, words: FloatArray, reached: FloatArray) -> BlockError:
    names = machine.axis_names[3:5]
    said, found = (
        ' '.join(f'{name}{value / DEG:.3f}' for name, value in zip(names, place, strict=True))
        for place in (words, reached)
    )
    return BlockError(
        f'the rotary words ask for {said}, but following the tool directions the axes reach '
        f'{found}; write this position in the words, or turn with the tool retracted',
        line,
    )


def refuse_tilt(machine: Machine, segments: PathSegments) -> None:
    turned = np.abs(segments.rotation).max(axis=1, initial=0.0) > 1e-12
    tilted = np.flatnonzero((segments.axis[:, 2] < 1.0 - 1e-12) | turned)
    if len(tilted):
        raise BlockError(
            f'a tilted tool needs rotary axes, and machine {machine.name} has none; '
            'choose a 5-axis machine',
            int(segments.line_number[tilted[0]]),
        )


def refuse(transform: Transform, status: int, line: int, stands: FloatArray) -> NoReturn:
    """Reject a segment that the axes cannot follow; ``stands``: the last axis positions."""
    machine = transform.machine
    if isinstance(transform, JointChain) and status != STANDSTILL:
        raise transform.refusal(stands, line, status == SINGULAR)
    if status == SINGULAR:
        name = machine.axis_names[3 + transform.five_axis.outer]
        raise SingularityError(
            f'the turning tool axis comes closer than {machine.singular_cone / DEG:g} '
            f'deg to the direction where axis {name} is undefined; tilt the workpiece or the '
            'path',
            line,
            name,
        )
    if status == STANDSTILL:
        raise BlockError(
            'the tip rests on a curve while the tool axis turns; give the turn a block of its own',
            line,
        )
    raise BlockError(
        f'machine {machine.name} cannot reach the tool axis; choose another clamping', line
    )


def check_travel(
    machine: Machine, steps: FloatArray, left: FloatArray, right: FloatArray, lines: IntArray
) -> None:
    """Reject cells on which an axis leaves its travel, at their ends or between them.

    A septic lies between its least and greatest Bezier value. A cell is divided until these lie
    within the travel, or until an end of a part lies outside. The Bezier values approach the curve
    with the square of the length, and half of ``TRAVEL_SLACK`` separates both decisions, so the
    division ends.
    """
    powers = steps[:, None, None] ** np.arange(4.0)[:, None]
    values = np.concatenate(
        [TO_BEZIER @ (powers * left), (TO_BEZIER @ (MIRROR * powers * right))[:, ::-1]], axis=1
    )
    low, high = machine.travel.T[:, :, None]
    beyond = (values < low[:, 0] - TRAVEL_SLACK) | (values > high[:, 0] + TRAVEL_SLACK)
    cell, axis = np.nonzero(beyond.any(axis=1))
    parts, found = values[cell, :, axis], -1
    while len(parts):
        ends, slack = parts[:, [0, -1]], 0.5 * TRAVEL_SLACK
        outside = ((ends < low[axis] - slack) | (ends > high[axis] + slack)).any(axis=1)
        if outside.any():  # later places are not the first one
            first = int(outside.argmax())
            found, k = int(cell[first]), int(axis[first])
            parts, cell, axis = parts[:first], cell[:first], axis[:first]
        parts = np.stack(divided(parts[:, :, None]), axis=1).reshape(-1, 8)
        cell, axis = cell.repeat(2), axis.repeat(2)
        beyond = (parts < low[axis] - TRAVEL_SLACK) | (parts > high[axis] + TRAVEL_SLACK)
        rows = beyond.any(axis=1)
        parts, cell, axis = parts[rows], cell[rows], axis[rows]
    if found >= 0:
        course = bezier_values(values[lines == lines[found], None, :, k], _PLACES)
        _refuse_travel(machine, k, course.min(), course.max(), int(lines[found]))


def _refuse_travel(machine: Machine, k: int, lowest: float, highest: float, line: int) -> NoReturn:
    axis, (low, high) = machine.axes[k], machine.travel[k]
    value = float(highest if highest - high > low - lowest else lowest)
    unit, word = axis.shown_size, axis.shown_unit
    raise TravelError(
        f'axis {axis.name} would have to go to {value / unit:.3f} {word}, outside its '
        f'travel {low / unit:g} ... {high / unit:g} {word}; move the workpiece',
        line,
        axis.name,
        value,
    )
