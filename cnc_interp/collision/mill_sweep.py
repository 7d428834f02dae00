"""The interval that a moving tool sweeps on a line of the stock, in closed form.

A tool is a stack of slabs, each a frustum or a ball. In a piece of motion a slab moves by its own
translation v, from -v to v about the middle of the piece. The swept region is convex, so it meets
a line in one interval. The ends of the interval lie on

- the frustum at either end of the motion,
- either end disc, moved along v,
- the two flat strips swept by the generators with n . v = 0, where n is their outward normal.

The interval extends from the least to the greatest intersection of these with the line.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from cnc_interp.collision.scene import Body, Role
from cnc_interp.core import FloatArray
from cnc_interp.core.kernels import njit

TURNS = 8  #: Number of frusta that approximate the corner radius of a mill.
FAR = 1e9  #: Beyond every line [m].
TINY = 1e-12  #: Below this component two directions count as normal to each other [-].
FLAT = 1e-6  #: A translation whose normal share is below this lies in the plane of a disc [-].
#: Columns of a slab: 1 for a ball, lower height and radius, upper height and radius [m]. Heights
#: count from the tip.
BALL, Z0, R0, Z1, R1, SLAB = 0, 1, 2, 3, 4, 5
#: A flat strip: begin of its generator, from the middle of the base (3); the inverse of the matrix
#: from shares of generator and motion to u and v (4); extent of the generator along w (1).
Strip = tuple[float, float, float, float, float, float, float, float]
NOWHERE = (FAR, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0)  #: A strip that no line meets.


def slabs_of(body: Body, grown: float = 0.0) -> FloatArray:
    """Return the slabs of a part of a tool, (n, 5), grown by ``grown`` [m], or shrunk if negative.

    The result errs on the safe side: parts grow, or shrink, by slightly more than ``grown``.
    """
    if body.role is not Role.CUTTER:
        cones = [piece.discs[:, 2:].T for piece in body.pieces]
        return np.concatenate([_offset(height, width, grown) for height, width in cones])
    (low, radius), (top, _) = body.pieces[-1].discs[:, 2:]
    corner = body.pieces[0].round
    if corner >= radius:
        size = max(radius + grown, 0.0)
        ball = (1.0, low, size, low, size)
        return np.array([ball, (0.0, low, size, top + grown, size)])
    height, width = np.array([low, top]), np.array([radius, radius])
    if corner:
        # Vertices outside and inside the arc, so that the area of the profile is kept.
        angle = np.linspace(0.0, np.pi / 2.0, TURNS + 1)
        size = corner * np.sqrt(angle[1] / np.sin(angle[1]))
        height = np.append(low - np.minimum(size * np.cos(angle), corner), top)
        width = np.append(radius - corner + np.minimum(size * np.sin(angle), corner), radius)
    return _offset(height, width, grown)


def _offset(height: FloatArray, width: FloatArray, grown: float) -> FloatArray:
    """Return the slabs of a convex profile after its lines have moved outwards by ``grown``."""
    slope = np.diff(width) / np.diff(height)
    at = height.copy()
    at[0], at[-1] = height[0] - grown, height[-1] + grown
    lines = width[:-1] + slope * (at[:, None] - height[:-1]) + grown * np.hypot(1.0, slope)
    radius, rows = lines.min(axis=1), []
    for z0, r0, z1, r1 in zip(at[:-1], radius[:-1], at[1:], radius[1:], strict=True):
        if z0 < z1 and max(r0, r1) > 0.0:
            rise = (r1 - r0 or 1.0) / (z1 - z0)
            low, high = z0 - min(r0, 0.0) / rise, z1 - min(r1, 0.0) / rise
            rows.append((0.0, low, max(r0, 0.0), high, max(r1, 0.0)))
    return np.array(rows).reshape(-1, SLAB)


@njit(cache=True, nogil=True, inline='always')
def _within(a: float, b: float, c: float, low: float, high: float) -> tuple[float, float]:
    """Return the least interval that contains all t in [low, high] with a t^2 + 2 b t + c <= 0."""
    first, second = high, high
    disc = b * b - a * c
    if abs(a) < TINY:
        if abs(b) > TINY:
            first = -0.5 * c / b
    elif disc > 0.0:
        root = -b - sqrt(disc) if b > 0.0 else -b + sqrt(disc)
        first, second = root / a, (c / root if root != 0.0 else 0.0)
        if first > second:
            first, second = second, first
    first, second = min(max(first, low), high), min(max(second, low), high)
    begin, end = FAR, -FAR
    for k in range(3):
        x = low if k == 0 else (first if k == 1 else second)
        y = first if k == 0 else (second if k == 1 else high)
        middle = 0.5 * (x + y)
        if y > x and (a * middle + 2.0 * b) * middle + c <= 0.0:
            begin, end = min(begin, x), max(end, y)
    return begin, end


@njit(cache=True, nogil=True)
def frustum(
    du: float,
    dv: float,
    a: tuple[float, float, float],
    r0: float,
    r1: float,
    height: float,
) -> tuple[float, float]:
    """Return where a line along w enters and leaves a frustum, relative to its base point [m].

    The base point is the middle of the lower disc. ``du``, ``dv``: position of the line relative
    to it [m]. If the line misses the frustum, the first value exceeds the second.
    """
    foot, slope = du * a[0] + dv * a[1], (r1 - r0) / height
    reach = max(r0, r1) + height
    low, high = -reach, reach
    if abs(a[2]) > TINY:
        one, other = -foot / a[2], (height - foot) / a[2]
        low, high = max(low, min(one, other)), min(high, max(one, other))
    elif foot < 0.0 or foot > height:
        return FAR, -FAR
    if low >= high:
        return FAR, -FAR
    wide = 1.0 + slope * slope
    return _within(
        1.0 - a[2] * a[2] * wide,
        -a[2] * (foot * wide + r0 * slope),
        du * du + dv * dv - (foot * wide + 2.0 * r0 * slope) * foot - r0 * r0,
        low,
        high,
    )


@njit(cache=True, nogil=True)
def _disc(
    du: float,
    dv: float,
    a: tuple[float, float, float],
    r: float,
    v: tuple[float, float, float],
) -> tuple[float, float]:
    """Return where a line along w meets a disc that moves from -v to v about its middle."""
    foot = du * a[0] + dv * a[1]
    along = v[0] * a[0] + v[1] * a[1] + v[2] * a[2]
    square = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    if along * along < FLAT * FLAT * square:
        if abs(a[2]) < TINY:
            return FAR, -FAR
        t = -foot / a[2]
        share = (du * v[0] + dv * v[1] + t * v[2]) / square
        share = min(max(share, -1.0), 1.0)
        x, y, z = du - share * v[0], dv - share * v[1], t - share * v[2]
        return (t, t) if x * x + y * y + z * z <= r * r else (FAR, -FAR)
    low, high = -FAR, FAR
    if abs(a[2]) > TINY:
        one, other = (-along - foot) / a[2], (along - foot) / a[2]
        low, high = min(one, other), max(one, other)
    elif abs(foot) > abs(along):
        return FAR, -FAR
    share, rate = foot / along, a[2] / along
    x0, y0, z0 = du - share * v[0], dv - share * v[1], -share * v[2]
    x1, y1, z1 = -rate * v[0], -rate * v[1], 1.0 - rate * v[2]
    return _within(
        x1 * x1 + y1 * y1 + z1 * z1,
        x0 * x1 + y0 * y1 + z0 * z1,
        x0 * x0 + y0 * y0 + z0 * z0 - r * r,
        low,
        high,
    )


@njit(cache=True, nogil=True)
def _capsule(du: float, dv: float, r: float, v: tuple[float, float, float]) -> tuple[float, float]:
    """Return where a line along w meets a ball that moves from -v to v about its middle."""
    begin, end = FAR, -FAR
    way = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    if way > TINY:
        a = v[0] / way, v[1] / way, v[2] / way
        begin, end = frustum(du + v[0], dv + v[1], a, r, r, 2.0 * way)
        begin, end = begin - v[2], end - v[2]
    for side in (-1.0, 1.0):
        x, y = du - side * v[0], dv - side * v[1]
        room = r * r - x * x - y * y
        if room > 0.0:
            half = sqrt(room)
            begin, end = min(begin, side * v[2] - half), max(end, side * v[2] + half)
    return begin, end


@njit(cache=True, nogil=True)
def swept(
    du: float,
    dv: float,
    a: tuple[float, float, float],
    slab: tuple[float, float, float, float],
    v: tuple[float, float, float],
    strips: tuple[Strip, Strip],
) -> tuple[float, float]:
    """Return the interval that a moving slab sweeps on a line along w, relative to its base [m].

    The base is the middle of the lower disc at the middle of the motion. ``du``, ``dv``: position
    of the line relative to it [m]. ``slab``: 1 for a ball, both radii, and the height.
    ``strips``: the result of ``strips_of``. Vectors have the components u, v, w.
    """
    ball, r0, r1, height = slab
    if ball > 0.5:
        return _capsule(du, dv, r0, v)
    one, other = frustum(du - v[0], dv - v[1], a, r0, r1, height)
    low, high = one + v[2], other + v[2]
    if v[0] == 0.0 and v[1] == 0.0 and v[2] == 0.0:
        return low, high
    one, other = frustum(du + v[0], dv + v[1], a, r0, r1, height)
    low, high = min(low, one - v[2]), max(high, other - v[2])
    if r0 > 0.0:
        one, other = _disc(du, dv, a, r0, v)
        low, high = min(low, one), max(high, other)
    if r1 > 0.0:
        one, other = _disc(du - height * a[0], dv - height * a[1], a, r1, v)
        low, high = min(low, one + height * a[2]), max(high, other + height * a[2])
    for strip in strips:
        x, y = du - strip[0], dv - strip[1]
        share, side = x * strip[3] + y * strip[4], x * strip[5] + y * strip[6]
        if share >= 0.0 and share <= 1.0 and side >= -1.0 and side <= 1.0:
            t = strip[2] + share * strip[7] + side * v[2]
            low, high = min(low, t), max(high, t)
    return low, high


@njit(cache=True, nogil=True)
def strips_of(
    a: tuple[float, float, float],
    slab: tuple[float, float, float, float],
    v: tuple[float, float, float],
) -> tuple[Strip, Strip]:
    """Return the two flat strips between the slab at either end of the motion."""
    ball, r0, r1, height = slab
    along = v[0] * a[0] + v[1] * a[1] + v[2] * a[2]
    x, y, z = v[0] - along * a[0], v[1] - along * a[1], v[2] - along * a[2]
    across = sqrt(x * x + y * y + z * z)
    slope = (r1 - r0) / height if ball < 0.5 else 0.0
    if ball > 0.5 or across <= abs(slope * along) or across == 0.0:
        return NOWHERE, NOWHERE
    x, y, z = x / across, y / across, z / across
    b = a[1] * z - a[2] * y, a[2] * x - a[0] * z, a[0] * y - a[1] * x
    fore = slope * along / across
    turn, found = sqrt(1.0 - fore * fore), (NOWHERE, NOWHERE)
    for side in (turn, -turn):
        ex, ey, ez = fore * x + side * b[0], fore * y + side * b[1], fore * z + side * b[2]
        gx = height * a[0] + (r1 - r0) * ex
        gy = height * a[1] + (r1 - r0) * ey
        gz = height * a[2] + (r1 - r0) * ez
        det = gx * v[1] - gy * v[0]
        if abs(det) >= TINY * height * across:
            shares = v[1] / det, -v[0] / det, -gy / det, gx / det
            strip = r0 * ex, r0 * ey, r0 * ez, shares[0], shares[1], shares[2], shares[3], gz
            found = strip, found[0]
    return found
