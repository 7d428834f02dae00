"""Programs as bad as CAM systems write them, and worse."""

import numpy as np
from programs import blocks_of

from cnc_interp.core import MM, MM_PER_MIN, UM


def some(rng, n, often, share, usual, other):
    """Now and then a column has a share of other values."""
    if rng.random() > often:
        return usual
    chosen = rng.random(n) < share
    return np.where(chosen.reshape(-1, *[1] * (np.ndim(usual) - 1)), other, usual)


def path(rng, n):
    """Tips: steps of 10 um to 3 mm, tiny, zero, 5 mm and long ones, turns, reversals, noise."""
    step = np.full(n, 10 ** rng.uniform(-5, -2.5))
    step = some(rng, n, 0.5, 0.2, step, 10 * UM)
    step = some(rng, n, 0.4, 0.1, step, 5 * MM)
    step = some(rng, n, 0.3, 0.1, step, 0.1 * UM)
    step = some(rng, n, 0.3, 0.1, step, 0.0)
    step = some(rng, n, 0.1, 0.05, step, 30 * MM)
    heading = np.cumsum(rng.normal(0, rng.choice([0.003, 0.03, 0.2]), n)) + rng.uniform(0, 6.3)
    heading += np.cumsum((rng.random(n) < 0.03) * rng.uniform(-3.14, 3.14, n))
    pitch = np.cumsum(rng.normal(0, 0.02, n))
    flat = np.cos(pitch)
    d = np.column_stack([np.cos(heading) * flat, np.sin(heading) * flat, np.sin(pitch)])
    d = some(rng, n, 0.2, 0.02, d, -d)
    tip = np.cumsum(step[:, None] * d, axis=0)
    if rng.random() < 0.5:
        tip = tip + rng.normal(0, 10 ** rng.uniform(-8, -5.5), tip.shape)
    return step, tip


def tools(rng, step):
    """Tool axes: fixed, turning, near the pole, with jitter."""
    n, way, kind = len(step), np.cumsum(step), rng.integers(0, 4)
    if kind < 2:
        return np.tile([[0.0, 0.0, 1.0], [0.2, 0.1, 1.0]][kind], (n, 1))
    lean = 0.3 + 0.25 * np.sin(way / rng.uniform(1e-3, 0.1) + rng.uniform(0, 6))
    turn = way / rng.uniform(5e-3, 0.2) + rng.uniform(0, 6)
    if kind == 3:
        lean = 0.02 * lean
    axis = np.column_stack(
        [np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), np.cos(lean)]
    )
    if rng.random() < 0.3:
        axis = axis + rng.normal(0, 10 ** rng.uniform(-7, -4), axis.shape)
    return axis


def dirty(seed, most=160):
    """A program of up to ``most`` rows, of everything at once."""
    rng = np.random.default_rng(seed)
    n, tolerance = int(rng.integers(5, most)), 10 ** rng.uniform(-6, -4)
    step, tip = path(rng, n)
    axis = tools(rng, step)
    if rng.random() < 0.2:  # rotations of the resting tip
        k = rng.integers(1, n, 3)
        tip[k] = tip[k - 1]
    if rng.random() < 0.2:  # a repeated point
        k = rng.integers(1, n)
        tip[k], axis[k] = tip[k - 1], axis[k - 1]
    stop, rapid = np.zeros(n, bool), np.zeros(n, bool)
    if rng.random() < 0.3:
        stop[rng.integers(0, n)] = True
    if rng.random() < 0.2:
        rapid[rng.integers(1, n, 2)] = True
    feed = np.full(n, 3000 * MM_PER_MIN)
    if rng.random() < 0.3:
        feed = rng.choice([1200 * MM_PER_MIN, 3000 * MM_PER_MIN], n)
    duration = np.full(n, np.nan)
    if rng.random() < 0.2:
        way = np.linalg.norm(np.diff(tip, axis=0), axis=1)
        duration[1:] = np.maximum(1e-4, way / rng.uniform(0.02, 0.05, n - 1))
        feed = np.where(np.isfinite(duration), np.nan, feed)
    return blocks_of(
        tip,
        axis,
        tolerance=tolerance,
        feedrate=np.where(rapid, np.inf, feed),
        duration=np.where(rapid, np.nan, duration),
        exact_stop=stop,
        rapid=rapid,
    )
