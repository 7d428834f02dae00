"""Selected corners: their curves, parametrization, derivatives and feed."""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import plotly.graph_objects as go

from cnc_interp.core import MM, MM_PER_MIN, UM, FloatArray, IntArray, InterpError, jet, norm
from cnc_interp.core.bspline import bezier_values, corner_spline_points
from cnc_interp.kinematics import segment_axes as axes
from cnc_interp.program.blocks import POSES
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.proof.program_shapes import vertex_tolerances
from cnc_interp.report.html import BLUE, ORANGE, drawing, laid_out, section
from cnc_interp.smoothing import segments as kinds
from cnc_interp.smoothing.corners.connection import Curves, poses, top_parameters

#: Points of a span in the close-up, and its spans on either side of the largest bound.
POINTS, AROUND = 24, 5
MOST_BOUNDS = 4000  #: Largest number of bounds drawn along the path.


@dataclass(frozen=True)
class CurvesView:
    #: Number of blocks that became curves, of spans, and of curves.
    blocks: int
    spans: int
    runs: int
    share: float  #: Share of the path that consists of curves [-].
    way: FloatArray  #: (n,): Path length at the ends of the spans [mm].
    bound: FloatArray  #: (n, 2): Bounds of contour and orientation deviation of the spans [um].
    used: FloatArray  #: (2,): Largest bounds of all spans over their tolerances [-].
    #: (K, 2): The curve around the largest bound, in the plane of its largest extent [mm].
    curve: FloatArray
    polyline: FloatArray  #: (M, 2): The programmed tips near this curve, in the same plane [mm].
    line: int  #: Line of the program at the largest bound.

    @property
    def text(self) -> str:
        return (
            f'{self.blocks:,} blocks became {self.runs:,} curves of {self.spans:,} spans: '
            f'{self.spans / max(self.blocks, 1):.2f} spans a block, {self.share:.1%} of the path. '
            'Left: proven bounds of the deviation along the path, in both directions: '
            f'at most {self.used[0]:.1%} of the contour and {self.used[1]:.1%} of the '
            f'orientation tolerance. Right: around the largest one, line {self.line}.'
        )


def curves_of(plan: PlanFiles, segments: kinds.PathSegments) -> CurvesView | None:
    native = np.isfinite(plan.blocks['knot_interval'])
    spans = np.flatnonzero((segments.kind == kinds.SPLINE) & ~native[segments.block[:, 1]])
    if not len(spans):
        return None
    length = lengths(segments, plan.flank_height)
    begins = np.r_[True, (np.diff(spans) > 1) | segments.stop[spans[:-1]]]
    first = segments.block[spans[begins], 0]
    last = segments.block[spans[np.r_[begins[1:], True]], 1]
    bound = segments.deviation[spans] / UM
    tolerance = np.column_stack(
        [
            plan.blocks[name][segments.block[spans, 1]]
            for name in ('contour_tolerance', 'orientation_tolerance')
        ]
    )
    worst = int(np.argmax(bound.max(axis=1)))
    near = spans[max(worst - AROUND, 0) : worst + AROUND + 1]
    near = near[np.abs(near - spans[worst]) <= AROUND]
    u = np.linspace(0.0, 1.0, POINTS)
    curves = segments.bottom[near].transpose(0, 2, 1)
    points = np.concatenate([bezier_values(one[None], u[:, None]) for one in curves])
    rows = slice(max(int(segments.block[near].min()) - 1, 0), int(segments.block[near].max()) + 2)
    tips = plan.blocks['tip'][rows]
    middle = points.mean(axis=0)
    plane = np.linalg.svd(points - middle, full_matrices=False)[2][:2]
    chosen = np.unique(np.linspace(0, len(spans) - 1, min(len(spans), MOST_BOUNDS)).astype(int))
    return CurvesView(
        blocks=int((last - first + 1).sum()),
        spans=len(spans),
        runs=int(begins.sum()),
        share=float(length[spans].sum() / length.sum()),
        way=np.cumsum(length)[spans][chosen] / MM,
        bound=bound[chosen],
        used=(segments.deviation[spans] / tolerance).max(axis=0),
        curve=(points - middle) @ plane.T / MM,
        polyline=(tips - middle) @ plane.T / MM,
        line=int(segments.line_number[spans[worst]]),
    )


def bounds_figure(view: CurvesView) -> Any:
    figure = go.Figure()
    for k, (name, colour) in enumerate((('contour', BLUE), ('orientation', ORANGE))):
        figure.add_scatter(
            x=view.way,
            y=view.bound[:, k],
            name=name,
            mode='lines',
            line={'color': colour, 'width': 1.0},
        )
    own = {'yaxis_title': 'bound (µm)', 'yaxis_rangemode': 'tozero'}
    return laid_out(figure, 360, xaxis_title='path (mm)', **own)


def close_figure(view: CurvesView) -> Any:
    figure = go.Figure()
    figure.add_scatter(
        x=view.polyline[:, 0],
        y=view.polyline[:, 1],
        name='programmed',
        mode='lines+markers',
        line={'color': '#8d99a5', 'width': 1.5},
        marker={'size': 4},
    )
    figure.add_scatter(
        x=view.curve[:, 0],
        y=view.curve[:, 1],
        name='curve',
        mode='lines',
        line={'color': BLUE, 'width': 2.0},
    )
    return laid_out(figure, 360, xaxis_title='mm', yaxis_title='mm', yaxis_scaleanchor='x')


def curves_section(plan: PlanFiles, segments: kinds.PathSegments) -> str:
    view = curves_of(plan, segments)
    if view is None:
        return ''
    pair = f'<div>{drawing(bounds_figure(view))}</div><div>{drawing(close_figure(view))}</div>'
    return section('Dense blocks as curves', view.text, f'<div class="pair">{pair}</div>')


FILE = 'segments.npz'


def read_segments(directory: Path) -> kinds.PathSegments | None:
    file = directory / FILE
    if not file.is_file():
        return None
    try:
        with np.load(file, allow_pickle=False) as archive:
            return kinds.PathSegments.of_columns(archive)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as fault:
        raise InterpError(f'{file}: cannot be read ({fault}); plan again') from fault


def lengths(segments: kinds.PathSegments, height: float) -> FloatArray:
    shapes, beside = axes.shapes_of(segments), axes.beside_of(segments)
    motion = np.where(segments.interpolation == POSES, axes.FOLLOWING, axes.LINEAR)
    rows = zip(segments.kind, motion, shapes, beside, segments.length, strict=True)
    halves = ((0.0, 0.5), (0.5, 1.0))
    return np.array(
        [
            sum(axes.arc_length(kind, how, shape, own, height, length, *half) for half in halves)
            for kind, how, shape, own, length in rows
        ]
    )


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


def views_of(plan: PlanFiles, segments: kinds.PathSegments) -> list[CornerView]:
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
    plan: PlanFiles, segments: kinds.PathSegments, starts: FloatArray, ends: FloatArray
) -> IntArray:
    """Select corners, alternately by the use of the tolerance and by the feed."""
    # A corner in machine axes has no top curve to be drawn.
    corners = np.flatnonzero((segments.kind == kinds.CORNER) & (segments.interpolation == POSES))
    use = (segments.deviation[corners] / _tolerances(plan, segments, corners)).max(axis=1)
    slow = np.array([_speeds(plan, starts[i], ends[i])[0] for i in corners])
    # Most corners use all of their tolerance; the slower one comes first among equals.
    by_use = corners[np.lexsort((slow, -np.round(use, 2)))]
    by_feed = corners[np.argsort(slow, kind='stable')]
    order = np.stack([by_feed, by_use], axis=1).ravel().tolist()
    return np.sort(np.array(list(dict.fromkeys(order))[:MOST], dtype=np.int64))


def _tolerances(plan: PlanFiles, segments: kinds.PathSegments, rows: IntArray) -> FloatArray:
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
    plan: PlanFiles, segments: kinds.PathSegments, row: int, start: float, end: float
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
        line=int(one.line_number[0]),
        deviation=one.deviation[0] / UM,
        tolerance=_tolerances(plan, segments, np.array([row]))[0] / UM,
        slowest=slowest / MM_PER_MIN,
        programmed=programmed / MM_PER_MIN,
        bottom=tip / MM,
        top=(top + bend) / MM,
        bottom_polygon=bottom[0] / MM,
        top_polygon=polygon[0] / MM,
        vertex=one.bottom[0, 2] / MM,
        axis=axis,
        u=u,
        top_u=top_u,
        connection=norm(bend) / UM,
        way=(way + start - middle) / MM,
        turn=turn * MM**3,
        ends=((start - middle) / MM, (end - middle) / MM),
        feed_way=(plan.path['s'][near] - middle) / MM,
        feed=plan.path['feed'][near] / MM_PER_MIN,
        feed_limit=plan.path['feed_limit'][near] / MM_PER_MIN,
        programmed_feed=plan.path['programmed_feed'][near] / MM_PER_MIN,
    )


def _parameters(parametrization: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return parameters along a corner, breaks twice, and the middle of the span of each."""
    breaks = kinds.corner_breaks(parametrization)
    u, inside = [], []
    for low, high in pairwise(breaks):
        count = max(3, int(2 * SAMPLES * (high - low)))
        u.append(np.linspace(low, high, count))
        inside.append(np.full(count, 0.5 * (low + high)))
    return np.concatenate(u), np.concatenate(inside)


def _third_derivatives(
    one: kinds.PathSegments, u: FloatArray, inside: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return path length [m] and |o_sss| along a corner [1/m3, B2013, Eq. 11], shapes (K,)."""
    turn, speed = np.empty(len(u)), np.empty(len(u))
    curves = one.bottom[0], one.top[0], one.connection[0], one.parametrization[0]
    for k, (v, piece) in enumerate(zip(u, inside, strict=True)):
        tip, axis = kinds.corner_jets(*curves, v, piece)
        rate = axes.speed_of(tip)
        speed[k] = rate[0]
        turn[k] = np.linalg.norm([jet.by_arc_length.py_func(tuple(a), rate)[3] for a in axis])
    way = np.r_[0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(u))]
    return way * (float(lengths(one, 0.0)[0]) / way[-1]), turn


def _with_lines(
    segments: kinds.PathSegments, row: int, corner: tuple[FloatArray, FloatArray], reach: float
) -> tuple[FloatArray, FloatArray]:
    """Add the constant third derivatives of the lines on both sides of a corner."""
    way, turn = corner
    for side, at in ((-1, row - 1), (1, row + 1)):
        if not 0 <= at < len(segments) or segments.kind[at] != kinds.LINE:
            continue
        length = float(segments.length[at])
        beside = (float(norm(segments.rotation[at])) / length) ** 3 if length > 0.0 else 0.0
        span = min(reach, length)
        if side < 0:
            way, turn = np.r_[-span, 0.0, way], np.r_[beside, beside, turn]
        else:
            way, turn = np.r_[way, way[-1], way[-1] + span], np.r_[turn, beside, beside]
    return way, turn
