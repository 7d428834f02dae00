"""The certificate: a proof that a curve stays within the tolerances, without samples.

On the part of a span between two vertices, the blocks are linear in u and the curve is a quintic.
Their difference is a quintic, which lies in the convex hull of its Bezier points. Curve and blocks
are compared at the same u, and u covers both from end to end. So the bound holds for the distance
of the curve from the blocks and of the blocks from the curve. Tip and tool axis are compared at
the same u, too.
"""

from math import sqrt

import numpy as np

from cnc_interp.core import BoolArray, FloatArray
from cnc_interp.core.bspline import quintic_part
from cnc_interp.core.kernels import njit
from cnc_interp.smoothing.dense.polyline import Polyline

HALVINGS = 3  #: Largest number of times that a part is halved if the hull is too wide.
#: Smallest step of the Bezier points of the tip along the chord of the span, over the chord [-].
ADVANCE = 0.01


@njit(cache=True, nogil=True)
def _hull(
    points: FloatArray,
    part: tuple[float, float],
    line: tuple[FloatArray, FloatArray, FloatArray, float],
    height: float,
    turning: bool,
    work: FloatArray,
) -> tuple[float, float]:
    """Bound contour and orientation deviation of a part of a quintic span from a line [m].

    The top point is p + h D/|D|, where D = top - bottom. So the component of D along the tool axis
    has no effect on it. Primes mark the line. With d = D - D' and the direction o' of D',

        |p + h D/|D| - p' - h o'| <= |p - p' + d - (d . o') o'| + 2.3 |d|^2/h + (h/|D'| - 1) |d|.

    The ``line`` has tip and top (6,) at both ends of the part, the middle direction of o', which
    is used, and the angle by which o' turns, which adds |d| turn.
    """
    first, last, tool, turn = line
    quintic_part(points, part[0], part[1], work)
    contour, top, across = 0.0, 0.0, 0.0
    for k in range(6):
        share = k / 5.0
        off = 0.0
        for i in range(3):
            off += (work[k, i] - first[i] - share * (last[i] - first[i])) ** 2
        contour = max(contour, off)
        if turning:
            along, size = 0.0, 0.0
            for i in range(3):
                tip = work[k, i] - first[i] - share * (last[i] - first[i])
                d = work[k, 3 + i] - first[3 + i] - share * (last[3 + i] - first[3 + i]) - tip
                along += d * tool[i]
                size += d * d
            across = max(across, size)
            off = 0.0
            for i in range(3):
                off += (
                    work[k, 3 + i]
                    - first[3 + i]
                    - share * (last[3 + i] - first[3 + i])
                    - along * tool[i]
                ) ** 2
            top = max(top, off)
    if not turning:
        return sqrt(contour), sqrt(contour)
    across = sqrt(across)
    return sqrt(contour), sqrt(top) + across * (turn + 0.2 * turn * turn + 2.3 * across / height)


@njit(cache=True, nogil=True)
def certify(
    points: FloatArray,
    knots: FloatArray,
    line: Polyline,
    height: float,
    turning: bool,
    tolerance_share: float,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return deviations of spans [m] and as shares of tolerances, and where the tip advances."""
    n, u, tip, axis = len(points), line.u, line.pose[:, :3], line.pose[:, 3:]
    deviation, excess = np.zeros((n, 2)), np.zeros((n, 2))
    advances = np.ones(n, dtype=np.bool_)
    work = np.empty((6, points.shape[2]))
    first, last, tool = np.empty(6), np.empty(6), np.empty(3)
    k = 0
    for s in range(n):
        start, end = knots[s], knots[s + 1]
        d = end - start
        while k < len(u) - 2 and u[k + 1] <= start:
            k += 1
        j = k
        while j < len(u) - 1 and u[j] < end:
            low, high = max(u[j], start), min(u[j + 1], end)
            length = u[j + 1] - u[j]
            cosine = 0.0
            for i in range(3):
                cosine += (axis[j + 1, i] - axis[j, i]) ** 2
            turn = sqrt(cosine)
            allowed = (
                tolerance_share * line.tolerance[j, 0],
                tolerance_share * line.tolerance[j, 1],
            )
            for halving in range(HALVINGS + 1):
                parts = 2**halving
                worst, worst_top = 0.0, 0.0
                for p in range(parts):
                    a = low + (high - low) * p / parts
                    b = low + (high - low) * (p + 1) / parts
                    x, y = (a - u[j]) / length, (b - u[j]) / length
                    size = 0.0
                    for i in range(3):
                        first[i] = tip[j, i] + x * (tip[j + 1, i] - tip[j, i])
                        last[i] = tip[j, i] + y * (tip[j + 1, i] - tip[j, i])
                        first[3 + i] = first[i] + height * (
                            axis[j, i] + x * (axis[j + 1, i] - axis[j, i])
                        )
                        last[3 + i] = last[i] + height * (
                            axis[j, i] + y * (axis[j + 1, i] - axis[j, i])
                        )
                        tool[i] = 0.5 * (first[3 + i] - first[i] + last[3 + i] - last[i])
                        size += tool[i] * tool[i]
                    for i in range(3):
                        tool[i] /= sqrt(size)
                    contour, top = _hull(
                        points[s],
                        ((a - start) / d, (b - start) / d),
                        (first, last, tool, turn * (y - x)),
                        height,
                        turning,
                        work,
                    )
                    worst, worst_top = max(worst, contour), max(worst_top, top)
                worst, worst_top = worst + line.used[j, 0], worst_top + line.used[j, 1]
                if worst <= allowed[0] and worst_top <= allowed[1]:
                    break
            deviation[s, 0] = max(deviation[s, 0], worst)
            deviation[s, 1] = max(deviation[s, 1], worst_top)
            excess[s, 0] = max(excess[s, 0], worst / allowed[0])
            excess[s, 1] = max(excess[s, 1], worst_top / allowed[1])
            j += 1
        square = 0.0
        for i in range(3):
            square += (points[s, 5, i] - points[s, 0, i]) ** 2
        for q in range(5):
            along = 0.0
            for i in range(3):
                along += (points[s, q + 1, i] - points[s, q, i]) * (
                    points[s, 5, i] - points[s, 0, i]
                )
            if not along > ADVANCE * square:  # also NaN, if the solution broke down
                advances[s] = False
    return deviation, excess, advances
