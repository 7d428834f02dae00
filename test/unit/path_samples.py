"""Points of path segments and their derivatives at joins, worked out from the control points."""

from math import comb

import numpy as np
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from cnc_interp.proof.programmed_path import ProgrammedPath, distances_to_vertices
from cnc_interp.smoothing.segments import CORNER, LINE, ROTATION, SPLINE

CORNER_KNOTS = [0, 0, 0, 0, 0.5, 1, 1, 1, 1]


def bernstein(degree, u):
    """Bernstein polynomials, shape (len(u), degree + 1)."""
    return np.stack(
        [comb(degree, k) * u**k * (1 - u) ** (degree - k) for k in range(degree + 1)], axis=1
    )


def sampled(segments, count):
    """Tips and tool axes of all segments, shape (n, count, 3) each, ends included."""
    u = np.linspace(0.0, 1.0, count)
    tip, tool = np.zeros((len(segments), count, 3)), np.zeros((len(segments), count, 3))
    spans = segments.kind == SPLINE
    tip[spans] = np.einsum('uk,nki->nui', bernstein(5, u), segments.bottom[spans])
    tool[spans] = np.einsum('uk,nki->nui', bernstein(5, u), segments.top[spans]) - tip[spans]
    connection = bernstein(segments.connection.shape[1] - 1, u)
    tool[spans] += np.einsum('uk,nki->nui', connection, segments.connection[spans])
    for i in np.flatnonzero(~spans):
        if segments.kind[i] == CORNER:
            tip[i] = BSpline(CORNER_KNOTS, segments.bottom[i, :5], 3)(u)
            top = BSpline(CORNER_KNOTS, segments.top[i, :5], 3)(u)
            tool[i] = top + connection @ segments.connection[i] - tip[i]
            continue
        start = segments.bottom[i, 0]
        end = segments.bottom[i, 1] if segments.kind[i] == LINE else start
        tip[i] = start + u[:, None] * (end - start)
        turn = Rotation.from_rotvec(u[:, None] * segments.rotation[i].copy())
        tool[i] = turn.apply(segments.axis[i].copy())
    return tip, tool / np.linalg.norm(tool, axis=2, keepdims=True)


def derivatives(segments, i, late):
    """Value and two derivatives by the tip's way of tip and axis at one end, shape (2, 3, 3)."""
    ends = slice(None, None, -1) if late else slice(None)
    sense = -1.0 if late else 1.0
    p, t = segments.bottom[i][ends], segments.top[i][ends]
    e, n = segments.connection[i][ends], segments.connection.shape[1] - 1
    e = np.array([e[0], n * sense * (e[1] - e[0]), n * (n - 1) * (e[0] - 2 * e[1] + e[2])])
    if segments.kind[i] == SPLINE:
        tip = np.array([p[0], 5 * sense * (p[1] - p[0]), 20 * (p[0] - 2 * p[1] + p[2])])
        top = np.array([t[0], 5 * sense * (t[1] - t[0]), 20 * (t[0] - 2 * t[1] + t[2])])
        tool = top + e - tip
    elif segments.kind[i] == CORNER:
        p, t = segments.bottom[i, :5][ends], segments.top[i, :5][ends]
        tip, top = (
            np.array([x[0], 6 * sense * (x[1] - x[0]), 24 * x[0] - 36 * x[1] + 12 * x[2]])
            for x in (p, t)
        )
        tool = top + e - tip
    else:
        way = segments.bottom[i, 1] - segments.bottom[i, 0]
        tip = np.array([segments.bottom[i, int(late)], way, np.zeros(3)])
        turn = segments.rotation[i]
        o = Rotation.from_rotvec(turn * float(late)).apply(segments.axis[i].copy())
        tool = np.array([o, np.cross(turn, o), np.cross(turn, np.cross(turn, o))])
    size = np.linalg.norm(tool[0])
    o = tool[0] / size
    o_u = (tool[1] - (tool[1] @ o) * o) / size
    grow = tool[2] @ o + tool[1] @ o_u
    axis = np.array([o, o_u, (tool[2] - grow * o - 2 * (tool[1] @ o) * o_u) / size])
    speed = np.linalg.norm(tip[1])
    found = []
    for f in (tip, axis):
        first = f[1] / speed
        found.append([f[0], first, (f[2] - first * (tip[1] @ tip[2] / speed)) / speed**2])
    return np.array(found)


def jumps(segments, height):
    """
    Jumps of value, first and second derivative at joins where the tool does not rest.

    Of the tip and of the point at flank height; derivatives are made lengths by the shorter of
    both segments. NaN where a derivative is none, because a segment does not advance at its end.
    """
    worst = np.zeros(3)
    ways = np.linalg.norm(np.diff(sampled(segments, 9)[0], axis=1), axis=2).sum(axis=1)
    for i in range(len(segments) - 1):
        if segments.stop[i] or ROTATION in segments.kind[i : i + 2]:
            continue
        gap = derivatives(segments, i + 1, False) - derivatives(segments, i, True)
        size = min(ways[i], ways[i + 1])
        for order in range(3):
            length = np.abs(gap[0, order]).max() + height * np.abs(gap[1, order]).max()
            worst[order] = np.maximum(worst[order], length * size**order)  # keeps a NaN
    return worst


def deviation(segments, blocks, height, count=7):
    """
    Largest deviation over its tolerance: path from program (tip, top), program from path.

    The second is taken at the program's vertices.
    """
    tip, axis = (part.reshape(-1, 3) for part in sampled(segments, count))
    path = ProgrammedPath.of(blocks.tip, blocks.axis, blocks.rotary, height)
    tolerance = float(blocks.contour_tolerance[0])
    n = len(blocks)
    off = path.deviation(
        tip, axis, np.repeat(segments.block[:, 0], count), np.full(len(tip), np.inf)
    )
    anywhere = np.zeros(n, np.int64), np.full(n, len(tip) - 1)
    near, _ = distances_to_vertices(tip, blocks.tip, *anywhere)
    near_top, _ = distances_to_vertices(
        tip + height * axis, blocks.tip + height * blocks.axis, *anywhere
    )
    forth = max(off.contour.max(), off.orientation.max())
    return forth / tolerance, max(near.max(), near_top.max()) / tolerance
