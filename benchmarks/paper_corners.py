"""
Statements of the corner-rounding paper [B2013] beside our numbers, and its corners beside ours.

    PYTHONPATH=. python benchmarks/paper_corners.py [--statements] [--paths]

The first table has those statements of the paper whose inputs its text gives. The paper prints
neither its parts nor the limits of its machine. Our own parts with its tolerances and feed replace
them, so only shapes and ratios can be compared, not seconds. The second table compares
``--corner paper`` with the default: cycle time, share of the tolerances used, stops, the proof.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from paths import ROOT
from ratios import programs
from whole_plans import Plan, plan_program, write_plan

from cnc_interp.core import DEG, MM, MM_PER_MIN, FloatArray
from cnc_interp.core.bspline import corner_spline_points
from cnc_interp.feedrate.planning_windows import PlannedPiece
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import Program, read_program
from cnc_interp.proof.verify import verify_plan
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.corners.corner_curve import Corners, Style, build, initial_lengths
from cnc_interp.smoothing.segments import CORNER

MACHINE = Machine.load('xyzac')
FEED = 3000.0 * MM_PER_MIN
#: The corner's time is measured from here before its entry to here after its exit [m].
MARGIN = 3.0 * MM
#: Paths of the second table that are too long for it.
LEFT_OUT = ('impeller', 'dome')


@dataclass(frozen=True)
class Figures:
    """Figures of one plan."""

    time: float
    corner_time: float
    stops: int
    used: FloatArray
    proven: bool


def figures(program: Program, settings: Settings) -> Figures:
    """Plan and prove a program."""
    plan = plan_program(program, MACHINE, settings)
    with TemporaryDirectory() as directory:
        write_plan(plan, Path(directory))
        proven = verify_plan(Path(directory), MACHINE).ok
    whole = PlannedPiece.join(plan.pieces)
    return Figures(
        whole.law.end_time,
        corner_time(plan, whole),
        int(whole.path.stop[1:-1].sum()),
        used_of(plan),
        proven,
    )


def used_of(plan: Plan) -> FloatArray:
    """Return the mean share of both tolerances that the corners use, shape (2,) [-]."""
    segments, blocks = plan.segments, plan.program.blocks
    own = segments.kind == CORNER
    if not own.any():
        return np.zeros(2)
    rows = segments.block[own]
    columns = blocks.contour_tolerance, blocks.orientation_tolerance
    tolerances = np.stack([np.minimum(x[rows[:, 0]], x[rows[:, 1]]) for x in columns], axis=1)
    return np.asarray((segments.deviation[own] / tolerances).mean(axis=0))


def corner_time(plan: Plan, whole: PlannedPiece) -> float:
    """Return the time from MARGIN before the first corner to MARGIN after it [s]."""
    segments = plan.segments
    first = int(np.argmax(segments.kind == CORNER))
    if segments.kind[first] != CORNER:
        return float('nan')
    points = [
        corner_spline_points(segments.bottom[first][None, :5], u)[0]
        for u in np.linspace(0.0, 1.0, 2001)
    ]
    entry = float(np.nansum(segments.length[:first]))
    exit_ = entry + float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    law = whole.law
    t = (law.time[:, None] + law.duration[:, None] * np.arange(16) / 16.0).ravel()
    s = np.maximum.accumulate(law.evaluate(t)[0])
    times = np.interp([entry - MARGIN, exit_ + MARGIN], s, t)
    return float(times[1] - times[0])


def basis(u: FloatArray) -> FloatArray:
    """Return the five basis functions as Eq. A.2 of the paper prints them, shape (5, k)."""
    first = np.stack(
        [
            (1 - 2 * u) ** 3,
            2 * u * ((1 - 2 * u) ** 2 + (1 - u) * (2 - 3 * u)),
            2 * u**2 * (3 - 4 * u),
            2 * u**3,
            0 * u,
        ]
    )
    v = 1 - u
    second = np.stack(
        [
            0 * u,
            2 * v**3,
            2 * v**2 * (4 * u - 1),
            2 * v * (u * (3 * u - 1) + (2 * u - 1) ** 2),
            (2 * u - 1) ** 3,
        ]
    )
    return np.where(u < 0.5, first, second)


def example(name: str, tolerance: float) -> tuple[Program, Settings]:
    """Read an example with the tolerance and the feed of the paper."""
    settings = Settings(
        contour_tolerance=tolerance, orientation_tolerance=tolerance, feedrate=FEED, corner='paper'
    )
    program = read_program(ROOT / 'examples' / f'{name}.apt', Transform.of(MACHINE), settings)
    return program, settings


def row(place: str, statement: str, paper: str, ours: str) -> None:
    """Print one row."""
    print(f'| {place} | {statement} | {paper} | {ours} |', flush=True)


def print_statements() -> None:
    """Print what the paper states beside what the package computes."""
    print('| place | statement | paper | ours |\n|---|---|---|---|')
    u = np.linspace(0.0, 1.0, 1001)
    points = np.random.default_rng(1).normal(size=(1, 5, 3))
    printed = basis(u).T @ points[0]
    found = np.concatenate([corner_spline_points(points, x) for x in u])
    row(
        'A.2',
        'basis functions as printed, largest difference',
        '0',
        f'{np.abs(found - printed).max():.0e}',
    )
    weights = [corner_spline_points(np.eye(5)[None], 0.5)[0, k] for k in range(5)]
    row(
        'Eq. 2',
        'weights of P0 to P4 at u = 0.5',
        '0, 1/4, 1/2, 1/4, 0',
        ', '.join(f'{x:g}' for x in weights),
    )
    angles = np.array([30.0, 60.0, 90.0, 120.0, 150.0]) * DEG
    corners = plane_corners(angles, 0.02 * MM)
    ratios = np.full((len(angles), 2), 1.4)
    inner, outer = initial_lengths(corners, np.full((len(angles), 2), 1.0), ratios, literal=True)
    style = Style(30.0 * MM, False, 'linear', False, literal=True)
    curves = build(corners, inner, outer, corners.tolerances[:, 1], style)
    gaps = [
        np.linalg.norm(corner_spline_points(curves.bottom, x) - corners.tip, axis=1) for x in u
    ]
    by_eq_3 = 2.0 * 0.02 / np.cos(0.5 * angles)
    for k, angle in enumerate(angles):
        row(
            'Eq. 3',
            f'L1 for eps 0.02 mm, alpha {angle / DEG:.0f} deg',
            f'{by_eq_3[k]:.6f} mm',
            f'{inner[k] / MM:.6f} mm',
        )
    nearest = u[np.argmin(np.stack(gaps), axis=0)]
    row(
        '2.2',
        'the curve is nearest to the corner at u',
        '0.5',
        ', '.join(sorted({f'{x:g}' for x in nearest})),
    )
    row('2.2', 'L2 / L1', '1.4', f'{(outer / inner[:, None]).mean():g}')
    short, _ = initial_lengths(corners, np.array([[5.0, 0.05]] * 5) * MM, ratios, literal=True)
    row(
        '2.2',
        'L2 beside lines of 10 and 0.1 mm, alpha 150 deg',
        'half the shorter, 0.05 mm',
        f'{1.4 * short[-1] / MM:g} mm',
    )
    print_ratios()
    print_parts()


def plane_corners(angles: FloatArray, tolerance: float) -> Corners:
    """Make corners with these angles between both lines; the tool axis rests."""
    n, zero = len(angles), np.zeros_like(angles)
    first = np.stack([zero + 1.0, zero, zero], axis=1)
    second = np.stack([np.cos(angles), np.sin(angles), zero], axis=1)
    legs = np.stack([first, second], axis=1)
    axis = np.tile([0.0, 0.0, 1.0], (n, 1))
    return Corners(np.zeros((n, 3)), axis, legs, np.zeros((n, 2, 3)), np.full((n, 2), tolerance))


def print_ratios() -> None:
    """Print how the machining time depends on L2/L1, with a smooth connection."""
    program, settings = example('pyramid', 0.02 * MM)
    times = {
        ratio: figures(
            program, replace(settings, corner_ratio=ratio, parametrization='exact')
        ).time
        for ratio in (1.2, 1.4, 1.6, 1.75, 2.0, 2.5)
    }
    told = ', '.join(f'{ratio:g}: {time:.3f} s' for ratio, time in times.items())
    row(
        '2.2',
        'machining time over L2/L1 (pyramid, f exact)',
        '1.4 to 1.75 satisfying, more useless',
        told,
    )


def print_parts() -> None:
    """Print what the paper says of its two parts."""
    for place, name, tolerance in (('4.1', 'pocket_corner', 3.0), ('4.2', 'pyramid', 0.02)):
        program, settings = example(name, tolerance * MM)
        ways: dict[str, dict[str, Any]] = {
            'linear': {'parametrization': 'linear'},
            'paper': {},
            'exact': {'parametrization': 'exact'},
            'our default': {'corner': 'default'},
        }
        found = {label: figures(program, replace(settings, **way)) for label, way in ways.items()}

        def told(value: Any, found: dict[str, Figures] = found) -> str:
            return ', '.join(f'{label} {value(f)}' for label, f in found.items())

        part = name.replace('_', ' ')
        row(
            place,
            f'{part}: points inside at which the tool rests',
            'u_top = u_bottom: feed almost zero at entry and exit; with f: none',
            told(lambda f: f.stops),
        )
        if name == 'pocket_corner':
            row(
                place,
                f'{part}: time near the corner',
                'halved by f',
                told(lambda f: f'{f.corner_time:.3f} s'),
            )
        row(place, f'{part}: time of the whole part', '-', told(lambda f: f'{f.time:.3f} s'))
        row(
            place,
            f'{part}: share of the tolerances used',
            '100 % (tip), 100 % (top)',
            told(lambda f: ' / '.join(f'{100.0 * x:.0f} %' for x in f.used)),
        )
        row(place, f'{part}: proven by check', '-', told(lambda f: 'yes' if f.proven else 'NO'))


def print_paths() -> None:
    """Print the paper's corners beside the default on the benchmark paths."""
    heads = 'path', 'default, s', 'paper, s', 'paper, f exact, s'
    more = 'tolerances used: default', 'paper', 'stops: default', 'paper', 'proven'
    print('| ' + ' | '.join([*heads, *more]) + ' |\n' + '|---' * 9 + '|')
    for name, blocks in programs():
        if name.startswith(LEFT_OUT):
            continue
        program = Program(blocks, (), name, 'gcode')
        usual = Settings(compress=False)
        ways = (
            usual,
            replace(usual, corner='paper'),
            replace(usual, corner='paper', parametrization='exact'),
        )
        found = [figures(program, way) for way in ways]
        base = found[0].time
        cells = [f'{base:.3f}'] + [f'{x.time:.3f} ({x.time / base - 1:+.1%})' for x in found[1:]]
        cells += [' / '.join(f'{100.0 * u:.0f} %' for u in x.used) for x in found[:2]]
        cells += [f'{x.stops}' for x in found[:2]]
        cells.append('all' if all(x.proven for x in found) else 'NOT ALL')
        print(f'| {name} | ' + ' | '.join(cells) + ' |', flush=True)


def main(arguments: list[str]) -> None:
    """Print both tables, or the one that is named."""
    if '--paths' not in arguments:
        print_statements()
        print()
    if '--statements' not in arguments:
        print_paths()


if __name__ == '__main__':
    main(sys.argv[1:])
