"""Selected corners: their curves, parametrization, derivatives and feed."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cnc_interp.core import MM, MM_PER_MIN, UM, FloatArray, IntArray, InterpError, jet, norm
from cnc_interp.core.bezier import bezier_values
from cnc_interp.core.bspline import corner_spline_points
from cnc_interp.kinematics.segment_axes import speed_of
from cnc_interp.program.blocks import POSES
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.proof.program_shapes import vertex_tolerances
from cnc_interp.report.dense_blocks import FILE, lengths
from cnc_interp.smoothing.corners.connection import Curves, poses, top_parameters
from cnc_interp.smoothing.segments import CORNER, LINE, PathSegments, corner_breaks, corner_jets

MOST = 8
SAMPLES = 60  #: Samples of each half of a corner for its figures.
MARGIN = 1.5  #: Range of the feed figure on either side, as a multiple of the corner length.


@dataclass(frozen=True)
class CornerView:
    line: int  #: Line of the block that leaves the corner.
    #: (2,): Contour and orientation deviation, and their tolerances [um].
    deviation: FloatArray
    tolerance: FloatArray
    #: Least planned and least programmed feed in the corner [mm/min].
    slowest: float
    programmed: float
    #: (K, 3): Points of both curves, the top curve with its connection [mm].
    bottom: FloatArray
    top: FloatArray
    #: (5, 3): Control points [mm].
    bottom_polygon: FloatArray
    top_polygon: FloatArray
    vertex: FloatArray  #: (3,): Programmed corner [mm].
    axis: FloatArray  #: (K, 3): Unit tool axis on the curve [-].
    #: (K,): Parameter of the bottom curve and of the top curve [-].
    u: FloatArray
    top_u: FloatArray
    connection: FloatArray  #: (K,): Length of the connection that is added to the top curve [um].
    #: (M,): Path length from the middle of the corner [mm], and norm of the third derivative of
    #: the tool axis by path length, with the lines on both sides [1/mm3].
    way: FloatArray
    turn: FloatArray
    ends: tuple[float, float]  #: Path lengths at which the corner begins and ends [mm].
    #: (N,): Planner's grid near the corner [mm] and the speeds there [mm/min].
    feed_way: FloatArray
    feed: FloatArray
    feed_limit: FloatArray
    programmed_feed: FloatArray

    @property
    def in_step(self) -> bool:
        return bool(np.abs(self.top_u - self.u).max() < 1e-9)

    @property
    def title(self) -> str:
        (contour, turn), (most, most_turn) = self.deviation, self.tolerance
        slowest = f'{self.slowest:,.0f}' if self.slowest >= 10.0 else f'{self.slowest:.2g}'
        return (
            f'line {self.line}: contour {contour:.4g} of {most:.4g} µm, '
            f'orientation {turn:.4g} of {most_turn:.4g} µm, slowest {slowest} mm/min'
        )


def views_of(plan: PlanFiles, segments: PathSegments) -> list[CornerView]:
    ends = np.cumsum(lengths(segments, plan.flank_height))
    total = float(plan.path['s'][-1] - plan.path['s'][0])
    rows = segments.block
    if not len(segments) or abs(ends[-1] - total) > 1e-5 * total + 1e-9:
        raise InterpError(f'{FILE} is not of the same plan as path.npz; plan again')
    if rows.min() < 0 or rows.max() >= len(plan.blocks['tip']):
        raise InterpError(f'{FILE} names blocks that blocks.npz does not hold; plan again')
    starts = np.r_[0.0, ends[:-1]] + plan.path['s'][0]
    chosen = worst_corners(plan, segments, starts, starts + np.diff(np.r_[0.0, ends]))
    return [_view(plan, segments, int(i), starts[i], starts[0] + ends[i]) for i in chosen]


def worst_corners(
    plan: PlanFiles, segments: PathSegments, starts: FloatArray, ends: FloatArray
) -> IntArray:
    """Select corners, alternately by the use of the tolerance and by the feed."""
    # A corner in machine axes has no top curve to be drawn.
    corners = np.flatnonzero((segments.kind == CORNER) & (segments.interpolation == POSES))
    use = (segments.deviation[corners] / _tolerances(plan, segments, corners)).max(axis=1)
    slow = np.array([_speeds(plan, starts[i], ends[i])[0] for i in corners])
    # Most corners use all of their tolerance; the slower one comes first among equals.
    by_use = corners[np.lexsort((slow, -np.round(use, 2)))]
    by_feed = corners[np.argsort(slow, kind='stable')]
    order = np.stack([by_feed, by_use], axis=1).ravel().tolist()
    return np.sort(np.array(list(dict.fromkeys(order))[:MOST], dtype=np.int64))


def _tolerances(plan: PlanFiles, segments: PathSegments, rows: IntArray) -> FloatArray:
    both = np.stack(vertex_tolerances(plan), axis=1)
    found: FloatArray = np.maximum(both[segments.block[rows, 0]], 1e-12)
    return found


def _speeds(plan: PlanFiles, start: float, end: float) -> tuple[float, float]:
    first, last = _grid_rows(plan, start, end)
    at = slice(first, last + 1)
    return float(plan.path['feed'][at].min()), float(plan.path['programmed_feed'][at].min())


def _grid_rows(plan: PlanFiles, start: float, end: float) -> tuple[int, int]:
    s = plan.path['s']
    slack = 1e-9 * float(s[-1])
    first = min(int(np.searchsorted(s, start - slack)), len(s) - 1)
    return first, max(first, int(np.searchsorted(s, end + slack, 'right')) - 1)


def _view(
    plan: PlanFiles, segments: PathSegments, row: int, start: float, end: float
) -> CornerView:
    one = segments[row : row + 1]
    bottom, polygon = one.bottom[:, :5], one.top[:, :5]
    curves = Curves(bottom, polygon, one.connection, one.parametrization)
    u, late = _parameters(one.parametrization[0])
    tip, axis = (np.concatenate(x) for x in zip(*(poses(curves, v) for v in u), strict=True))
    top_u = np.array([top_parameters(one.parametrization, v)[0] for v in u])
    top = corner_spline_points(polygon[0], top_u)
    bend = bezier_values(one.connection[0].T, u[:, None])
    corner_way, corner_turn = _third_derivatives(one, u, late)
    middle, reach = 0.5 * (start + end), MARGIN * (end - start)
    way, turn = _with_lines(segments, row, (corner_way, corner_turn), reach)
    first, last = _grid_rows(plan, start - reach, end + reach)
    near = slice(max(first - 1, 0), last + 2)
    slowest, programmed = _speeds(plan, start, end)
    return CornerView(
        line=int(one.line_number[0]), deviation=one.deviation[0] / UM,
        tolerance=_tolerances(plan, segments, np.array([row]))[0] / UM,
        slowest=slowest / MM_PER_MIN, programmed=programmed / MM_PER_MIN, bottom=tip / MM,
        top=(top + bend) / MM, bottom_polygon=bottom[0] / MM, top_polygon=polygon[0] / MM,
        vertex=one.bottom[0, 2] / MM, axis=axis, u=u, top_u=top_u, connection=norm(bend) / UM,
        way=(way + start - middle) / MM, turn=turn * MM**3,
        ends=((start - middle) / MM, (end - middle) / MM),
        feed_way=(plan.path['s'][near] - middle) / MM, feed=plan.path['feed'][near] / MM_PER_MIN,
        feed_limit=plan.path['feed_limit'][near] / MM_PER_MIN,
        programmed_feed=plan.path['programmed_feed'][near] / MM_PER_MIN,
    )  # fmt: skip


def _parameters(parametrization: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return parameters of a corner, each break twice, and parameters inside their pieces."""
    breaks = corner_breaks(parametrization)
    u, inside = [], []
    for low, high in pairwise(breaks):
        count = max(3, int(2 * SAMPLES * (high - low)))
        u.append(np.linspace(low, high, count))
        inside.append(np.full(count, 0.5 * (low + high)))
    return np.concatenate(u), np.concatenate(inside)


def _third_derivatives(
    one: PathSegments, u: FloatArray, inside: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return path length [m] and |o_sss| along a corner [1/m3, B2013, Eq. 11], shapes (K,)."""
    turn, speed = np.empty(len(u)), np.empty(len(u))
    curves = one.bottom[0], one.top[0], one.connection[0], one.parametrization[0]
    for k, (v, piece) in enumerate(zip(u, inside, strict=True)):
        tip, axis = corner_jets(*curves, v, piece)
        rate = speed_of(tip)
        speed[k] = rate[0]
        turn[k] = np.linalg.norm([jet.by_arc_length.py_func(tuple(a), rate)[3] for a in axis])
    step = np.diff(u)
    way = np.r_[0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * step)]
    return way * (float(lengths(one, 0.0)[0]) / way[-1]), turn


def _with_lines(
    segments: PathSegments, row: int, corner: tuple[FloatArray, FloatArray], reach: float
) -> tuple[FloatArray, FloatArray]:
    """Add the constant third derivatives of the lines on both sides of a corner."""
    way, turn = corner
    for side, at in ((-1, row - 1), (1, row + 1)):
        if not 0 <= at < len(segments) or segments.kind[at] != LINE:
            continue
        length = float(segments.length[at])
        beside = (float(norm(segments.rotation[at])) / length) ** 3 if length > 0.0 else 0.0
        span = min(reach, length)
        if side < 0:
            way, turn = np.r_[-span, 0.0, way], np.r_[beside, beside, turn]
        else:
            way, turn = np.r_[way, way[-1], way[-1] + span], np.r_[turn, beside, beside]
    return way, turn
