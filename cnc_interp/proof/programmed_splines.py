"""
Native splines as many short blocks: so the proof judges them by the same rules as linear ones.

The control points of a curve are evaluated by SciPy and replaced by rows on the curve, so close
that tip and point at flank height stay within ``CHORD`` of chord and great circle. Samples and
grid points that execute the curve are given the row that they have come to. Nothing here is
shared with planning.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray
from cnc_interp.core.errors import InterpError
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.proof.plan_files import Columns, PlanFiles

#: Largest distance between curve and chord [m].
CHORD = 1e-8
#: Points of a knot interval at which its curvature is measured.
PROBES = 65
#: A pose is looked for this much further along the curve than it has moved [m].
REACH = 2e-4


def with_chords(plan: PlanFiles, machine: Machine) -> PlanFiles:
    """
    Return a plan whose program has rows on its native splines instead of control points.

    Parameters
    ----------
    plan : PlanFiles
        Any plan; one without splines is returned as it is.
    machine : Machine
        Whose forward kinematics count.

    Raises
    ------
    InterpError
        If control points make no curve.

    """
    on_spline = np.isfinite(plan.blocks['knot_interval'])
    if not on_spline.any():
        return plan
    transform = Transform.of(machine)
    blocks = plan.blocks
    samples = transform.forward(plan.position)
    grid = transform.forward(plan.path['q']) if plan.path else None
    sample_rows, parts = plan.block.copy(), []
    grid_rows = np.array(plan.path['block'], dtype=np.int64) if plan.path else None
    count = 0
    for first, last in portions(on_spline, np.asarray(blocks['exact_stop'], dtype=bool)):
        if not on_spline[first]:
            parts.append({name: column[first:last] for name, column in blocks.items()})
            place, rows = np.arange(first, last), np.arange(count, count + last - first)
            sample_rows = _renumbered(sample_rows, plan.block, place, rows)
            if grid_rows is not None:
                grid_rows = _renumbered(grid_rows, plan.path['block'], place, rows)
        else:
            part, curve = chords(blocks, first, last, plan.flank_height)
            parts.append(part)
            inside = (plan.block >= first) & (plan.block < last)
            sample_rows[inside] = count + _rows_reached(curve, samples, inside, plan.flank_height)
            if grid_rows is not None and grid is not None:
                inside = (plan.path['block'] >= first) & (plan.path['block'] < last)
                grid_rows[inside] = count + _rows_reached(curve, grid, inside, plan.flank_height)
        count += len(parts[-1]['tip'])
    path: Columns = plan.path if grid_rows is None else {**plan.path, 'block': grid_rows}
    return replace(
        plan,
        blocks={name: np.concatenate([part[name] for part in parts]) for name in blocks},
        setpoints={**plan.setpoints, 'block': sample_rows},
        path=path,
    )


def portions(on_spline: BoolArray, exact_stop: BoolArray) -> list[tuple[int, int]]:
    """Return first and last row (exclusive) of linear stretches and of curves, in order."""
    changes = (on_spline[1:] != on_spline[:-1]) | (on_spline & exact_stop)[:-1]
    return list(pairwise([0, *(np.flatnonzero(changes) + 1).tolist(), len(on_spline)]))


def _renumbered(rows: IntArray, block: NDArray[Any], place: IntArray, new: IntArray) -> IntArray:
    """Give samples of linear rows their new row numbers."""
    inside = (block >= place[0]) & (block <= place[-1])
    rows[inside] = block[inside] + (new[0] - place[0])
    return rows


def chords(
    blocks: Columns, first: int, last: int, height: float, chord: float = CHORD
) -> tuple[dict[str, NDArray[Any]], FloatArray]:
    """
    Cut one native spline into linear rows.

    Parameters
    ----------
    blocks : mapping
        Columns of a program, as in ``blocks.npz``.
    first, last : int
        Rows of the control points, the last one exclusive.
    height : float
        Flank height [m].
    chord : float
        Largest distance of tip and of point at flank height from the curve [m].

    Returns
    -------
    tuple of dict and ndarray, shape (n, 6)
        The columns of the rows, and their tips and points at flank height [m].

    Raises
    ------
    InterpError
        If the control points make no curve.

    """
    line = int(blocks['line'][first])
    interval = np.asarray(blocks['knot_interval'][first:last], dtype=float)
    if len(interval) < 4 or interval[0] or interval[-2:].any():
        raise InterpError(f'blocks.npz: line {line}: the control points make no clamped spline')
    knots = np.concatenate([np.zeros(3), np.cumsum(interval)])
    knots = np.append(knots, knots[-1])
    points = np.hstack([blocks['tip'][first:last], blocks['top'][first:last]])
    curve = BSpline(knots, points, 3)
    u, row = [np.zeros(1)], [np.zeros(1, dtype=np.int64)]
    for i in np.flatnonzero(interval):
        begin, end = knots[i + 2], knots[i + 3]
        probe = _poses(curve, np.linspace(begin, end, PROBES), height)
        bend = np.abs(np.diff(probe, 2, axis=0)).max() * (PROBES - 1) ** 2
        pieces = max(1, int(np.ceil(np.sqrt(3.0 * bend / (8.0 * chord)))))
        u.append(np.linspace(begin, end, pieces + 1)[1:])
        row.append(np.full(pieces, first + i))
    places, rows = np.concatenate(u)[1:], np.concatenate(row)[1:]
    poses = _poses(curve, places, height)
    made = {name: np.asarray(column)[rows] for name, column in blocks.items()}
    made['tip'] = poses[:, :3]
    made['axis'] = (poses[:, 3:] - poses[:, :3]) / height
    made['exact_stop'] = np.zeros(len(rows), dtype=bool)
    made['exact_stop'][-1] = blocks['exact_stop'][last - 1]
    made['top'] = np.full((len(rows), 3), np.nan)
    made['knot_interval'] = np.full(len(rows), np.nan)
    return made, poses


def _poses(curve: BSpline, u: FloatArray, height: float) -> FloatArray:
    """Return tip and point at flank height on a curve, shape (n, 6) [m]."""
    both = curve(u)
    tool = both[:, 3:] - both[:, :3]
    tool *= height / np.linalg.norm(tool, axis=1)[:, None]
    return np.hstack([both[:, :3], both[:, :3] + tool])


def _rows_reached(
    curve: FloatArray, poses: tuple[FloatArray, FloatArray], inside: BoolArray, height: float
) -> IntArray:
    """
    Follow poses along a curve: the row that each of them has come to, shape (k,).

    A pose lies no further along the curve than it has moved, from the nearest row to the one
    before it on; rows may lie further apart than poses, so one row more is always looked at.
    """
    tip, axis = poses
    both = np.hstack([tip, tip + height * axis])
    moved = np.r_[0.0, np.linalg.norm(np.diff(both, axis=0), axis=1)][inside]
    both = both[inside]
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))]
    found = np.empty(len(both), dtype=np.int64)
    here, last = 0, len(curve) - 1
    for i, pose in enumerate(both):
        reached = way[min(here + 1, last)] + 2.0 * moved[i] + REACH
        end = int(np.searchsorted(way, reached, 'right')) + 1
        gap = curve[here:end] - pose
        here += int(np.argmin((gap * gap).sum(axis=1)))
        found[i] = here
    return found
