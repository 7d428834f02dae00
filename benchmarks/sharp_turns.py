"""
Rounded corners against exact stops where the path almost reverses.

    PYTHONPATH=. python benchmarks/sharp_turns.py

prints the table of corner_rounding.md: cycle time with rounding relative to an exact stop, for
random pairs of lines, with a constant and with a turning tool axis.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from paths import time_along

from cnc_interp.core import DEG, MM, MM_PER_MIN
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.machine_traits import traits_of
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import Blocks
from cnc_interp.run.path_chain import is_faster
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.path_smoother import PathSmoother

TURNS = (150, 160, 165, 170, 173, 175, 176, 177, 178, 179, 179.5)
COUNT = 40
MACHINE = Machine.load('xyzac')


def two_lines(rng: np.random.Generator, turn: float, turning: bool) -> Blocks:
    """Make two lines of 0.5 to 40 mm with a turn between them, tolerance 2 um to 1 mm."""

    def spread(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    first = rng.normal(size=3)
    first /= np.sqrt(first @ first)
    side = np.cross(first, rng.normal(size=3))
    side /= np.sqrt(side @ side)
    second = np.cos(turn) * first + np.sin(turn) * side
    corner = rng.uniform(-40.0, 40.0, 3) * MM
    lengths = spread(0.5, 40.0) * MM, spread(0.5, 40.0) * MM
    tip = np.array([corner - lengths[0] * first, corner, corner + lengths[1] * second])
    swing = spread(0.02, 2.0) * DEG * turning
    lean = 20.0 * DEG + swing * rng.uniform(-3.0, 3.0, 3)
    way = rng.uniform(0.0, 6.28) + np.cumsum(swing * rng.uniform(-10.0, 10.0, 3))
    axis = np.column_stack([np.sin(lean) * np.sin(way), np.sin(lean) * np.cos(way), np.cos(lean)])
    feedrate = float(rng.choice([1000.0, 3000.0, 10000.0])) * MM_PER_MIN
    return Blocks.of_poses(tip, axis, feedrate, spread(0.002, 1.0) * MM)


def cycle_time(blocks: Blocks, sharpest: float) -> float:
    """Plan blocks, turns up to the sharpest rounded, and return the time they take [s]."""
    settings, transform = Settings(compress=False), Transform.of(MACHINE)
    traits = replace(traits_of(transform), sharpest_turn=sharpest, sharpest_swing=sharpest)
    smoother = PathSmoother(settings, traits, partial(is_faster, transform, settings))
    return time_along(smoother, blocks, transform, settings)


def main() -> None:
    """Print mean and worst for each turn."""
    print('| turn, deg | axis rests: mean | worst | axis turns: mean | worst |')
    print('|---' * 5 + '|')
    rng = np.random.default_rng(5)
    for turn in TURNS:
        cells = []
        for turning in (False, True):
            programs = [two_lines(rng, turn * DEG, turning) for _ in range(COUNT)]
            times = np.array([[cycle_time(p, x * DEG) for x in (179.9, 1.0)] for p in programs])
            gain = 100.0 * (times[:, 0] / times[:, 1] - 1.0)
            cells += [f'{gain.mean():+.1f} %', f'{gain.max():+.1f} %']
        print(f'| {turn:g} | ' + ' | '.join(cells) + ' |', flush=True)


if __name__ == '__main__':
    main()
