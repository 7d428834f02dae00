"""The paths that are compared: example programs, published ones where they are at hand, random."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.polynomial import Chebyshev
from scipy.interpolate import BSpline
from whole_plans import path_of

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import InterpError
from cnc_interp.core.limits_by_position import constant_table
from cnc_interp.core.units import DEG, MM, MM_PER_MIN
from cnc_interp.feedrate.feed_planner import plan_path
from cnc_interp.kinematics.axis_path import AxisPath, cut
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform
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


@dataclass(frozen=True)
class Limits:
    """Limits of the axes, as the feed planner wants them."""

    max_velocity: FloatArray
    max_acceleration: FloatArray
    max_jerk: FloatArray

    @property
    def limit_table(self) -> FloatArray:
        return constant_table(np.stack([self.max_velocity, self.max_acceleration, self.max_jerk]))


@dataclass(frozen=True)
class Case:
    """One path to compare on, stops included, and the blocks it was made of, if of blocks."""

    name: str
    path: AxisPath
    limits: Machine | Limits
    blocks: Blocks | None = None


def smoothed(blocks: Blocks, machine: Machine) -> AxisPath:
    """Send blocks through look-ahead and kinematics, corner by corner."""
    return path_of(blocks, Transform.of(machine), Settings(compress=False))


def case_of(name: str, blocks: Blocks, machine: Machine) -> Case:
    """Make a case of blocks."""
    return Case(name, smoothed(blocks, machine), machine, blocks)


def blocks_of(
    tip: FloatArray, axis: FloatArray, feedrate: float, tolerance: float = 0.02 * MM
) -> Blocks:
    """Make blocks from tool tips and tool axes, one feedrate and one tolerance."""
    n = len(tip)
    still = np.zeros(n, dtype=bool)
    return Blocks(
        tip=tip,
        axis=axis,
        rotary=np.full((n, 2), np.nan),
        feedrate=np.full(n, feedrate),
        duration=np.full(n, np.nan),
        rapid=still,
        exact_stop=still.copy(),
        contour_tolerance=np.full(n, tolerance),
        orientation_tolerance=np.full(n, tolerance),
        line_number=np.arange(1, n + 1),
    )


def dome(count: int = 2000, step: float = 0.5 * MM, radius: float = 80.0 * MM) -> Blocks:
    """Make a spiral on a sphere, the tool normal to it: short blocks, small turns."""
    polar, around = np.empty(count + 1), np.empty(count + 1)
    rise = 1.0 * DEG / (2.0 * np.pi)
    p, a = 15.0 * DEG, 0.0
    for i in range(count + 1):
        polar[i], around[i] = p, a
        turn = step / (radius * np.hypot(np.sin(p), rise))
        p, a = p + rise * turn, a + turn
    ring = np.sin(polar)
    normal = np.column_stack([ring * np.cos(around), ring * np.sin(around), np.cos(polar)])
    tip = radius * (normal - np.array([0.0, 0.0, 1.0]))
    return blocks_of(tip, normal, 3000.0 * MM_PER_MIN, 0.01 * MM)


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
    return path, Limits(*(np.array(limits[name], float) * unit for name in names))


def random_blocks(seed: int) -> Blocks:
    """Make a random 5-axis polyline: 3 to 7 blocks of 2 to 40 mm, turns up to 140 degrees."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 8))
    tip, direction = [np.zeros(3)], np.array([1.0, 0.0, 0.0])
    for _ in range(count):
        tip.append(tip[-1] + direction * 2 * MM * 20 ** rng.uniform())
        side = np.cross(direction, rng.normal(size=3))
        side /= np.linalg.norm(side)
        turn = rng.uniform(5, 140) * DEG
        direction = np.cos(turn) * direction + np.sin(turn) * side
    # tilts stay between 10 and 30 degrees, away from the pole
    tilt = rng.uniform(10, 30, count + 1) * DEG
    heading = np.cumsum(rng.uniform(-25, 25, count + 1) * DEG)
    axis = np.column_stack(
        [np.sin(tilt) * np.sin(heading), np.sin(tilt) * np.cos(heading), np.cos(tilt)]
    )
    feedrate = float(rng.choice([1000, 3000, 6000])) * MM_PER_MIN
    return blocks_of(np.array(tip), axis, feedrate, float(rng.choice([0.01, 0.02, 0.1])) * MM)


def public_cases(machine: Machine, pieces: Iterable[Piece]) -> Iterator[Case]:
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
            yield case_of(f'{folder} [{first}:{first + rows}]', blocks, machine)
        except InterpError as error:
            print(f'{folder} left out: {str(error).split(name)[-1]}')


def cases() -> Iterator[Case]:
    """Yield all paths."""
    machine = Machine.load('xyzac')
    for name in ('pyramid', 'pocket_corner'):
        file = ROOT / 'examples' / f'{name}.apt'
        blocks = read_program(file, Transform.of(machine), Settings()).blocks
        for tolerance in (0.02 * MM, 0.2 * MM):
            wide = np.full(len(blocks), tolerance)
            changed = replace(blocks, contour_tolerance=wide, orientation_tolerance=wide.copy())
            yield case_of(f'{name}, {tolerance / MM:g} mm', changed, machine)
    flank = SHARED / 'data' / 'flank_path_2022.json'
    if flank.exists():
        yield Case('flank_path_2022', *flank_path(flank))
    yield from public_cases(machine, PUBLIC)
    for seed in range(22):
        yield case_of(f'random 5-axis {seed}', random_blocks(seed), machine)


def stop_at_corners(case: Case) -> float:
    """Cycle time of the same blocks with an exact stop at the end of each [s]; nan without."""
    if case.blocks is None or not isinstance(case.limits, Machine):
        return math.nan
    stopping = np.ones(len(case.blocks), dtype=bool)
    path = smoothed(replace(case.blocks, exact_stop=stopping), case.limits)
    return plan_path(path, case.limits).law.end_time


def dense_cases(machine: Machine) -> Iterator[Case]:
    """Yield paths of many short blocks."""
    yield case_of('dome spiral, 2,000 blocks of 0.5 mm', dome(), machine)
    yield from public_cases(machine, DENSE)


def stretches(path: AxisPath) -> list[AxisPath]:
    """Cut a path at its stops."""
    stops = np.unique(np.concatenate([[0], np.flatnonzero(path.stop), [len(path.s) - 1]]))
    return [cut(path, int(a), int(b)) for a, b in pairwise(stops)]


def time_along(
    smoother: LookAhead | PathSmoother, blocks: Blocks, transform: Transform, settings: Settings
) -> float:
    """Return the time of the motion along blocks that a smoother rounds in its own way [s]."""
    builder = AxisPathBuilder(transform, settings.flank_height, settings.interpolation_period)
    parts = [builder.push(found) for found in (smoother.push(blocks), smoother.finish())]
    path = AxisPath.join([part for part in parts if part is not None])
    return plan_path(path, transform.machine).law.end_time
