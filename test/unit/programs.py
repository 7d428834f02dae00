"""Small programs as Blocks, built straight from tool tips and tool axes."""

import numpy as np
from scipy.interpolate import BPoly, BSpline, PPoly

from cnc_interp.core import DEG, MM, MM_PER_MIN
from cnc_interp.program.blocks import Blocks
from cnc_interp.smoothing.segments import SPLINE, PathSegments


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


def dome(count=400, noise=0.0, block=0.5 * MM, **columns):
    """A spiral over a dome of 80 mm in chords of one length, the tool along the normal."""
    radius, pitch = 80 * MM, 2 * MM / (2 * np.pi)
    way = 20 * MM + np.arange(count) * block
    turn = np.sqrt(2 * way / pitch)
    r = pitch * turn
    tip = np.column_stack([r * np.cos(turn), r * np.sin(turn), np.sqrt(radius**2 - r**2) - radius])
    axis = tip + [0.0, 0.0, radius]
    tip = tip + np.random.default_rng(0).normal(0.0, noise, tip.shape)
    return blocks_of(tip, axis, **columns)


def spline_segments(seed, spans=6, step=0.5 * MM, height=30 * MM):
    """One C4 5-axis curve as SPLINE segments, and the curve itself (tip and top) to compare."""
    rng = np.random.default_rng(seed)
    count = spans + 5
    way = np.arange(count) * step
    bend = np.cumsum(rng.normal(0, 0.1, (count, 2)), axis=0) * step
    tilt = 0.3 + np.cumsum(rng.normal(0, 0.004, (count, 2)), axis=0)
    axes = np.c_[np.sin(tilt[:, 0]), np.sin(tilt[:, 1]), np.ones(count)]
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    tips = np.c_[way, bend]
    curve = BSpline(np.arange(count + 6.0), np.hstack([tips, tips + height * axes]), 5)
    powers = [PPoly.from_spline((curve.t, column, 5)).c for column in curve.c.T]
    pieces = BPoly.from_power_basis(PPoly(np.stack(powers, axis=-1), curve.t))
    points = pieces.c[:, 5 : 5 + spans].swapaxes(0, 1)  # where the curve is defined
    bottom, top = points[..., :3], points[..., 3:]
    axis = top[:, 0] - bottom[:, 0]
    segments = PathSegments(
        kind=np.full(spans, SPLINE),
        bottom=bottom.copy(),
        top=top.copy(),
        connection=np.zeros((spans, 6, 3)),
        parametrization=np.zeros((spans, 0, 8)),
        axis=axis / np.linalg.norm(axis, axis=1)[:, None],
        rotation=np.zeros((spans, 3)),
        rotary=np.full((spans, 6, 2), np.nan),
        length=np.full(spans, np.nan),
        feed=np.full((spans, 2), 3000.0 * MM_PER_MIN),
        block=np.repeat(np.arange(1, spans + 1)[:, None], 2, axis=1),
        line_number=np.arange(1, spans + 1),
        stop=np.arange(spans) == spans - 1,
        deviation=np.zeros((spans, 2)),
    )
    return segments, curve
