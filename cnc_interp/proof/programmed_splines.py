"""Native splines as short linear rows, within ``CHORD`` of the curve: one rule for all."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from cnc_interp.core import BoolArray, FloatArray, IntArray, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform
from cnc_interp.proof.plan_files import Columns, PlanFiles, Stored, held, spans

CHORD = 1e-8  #: Largest distance between curve and chord [m].
PROBES = 65  #: Number of points of a knot interval at which its curvature is measured.
REACH = 2e-4  #: A pose is searched up to twice its movement plus this along the curve [m].


def with_chords(plan: PlanFiles, machine: Machine) -> PlanFiles:
    on_spline = np.isfinite(plan.blocks['knot_interval'])
    if not on_spline.any():
        return plan
    blocks, parts, count = plan.blocks, [], 0
    new = np.zeros(len(on_spline), dtype=np.int64)  # number of linear rows, first row of curves
    curves: dict[tuple[int, int], FloatArray] = {}
    for first, last in portions(on_spline, np.asarray(blocks['exact_stop'], dtype=bool)):
        new[first:last] = count
        if not on_spline[first]:
            parts.append({name: column[first:last] for name, column in blocks.items()})
            new[first:last] += np.arange(last - first)
        else:
            part, curves[first, last] = chords(blocks, first, last, plan.flank_height)
            parts.append(part)
        count += len(parts[-1]['tip'])

    def renumbered(block: Any, position: Any) -> Stored:
        return _renumbered(block, position, new, curves, Transform.of(machine), plan.flank_height)

    path = plan.path
    if path:
        path = {**path, 'block': renumbered(path['block'], path['q'])}
    return replace(
        plan, blocks={name: np.concatenate([part[name] for part in parts]) for name in blocks},
        setpoints={**plan.setpoints, 'block': renumbered(plan.block, plan.position)}, path=path,
    )  # fmt: skip


def portions(on_spline: BoolArray, exact_stop: BoolArray) -> list[tuple[int, int]]:
    changes = (on_spline[1:] != on_spline[:-1]) | (on_spline & exact_stop)[:-1]
    return list(pairwise([0, *(np.flatnonzero(changes) + 1).tolist(), len(on_spline)]))


def _renumbered(
    block: Any, position: Any, new: IntArray, curves: dict[tuple[int, int], FloatArray],
    transform: Transform, height: float,
) -> Stored:  # fmt: skip
    rows, reached = Stored.empty(len(block), np.int64), dict.fromkeys(curves, 0)
    for a, b in spans(len(block)):
        old = np.asarray(block[a:b], dtype=np.int64)
        found, within = new[old], [k for k in curves if k[0] <= old.max() and k[1] > old.min()]
        if within:
            tip, axis = transform.forward(held(position, a, b, 1, 0))
            both = np.hstack([tip, tip + height * axis])
            moved = np.linalg.norm(np.diff(both, axis=0), axis=1)
            for k in within:
                inside = (old >= k[0]) & (old < k[1])
                along = _rows_reached(curves[k], both[1:][inside], moved[inside], reached[k])
                found[inside] += along
                reached[k] = int(along[-1]) if len(along) else reached[k]
        rows[a:b] = found
    return rows


def chords(
    blocks: Columns, first: int, last: int, height: float
) -> tuple[dict[str, NDArray[Any]], FloatArray]:
    """Replace a native spline, rows ``first`` to ``last``, by n linear rows and poses (n, 6)."""
    line = int(blocks['line'][first])
    interval = np.asarray(blocks['knot_interval'][first:last], dtype=float)
    if len(interval) < 4 or interval[0] or interval[-2:].any():
        raise InterpError(
            f'blocks.npz: line {line}: the control points do not form a clamped spline; plan again'
        )
    knots = np.concatenate([np.zeros(3), np.cumsum(interval)])
    knots = np.append(knots, knots[-1])
    points = np.hstack([blocks['tip'][first:last], blocks['top'][first:last]])
    curve = BSpline(knots, points, 3)
    u, row = [np.zeros(1)], [np.zeros(1, dtype=np.int64)]
    for i in np.flatnonzero(interval):
        begin, end = knots[i + 2], knots[i + 3]
        probe = _poses(curve, np.linspace(begin, end, PROBES), height)
        bend = np.abs(np.diff(probe, 2, axis=0)).max() * (PROBES - 1) ** 2
        pieces = max(1, int(np.ceil(np.sqrt(3.0 * bend / (8.0 * CHORD)))))
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
    both = curve(u)
    tool = both[:, 3:] - both[:, :3]
    tool *= height / np.linalg.norm(tool, axis=1)[:, None]
    return np.hstack([both[:, :3], both[:, :3] + tool])


def _rows_reached(curve: FloatArray, both: FloatArray, moved: FloatArray, here: int) -> IntArray:
    """Return the row that each pose on a curve has reached, (k,): no farther than it moved."""
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))]
    found, last = np.empty(len(both), dtype=np.int64), len(curve) - 1
    for i, pose in enumerate(both):
        reached = way[min(here + 1, last)] + 2.0 * moved[i] + REACH
        end = int(np.searchsorted(way, reached, 'right')) + 1
        gap = curve[here:end] - pose
        here += int(np.argmin((gap * gap).sum(axis=1)))
        found[i] = here
    return found
