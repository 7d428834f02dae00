"""The paths that are compared: example programs, published ones if available, random ones."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.polynomial import Chebyshev
from scipy.interpolate import BSpline

from cnc_interp.core import MM, MM_PER_MIN, InterpError
from cnc_interp.core.axis_limits import Limits
from cnc_interp.feedrate.planning_windows import plan_path
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.problems import Problem, problem
from cnc_interp.problems.paths import dome, of_blocks, random_blocks
from cnc_interp.program import Blocks, read_program
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.lookahead import LookAhead
from cnc_interp.smoothing.path_smoother import PathSmoother

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / 'shared'

#: Pieces of public 5-axis programs: folder, file, first row, rows.
PUBLIC = (
    ('cnclite-tulsyan-apt', 'Tulsyan_Altintas_IJMTM_2015.apt', 0, 40),
    ('hust-yelun-cl', 'yelun.txt', 0, 60),
    ('creo-finition-ncl', 'finition.ncl', 100, 12),
    ('linuxcnc-impeller-xyzac', 'impeller-7bl-xyzac.ngc', 100, 12),
    ('opencn-congee-5x', '034_congee_simplified_excerpt.ngc', 5, 15),
    ('solidcam-4x-rotx', 'gcode_demo2_rotX.TAP', 300, 12),
)

#: Longer pieces of them.
DENSE = (('linuxcnc-impeller-xyzac', 'impeller-7bl-xyzac.ngc', 0, 1500),)

Piece = tuple[str, str, int, int]


def flank_path(file: Path) -> tuple[AxisPath, Limits]:
    """
    Build the published flank path: two cubic B-splines, on the reference machine without offsets.

    On each span of the splines the axes are fitted by Chebyshev polynomials of u (to rounding) and
    their derivatives turned into derivatives by the tip's arc length.
    """
    content = json.loads(file.read_text(encoding='utf-8'))
    knots, degree = np.array(content['knots'], float), content['degree']
    bottom, top = (
        BSpline(knots, np.array(content[f'control_points_{name}']) * MM, degree)
        for name in ('bottom', 'top')
    )
    lefts, rights, lengths = [], [], []
    turn = 0.0
    for low, high in pairwise(np.unique(knots)):
        u = (low + high) / 2 - (high - low) / 2 * np.cos(np.pi * (np.arange(32) + 0.5) / 32)
        tip, tool = bottom(u), top(u) - bottom(u)
        tool /= np.linalg.norm(tool, axis=1, keepdims=True)
        a, c = np.arccos(tool[:, 2]), np.unwrap(np.arctan2(tool[:, 0], tool[:, 1]))
        c += 2 * np.pi * np.round((turn - c[0]) / (2 * np.pi))
        turn = c[-1]
        x = np.cos(c) * tip[:, 0] - np.sin(c) * tip[:, 1]
        y = np.sin(c) * tip[:, 0] + np.cos(c) * tip[:, 1]
        y, z = np.cos(a) * y - np.sin(a) * tip[:, 2], np.sin(a) * y + np.cos(a) * tip[:, 2]
        axes = [Chebyshev.fit(u, q, 20, domain=[low, high]) for q in (x, y, z, a, c)]
        at = np.linspace(low, high, 17)
        jet = np.stack([np.column_stack([f.deriv(k)(at) for f in axes]) for k in range(4)])
        c1, c2, c3 = (bottom(np.clip(at, low, high - 1e-12), k) for k in (1, 2, 3))
        speed = np.linalg.norm(c1, axis=1, keepdims=True)
        rate = (c1 * c2).sum(axis=1, keepdims=True) / speed
        bend = ((c2 * c2 + c1 * c3).sum(axis=1, keepdims=True) - rate**2) / speed
        first = jet[1] / speed
        second = (jet[2] - rate * first) / speed**2
        third = (jet[3] - 3 * speed * rate * second - bend * first) / speed**3
        jet = np.stack([jet[0], first, second, third])
        nodes, weights = np.polynomial.legendre.leggauss(12)
        middle = (at[:-1, None] + np.diff(at)[:, None] * (nodes + 1) / 2).ravel()
        lengths.append(
            np.linalg.norm(bottom(middle, 1), axis=1).reshape(16, 12) @ weights * np.diff(at) / 2
        )
        lefts.append(jet[:, :-1])
        rights.append(jet[:, 1:])
    s = np.concatenate([[0.0], np.cumsum(np.concatenate(lengths))])
    n = len(s)
    stop = np.zeros(n, dtype=bool)
    stop[[0, -1]] = True
    unit = np.array([MM, MM, MM, 1.0, 1.0])
    limits = content['limits']
    path = AxisPath(
        s=s,
        cell_left=np.concatenate(lefts, axis=1),
        cell_right=np.concatenate(rights, axis=1),
        tip=np.zeros((n, 3)),
        axis=np.tile([0.0, 0.0, 1.0], (n, 1)),
        cell_feed=np.full(n - 1, 6000 * MM_PER_MIN),
        cell_block=np.zeros(n - 1, dtype=np.int64),
        stop=stop,
    )
    names = ('velocity', 'acceleration', 'jerk')
    return path, Limits.constant(*(np.array(limits[name], float) * unit for name in names))


def public_cases(machine: Machine, pieces: Iterable[Piece]) -> Iterator[Problem]:
    """Yield pieces of public programs that stand beside the repository; none where they do not."""
    options = Settings(feedrate=3000 * MM_PER_MIN)
    for folder, name, first, rows in pieces:
        file = SHARED / 'programs' / folder / name
        if not file.exists():
            continue
        try:
            blocks = read_program(file, Transform.of(machine), options).blocks[
                first : first + rows
            ]
            # the workpiece may stand elsewhere on the other machine: begin over the C axis
            blocks = replace(blocks, tip=blocks.tip - blocks.tip[0])
            yield of_blocks(f'{folder} [{first}:{first + rows}]', blocks, machine)
        except InterpError as error:
            print(f'{folder} left out: {str(error).split(name)[-1]}')


def cases() -> Iterator[Problem]:
    """Yield all paths."""
    machine = Machine.load('xyzac')
    for name in ('pyramid', 'pocket_corner'):
        for tolerance in (0.02, 0.2):
            yield problem(f'{name}, {tolerance:g} mm')
    flank = SHARED / 'data' / 'flank_path_2022.json'
    if flank.exists():
        yield Problem('flank_path_2022', *flank_path(flank))
    yield from public_cases(machine, PUBLIC)
    for seed in range(22):
        yield of_blocks(f'random 5-axis {seed}', random_blocks(seed), machine)


def stop_at_corners(case: Problem) -> float:
    """Cycle time of the same blocks with an exact stop at the end of each [s]; nan without."""
    if case.blocks is None or not isinstance(case.limits, Machine):
        return math.nan
    stopping = np.ones(len(case.blocks), dtype=bool)
    stops = of_blocks(case.name, replace(case.blocks, exact_stop=stopping), case.limits)
    return plan_path(stops.path, case.limits).law.end_time


def dense_cases(machine: Machine) -> Iterator[Problem]:
    """Yield paths of many short blocks."""
    yield of_blocks('dome spiral, 2,000 blocks of 0.5 mm', dome(), machine)
    yield from public_cases(machine, DENSE)


def time_along(
    smoother: LookAhead | PathSmoother, blocks: Blocks, transform: Transform, settings: Settings
) -> float:
    """Return the time of the motion along blocks that a smoother rounds in its own way [s]."""
    builder = AxisPathBuilder(transform, settings.flank_height, settings.interpolation_period)
    parts = [builder.push(found) for found in (smoother.push(blocks), smoother.finish())]
    path = AxisPath.join([part for part in parts if part is not None])
    return plan_path(path, transform.machine).law.end_time
