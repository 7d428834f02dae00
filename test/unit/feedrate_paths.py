"""Paths for the tests of the feed planner: exact AxisPaths built without the rest of the house."""

from __future__ import annotations

import numpy as np

from cnc_interp.core import M_PER_MIN, MM, REV, REV_PER_MIN, FloatArray
from cnc_interp.core.axis_limits import Limits
from cnc_interp.kinematics.axis_path import AxisPath, evaluate

GAUSS_X, GAUSS_W = np.polynomial.legendre.leggauss(12)


XYZAC = Limits.constant(
    np.array([30 * M_PER_MIN, 30 * M_PER_MIN, 30 * M_PER_MIN, 15 * REV_PER_MIN, 20 * REV_PER_MIN]),
    np.array([2.5, 3.0, 2.1, 0.83 * REV, 0.83 * REV]),
    np.array([5.0, 5.0, 50.0, 5 * REV, 50 * REV]),
)


def scaled(limits: Limits, velocity: float, acceleration: float, jerk: float) -> Limits:
    """Relax or tighten all axes alike."""
    return Limits.constant(
        limits.max_velocity * velocity,
        limits.max_acceleration * acceleration,
        limits.max_jerk * jerk,
    )


def first_axes(limits: Limits, n: int) -> Limits:
    """Take the limits of the first n axes."""
    return Limits(limits.axes[:n])


def rotary_jet(s: FloatArray, amplitude: float, wavelength: float) -> FloatArray:
    """Two smooth rotary axes as functions of s: value and three derivatives, (4, n, 2)."""
    w = np.array([2 * np.pi / wavelength, 2 * np.pi / (1.7 * wavelength)])
    gain = np.array([amplitude, 1.5 * amplitude])
    angle = s[:, None] * w + np.array([0.3, 1.1])
    jet = [np.sin(angle), np.cos(angle), -np.sin(angle), -np.cos(angle)]
    return np.stack([gain * w**k * jet[k] for k in range(4)])


def bezier_jet(points: FloatArray, u: FloatArray) -> FloatArray:
    """Cubic Bezier curve and three derivatives by u, shape (4, n, 3)."""
    d1, d2 = 3 * np.diff(points, axis=0), 6 * np.diff(points, 2, axis=0)
    d3 = 6 * np.diff(points, 3, axis=0)
    u = u[:, None]
    w = 1 - u
    value = (
        w**3 * points[0] + 3 * w**2 * u * points[1] + 3 * w * u**2 * points[2] + u**3 * points[3]
    )
    first = w**2 * d1[0] + 2 * w * u * d1[1] + u**2 * d1[2]
    return np.stack([value, first, w * d2[0] + u * d2[1], 0 * u + d3[0]])


def by_length(jet: FloatArray) -> FloatArray:
    """Turn derivatives by u into derivatives by arc length."""
    c, c1, c2, c3 = jet
    speed = np.linalg.norm(c1, axis=1, keepdims=True)
    rate = np.sum(c1 * c2, axis=1, keepdims=True) / speed
    bend = (np.sum(c2 * c2 + c1 * c3, axis=1, keepdims=True) - rate**2) / speed
    s1 = c1 / speed
    s2 = (c2 - rate * s1) / speed**2
    s3 = (c3 - 3 * speed * rate * s2 - bend * s1) / speed**3
    return np.stack([c, s1, s2, s3])


def curve_cells(points: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lengths and jets by arc length of the pieces of a cubic Bezier between given u."""
    du = np.diff(u)
    at = (u[:-1, None] + du[:, None] * (GAUSS_X + 1) / 2).ravel()
    speed = np.linalg.norm(bezier_jet(points, at)[1], axis=1).reshape(len(du), -1)
    return speed @ GAUSS_W * du / 2, by_length(bezier_jet(points, u))


def polyline_path(
    points: FloatArray,
    feed: float | FloatArray = 3000 * MM / 60,
    tolerance: float = 0.02 * MM,
    cells: int = 8,
    n_axes: int = 5,
    amplitude: float = 0.3,
    wavelength: float = 0.11,
    stops: tuple[int, ...] = (),
    ratio: float = 2.0,
) -> AxisPath:
    """
    Round a polyline of the tool tip by five-point B-splines [B2013, Eq. 1-3].

    X Y Z are the tip; two rotary axes follow smooth functions of the path length. ``feed`` is one
    value or one per segment; ``stops`` are inner vertices kept sharp, with an exact stop.
    """
    p = np.asarray(points, dtype=np.float64)
    n = len(p)
    chord = np.diff(p, axis=0)
    length = np.linalg.norm(chord, axis=1)
    t = chord / length[:, None]
    feeds = np.broadcast_to(np.asarray(feed, dtype=np.float64), (n - 1,))
    reach = np.zeros((n, 2))
    for i in range(1, n - 1):
        half_sine = np.linalg.norm(t[i] - t[i - 1]) / 2
        if half_sine < 1e-9 or i in stops:
            continue
        half = 0.5 * min(length[i - 1], length[i])
        l1 = 2 * tolerance / half_sine
        l2 = min(ratio * l1, half)
        reach[i] = min(l1, l2 / 1.5), l2
    lengths: list[float] = []
    lefts: list[FloatArray] = []
    rights: list[FloatArray] = []
    cell_feed: list[float] = []
    block: list[int] = []
    stop_at: set[int] = {0}
    for i in range(n - 1):
        straight = length[i] - reach[i, 1] - reach[i + 1, 1]
        if straight > 1e-12 + 1e-9 * length[i]:
            a = p[i] + reach[i, 1] * t[i]
            b = a + straight * t[i]
            zero = np.zeros(3)
            lengths.append(straight)
            lefts.append(np.stack([a, t[i], zero, zero])[:, None])
            rights.append(np.stack([b, t[i], zero, zero])[:, None])
            cell_feed.append(feeds[i])
            block.append(i)
        l1, l2 = reach[i + 1]
        if l2 > 0:
            c = p[i + 1]
            p0, p1 = c - l2 * t[i], c - l1 * t[i]
            p3, p4 = c + l1 * t[i + 1], c + l2 * t[i + 1]
            m0, m1 = (p1 + c) / 2, (c + p3) / 2
            mid = (m0 + m1) / 2
            u = np.linspace(0, 1, cells + 1)
            for half_points, which in (([p0, p1, m0, mid], i), ([mid, m1, p3, p4], i + 1)):
                ds, jet = curve_cells(np.array(half_points), u)
                lengths.extend(ds)
                lefts.append(jet[:, :-1])
                rights.append(jet[:, 1:])
                cell_feed.extend([min(feeds[i], feeds[i + 1])] * cells)
                block.extend([which] * cells)
        if i + 1 in stops or i == n - 2:
            stop_at.add(len(lengths))
    s = np.concatenate([[0.0], np.cumsum(lengths)])
    left, right = np.concatenate(lefts, axis=1), np.concatenate(rights, axis=1)
    tip = np.concatenate([left[0], right[0, -1:]])
    if n_axes == 5:
        turn = rotary_jet(s, amplitude, wavelength)
        left = np.concatenate([left, turn[:, :-1]], axis=2)
        right = np.concatenate([right, turn[:, 1:]], axis=2)
    stop = np.zeros(len(s), dtype=np.bool_)
    stop[list(stop_at)] = True
    return AxisPath(
        s=s,
        cell_left=left,
        cell_right=right,
        tip=tip,
        axis=np.tile([0.0, 0.0, 1.0], (len(s), 1)),
        cell_feed=np.array(cell_feed, dtype=np.float64),
        cell_block=np.array(block, dtype=np.int64),
        stop=stop,
    )


def line_path(length: float, feed: float = np.inf, cells: int = 1, n_axes: int = 5) -> AxisPath:
    """One straight stroke of the X axis, cut into equal cells."""
    points = np.zeros((cells + 1, 3))
    points[:, 0] = np.linspace(0, length, cells + 1)
    return polyline_path(points, feed, n_axes=n_axes, amplitude=0.0)


def random_polyline(rng: np.random.Generator, corners: int, longest: float = 0.06) -> FloatArray:
    """Random 3-D polyline, turns up to 150 degrees, segments from 1 % of the longest."""
    points = [np.zeros(3)]
    direction = np.array([1.0, 0.0, 0.0])
    for _ in range(corners + 1):
        points.append(points[-1] + direction * longest * 10 ** rng.uniform(-2, 0))
        side = rng.normal(size=3)
        side -= side @ direction * direction
        side /= np.linalg.norm(side)
        turn = np.deg2rad(rng.uniform(2, 150))
        direction = np.cos(turn) * direction + np.sin(turn) * side
    return np.array(points)


def sampled_ratios(path: AxisPath, law, limits: Limits, period: float = 1e-3) -> FloatArray:
    """
    Largest |difference quotient| / limit of the emitted samples, shape (3, n_axes).

    Nothing of the planner is used but s(t) and q(s): positions at every period, then first,
    second and third differences, with the tool at rest before and after.
    """
    count = int(np.ceil(law.end_time / period)) + 1
    time = np.arange(-3, count + 4) * period
    q = evaluate(path, law.evaluate(time)[0])[0]
    out = np.zeros((3, q.shape[1]))
    limit = (limits.max_velocity, limits.max_acceleration, limits.max_jerk)
    for order in (1, 2, 3):
        quotient = np.diff(q - q[0], order, axis=0) / period**order
        out[order - 1] = np.abs(quotient).max(axis=0) / limit[order - 1]
    return out
