"""Draw the figures of the iso-scallop paper [TL2008] on numbers of this package.

    python docs/make_cam_figures.py           pictures
    python docs/make_cam_figures.py --times   table and picture of machining times (ten minutes)
    python docs/make_cam_figures.py --solvers iterations of both methods for scallop points

writes ``docs/pictures/cam_*.png`` and the table between the two marker comments of
``docs/how_it_works/cam.md``. Needs matplotlib beside the package.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from make_pictures import BLUE, INK, ORANGE, PICTURES, QUIET, STYLE
from matplotlib import pyplot as plt
from scipy.optimize import fsolve

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.guiding import GuidingPlanes
from cnc_interp.cam.iso_scallop import IsoScallopOptions, IsoScallopPaths, iso_scallop_paths
from cnc_interp.cam.make_program import across
from cnc_interp.cam.nbuffer import cut_needles
from cnc_interp.cam.needles import Needles
from cnc_interp.cam.passes import Pass, constant_tilt
from cnc_interp.cam.scallop import conditions, nearest_places, resting, scallop_points
from cnc_interp.cam.shapes import Bumps, Cap, Cylinder
from cnc_interp.cam.simulation import Motion, cross_sections
from cnc_interp.cam.spline_pass import SplinePass
from cnc_interp.cam.surface_file import read_part
from cnc_interp.cam.tool_path import LinkOptions, ToolPath, link
from cnc_interp.commands.cli import main as command
from cnc_interp.core import DEG, MM, UM, FloatArray

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / 'benchmarks'))

from classical_passes import classical_paths  # noqa: E402
from marched_scallop import march_to_scallops  # noqa: E402

EXAMPLES = HERE.parent / 'examples'
PAGE = HERE / 'how_it_works' / 'cam.md'
MARKERS = '<!-- times: begin -->', '<!-- times: end -->'
MILL, HEIGHT = Cutter(5 * MM, 1.5 * MM), 10 * UM
Y = np.array([0.0, 1.0, 0.0])

#: Rows of the table: heading, surface, options.
ROWS: list[tuple[str, str, list[str]]] = [
    ('planes, d 2.0 mm', 'bumps', ['--stepover', '2']),
    ('planes, largest d, tilt from 3 deg', 'bumps', []),
    ('planes, d 5.0 mm', 'hollow', ['--stepover', '5']),
    ('planes, d 2.0 mm, feed along v', 'bumps', ['--stepover', '2', '--direction', '90']),
    ('planes, d 1.6 mm', 'bumps', ['--stepover', '1.6']),
    ('planes, d 3.5 mm', 'hollow', ['--stepover', '3.5']),
]


def loops() -> None:
    """Fig. 1: passes of the classical path, from above, as far as they go."""
    cap = Cap((0.05, 0.05), 15 * MM, 6 * MM, 70 * DEG)
    found = classical_paths(cap, Cutter(0.0, 4.5 * MM), Y, HEIGHT, 5 * DEG, start=0.0)
    figure, panel = plt.subplots(figsize=(6.0, 3.0), layout='constrained')
    ring = np.linspace(0.0, 2.0 * np.pi, 200)
    for radius in (cap.join, cap.foot):
        panel.plot(radius / MM * np.cos(ring), radius / MM * np.sin(ring), color=QUIET, lw=0.8)
    for made in found.passes:
        line = made.postures.contact / MM
        panel.plot(line[:, 0], line[:, 1], color=BLUE, lw=1.0)
    panel.set(xlim=(-22, 22), ylim=(-3, 17), xlabel='x (mm)', ylabel='y (mm)', aspect='equal')
    panel.set_title(f'sphere, torus, plane; {found.loop}', fontsize=8)
    _save(figure, 'cam_loops')


def strategies() -> None:
    """Fig. 5a: classical passes where the curvature varies, and those along parallel planes."""
    surface = Bumps((50 * MM, 40 * MM), np.array([[0.0, 0.0, 5.0, 10.0]]) * MM)
    classical = classical_paths(surface, MILL, Y, HEIGHT, 8 * DEG)
    options = IsoScallopOptions(scallop_height=HEIGHT, tilt=8 * DEG)
    planes = iso_scallop_paths(surface, MILL, Y, options)
    print('classical', len(classical.passes), classical.loop, '; planes', len(planes.passes))
    figure, panels = plt.subplots(
        1, 2, figsize=(7.6, 3.3), layout='constrained', sharex=True, sharey=True
    )
    x, y = np.meshgrid(np.linspace(-25, 25, 101), np.linspace(-20, 20, 81))
    for panel, passes, title in (
        (panels[0], classical.passes, f'classical; {classical.loop}'),
        (panels[1], planes.passes, f'parallel planes; all {len(planes.passes)} passes'),
    ):
        height = 5.0 * np.exp(-(x**2 + y**2) / 200.0)
        panel.contour(x, y, height, np.arange(0.5, 5.0), colors=[QUIET], linewidths=0.6)
        for made in passes:
            line = made.postures.contact / MM
            panel.plot(line[:, 0], line[:, 1], color=BLUE, lw=1.0)
        panel.set(xlim=(-25, 25), ylim=(-20, 20), xlabel='x (mm)', aspect='equal')
        panel.set_title(title, fontsize=8)
        panel.grid(visible=False)
    panels[0].set_ylabel('y (mm)')
    _save(figure, 'cam_strategies')


def contours() -> list[tuple[float, float, bool]]:
    """Fig. 4: zero contours of Eq. 3.13 and 3.14 over place and tilt, on a cylinder."""
    surface = Cylinder(50 * MM, 0.8, 30 * MM)
    planes = GuidingPlanes(surface, MILL.corner_radius, Y, 3 * MM)
    curve, beside = planes.curve(0.0), planes.curve(2.0 * MM)
    angles = constant_tilt(curve, 5 * DEG, 0.0, 41)
    right = scallop_points(surface, angles.postures(curve, MILL, angles.s), HEIGHT)
    middle = nearest_places(beside, right)[20]

    def both(place: FloatArray, tilt: FloatArray) -> tuple[FloatArray, FloatArray, Any]:
        many = {
            name: np.repeat(getattr(right, name)[20:21], place.size, axis=0)
            for name in ('position', 'tangent', 'normal', 'angle', 'found', 'marched', 'refined')
        }
        zero = np.zeros(place.size)
        postures = resting(MILL, beside.frames(middle + place.ravel()), tilt.ravel(), zero)
        with np.errstate(invalid='ignore', divide='ignore'):
            first, second, right_one = conditions(postures, replace(right, **many))
        return tuple(x.reshape(place.shape) for x in (first, second, right_one))

    place, tilt = np.meshgrid(np.linspace(-14, 14, 301) * MM, np.linspace(-180, 180, 481) * DEG)
    first, second, _ = both(place, tilt)
    change = [
        (np.abs(np.diff(np.sign(f), axis=0))[:, :-1] > 0)
        | (np.abs(np.diff(np.sign(f), axis=1))[:-1] > 0)
        for f in (first, second)
    ]
    roots: list[tuple[float, float, bool]] = []
    for i, j in np.argwhere(change[0] & change[1]):

        def miss(x: FloatArray) -> FloatArray:
            a, b, _ = both(np.array([x[0] * MM]), np.array([x[1]]))
            return np.array([a[0], b[0]]) / UM

        x, _, fine, _ = fsolve(miss, [place[i, j] / MM, tilt[i, j]], full_output=True)
        degrees = float(np.degrees(x[1]))
        sound = fine == 1 and float(np.abs(miss(x)).max()) < 1e-5 and abs(degrees) <= 180.0
        if sound and all(abs(degrees - r[1]) > 0.2 or abs(x[0] - r[0]) > 0.1 for r in roots):
            ours = bool(both(np.array([x[0] * MM]), np.array([x[1]]))[2][0])
            roots.append((float(x[0]), degrees, ours))
    figure, panel = plt.subplots(figsize=(6.4, 4.0), layout='constrained')
    panel.contour(place / MM, tilt / DEG, first, [0.0], colors=[BLUE], linewidths=1.4)
    panel.contour(
        place / MM, tilt / DEG, second, [0.0], colors=[INK], linewidths=1.2, linestyles='--'
    )
    for x, degrees, ours in roots:
        panel.plot(x, degrees, 'o', ms=8 if ours else 4, color=ORANGE if ours else QUIET)
    panel.set(xlabel='place on the next guiding curve, from the scallop point (mm)')
    panel.set(ylabel='tilt (deg)', yticks=range(-180, 181, 45))
    panel.set_title('solid: Eq. 3.13, dashed: Eq. 3.14, large dot: the root taken', fontsize=8)
    _save(figure, 'cam_contours')
    print('roots (mm, deg, taken):', [(round(a, 3), round(b, 2), c) for a, b, c in roots])
    return roots


def application() -> None:
    """Fig. 5b to 5d: tilt, widths of cut and heights with the numbers of the paper."""
    surface = read_part(EXAMPLES / 'hollow.json').surfaces[1]
    normal = across(surface, 0.0)
    options = IsoScallopOptions(
        scallop_height=HEIGHT, stepover=5 * MM, tilt=5 * DEG, start='tilt', stray=None, points=25
    )
    paths = iso_scallop_paths(surface, MILL, normal, options)
    curves = [c for c in (SplinePass.of(p, 0.5 * MM) for p in paths.passes) if c]
    path = ToolPath.of(link(curves, surface, MILL, LinkOptions()), 0.05 * UM)
    motion = Motion('programmed', path.tip, path.axis)
    heights = cut_needles(Needles.on(surface, 0.1 * MM, 2 * MM), MILL, path.tip, path.axis)
    section = cross_sections(surface, MILL, motion, normal, 2 * MM)
    ridges = np.percentile(section.ridges, [0, 5, 50, 95, 100]) / UM
    print('iterations', paths.iterations, 'passes', len(paths.passes))
    print('ridges (um; 0, 5, 50, 95, 100 %)', ridges.round(3), len(section.ridges))
    _tilts_and_widths(paths)
    figure, panels = plt.subplots(
        1, 2, figsize=(7.6, 3.2), layout='constrained', width_ratios=(1.35, 1.0)
    )
    size = [float(np.ptp(heights.needles.base[..., 0])) / MM, 36.0]
    image = panels[0].imshow(
        heights.height.T / UM,
        origin='lower',
        extent=(0, size[0], 0, size[1]),
        cmap='viridis',
        vmin=0.0,
        vmax=10.5,
        interpolation='none',
    )
    panels[0].set(xlabel='along the passes (mm)', ylabel='across (mm)')
    panels[0].grid(visible=False)
    figure.colorbar(image, ax=panels[0], label='height (um)', shrink=0.85)
    row = section.height[len(section.height) // 2]
    panels[1].plot(section.way / MM, row / UM, color=BLUE, lw=1.0)
    panels[1].axhline(10.0, color=ORANGE, lw=0.8, ls='--')
    panels[1].set(xlabel='across, in the middle (mm)', ylabel='height (um)')
    _save(figure, 'cam_heights')


def solvers() -> None:
    """Count the iterations of the paper's method and of ours on the passes of the application."""
    surface = read_part(EXAMPLES / 'hollow.json').surfaces[1]
    options = IsoScallopOptions(
        scallop_height=HEIGHT, stepover=5 * MM, tilt=5 * DEG, start='tilt', stray=None, points=25
    )
    paths = iso_scallop_paths(surface, MILL, across(surface, 0.0), options)
    counts, farthest = [], 0.0
    for made in paths.passes[1:]:
        left = scallop_points(surface, made.postures, HEIGHT, -1.0)
        marched = march_to_scallops(surface, made.postures, HEIGHT, left.position)
        if not marched.found.all():
            raise SystemExit('the march of the paper did not end everywhere')
        gap = np.linalg.norm(marched.position - made.right.position, axis=1)
        farthest = max(farthest, float(gap.max()))
        counts.append([marched.steps, marched.corrections, marched.solved])
    steps, corrections, solved = np.concatenate(counts, axis=1).mean(axis=1)
    ours = paths.iterations
    print(f'paper: {steps:.1f} steps with {corrections:.1f} corrections, {solved:.1f} to solve')
    print(f'ours: {ours[0]:.1f} to bracket, {ours[1]:.1f} to solve; a posture {ours[2]:.1f}')
    print(f'largest distance of the points {farthest:.1e} m')


def _tilts_and_widths(paths: IsoScallopPaths) -> None:
    figure, panels = plt.subplots(1, 2, figsize=(7.6, 3.2), layout='constrained')
    shades = mpl.colormaps['viridis'](np.linspace(0.0, 0.9, len(paths.passes)))
    for k, made in enumerate(paths.passes):
        share = made.s / made.curve.length
        panels[0].plot(share, made.postures.tilt / DEG, color=shades[k], lw=1.3, label=f'{k + 1}')
        panels[1].plot(share, _width(made) / MM, color=shades[k], lw=1.3)
    panels[0].set(xlabel='along the pass (-)', ylabel='tilt (deg)')
    panels[0].legend(title='pass', fontsize=7, ncols=2, title_fontsize=7)
    panels[1].set(xlabel='along the pass (-)', ylabel='width of cut (mm)')
    _save(figure, 'cam_tilt')


def _width(made: Pass) -> FloatArray:
    """Return the width of cut: both half widths."""
    left = scallop_points(made.curve.surface, made.postures, HEIGHT, -1.0)
    return made.right.half_width(made.postures) + left.half_width(made.postures)


def times() -> None:
    """Plan all rows on the reference machine; write table and picture."""
    found: list[tuple[str, str, dict[str, Any], float]] = []
    for heading, surface, options in ROWS:
        with tempfile.TemporaryDirectory() as folder:
            arguments = ['cam', 'iso-scallop', str(EXAMPLES / f'{surface}.json'), *options]
            program, plan = Path(folder, 'program.mpf'), Path(folder, 'plan')
            tolerances = ['--contour-tolerance', '0.002', '--orientation-tolerance', '0.002']
            code = command([*arguments, '--points', '40', '--out', folder]) or command(
                ['plan', str(program), *tolerances, '--out', str(plan)]
            )
            if code:
                raise SystemExit(f'{heading}: exit code {code}')
            row = json.loads(Path(folder, 'summary.json').read_text(encoding='utf-8'))
            planned = json.loads((plan / 'summary.json').read_text(encoding='utf-8'))
        row['path_length'] = planned['path_length']
        found.append((heading, surface, row, planned['cycle_time']))
        print(heading, surface, planned['cycle_time'], flush=True)
        _write_times(found)


def _write_times(found: list[tuple[str, str, dict[str, Any], float]]) -> None:
    """Write the rows measured so far, by surface and time."""
    found = sorted(found, key=lambda row: (row[1], -row[3]))
    lines = [
        '| surface | strategy | passes | path with links | machining time |',
        '|---|---|---|---|---|',
    ]
    for heading, surface, row, seconds in found:
        lines.append(
            f'| {surface} | {heading} | {row["passes"]} | {row["path_length"] / MM:.0f} mm | '
            f'{seconds:.1f} s |'
        )
    text = PAGE.read_text(encoding='utf-8')
    before, rest = text.split(MARKERS[0])
    after = rest.split(MARKERS[1])[1]
    table = '\n'.join(lines)
    PAGE.write_text(f'{before}{MARKERS[0]}\n{table}\n{MARKERS[1]}{after}', encoding='utf-8')
    figure, panel = plt.subplots(figsize=(7.2, 3.2), layout='constrained')
    names = [f'{row[1]}: {row[0]}' for row in found]
    seconds = [row[3] for row in found]
    panel.barh(names, seconds, color=BLUE)
    for k, value in enumerate(seconds):
        panel.text(value, k, f' {value:.1f}', va='center', fontsize=8)
    panel.invert_yaxis()
    panel.set(xlabel='machining time on xyzac, F 3000 (s)')
    panel.grid(axis='y', visible=False)
    _save(figure, 'cam_times')


def _save(figure: Any, name: str) -> None:
    figure.savefig(PICTURES / f'{name}.png', dpi=130)
    plt.close(figure)


def main() -> None:
    """Draw the pictures, or measure the times."""
    parser = argparse.ArgumentParser(description='Figures and table of docs/how_it_works/cam.md.')
    parser.add_argument('--times', action='store_true', help='machining times only')
    parser.add_argument(
        '--solvers', action='store_true', help='iterations for scallop points only'
    )
    chosen = parser.parse_args()
    mpl.use('Agg')
    with mpl.rc_context(STYLE):
        if chosen.solvers:
            solvers()
            return
        if chosen.times:
            times()
            return
        loops()
        strategies()
        contours()
        application()


if __name__ == '__main__':
    main()
