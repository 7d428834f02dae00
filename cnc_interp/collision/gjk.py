"""Nearest points of two convex pieces. They propose normals; certificates then decide.

The method is Wolfe's minimum-norm point of the difference A - B [Wolfe1976]_. With at most four
points kept, it is the algorithm of Gilbert, Johnson and Keerthi [GJK1988]_. It treats both pieces
without their rounding radii and subtracts these from the distance afterwards.
"""

from math import sqrt

import numpy as np

from cnc_interp.collision.link_poses import placed, turned_back
from cnc_interp.collision.shapes import Pieces, support_point
from cnc_interp.core import FloatArray
from cnc_interp.core.kernels import njit

MOST_STEPS = 60
EXACT = 1e-7  #: Relative difference at which the iteration ends [-].
INSIDE = 1e-12  #: Pieces nearer than this overlap [m].
NOTHING = 1e-12  #: Points with a smaller weight are dropped [-].


@njit(cache=True, nogil=True)
def affine_minimum(d: FloatArray, count: int, weight: FloatArray) -> bool:
    """Write the weights, with sum 1, of the point nearest to 0 in the affine hull of d (k, 3)."""
    k = count - 1
    m = np.zeros((3, 4))
    for i in range(k):
        for j in range(k):
            for c in range(3):
                m[i, j] += (d[i + 1, c] - d[0, c]) * (d[j + 1, c] - d[0, c])
        for c in range(3):
            m[i, 3] -= (d[i + 1, c] - d[0, c]) * d[0, c]
    for i in range(k):
        pivot = i
        for r in range(i + 1, k):
            if abs(m[r, i]) > abs(m[pivot, i]):
                pivot = r
        if abs(m[pivot, i]) < 1e-24:
            return False
        for c in range(4):
            m[i, c], m[pivot, c] = m[pivot, c], m[i, c]
        for r in range(k):
            if r != i:
                share = m[r, i] / m[i, i]
                for c in range(i, 4):
                    m[r, c] -= share * m[i, c]
    weight[0] = 1.0
    for i in range(k):
        weight[i + 1] = m[i, 3] / m[i, i]
        weight[0] -= weight[i + 1]
    return True


@njit(cache=True, nogil=True)
def nearest(pieces: Pieces, a: int, b: int, pose: FloatArray, out: FloatArray) -> float:
    """Return the distance of two pieces, 0 where they overlap [m].

    ``pose`` (12,): the link of A in the frame of the link of B. ``out`` (9,): receives the unit
    normal from A to B, then the nearest points of A in its own frame and of B, without rounding.
    """
    first, disc = pieces.first, pieces.disc
    along_a = pieces.along[a, 0], pieces.along[a, 1], pieces.along[a, 2]
    along_b = pieces.along[b, 0], pieces.along[b, 1], pieces.along[b, 2]
    d, p, q = np.zeros((5, 3)), np.zeros((5, 3)), np.zeros((5, 3))
    weight, wanted = np.zeros(5), np.zeros(5)
    ball = placed(pose, (pieces.ball[a, 0], pieces.ball[a, 1], pieces.ball[a, 2]))
    v0, v1, v2 = (
        ball[0] - pieces.ball[b, 0],
        ball[1] - pieces.ball[b, 1],
        ball[2] - pieces.ball[b, 2],
    )
    count, square = 0, v0 * v0 + v1 * v1 + v2 * v2
    if square == 0.0:
        v0, square = 1.0, 1.0
    for step in range(MOST_STEPS):
        back = turned_back(pose, (-v0, -v1, -v2))
        x = support_point(disc, first[a], first[a + 1], along_a, back)
        y = support_point(disc, first[b], first[b + 1], along_b, (v0, v1, v2))
        z = placed(pose, x)
        w0, w1, w2 = z[0] - y[0], z[1] - y[1], z[2] - y[2]
        if step > 0 and square - (v0 * w0 + v1 * w1 + v2 * w2) <= EXACT * square:
            break
        d[count, 0], d[count, 1], d[count, 2] = w0, w1, w2
        p[count, 0], p[count, 1], p[count, 2] = x
        q[count, 0], q[count, 1], q[count, 2] = y
        weight[count] = 0.0 if count else 1.0
        count += 1
        while True:
            if not affine_minimum(d, count, wanted):
                count -= 1  # the new point adds nothing
                break
            share = 1.0
            for i in range(count):
                if wanted[i] < NOTHING and weight[i] - wanted[i] > 0.0:
                    share = min(share, weight[i] / (weight[i] - wanted[i]))
            kept = 0
            for i in range(count):
                value = weight[i] + share * (wanted[i] - weight[i])
                if share == 1.0 or value > NOTHING:
                    weight[kept] = value
                    d[kept], p[kept], q[kept] = d[i], p[i], q[i]
                    kept += 1
            done = kept == count
            count = kept
            if done:
                break
        total = 0.0
        for i in range(count):
            total += weight[i]
        v0 = v1 = v2 = 0.0
        for i in range(count):
            weight[i] /= total
            v0 += weight[i] * d[i, 0]
            v1 += weight[i] * d[i, 1]
            v2 += weight[i] * d[i, 2]
        before, square = square, v0 * v0 + v1 * v1 + v2 * v2
        # Four points that are kept hold 0 up to rounding; a fifth one has no place.
        if count == 4 or square < INSIDE * INSIDE or (step > 0 and square >= before):
            break
    length = sqrt(square)
    for c in range(3):
        out[3 + c] = out[6 + c] = 0.0
        for i in range(count):
            out[3 + c] += weight[i] * p[i, c]
            out[6 + c] += weight[i] * q[i, c]
    if length < INSIDE:
        out[0], out[1], out[2] = 0.0, 0.0, 1.0
        return 0.0
    out[0], out[1], out[2] = -v0 / length, -v1 / length, -v2 / length
    return max(0.0, length - pieces.round[a] - pieces.round[b])
