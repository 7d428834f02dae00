"""Small programs as Blocks, built straight from tool tips and tool axes."""

import numpy as np

from cnc_interp.program.blocks import Blocks
from cnc_interp.units import DEG, MM, MM_PER_MIN


def blocks_of(tips, axes, feed=3000.0 * MM_PER_MIN, tolerance=0.02 * MM, **columns):
    """Blocks through tips [m] with tool axes (normalised here); further columns by name."""
    axes = np.asarray(axes, float)
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    n = len(axes)
    given = {
        'tip': np.asarray(tips, float),
        'axis': axes,
        'rotary': np.full((n, 2), np.nan),
        'feedrate': np.full(n, feed),
        'duration': np.full(n, np.nan),
        'rapid': np.zeros(n, bool),
        'exact_stop': np.zeros(n, bool),
        'contour_tolerance': np.full(n, tolerance),
        'orientation_tolerance': np.full(n, tolerance),
        'line_number': np.arange(1, n + 1),
    }
    given.update({name: np.asarray(value) for name, value in columns.items()})
    return Blocks(**given)


def pyramid(sign=1.0, **columns):
    """Four 60 mm sides, the tool in the walls, tilted 15 deg outward (sign 1) or inward."""
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]]) * 1.0
    slope = sign * np.tan(15 * DEG)
    return blocks_of(
        np.c_[corners * 30 * MM, np.zeros(5)], np.c_[corners * slope, np.ones(5)], **columns
    )


def zigzag(seed, count=12, step=5 * MM, tilt=20 * DEG, **columns):
    """Random 5-axis polyline: steps of random length and direction, tilts off the pole."""
    rng = np.random.default_rng(seed)
    tips = np.cumsum(rng.normal(0.0, step, (count, 3)), axis=0)
    tips -= tips.mean(axis=0)
    turn = np.cumsum(rng.uniform(-0.4, 0.4, count)) + rng.uniform(0, 6)
    lean = 0.6 + tilt * rng.uniform(-1, 1, count)
    axes = np.c_[np.sin(lean) * np.sin(turn), np.sin(lean) * np.cos(turn), np.cos(lean)]
    return blocks_of(tips, axes, **columns)
