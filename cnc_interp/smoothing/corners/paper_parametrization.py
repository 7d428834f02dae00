"""The parametrization of a corner as in the paper [B2013, section 3.3], to compare with.

The first and last three values of f are found one after the other by Newton's method on the
discrete third derivative of the axis (Eq. 11). A cubic spline joins them.
"""

import numpy as np

from cnc_interp.core import FloatArray, dot, norm
from cnc_interp.core.bspline import corner_end_derivatives, corner_spline_points, elevated
from cnc_interp.smoothing.corners.connection import Curves
from cnc_interp.smoothing.orientation import turned_by

#: Step of the discrete derivative in the bottom parameter [-]; [B2013] does not state a value.
STEP = 0.02


def spans(curves: Curves, axes: FloatArray, rates: FloatArray) -> FloatArray:
    """Return f as a cubic spline through the six points of the paper, shape (n, 7, 8)."""
    steps = STEP * np.arange(1, 4)
    x = np.concatenate([[0.0], steps, 1.0 - steps[::-1], [1.0]])
    first = _first_values(curves.bottom, curves.top, axes[:, 0], rates[:, 0])
    last = _first_values(curves.bottom[:, ::-1], curves.top[:, ::-1], axes[:, 1], -rates[:, 1])
    n = len(axes)
    y = np.concatenate([np.zeros((1, n)), first, 1.0 - last[::-1], np.ones((1, n))]).T
    h = np.diff(x)
    system = np.zeros((8, 8))  # for the second derivatives, with not-a-knot ends
    system[0, :3] = h[1], -h[0] - h[1], h[0]
    system[7, 5:] = h[6], -h[5] - h[6], h[5]
    for i in range(1, 7):
        system[i, i - 1 : i + 2] = h[i - 1], 2.0 * (h[i - 1] + h[i]), h[i]
    right = np.zeros((n, 8))
    right[:, 1:7] = 6.0 * np.diff(np.diff(y, axis=1) / h, axis=1)
    bend = np.linalg.solve(system, right.T).T
    slope = np.diff(y, axis=1) / h - h * (2.0 * bend[:, :-1] + bend[:, 1:]) / 6.0
    b1 = y[:, :-1] + slope * h / 3.0
    b2 = 2.0 * b1 - y[:, :-1] + bend[:, :-1] * h**2 / 6.0
    values = np.stack([y[:, :-1], b1, b2, y[:, 1:]], axis=2)
    values = elevated(values.reshape(-1, 4, 1), 6).reshape(n, 7, 7)
    return np.concatenate([np.broadcast_to(x[:-1, None], (n, 7, 1)), values], axis=2)


def _first_values(
    bottom: FloatArray, top: FloatArray, axis: FloatArray, rate: FloatArray
) -> FloatArray:
    """Return the first three values of u_top [B2013, section 3.3, Eq. 11], shape (3, n).

    The third difference is almost linear in u_top, so Gauss-Newton converges fast.
    """
    n = len(axis)
    speed = norm(corner_end_derivatives(bottom)[0])
    before = [turned_by(axis, rate, (k - 2) * STEP * speed) for k in range(3)]
    values = np.empty((3, n))

    def tool_at(u: FloatArray, point: FloatArray) -> FloatArray:
        # Unit tool axis from the bottom point to the top curve at u, shape (n, 3).
        tool = corner_spline_points(top, u) - point
        return np.asarray(tool / norm(tool)[:, None])

    for k in range(3):
        u = np.full(n, (k + 1) * STEP)
        point = corner_spline_points(bottom, u)
        expected = 3.0 * before[2] - 3.0 * before[1] + before[0]
        step = 1e-6
        for _ in range(8):
            slope = (tool_at(u + step, point) - tool_at(u - step, point)) / (2.0 * step)
            square = dot(slope, slope)
            change = dot(slope, tool_at(u, point) - expected)
            u = u - np.where(square > 0.0, change / np.where(square > 0.0, square, 1.0), 0.0)
        values[k] = u
        before = [*before[1:], tool_at(u, point)]
    return values
