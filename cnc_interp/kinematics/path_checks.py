"""What is refused of a path in machine axes: tilt, unreachable poses, words, travel."""

from __future__ import annotations

from typing import NoReturn

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.core.errors import BlockError, SingularityError, TravelError
from cnc_interp.core.units import DEG
from cnc_interp.kinematics.branch import branch_at
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.sampling import SINGULAR, STANDSTILL
from cnc_interp.kinematics.transform import Transform
from cnc_interp.smoothing.segments import LINE, PathSegments

#: Largest difference of rotary words from positions that follow the tool axis [rad].
OFF_WORDS = 15.0 * DEG


def check_words(
    transform: Transform, run: PathSegments, right: FloatArray, counts: IntArray
) -> None:
    """
    Refuse lines on which the tool axis leads the rotary axes away from their words.

    Parameters
    ----------
    transform : Transform
        The machine's five-axis transformation.
    run : PathSegments
        n segments.
    right : ndarray, shape (N, 4, n_axes)
        Axes and three derivatives by path length at the ends of their cells.
    counts : ndarray of int, shape (n,)
        Number of cells of each segment.

    Raises
    ------
    BlockError
        If a line ends away from the words.

    """
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
        branches = [branch_at(transform, place) for place in (end, reached[i])]
        off[i] = gap > OFF_WORDS and (gap > np.pi or branches[0] != branches[1])
    if off.any():
        i = int(off.argmax())
        raise off_words(machine, int(run.line_number[lines[i]]), words[i, 1], reached[i])


def off_words(machine: Machine, line: int, words: FloatArray, reached: FloatArray) -> BlockError:
    """Return the error for rotary axes that do not reach their words."""
    names = machine.axis_names[3:5]
    said, found = (
        ' '.join(f'{name}{value / DEG:.3f}' for name, value in zip(names, place, strict=True))
        for place in (words, reached)
    )
    return BlockError(
        f'the rotary words lead to {said}, but along the tool directions the axes come to '
        f'{found}; write the words of this position, or turn with the tool retracted',
        line,
    )


def refuse_tilt(machine: Machine, segments: PathSegments) -> None:
    """Refuse a tilted tool on a machine without rotary axes."""
    turned = np.abs(segments.rotation).max(axis=1, initial=0.0) > 1e-12
    tilted = np.flatnonzero((segments.axis[:, 2] < 1.0 - 1e-12) | turned)
    if len(tilted):
        raise BlockError(
            f'a tilted tool needs rotary axes, and machine {machine.name} has none; '
            'choose a 5-axis machine',
            int(segments.line_number[tilted[0]]),
        )


def refuse(machine: Machine, outer: int, status: int, line: int) -> NoReturn:
    """Raise the error for a segment that cannot be followed."""
    if status == SINGULAR:
        name = machine.axis_names[3 + outer]
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
    raise BlockError(f'machine {machine.name} cannot reach the tool axis', line)


def check_travel(machine: Machine, q: FloatArray, lines: IntArray) -> None:
    """Refuse positions outside the travel of an axis, shape (n, n_axes)."""
    low, high = machine.travel.T
    outside = np.argwhere((q < low) | (q > high))
    if not len(outside):
        return
    row, axis = outside[0]
    beyond, value = machine.axes[axis], float(q[row, axis])
    unit, word = beyond.shown_size, beyond.shown_unit
    raise TravelError(
        f'axis {beyond.name} would have to go to {value / unit:.3f} {word}, outside its '
        f'travel {low[axis] / unit:g} ... {high[axis] / unit:g} {word}; move the workpiece',
        int(lines[row]),
        beyond.name,
        value,
    )
