"""Draw the figures of the corner-rounding paper [B2013] on numbers of this package.

    python docs/make_paper_figures.py

writes ``docs/pictures/corner_*.png`` and the tables between the two marker comments of
``docs/how_it_works/corner_rounding.md``. Needs matplotlib beside the package.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from make_pictures import BLUE, INK, ORANGE, PICTURES, QUIET, STYLE
from matplotlib import pyplot as plt
from matplotlib.collections import PolyCollection
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from scipy.optimize import brentq

from cnc_interp.core import MM, MM_PER_MIN, FloatArray
from cnc_interp.core.bspline import corner_spline_points
from cnc_interp.feedrate.planning_windows import PlannedPiece
from cnc_interp.kinematics.axis_path import evaluate
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.kinematics.segment_axes import arc_length, shapes_of
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import Program, read_program
from cnc_interp.report.corners import lengths
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.corners.connection import top_parameters
from cnc_interp.smoothing.segments import CORNER

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / 'benchmarks'))

from whole_plans import Plan, plan_program  # noqa: E402

PAGE = HERE / 'how_it_works' / 'corner_rounding.md'
MARKERS = '<!-- tables: begin -->', '<!-- tables: end -->'
GREEN = '#2e7d4f'
FEED = 3000.0
#: The corner's time is measured from here before its entry to here after its exit [m].
MARGIN = 3.0 * MM
#: Steps of the discrete third derivative: at F one period on the pocket; fine on the pyramid [m].
POCKET_STEP, PYRAMID_STEP = 0.05 * MM, 0.002 * MM
#: Rows of the tables: parametrization, top curve, L2/L1 (None: chosen for each corner).
WAYS = (*((f, 'tolerance', 1.4) for f in ('linear', 'paper', 'exact')), ('exact', 'in_step', None))
#: Like for like: the same curves (the paper's top, its ratio), only the parametrization differs.
PAPER_CURVES: dict[str, Any] = {'top': 'tolerance', 'corner_ratio': 1.4}


class Part(NamedTuple):
    s: FloatArray  #: (N,): Path positions [m].
    cell_left: FloatArray  #: (4, N - 1, n_axes): As in ``AxisPath``.
    cell_right: FloatArray


@dataclass(frozen=True)
class Run:
    """One way to make the corners, planned."""

    plan: Plan

    @cached_property
    def whole(self) -> PlannedPiece:
        """Return path and motion law of the whole part."""
        return PlannedPiece.join(self.plan.pieces)

    @cached_property
    def transform(self) -> Transform:
        """Return the machine's transformation."""
        return Transform.of(self.plan.machine)

    @cached_property
    def parts(self) -> list[Part]:
        """Return the axes of each segment by itself, with its own one-sided derivatives."""
        segments, settings = self.plan.segments, self.plan.settings
        height = settings.flank_height
        builder = AxisPathBuilder(self.transform, height, settings.interpolation_period)
        path = builder.push(segments)
        assert path is not None
        ends = np.abs(path.s[:, None] - np.append(0.0, np.cumsum(lengths(segments, height))))
        return [
            Part(path.s[a : b + 1], path.cell_left[:, a:b], path.cell_right[:, a:b])
            for a, b in pairwise(ends.argmin(axis=0))
        ]

    @property
    def cycle_time(self) -> float:
        """Return the time for the whole part [s]."""
        return self.whole.law.end_time

    @cached_property
    def corner(self) -> tuple[float, float]:
        """Return path positions of entry and exit of the first corner [m]."""
        first = int(np.argmax(self.plan.segments.kind == CORNER))
        return float(self.parts[first].s[0]), float(self.parts[first].s[-1])

    @property
    def entry_speed(self) -> float:
        """Return ds/du of the first corner's bottom curve at its entry [m]."""
        bottom = self.plan.segments.bottom[np.argmax(self.plan.segments.kind == CORNER)]
        return 6.0 * float(np.linalg.norm(bottom[1] - bottom[0]))

    def corner_time(self) -> float:
        """Return the time from MARGIN before to MARGIN after the first corner [s]."""
        t, s, _ = self.motion()
        times = np.interp([self.corner[0] - MARGIN, self.corner[1] + MARGIN], s, t)
        return float(times[1] - times[0])

    def stops_inside(self) -> int:
        """Count the points between start and end at which the tool has to rest."""
        return int(self.whole.path.stop[1:-1].sum())

    def motion(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return time [s], path position [m] and feed [m/s], each piece in eight instants."""
        law = self.whole.law
        t = (law.time[:, None] + law.duration[:, None] * np.arange(8) / 8.0).ravel()
        t = np.append(t, law.end_time)
        s, v, _, _ = law.evaluate(t)
        return t, np.maximum.accumulate(s), v

    def backward(self, s: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
        """Return o_sss [1/m3] and Eq. 10 [m/s] from backward differences, as the paper does."""
        q = [evaluate(self.whole.path, s - k * step)[0] for k in range(4)]
        o = [self.transform.forward(x)[1] for x in q]
        return differences(o, step)[2], eq_10(differences(q, step), self.plan.machine)

    def jumps(self) -> FloatArray:
        """Return the largest jumps at joins of q_s, q_ss, q_sss over linear and rotary axes.

        Each is relative to that derivative's largest value of that axis on the path, shape (3, 2).
        """
        left = np.stack([part.cell_right[1:, -1] for part in self.parts[:-1]], axis=1)
        right = np.stack([part.cell_left[1:, 0] for part in self.parts[1:]], axis=1)
        every = [side for part in self.parts for side in (part.cell_left, part.cell_right)]
        largest = np.abs(np.concatenate(every, axis=1)[1:]).max(axis=1)
        jump = np.abs(right - left).max(axis=1) / largest
        return np.stack([jump[:, :3].max(axis=1), jump[:, 3:].max(axis=1)], axis=1)


def differences(x: list[FloatArray], step: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return three backward differences of values at s, s - step, s - 2 step, s - 3 step."""
    return (
        (x[0] - x[1]) / step,
        (x[0] - 2.0 * x[1] + x[2]) / step**2,
        (x[0] - 3.0 * x[1] + 3.0 * x[2] - x[3]) / step**3,
    )


def eq_10(jets: tuple[FloatArray, FloatArray, FloatArray], machine: Machine) -> FloatArray:
    """Return the upper limit of the feed [B2013, Eq. 10] from q_s, q_ss, q_sss [m/s]."""
    limits = machine.max_velocity, machine.max_acceleration, machine.max_jerk
    bound = np.full(len(jets[0]), FEED * MM_PER_MIN)
    for k, (limit, jet) in enumerate(zip(limits, jets, strict=True), start=1):
        share = (limit / np.maximum(np.abs(jet), 1e-300)) ** (1.0 / k)
        bound = np.minimum(bound, share.min(axis=1))
    return bound


def read_example(name: str, tolerance: float, machine: Machine) -> Program:
    """Read an example program with the same tolerance for contour and orientation."""
    settings = Settings(contour_tolerance=tolerance, orientation_tolerance=tolerance)
    file = HERE.parent / 'examples' / f'{name}.apt'
    return read_program(file, Transform.of(machine), settings)


def sheet(rows: int, columns: int, height: float, **settings: Any) -> Any:
    """Return a figure as wide as the page, and its panels."""
    size = (7.2, height)
    return plt.subplots(rows, columns, figsize=size, layout='constrained', **settings)


def save(figure: Any, name: str) -> None:
    """Write one picture."""
    figure.savefig(PICTURES / f'corner_{name}.png', dpi=130)
    plt.close(figure)


def draw_parametrization(runs: dict[str, Run]) -> None:
    """Fig. 5: the parametrization spline of the pocket corner, and what it differs from u."""
    u = np.linspace(0.0, 1.0, 401)
    figure, panels = sheet(1, 2, 2.9)
    for label, color in (('linear', QUIET), ('paper', ORANGE), ('exact', BLUE)):
        segments = runs[label].plan.segments
        f = segments.parametrization[segments.kind == CORNER][:1]
        top = np.array([top_parameters(f, x)[0] for x in u])
        panels[0].plot(u, top, color=color, lw=1.5, label=label)
        panels[1].plot(u, top - u, color=color, lw=1.5)
        if label == 'paper':
            knots = np.append(f[0, :, 0], 1.0)
            values = np.append(f[0, :, 1], 1.0)
            panels[0].plot(knots, values, 'o', ms=3, color=color)
            panels[1].plot(knots, values - knots, 'o', ms=3, color=color)
    panels[0].set(xlabel='$u_{bottom}$ (-)', ylabel='$u_{top} = f(u_{bottom})$ (-)')
    panels[0].legend()
    panels[1].set(xlabel='$u_{bottom}$ (-)', ylabel='$f(u) - u$ (-)')
    save(figure, 'parametrization')


def first_point(run: Run, step: float) -> dict[str, Any]:
    """Vary the first top parameter of the corner, the bottom point staying where it is (Fig. 6).

    Returns functions of u_top1 for the criterion (Eq. 11, 1/m3) and the limit (Eq. 10, m/s),
    its best value, that of the bottom, and the change that halves the limit.
    """
    segments = run.plan.segments
    i = int(np.argmax(segments.kind == CORNER))
    bottom, top = segments.bottom[i], segments.top[i]
    u_bottom = step / run.entry_speed
    beside = np.zeros((10, 0))  # moved by the tip and the tool alone
    ds = float(arc_length(CORNER, 0, shapes_of(segments)[i], beside, 0.0, 0.0, 0.0, u_bottom))
    q = list(evaluate(run.whole.path, run.corner[0] - ds * np.arange(3.0))[0][:, None])
    o = [run.transform.forward(x)[1] for x in q]
    tip = corner_spline_points(bottom, u_bottom)

    def tool(u: float) -> FloatArray:
        reach = corner_spline_points(top, u) - tip
        return np.asarray(reach / np.linalg.norm(reach))[None]

    def criterion(u: float) -> float:
        return float(np.linalg.norm(differences([tool(u), *o], ds)[2]))

    def limit(u: float) -> float:
        axis = tool(u)[0]
        pairs = run.transform.rotary_solutions(axis)
        pairs = [p + 2.0 * np.pi * np.round((q[0][0, 3:] - p) / (2.0 * np.pi)) for p in pairs]
        rotary = min(pairs, key=lambda p: float(np.abs(p - q[0][0, 3:]).max()))
        axes = np.r_[run.transform.linear(tip[None], rotary[None])[0], rotary][None]
        return float(eq_10(differences([axes, *q], ds), run.plan.machine)[0])

    slope = (tool(2.0 * u_bottom) - tool(0.0))[0]
    expected = 3.0 * o[0] - 3.0 * o[1] + o[2]
    best = brentq(
        lambda u: float(slope @ (tool(u) - expected)[0]), 0.0, 4.0 * u_bottom, xtol=1e-15
    )
    found = {'criterion': criterion, 'limit': limit, 'best': best, 'linear': u_bottom, 'ds': ds}
    half = brentq(lambda x: limit(best + x) - 0.5 * limit(best), 0.0, u_bottom, xtol=1e-14)
    return {**found, 'half': half}


def draw_sensitivity(point: dict[str, Any]) -> None:
    """Fig. 6: criterion and feed limit against a small change of the first top parameter."""
    away = point['linear'] - point['best']
    figure, panels = sheet(2, 2, 4.2)
    for column, reach in enumerate((1.3 * abs(away), 6.0 * point['half'])):
        x = np.linspace(-reach, reach, 401)
        scale = 1e-3 if column == 0 else 1e-6
        rows = (
            ([point['criterion'](point['best'] + v) * MM**3 for v in x], GREEN),
            ([point['limit'](point['best'] + v) / MM_PER_MIN for v in x], BLUE),
        )
        for panel, (y, color) in zip(panels[:, column], rows, strict=True):
            panel.plot(x / scale, y, color=color, lw=1.5)
            panel.set(ylim=(0, None), xlim=(-reach / scale, reach / scale))
            if column == 0:
                label = '$u_{top1} = u_{bottom1}$'
                panel.axvline(away / scale, color=INK, lw=1.0, ls=':', label=label)
        panels[1, column].set_xlabel(f'$u_{{top1}}$ - optimum ($10^{{{round(np.log10(scale))}}}$)')
    panels[0, 0].legend(loc='upper center')
    panels[0, 0].set(ylabel='criterion, Eq. 11 (1/mm³)')
    panels[1, 0].set(ylabel='feed limit, Eq. 10 (mm/min)')
    save(figure, 'sensitivity')


def draw_connection(
    runs: dict[str, Run], step: float, margin: float, highest: float, name: str
) -> None:
    """Fig. 8 and 11: o_sss, limit and planned feed, linear beside exact parametrization."""
    figure, panels = sheet(2, 2, 4.6, sharex='col', sharey='row')
    for column, label in enumerate(('linear', 'exact')):
        run = runs[label]
        middle = 0.5 * sum(run.corner)
        s = np.arange(run.corner[0] - margin, run.corner[1] + margin, 0.25 * step)
        o_sss, limit = run.backward(s, step)
        x = (s - middle) / MM
        upper, lower = panels[:, column]
        upper.set_title(f'{label} parametrization', fontsize=10)
        for k, (letter, color) in enumerate(zip('ijk', (BLUE, ORANGE, GREEN), strict=True)):
            upper.plot(x, o_sss[:, k] * MM**3, color=color, lw=1.0, label=f'${letter}_{{sss}}$')
        true_limit = eq_10(evaluate(run.whole.path, s)[1:], run.plan.machine)
        lower.plot(x, limit / MM_PER_MIN, color=ORANGE, lw=1.0, label='Eq. 10, differences')
        lower.plot(x, true_limit / MM_PER_MIN, color=INK, lw=0.9, ls='--', label='Eq. 10, exact')
        _, s, v = run.motion()
        near = (s > run.corner[0] - margin) & (s < run.corner[1] + margin)
        x, v = (s[near] - middle) / MM, v[near] / MM_PER_MIN
        lower.plot(x, v, color=BLUE, lw=1.8, label='planned')
        for panel in panels[:, column]:
            for edge in run.corner:
                panel.axvline((edge - middle) / MM, color=QUIET, lw=0.8, ls=':')
        lower.set(xlabel='path position from the middle of the corner (mm)')
    linear_to = float(np.abs(o_sss).max()) * MM**3  # of the exact one, drawn last
    panels[0, 0].set_yscale('symlog', linthresh=linear_to)
    largest = np.log10(np.abs(panels[0, 0].get_ylim()).max())
    decades = 10.0 ** np.arange(np.ceil(np.log10(1.5 * linear_to)), largest)
    panels[0, 0].set_yticks([*-decades[::-1], 0.0, *decades])
    for panel in panels[0]:
        panel.tick_params(which='minor', left=False)
    panels[0, 0].set(ylabel='$o_{sss}$ (1/mm³)')
    panels[1, 0].set(ylabel='feed (mm/min)', ylim=(0, highest))
    panels[0, 1].legend(loc='upper right', fontsize=8, ncols=3)
    panels[1, 1].legend(loc='upper center' if highest < FEED else 'lower left', fontsize=8)
    save(figure, name)


def swept(run: Run, first: float, last: float, count: int) -> tuple[FloatArray, FloatArray]:
    """Return the quads that the tool axis sweeps [mm], shape (n, 4, 3), and their feeds."""
    s = np.linspace(first, last, count)
    tip, axis = run.transform.forward(evaluate(run.whole.path, s)[0])
    low, high = tip / MM, (tip + run.plan.settings.flank_height * axis) / MM
    _, way, feed = run.motion()
    middle = np.interp(0.5 * (s[1:] + s[:-1]), way, feed)
    return np.stack([low[:-1], low[1:], high[1:], high[:-1]], axis=1), middle / MM_PER_MIN


def draw_swept(runs: dict[str, Run]) -> None:
    """Fig. 8, bottom: the planned feed on the surface that the tool axis sweeps, from above."""
    figure, panels = sheet(1, 2, 3.2, sharex=True, sharey=True)
    for panel, label in zip(panels, ('linear', 'exact'), strict=True):
        run = runs[label]
        quads, feed = swept(run, run.corner[0] - 15 * MM, run.corner[1] + 15 * MM, 900)
        shape = PolyCollection(list(quads[..., :2]), array=feed, edgecolors='face', lw=0.3)
        shape.set_cmap('viridis')
        shape.set_clim(0.0, FEED)
        panel.add_collection(shape)
        panel.plot(*quads[:, 0, :2].T, color=INK, lw=0.8)
        panel.set(xlabel='x (mm)', aspect='equal')
        panel.set_title(f'{label} parametrization', fontsize=10)
        panel.autoscale_view()
    panels[0].set_ylabel('y (mm)')
    figure.colorbar(shape, ax=panels, label='planned feed (mm/min)').outline.set_visible(False)
    save(figure, 'pocket_swept')


def draw_times(runs: dict[str, Run]) -> None:
    """Fig. 9: the feed over time, and machining times for two windows."""
    figure, (left, right) = sheet(1, 2, 2.9, width_ratios=(3, 2))
    ways = (('linear', QUIET), ('paper', ORANGE), ('exact', BLUE), ('in step', GREEN))
    for row, (label, color) in enumerate(ways):
        run = runs[label]
        t, _, v = run.motion()
        if label != 'in step':
            left.plot(t, v / MM_PER_MIN, color=color, lw=1.4)
        for k, time in enumerate((run.corner_time(), run.cycle_time)):
            place = 5.0 * k + row
            right.barh(place, time, color=color, height=0.8)
            right.text(time + 0.04, place, f'{time:.2f} {label}', va='center', fontsize=8)
    left.set(xlabel='time (s)', ylabel='planned feed (mm/min)', ylim=(0, None))
    right.set(xlabel='time (s)', xlim=(0, 4.4), yticks=[1.5, 6.5])
    right.set_yticklabels(['corner\n± 3 mm', 'whole\npart'])
    right.invert_yaxis()
    right.grid(False, axis='y')
    save(figure, 'pocket_times')


def draw_pyramid(run: Run) -> None:
    """Fig. 10: the pyramid's flanks and the tool path, coloured by feed."""
    figure = plt.figure(figsize=(7.2, 3.6))
    axes = figure.add_axes((-0.05, -0.1, 0.98, 1.25), projection='3d')
    quads, feed = swept(run, 0.0, float(run.whole.path.s[-1]), 1200)
    axes.computed_zorder = False
    walls, _ = swept(run, 0.0, float(run.whole.path.s[-1]), 201)
    axes.add_collection3d(Poly3DCollection(walls, facecolors='#e9edf1', linewidths=0, alpha=0.5))
    line = Line3DCollection(quads[:, :2], array=feed, cmap='viridis', linewidths=3, zorder=3)
    line.set_clim(0.0, FEED)
    axes.add_collection3d(line)
    axes.add_collection3d(Line3DCollection(quads[::30, [0, 3]], colors=QUIET, linewidths=0.6))
    low, high = quads.min(axis=(0, 1)), quads.max(axis=(0, 1))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set(xlabel='x (mm)', ylabel='y (mm)', zlabel='z (mm)', zticks=[0, 10, 20, 30])
    axes.set_box_aspect(high - low, zoom=0.9)
    axes.view_init(32.0, -58.0)
    for side in (axes.xaxis, axes.yaxis, axes.zaxis):
        side.set_pane_color('white')
    place = figure.add_axes((0.88, 0.22, 0.018, 0.56))
    bar = figure.colorbar(line, cax=place, label='planned feed (mm/min)')
    bar.outline.set_visible(False)
    save(figure, 'pyramid')


def jump_text(value: float) -> str:
    """Write a relative jump; below the rounding of the derivatives it is none."""
    if value < 1e-7:
        return '0'
    return f'{100.0 * value:.3g} %' if value >= 1e-4 else f'{100.0 * value:.0e} %'


def table(program: Program, machine: Machine) -> list[str]:
    """Return the Markdown table of the ways to make the corners of one program."""
    head = 'f | top | L2/L1 | q_s | q_ss | q_sss XYZ | q_sss AC | stops | corner, s | whole, s'
    lines = [f'| {head} |', '|---' * 10 + '|']
    for f, top, ratio in WAYS:
        settings = Settings(parametrization=f, top=top, corner_ratio=ratio)
        run = Run(plan_program(program, machine, settings))
        jump = run.jumps()
        cells = [f, top, f'{ratio:g}' if ratio else 'auto']
        cells += [jump_text(jump[k].max()) for k in range(2)] + [jump_text(x) for x in jump[2]]
        cells += [f'{run.stops_inside()}', f'{run.corner_time():.3f}', f'{run.cycle_time:.3f}']
        lines.append('| ' + ' | '.join(cells) + ' |')
    return lines


def write_page(sections: list[tuple[str, list[str]]]) -> None:
    """Put the tables between the markers of the page."""
    begin, end = MARKERS
    head, rest = PAGE.read_text(encoding='utf-8').split(begin)
    tail = rest.split(end)[1]
    body = '\n\n'.join(f'**{title}**\n\n' + '\n'.join(lines) for title, lines in sections)
    PAGE.write_text(f'{head}{begin}\n\n{body}\n\n{end}{tail}', encoding='utf-8')


def main() -> None:
    """Plan both parts in all ways, draw the pictures and write the tables."""
    machine = Machine.load('xyzac')
    pocket = read_example('pocket_corner', 3.0 * MM, machine)
    pyramid = read_example('pyramid', 0.02 * MM, machine)
    ways = {f: Settings(parametrization=f, **PAPER_CURVES) for f in ('linear', 'paper', 'exact')}
    ways['in step'] = Settings(corner_ratio=1.4)
    runs = {name: Run(plan_program(pocket, machine, way)) for name, way in ways.items()}
    small = {name: Run(plan_program(pyramid, machine, way)) for name, way in ways.items()}
    mpl.use('agg')
    PICTURES.mkdir(exist_ok=True)
    with mpl.rc_context(STYLE):
        draw_parametrization(runs)
        draw_sensitivity(first_point(runs['linear'], POCKET_STEP))
        draw_connection(runs, POCKET_STEP, 6.0 * MM, 1.03 * FEED, 'pocket')
        draw_swept(runs)
        draw_times(runs)
        draw_pyramid(small['exact'])
        draw_connection(small, PYRAMID_STEP, 0.06 * MM, 320.0, 'pyramid_zoom')
    programs = {'Pocket corner, 3 mm': pocket, 'Pyramid, 0.02 mm': pyramid}
    write_page([(title, table(program, machine)) for title, program in programs.items()])


if __name__ == '__main__':
    main()
