"""Dense blocks that became curves: figures and text of the report."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import plotly.graph_objects as go

from cnc_interp.core import MM, UM, FloatArray, InterpError
from cnc_interp.core.bezier import bezier_values
from cnc_interp.kinematics.segment_axes import FOLLOWING, LINEAR, arc_length, beside_of, shapes_of
from cnc_interp.program.blocks import POSES
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.report.html import BLUE, ORANGE, drawing, laid_out, section
from cnc_interp.smoothing.segments import SPLINE, PathSegments

#: Points of a span in the close-up, and its spans on either side of the largest bound.
POINTS, AROUND = 24, 5
MOST = 4000  #: Largest number of bounds drawn along the path.


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
    polyline: FloatArray  #: (M, 2): The programmed tips there, in the same plane [mm].
    line: int  #: Line of the program there.

    @property
    def text(self) -> str:
        return (
            f'{self.blocks:,} blocks became {self.runs:,} curves of {self.spans:,} spans: '
            f'{self.spans / max(self.blocks, 1):.2f} spans a block, {self.share:.1%} of the path. '
            'Left: proven bounds of the deviation along the path, in both directions: '
            f'at most {self.used[0]:.1%} of the contour and {self.used[1]:.1%} of the '
            f'orientation tolerance. Right: around the largest one, line {self.line}.'
        )


def curves_of(plan: PlanFiles, segments: PathSegments) -> CurvesView | None:
    native = np.isfinite(plan.blocks['knot_interval'])
    spans = np.flatnonzero((segments.kind == SPLINE) & ~native[segments.block[:, 1]])
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
    chosen = np.unique(np.linspace(0, len(spans) - 1, min(len(spans), MOST)).astype(int))
    return CurvesView(
        blocks=int((last - first + 1).sum()), spans=len(spans), runs=int(begins.sum()),
        share=float(length[spans].sum() / length.sum()), way=np.cumsum(length)[spans][chosen] / MM,
        bound=bound[chosen], used=(segments.deviation[spans] / tolerance).max(axis=0),
        curve=(points - middle) @ plane.T / MM, polyline=(tips - middle) @ plane.T / MM,
        line=int(segments.line_number[spans[worst]]),
    )  # fmt: skip


def bounds_figure(view: CurvesView) -> Any:
    figure = go.Figure()
    for k, (name, colour) in enumerate((('contour', BLUE), ('orientation', ORANGE))):
        figure.add_scatter(
            x=view.way, y=view.bound[:, k], name=name, mode='lines',
            line={'color': colour, 'width': 1.0},
        )  # fmt: skip
    figure.update_xaxes(title_text='path (mm)')
    figure.update_yaxes(title_text='bound (µm)', rangemode='tozero')
    return laid_out(figure, 360)


def close_figure(view: CurvesView) -> Any:
    figure = go.Figure()
    figure.add_scatter(
        x=view.polyline[:, 0], y=view.polyline[:, 1], name='programmed', mode='lines+markers',
        line={'color': '#8d99a5', 'width': 1.5}, marker={'size': 4},
    )  # fmt: skip
    figure.add_scatter(
        x=view.curve[:, 0], y=view.curve[:, 1], name='curve', mode='lines',
        line={'color': BLUE, 'width': 2.0},
    )  # fmt: skip
    figure.update_xaxes(title_text='mm')
    figure.update_yaxes(title_text='mm', scaleanchor='x')
    return laid_out(figure, 360)


def curves_section(plan: PlanFiles, segments: PathSegments) -> str:
    view = curves_of(plan, segments)
    if view is None:
        return ''
    pair = f'<div>{drawing(bounds_figure(view))}</div><div>{drawing(close_figure(view))}</div>'
    return section('Dense blocks as curves', view.text, f'<div class="pair">{pair}</div>')


FILE = 'segments.npz'


def read_segments(directory: Path) -> PathSegments | None:
    file = directory / FILE
    if not file.is_file():
        return None
    try:
        with np.load(file, allow_pickle=False) as archive:
            return PathSegments.of_columns(archive)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as fault:
        raise InterpError(f'{file}: cannot be read ({fault}); plan again') from fault


def lengths(segments: PathSegments, height: float) -> FloatArray:
    shapes, beside = shapes_of(segments), beside_of(segments)
    motion = np.where(segments.interpolation == POSES, FOLLOWING, LINEAR)
    rows = zip(segments.kind, motion, shapes, beside, segments.length, strict=True)
    halves = ((0.0, 0.5), (0.5, 1.0))
    return np.array([
        sum(arc_length(kind, how, shape, own, height, length, *half) for half in halves)
        for kind, how, shape, own, length in rows
    ])  # fmt: skip
