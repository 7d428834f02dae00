"""The generated paths of the problem set, their known times, and scores of motions."""

import csv
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cnc_interp.core import DEG, MM, MM_PER_MIN, UM, FloatArray, InterpError
from cnc_interp.core.kernels import njit
from cnc_interp.core.small_files import config_directory
from cnc_interp.drives.tool_error import HEIGHT, on_chord
from cnc_interp.kinematics.axis_path import AxisPath, cut, evaluate
from cnc_interp.library import axis_path_from, smooth_path
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.reading import read_program
from cnc_interp.run.setpoints import BEFORE, STILL, largest_shares
from cnc_interp.settings.options import Settings

FEED = 3000.0 * MM_PER_MIN
RANDOM = 14  #: Random polylines in the set.


@dataclass(frozen=True)
class Problem:
    name: str
    path: AxisPath  #: q(s), stops included; ``evaluate(path, s)``.
    limits: Machine  #: ``max_velocity``, ``max_acceleration``, ``max_jerk`` (n_axes,).
    blocks: Blocks | None = None  #: Blocks from which the path was made, if any.


class Known(NamedTuple):
    """Known times of a path [s]; NaN if unknown."""

    optimum: float  #: Time by an independent solver: IPOPT, or ruckig for strokes.
    ours: float
    bound: float  #: Lower bound, without jerk limits.


@cache
def _table() -> dict[str, Known]:
    with Path(__file__).with_name('times.csv').open(newline='', encoding='utf-8') as file:
        return {name: Known(*map(float, times)) for name, *times in list(csv.reader(file))[1:]}


def known(name: str) -> Known:
    """Return the times of a problem; NaN for a path that is not in the set."""
    return _table().get(name, Known(np.nan, np.nan, np.nan))


def problems() -> Iterator[Problem]:
    """Yield all paths of the set, each generated when needed."""
    for name in _MADE_BY:
        yield problem(name)


def problem(name: str) -> Problem:
    """Return one path of the set by its name; InterpError lists the names."""
    if name not in _MADE_BY:
        raise InterpError(f'no problem {name!r}; there are: {"; ".join(_MADE_BY)}')
    return replace(_MADE_BY[name](), name=name)


def stretches(path: AxisPath) -> list[AxisPath]:
    stops = np.unique(np.concatenate([[0], np.flatnonzero(path.stop), [len(path.s) - 1]]))
    return [cut(path, int(a), int(b)) for a, b in pairwise(stops)]


def of_blocks(name: str, blocks: Blocks, machine: Machine, curves: bool = False) -> Problem:
    path = smooth_path(blocks, Transform.of(machine), Settings(compress=curves))
    return Problem(name, path, machine, blocks)


def example(name: str, tolerance: float) -> Problem:
    machine = Machine.load('xyzac')
    file = config_directory().parent / 'examples' / f'{name}.apt'
    blocks = read_program(file, Transform.of(machine)).blocks
    wide = np.full(len(blocks), tolerance)
    blocks = replace(blocks, contour_tolerance=wide, orientation_tolerance=wide.copy())
    return of_blocks(name, blocks, machine)


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
    return Blocks.of_poses(tip, normal, FEED, 0.01 * MM)


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
    axis = _tools(tilt, np.cumsum(rng.uniform(-25, 25, count + 1) * DEG))
    feedrate = float(rng.choice([1000, 3000, 6000])) * MM_PER_MIN
    tolerance = float(rng.choice([0.01, 0.02, 0.1])) * MM
    return Blocks.of_poses(np.array(tip), axis, feedrate, tolerance)


def _tools(tilt: FloatArray, heading: FloatArray) -> FloatArray:
    return np.column_stack(
        [np.sin(tilt) * np.sin(heading), np.sin(tilt) * np.cos(heading), np.cos(tilt)]
    )


def _random(seed: int) -> Problem:
    return of_blocks('', random_blocks(seed), Machine.load('xyzac'))


def _corner(turn: float) -> Problem:
    legs = 20.0 * MM * np.array([[1.0, 0.0], [np.cos(turn * DEG), np.sin(turn * DEG)]])
    tip = np.column_stack([np.concatenate([[[0.0, 0.0]], np.cumsum(legs, axis=0)]), np.zeros(3)])
    axis = _tools(np.array([10.0, 15.0, 20.0]) * DEG, np.array([0.0, 10.0, 0.0]) * DEG)
    return of_blocks('', Blocks.of_poses(tip, axis, 2.0 * FEED), Machine.load('xyzac'))


def _past_pole(distance: float) -> Problem:
    off, tilt = distance * DEG, np.array([-20.0, 20.0]) * DEG
    nearest, side = np.array([[np.sin(off), 0.0, np.cos(off)], [0.0, 1.0, 0.0]])
    axis = np.cos(tilt)[:, None] * nearest + np.sin(tilt)[:, None] * side
    tip = np.array([[0.0, 0.0, 0.0], [56.0 * MM, 0.0, 0.0]])
    return of_blocks('', Blocks.of_poses(tip, axis, FEED), Machine.load('xyzac'))


def _s_path(feedrate: float) -> Problem:
    """Follow an S of two half circles as on a test piece, the tool leaning out of its flank."""
    turn = np.linspace(0.0, 2.0 * np.pi, 321)
    heading = np.where(turn < np.pi, turn, 2.0 * np.pi - turn)  # of the way along both halves
    step = 30.0 * MM * (turn[1] - turn[0])
    middle = 0.5 * (heading[1:] + heading[:-1])
    way = np.cumsum(step * np.column_stack([np.cos(middle), np.sin(middle)]), axis=0)
    tip = np.column_stack([np.concatenate([np.zeros((1, 2)), way]), np.zeros(len(turn))])
    lean = (15.0 + 10.0 * np.sin(turn / 2.0)) * DEG
    blocks = Blocks.of_poses(tip, _tools(lean, 0.3 * np.sin(turn)), feedrate)
    return of_blocks('', blocks, Machine.load('xyzac'), curves=True)


def _zigzag(count: int, length: float, across: float, machine: str = 'xyz') -> Problem:
    n = np.arange(count + 1)
    tip = np.column_stack([length * (n % 2), across * n, 0.0 * n])
    axis = np.tile([0.0, 0.0, 1.0], (count + 1, 1))
    return of_blocks('', Blocks.of_poses(tip, axis, 2.0 * FEED), Machine.load(machine))


def _small(length: float) -> Problem:
    """Walk 60 blocks of one length, each turned by up to 60 deg, while the tool sways."""
    rng = np.random.default_rng(60)
    heading = np.cumsum(rng.uniform(-60, 60, 60) * DEG)
    way = np.cumsum(length * np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
    tip = np.column_stack([np.concatenate([np.zeros((1, 2)), way]), np.zeros(61)])
    axis = _tools(np.full(61, 15.0 * DEG), np.linspace(0.0, 60.0 * length, 61))
    return of_blocks('', Blocks.of_poses(tip, axis, FEED), Machine.load('xyzac'))


def _arrays(name: str, s: FloatArray, q: FloatArray, feedrate: float = np.inf) -> Problem:
    machine = Machine.load(name)
    return Problem('', axis_path_from(q, s, machine, feedrate), machine)


def _stroke(length: float) -> Problem:
    s = np.linspace(0.0, length, 7)
    return _arrays('xyz', s, np.outer(s, [1.0, 0.0, 0.0]))


def _circle(radius: float) -> Problem:
    s = np.linspace(0.0, 2.0 * np.pi * radius, 201)
    a = s / radius
    q = radius * np.column_stack([np.cos(a), np.sin(a), np.zeros(201)])
    return _arrays('xyz', s, q, 10000.0 * MM_PER_MIN)


def _all_axes() -> Problem:
    s = np.linspace(0.0, 0.2, 201)
    waves = np.outer(2.0 * np.pi * s / s[-1], [1.0, 2.0, 3.0, 2.0, 1.0])
    return _arrays('xyzac', s, np.sin(waves) * [0.03, 0.02, 0.01, 0.2, 0.5], 2.0 * FEED)


def _dome(count: int, curves: bool) -> Problem:
    return of_blocks('', dome(count), Machine.load('xyzac'), curves)


_MADE_BY: dict[str, Callable[[], Problem]] = {
    **{
        f'{name}, {tolerance:g} mm': partial(example, name, tolerance * MM)
        for name in ('pyramid', 'pocket_corner')
        for tolerance in (0.02, 0.2)
    },
    **{f'random 5-axis {seed}': partial(_random, seed) for seed in range(RANDOM)},
    **{f'corner of {turn:g} deg': partial(_corner, turn) for turn in (45.0, 90.0, 150.0)},
    **{f'S path, F {6000 * k}': partial(_s_path, 2 * k * FEED) for k in (1, 2)},
    **{f'{d:g} deg beside the pole': partial(_past_pole, d) for d in (3.0, 1.0, 0.01)},
    'dense, corners': partial(_dome, 100, False),
    'dense, a curve': partial(_dome, 200, True),
    'reversals of 20 mm': partial(_zigzag, 6, 20.0 * MM, 0.5 * MM),
    'reversals of 2 mm, 5-axis': partial(_zigzag, 12, 2.0 * MM, 0.1 * MM, 'xyzac'),
    **{f'60 moves of {x:g} mm': partial(_small, x * MM) for x in (0.5, 0.05)},
    **{f'stroke of {x} mm': partial(_stroke, x * MM) for x in (10, 100, 1000)},
    **{f'circle of {r} mm': partial(_circle, r * MM) for r in (2, 40)},
    'all axes in waves': _all_axes,
    'long, 500 lines': partial(_zigzag, 500, 30.0 * MM, 0.5 * MM),
    'long, dome of 2,000 blocks': partial(_dome, 2000, False),
}


#: Largest use that counts as kept [-], largest deviation from the path [m].
KEPT, BESIDE = 1.001, 1.0 * UM
CHORDS = 200_000  #: Chords, about, that stand for a path.
#: A motion is searched this many of its steps ahead on the path, and at least this far [m].
AHEAD, LEAST = 8.0, 2e-6


@dataclass(frozen=True)
class Score:
    name: str
    time: float  #: Duration of the motion [s].
    use: float  #: Largest use of feed, velocity, acceleration and jerk by differences [-].
    deviation: float  #: Largest distance from the path; an angle counts by ``HEIGHT`` [m].

    @cached_property
    def ratio(self) -> float:
        """Time over the optimum of the independent solver; NaN where there is none."""
        return self.time / known(self.name).optimum

    @property
    def kept(self) -> bool:
        return self.use <= KEPT and self.deviation <= BESIDE


def score(
    problem: Problem, position: FloatArray, period: float, time: float | None = None
) -> Score:
    """Compare a sampled motion with its problem.

    Parameters
    ----------
    position : FloatArray
        (K, n_axes): q(t) at multiples of the period, from rest to rest [m, rad].
    period : float
        Time between two samples [s]; at 1 ms or more, rounding is no jerk.
    time : float, optional
        Exact duration [s]; otherwise whole periods count.

    Raises
    ------
    InterpError
        The motion has other axes, or is no motion.

    """
    path, axes = problem.path, problem.path.cell_left.shape[2]
    q = np.ascontiguousarray(position, dtype=float)
    if q.ndim != 2 or q.shape[1] != axes or len(q) < 2 or not np.isfinite(q).all():
        raise InterpError(
            f'{problem.name}: a motion has 2 or more finite rows of {axes} axes, not {q.shape}'
        )
    held = np.concatenate([q[:1].repeat(BEFORE, 0), q, q[-1:].repeat(BEFORE, 0)])
    use = float(largest_shares(held, problem.limits.limits, period).max())
    per_cell = max(8, CHORDS // len(path.cell_feed))
    part = np.arange(per_cell) / per_cell
    fine = np.append((path.s[:-1, None] + np.diff(path.s)[:, None] * part).ravel(), path.s[-1])
    scale = np.where(np.arange(axes) < 3, 1.0, HEIGHT)
    chords = evaluate(path, fine)[0] * scale
    place, off = _along(chords, q * scale)
    ends = np.abs((q[[0, -1]] - path.q[[0, -1]]) * scale).max()
    s = np.interp(place, np.arange(len(fine)), fine)
    cell = np.minimum(place.astype(np.int64) // per_cell, len(path.cell_feed) - 1)
    feed = np.maximum(path.cell_feed[cell[1:]], path.cell_feed[cell[:-1]])
    use = max(use, float((np.diff(s) / (period * feed)).max()))
    moving = np.flatnonzero(np.abs(np.diff(q, axis=0)).max(axis=1) > STILL)
    periods = moving[-1] + 1 - moving[0] if len(moving) else 0
    lasts = period * float(periods) if time is None else time
    return Score(problem.name, lasts, use, max(float(off.max()), float(ends)))


@njit(cache=True, nogil=True)
def _along(path: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the places of points that go along chords, in chords, and their distances."""
    place, off = np.empty(len(points)), np.empty(len(points))
    chord, last = 0, len(path) - 2
    for m in range(len(points)):
        step = np.sqrt(((points[m] - points[max(m - 1, 0)]) ** 2).sum())
        far, way, least, found = AHEAD * step + LEAST, 0.0, np.inf, chord
        for k in range(chord, last + 1):
            part, distance_sq = on_chord(path, k, points[m])
            if distance_sq < least:
                least, found, place[m] = distance_sq, k, k + part
            if k > chord:
                way += np.sqrt(((path[k + 1] - path[k]) ** 2).sum())
            if way > far:
                break
        chord, off[m] = found, np.sqrt(least)
    return place, off
