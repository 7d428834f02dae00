"""The programmed path of the proof, and the distance of a pose from it.

The point at flank height h moves along ``T(x) = p_0 + x (p_1 - p_0) + h o(x)``. The tip moves on a
line while the tool axis turns proportionally on a great circle [B2013, Eq. 4].
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from cnc_interp.core import BoolArray, FloatArray, IntArray, InterpError
from cnc_interp.core.kernels import njit
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.own_chain import Forward, forward_of
from cnc_interp.proof.plan_files import Columns, PlanFiles, Stored, held, spans

WINDOW = 2  #: Number of rows searched on either side of the row of a setpoint.
WIDE_WINDOW = 500  #: Largest number of rows searched if blocks are shorter than the tolerance.
TURN_PER_START = 0.1  #: Largest turn between two starts of the search for the nearest point [rad].
TIE = 1e-9  #: A shorter way of the tip counts as zero [m].


@dataclass(frozen=True)
class Deviation:
    contour: FloatArray  #: (K,): Distance of the tip from the nearest programmed line [m].
    row: IntArray  #: (K,): Program row of the nearest point.
    part: FloatArray  #: (K,): Place of the nearest point on its row, 0 to 1 [-].
    orientation: FloatArray  #: (K,): Distance of the point at flank height from its curve T [m].


@dataclass(frozen=True)
class ProgrammedPath:
    """The program as lines and great circles, one row per block; row 0 is the start pose."""

    #: (M, 3): Tip at the start of the row, and the vector from there to its end [m].
    start: FloatArray
    chord: FloatArray
    #: (M, 3): Tool axis at the start of the row, and the unit vector towards which it turns [-].
    axis: FloatArray
    sideways: FloatArray
    turn: FloatArray  #: (M,): Angle of the turn [rad].
    #: (M,): Whether a row has no great circle: a pure rotation by rotary words, or no tip line.
    by_axes: BoolArray
    rotary_from: FloatArray  #: (M, 2): Rotary positions at the start of the row, NaN if not known.
    flank_height: float  #: Height of the second point above the tip [m].

    @staticmethod
    def of(
        tip: FloatArray,
        axis: FloatArray,
        rotary: FloatArray,
        height: float,
        linear: BoolArray | None = None,
        rotary_from: FloatArray | None = None,
    ) -> ProgrammedPath:
        """Build the path of M rows; no pose is near those whose rotary axes run linearly."""
        before = np.r_[0, np.arange(len(tip) - 1)]
        start, first = tip[before], axis[before]
        chord = tip - start
        cosine = np.sum(first * axis, axis=1)
        across = axis - cosine[:, None] * first
        sine = np.linalg.norm(across, axis=1)
        begin = rotary[before]
        if rotary_from is not None:  # told where the row before names no rotary words
            begin = np.where(np.isfinite(rotary_from), rotary_from, begin)
        by_axes = np.isfinite(begin + rotary).all(axis=1) & (np.linalg.norm(chord, axis=1) < TIE)
        if linear is not None:
            start = np.where(linear[:, None], np.nan, start)
            by_axes = by_axes | linear
        return ProgrammedPath(
            start=np.ascontiguousarray(start, dtype=float),
            chord=chord,
            axis=np.ascontiguousarray(first, dtype=float),
            sideways=across / np.where(sine > 0.0, sine, 1.0)[:, None],
            turn=np.arctan2(sine, cosine),
            by_axes=by_axes,
            rotary_from=begin,
            flank_height=height,
        )

    @cached_property
    def way(self) -> FloatArray:
        """Length up to the end of each row: of the tip plus of the turn at flank height [m]."""
        lengths = np.linalg.norm(self.chord, axis=1) + self.flank_height * self.turn
        return np.asarray(np.cumsum(lengths))

    def deviation(
        self,
        tip: FloatArray,
        axis: FloatArray,
        block: IntArray,
        reach: FloatArray | None = None,
        rows: int = WINDOW,
    ) -> Deviation:
        """Return the deviation from the rows near ``block``, or within ``reach`` [m]."""
        low = np.maximum(block - rows, 0)
        high = np.minimum(block + rows, len(self.start) - 1)
        if reach is not None:
            way = self.way
            begin = way[np.maximum(block - 1, 0)]
            low = np.minimum(low, np.searchsorted(way, begin - reach))
            high = np.maximum(high, np.searchsorted(way[:-1], way[block] + reach))
            low = np.maximum(low, block - WIDE_WINDOW)
            high = np.minimum(high, block + WIDE_WINDOW)
        path = (self.start, self.chord, self.axis, self.sideways, self.turn, self.by_axes)
        return Deviation(
            *_deviation(
                np.ascontiguousarray(tip),
                np.ascontiguousarray(axis),
                low.astype(np.int64),
                high.astype(np.int64),
                path,
                self.flank_height,
            )
        )


def peaks(points: FloatArray) -> FloatArray:
    """Bound the part of a motion's bulge over a chord that its second difference does not show.

    The bulge is an eighth of the second difference if the acceleration is constant. It changes
    between samples by at most half a nearby third difference.
    """
    return np.asarray(np.abs(np.diff(points, 3, axis=-2)) / 16.0)


def distances_to_vertices(
    points: FloatArray,
    vertices: FloatArray,
    low: IntArray,
    high: IntArray,
    unit: FloatArray | None = None,
) -> tuple[FloatArray, IntArray]:
    """Return the distance of each vertex from a sampled motion, and the sample before that place.

    The bulge of the motion over its chord is subtracted: vertices lie outside their roundings.
    """
    bulge = np.zeros(points.shape)
    bulge[1:-1] = np.diff(points, 2, axis=0) / 8.0
    unit = np.ones((1, 3)) if unit is None else unit
    unit = np.ascontiguousarray(np.broadcast_to(unit, vertices.shape))
    return _distances_to_vertices(
        np.ascontiguousarray(points),
        bulge,
        np.ascontiguousarray(vertices),
        low.astype(np.int64),
        high.astype(np.int64),
        unit,
    )


ORIGIN = np.zeros(3)


@njit(cache=True, nogil=True)
def _foot(x: FloatArray, a: FloatArray, d: FloatArray) -> float:
    length_sq = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    if length_sq == 0.0:
        return 0.0
    along = (x[0] - a[0]) * d[0] + (x[1] - a[1]) * d[1] + (x[2] - a[2]) * d[2]
    return float(min(1.0, max(0.0, along / length_sq)))


@njit(cache=True, nogil=True)
def _line_distance(x: FloatArray, a: FloatArray, d: FloatArray, part: float) -> float:
    total = 0.0
    for i in range(3):
        total += (x[i] - a[i] - part * d[i]) ** 2
    return float(np.sqrt(total))


@njit(cache=True, nogil=True)
def _distance_slopes(
    x: FloatArray,
    a: FloatArray,
    d: FloatArray,
    o: FloatArray,
    n: FloatArray,
    turn: float,
    h: float,
    part: float,
) -> tuple[float, float, float]:
    """Return ``|T - x|^2`` and half its first two derivatives with respect to ``part``."""
    c, s = np.cos(turn * part), np.sin(turn * part)
    value, first, second = 0.0, 0.0, 0.0
    for i in range(3):
        gap = a[i] + part * d[i] + h * (o[i] * c + n[i] * s) - x[i]
        rate = d[i] + h * turn * (n[i] * c - o[i] * s)
        bend = -h * turn * turn * (o[i] * c + n[i] * s)
        value += gap * gap
        first += gap * rate
        second += rate * rate + gap * bend
    return value, first, second


@njit(cache=True, nogil=True)
def _locus_distance(
    x: FloatArray,
    a: FloatArray,
    d: FloatArray,
    o: FloatArray,
    n: FloatArray,
    turn: float,
    h: float,
) -> float:
    """Return the distance between x and T of one row: Newton in brackets from several starts."""
    starts = 1 if turn < 1e-6 else max(4, int(np.ceil(turn / TURN_PER_START)))
    step = 1.0 / starts
    left, here = np.inf, _distance_slopes(x, a, d, o, n, turn, h, 0.0)[0]
    best = here
    for j in range(starts + 1):
        right = np.inf
        if j < starts:
            right = _distance_slopes(x, a, d, o, n, turn, h, (j + 1) * step)[0]
        if here <= left and here <= right:
            low, high = max(0.0, (j - 1) * step), min(1.0, (j + 1) * step)
            part = j * step
            for _ in range(60):
                value, first, second = _distance_slopes(x, a, d, o, n, turn, h, part)
                best = min(best, value)
                if first > 0.0:
                    high = part
                else:
                    low = part
                following = part - first / second if second > 0.0 else 0.5 * (low + high)
                if not low <= following <= high:
                    following = 0.5 * (low + high)
                if abs(following - part) < 1e-13:
                    break
                part = following
        left, here = here, right
    return float(np.sqrt(best))


@njit(cache=True, nogil=True)
def _deviation(
    tip: FloatArray,
    axis: FloatArray,
    low: IntArray,
    high: IntArray,
    path: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, BoolArray],
    h: float,
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]:
    start, chord, first, sideways, turn, by_axes = path
    count = len(tip)
    row = np.empty(count, dtype=np.int64)
    contour, part, orientation = np.empty(count), np.empty(count), np.empty(count)
    for i in range(count):
        best, best_row, best_part, top_best = np.inf, low[i], 0.0, np.inf
        top = tip[i] + h * axis[i]
        for k in range(low[i], high[i] + 1):
            foot = _foot(tip[i], start[k], chord[k])
            distance = _line_distance(tip[i], start[k], chord[k], foot)
            if distance < best:
                best, best_row, best_part = distance, k, foot
            if not by_axes[k]:
                # The foot of the tip is one start more: near a cusp of T the others may miss it.
                square = _distance_slopes(
                    top, start[k], chord[k], first[k], sideways[k], turn[k], h, foot
                )[0]
                top_best = min(
                    top_best,
                    np.sqrt(square),
                    _locus_distance(top, start[k], chord[k], first[k], sideways[k], turn[k], h),
                )
        contour[i], row[i], part[i], orientation[i] = best, best_row, best_part, top_best
    return contour, row, part, orientation


@njit(cache=True, nogil=True)
def _distances_to_vertices(
    points: FloatArray,
    bulge: FloatArray,
    vertices: FloatArray,
    low: IntArray,
    high: IntArray,
    unit: FloatArray,
) -> tuple[FloatArray, IntArray]:
    count = len(vertices)
    nearest = np.full(count, np.inf)
    where = np.zeros(count, dtype=np.int64)
    to_here, step, size = np.empty(3), np.empty(3), np.empty(2)
    for k in range(count):
        for i in range(low[k], high[k]):
            size[:] = 0.0
            for c in range(3):
                to_here[c] = (points[i, c] - vertices[k, c]) / unit[k, c]
                step[c] = (points[i + 1, c] - points[i, c]) / unit[k, c]
                for end in range(2):
                    size[end] += (bulge[i + end, c] / unit[k, c]) ** 2
            foot = _foot(ORIGIN, to_here, step)
            off = _line_distance(ORIGIN, to_here, step, foot)
            distance = off - np.sqrt(max(size[0], size[1]))
            if distance < nearest[k]:
                nearest[k], where[k] = max(0.0, distance), i
                if distance <= 0.0:
                    break
    return nearest, where


CHORD = 1e-8  #: Largest distance between curve and chord [m].
PROBES = 65  #: Number of points per knot interval at which curvature is measured.
REACH = 2e-4  #: A pose is searched along the curve up to twice its movement plus this [m].


ROW = 'row'  #: Column of the blocks with chords that holds the program row.


def with_chords(plan: PlanFiles, machine: Machine) -> PlanFiles:
    on_spline = np.isfinite(plan.blocks['knot_interval'])
    if not on_spline.any():
        return plan
    blocks, parts, rows, count = plan.blocks, [], [], 0
    new = np.zeros(len(on_spline), dtype=np.int64)  # number of linear rows, first row of curves
    curves: dict[tuple[int, int], FloatArray] = {}
    for first, last in portions(on_spline, np.asarray(blocks['exact_stop'], dtype=bool)):
        new[first:last] = count
        if not on_spline[first]:
            parts.append({name: column[first:last] for name, column in blocks.items()})
            new[first:last] += np.arange(last - first)
            rows.append(np.arange(first, last))
        else:
            part, curves[first, last] = chords(blocks, first, last, plan.flank_height)
            parts.append(part)
            rows.append(np.full(len(part['tip']), last - 1))
        count += len(parts[-1]['tip'])

    def renumbered(block: Any, position: Any) -> Stored:
        return _renumbered(block, position, new, curves, forward_of(machine), plan.flank_height)

    path = plan.path
    if path:
        path = {**path, 'block': renumbered(path['block'], path['q'])}
    return replace(
        plan,
        blocks={name: np.concatenate([part[name] for part in parts]) for name in blocks}
        | {ROW: np.concatenate(rows)},
        setpoints={**plan.setpoints, 'block': renumbered(plan.block, plan.position)},
        path=path,
    )


def portions(on_spline: BoolArray, exact_stop: BoolArray) -> list[tuple[int, int]]:
    changes = (on_spline[1:] != on_spline[:-1]) | (on_spline & exact_stop)[:-1]
    return list(pairwise([0, *(np.flatnonzero(changes) + 1).tolist(), len(on_spline)]))


def _renumbered(
    block: Any,
    position: Any,
    new: IntArray,
    curves: dict[tuple[int, int], FloatArray],
    transform: Forward,
    height: float,
) -> Stored:
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
    """Replace a native spline, rows [first, last), by n linear rows and poses (n, 6)."""
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
    """Return the row that each pose on a curve has reached, (k,), given how far it ``moved``."""
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))]
    found, last = np.empty(len(both), dtype=np.int64), len(curve) - 1
    for i, pose in enumerate(both):
        reached = way[min(here + 1, last)] + 2.0 * moved[i] + REACH
        end = int(np.searchsorted(way, reached, 'right')) + 1
        gap = curve[here:end] - pose
        here += int(np.argmin((gap * gap).sum(axis=1)))
        found[i] = here
    return found
