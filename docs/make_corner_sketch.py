"""Draw the parts of a rounded corner by their names, for ``docs/how_it_works/corner_rounding.md``.

    python docs/make_corner_sketch.py

writes ``docs/pictures/corner_parts.png``: the corner of ``examples/pocket_corner.apt`` with
3 mm. Needs matplotlib beside the package.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from make_pictures import BLUE, INK, ORANGE, PICTURES, QUIET, STYLE
from matplotlib import pyplot as plt

from cnc_interp.core import MM, FloatArray
from cnc_interp.core.bspline import corner_spline_points
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_program
from cnc_interp.run.path_chain import segments_of
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.orientation import turned_by
from cnc_interp.smoothing.segments import CORNER, LINE

PROGRAM = Path(__file__).parent.parent / 'examples' / 'pocket_corner.apt'
#: Part of the lines that is drawn on either side of the corner [mm].
SHOWN = 24.0
#: Tool axes drawn on each line and on the corner.
SPOKES = 4, 9


def label(axes: Any, text: str, at: Any, away: tuple[float, float], colour: str = INK) -> None:
    """Write a text beside a point; ``away`` is the distance in points."""
    axes.annotate(
        text, at, away, textcoords='offset points', color=colour, ha='center', va='center'
    )


def draw_bottom(axes: Any, points: FloatArray, curve: FloatArray) -> None:
    """Draw the bottom curve from above, with control points and lengths [mm]."""
    corner = points[2]
    entry = (points[0] - corner) / np.linalg.norm(points[0] - corner)
    leave = (points[4] - corner) / np.linalg.norm(points[4] - corner)
    for direction in (entry, leave):
        line = np.stack([corner, corner + SHOWN * direction])
        axes.plot(line[:, 0], line[:, 1], color=QUIET, lw=1.2)
    axes.plot(curve[:, 0], curve[:, 1], color=BLUE, lw=2.4)
    axes.plot(points[:, 0], points[:, 1], 'o', color=INK, ms=4, zorder=3)
    sides = [(0.0, 11.0), (0.0, 11.0), (12.0, -8.0), (12.0, 0.0), (12.0, 0.0)]
    for k, away in enumerate(sides):
        label(axes, f'P{k}', points[k, :2], away)
    middle = curve[len(curve) // 2]
    axes.plot(*np.stack([corner, middle])[:, :2].T, color=ORANGE, lw=1.4)
    label(axes, 'ε', 0.5 * (corner + middle)[:2], (-9.0, -4.0), ORANGE)
    for k, text, offset in ((1, 'L1', 3.2), (0, 'L2', 5.4)):
        low, high = points[k, 0], corner[0]
        axes.annotate(
            '', (low, -offset), (high, -offset), arrowprops={'arrowstyle': '<->', 'color': INK}
        )
        label(axes, text, (0.5 * (low + high), -offset), (0.0, -8.0))
    label(axes, 'C_bottom', curve[len(curve) // 3, :2], (-14.0, 16.0), BLUE)
    label(axes, 'line', corner[:2] + 0.85 * SHOWN * entry[:2], (0.0, 8.0), QUIET)
    axes.set(xlim=(-1.1 * SHOWN, 4.0), ylim=(-9.0, 1.1 * SHOWN))
    axes.set(aspect='equal', xlabel='x (mm)', ylabel='y (mm)', title='the tool tip from above')


def draw_tool(axes: Any, curves: tuple[FloatArray, FloatArray], lines: list[FloatArray]) -> None:
    """Draw both curves in space, with tool axes on the lines and on the corner [mm]."""
    bottom, top = curves
    for line in lines:
        for row in (line[:, 0], line[:, 1]):
            axes.plot(*row.T, color=QUIET, lw=1.2)
        for pair in line[:: max(1, len(line) // SPOKES[0])]:
            axes.plot(*pair.T, color=QUIET, lw=0.8)
    axes.plot(*bottom.T, color=BLUE, lw=2.4)
    axes.plot(*top.T, color=ORANGE, lw=2.4)
    for k in np.linspace(0, len(bottom) - 1, SPOKES[1]).astype(int):
        axes.plot(*np.stack([bottom[k], top[k]]).T, color=INK, lw=0.8)
    axes.text(*(bottom[len(bottom) // 2] + [2.0, -4.0, -5.0]), 'C_bottom', color=BLUE)
    axes.text(*(top[len(top) // 2] + [1.0, -3.0, 3.0]), 'C_top', color=ORANGE)
    axes.text(*(0.5 * (bottom[-1] + top[-1]) + [2.0, 0.0, 0.0]), 'h', color=INK)
    axes.set(xlabel='x (mm)', ylabel='y (mm)', zlabel='z (mm)', title='the tool axis')
    axes.view_init(18, -62)
    axes.set_aspect('equal')


def main() -> None:
    """Round the corner and draw its parts."""
    mpl.rcParams.update(STYLE)
    machine = Machine.load('xyzac')
    transform = Transform.of(machine)
    settings = replace(Settings(), contour_tolerance=3.0 * MM, orientation_tolerance=3.0 * MM)
    segments = segments_of(read_program(PROGRAM, transform, settings).blocks, transform, settings)
    row = int(np.flatnonzero(segments.kind == CORNER)[0])
    u = np.linspace(0.0, 1.0, 121)
    points, top_points = segments.bottom[row, :5] / MM, segments.top[row, :5] / MM
    bottom = np.stack([corner_spline_points(points, x) for x in u])
    # In step: f(u) = u. The connection E is too small to be seen.
    top = np.stack([corner_spline_points(top_points, x) for x in u])
    height = settings.flank_height / MM
    lines = []
    for k in np.flatnonzero(segments.kind == LINE):
        share = np.linspace(0.0, 1.0, 25)[:, None]
        tips = (segments.bottom[k, 0] * (1.0 - share) + segments.bottom[k, 1] * share) / MM
        near = np.linalg.norm(tips - points[2], axis=1) < SHOWN
        tools = turned_by(segments.axis[k][None], segments.rotation[k][None], share[:, 0])
        lines.append(np.stack([tips, tips + height * tools], axis=1)[near])
    figure = plt.figure(figsize=(10.4, 4.4))
    draw_bottom(figure.add_axes((0.06, 0.12, 0.38, 0.79)), points, bottom)
    draw_tool(figure.add_axes((0.46, 0.02, 0.52, 0.88), projection='3d'), (bottom, top), lines)
    figure.savefig(PICTURES / 'corner_parts.png', dpi=110)


if __name__ == '__main__':
    main()
