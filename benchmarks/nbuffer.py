"""
How fast the N-buffer cuts, and how its time grows with needles and poses.

    python benchmarks/nbuffer.py

Straight passes 2 mm apart with a filleted mill over a plane; processor time of one core.
"""

from __future__ import annotations

import time

import numpy as np

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.nbuffer import cut_needles
from cnc_interp.cam.needles import Needles
from cnc_interp.cam.shapes import Plane
from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.units import DEG, MM

MILL, SIDE, STEPOVER, TILT = Cutter(5 * MM, 1.5 * MM), 30 * MM, 2 * MM, 5 * DEG


def passes(step: float) -> tuple[FloatArray, FloatArray]:
    """Return tips and axes of zigzag passes with poses so far apart [m]."""
    u = np.array([np.sin(TILT), 0.0, np.cos(TILT)])
    front = np.array([np.cos(TILT), 0.0, -np.sin(TILT)])
    x = np.arange(-0.5 * SIDE, 0.5 * SIDE, step)
    rows = np.arange(-0.5 * SIDE, 0.5 * SIDE, STEPOVER)
    K = [
        np.column_stack([x[:: 1 - 2 * (k % 2)], np.full_like(x, y), np.full_like(x, 1.5 * MM)])
        for k, y in enumerate(rows)
    ]
    tip = np.vstack(K) - MILL.tool_radius * front - MILL.corner_radius * u
    return tip, np.tile(u, (len(tip), 1))


def main() -> None:
    """Print one line for each size."""
    surface = Plane((SIDE, SIDE))
    cut_needles(Needles.on(surface, 2 * MM), MILL, *passes(2 * MM))  # compiles
    print('needles    poses   seconds   needles x poses / s')
    for spacing, step in ((0.2, 0.2), (0.1, 0.2), (0.05, 0.2), (0.1, 0.1), (0.1, 0.05)):
        needles = Needles.on(surface, spacing * MM)
        tip, axis = passes(step * MM)
        begin = time.process_time()
        found = cut_needles(needles, MILL, tip, axis)
        seconds = time.process_time() - begin
        print(
            f'{needles.base[..., 0].size:7d}  {len(tip):7d}  {seconds:8.2f}   '
            f'{found.pairs / seconds:.2e}'
        )


if __name__ == '__main__':
    main()
