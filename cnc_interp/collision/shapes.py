"""Convex pieces by their support function, one formula for all of them.

A piece is the convex hull of discs about one direction a, grown by a radius r. With the centres
p_i and the radii rho_i of its discs, its support function is

    h(n) = max_i (n . p_i + rho_i |n x a|) + r |n|

Hulls, boxes and triangles have rho = 0; cylinders, cones and stacks of them have discs on their
axis; balls have one point and r; a bull-nose mill has a disc and r.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.kernels import njit

UP = (0.0, 0.0, 1.0)


class Piece(NamedTuple):
    """One convex piece in the frame of its link."""

    discs: FloatArray  #: (k, 4): Centres and radii of the discs [m].
    along: FloatArray  #: (3,): Unit vector normal to the discs [-].
    round: float = 0.0  #: Radius by which the hull is grown [m].


def hull(points: FloatArray, round: float = 0.0) -> Piece:  # noqa: A002
    """Return the convex hull of points, (k, 3) [m]."""
    points = np.asarray(points, dtype=float)
    return Piece(np.column_stack([points, np.zeros(len(points))]), np.array(UP), round)


def box(low: FloatArray, high: FloatArray) -> Piece:
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing='ij'), axis=-1)
    return hull(corners.reshape(-1, 3))


def stack(profile: FloatArray, along: FloatArray | None = None, round: float = 0.0) -> Piece:  # noqa: A002
    """Return the hull of discs on an axis through the origin, given heights and radii [m]."""
    along = np.array(UP) if along is None else along
    height, radius = np.asarray(profile, dtype=float).reshape(-1, 2).T
    return Piece(np.column_stack([height[:, None] * along, radius]), along, round)


class Pieces(NamedTuple):
    """All pieces of a scene, parents before their children, as arrays for the kernels."""

    disc: FloatArray  #: (m, 4): Centres and radii of the discs of all pieces [m].
    first: IntArray  #: (n + 1,): First disc of each piece.
    along: FloatArray  #: (n, 3): Unit vector normal to the discs [-].
    round: FloatArray  #: (n,): Radius by which each piece is grown [m].
    ball: FloatArray  #: (n, 4): Centre and radius of a ball around each piece [m].
    child: IntArray  #: (n, 2): The two children of each piece in the tree; -1 for a leaf.
    body: IntArray  #: (n,): Body to which each piece belongs.
    link: IntArray  #: (n,): Link to which it is fixed.


def gathered(pieces: list[Piece], child: IntArray, body: IntArray, link: IntArray) -> Pieces:
    counts = [len(piece.discs) for piece in pieces]
    ball = np.array([ball_around(piece) for piece in pieces]).reshape(-1, 4)
    return Pieces(
        np.concatenate([piece.discs for piece in pieces]),
        np.cumsum([0, *counts]),
        np.array([piece.along for piece in pieces]),
        np.array([piece.round for piece in pieces]),
        ball,
        child,
        body,
        link,
    )


def ball_around(piece: Piece) -> FloatArray:
    """Return centre and radius of a ball that contains a piece, (4,) [m]."""
    centres, radii = piece.discs[:, :3], piece.discs[:, 3]
    reach = radii[:, None] * np.sqrt(np.maximum(1.0 - piece.along**2, 0.0))
    centre = 0.5 * ((centres - reach).min(axis=0) + (centres + reach).max(axis=0))
    return np.append(centre, farthest(piece, centre))


def farthest(piece: Piece, point: FloatArray) -> float:
    """Return how far the farthest point of a piece is from a point [m]."""
    way = piece.discs[:, :3] - point
    up = way @ piece.along
    across = np.linalg.norm(way - up[:, None] * piece.along, axis=1)
    return float(np.hypot(up, across + piece.discs[:, 3]).max()) + piece.round


@njit(cache=True, nogil=True, inline='always')
def support(
    disc: FloatArray,
    first: int,
    last: int,
    a: tuple[float, float, float],
    n: tuple[float, float, float],
) -> tuple[int, float]:
    """Return the farthest disc along n and its n . p + rho |n x a|, without the radius r [m]."""
    x, y, z = n[1] * a[2] - n[2] * a[1], n[2] * a[0] - n[0] * a[2], n[0] * a[1] - n[1] * a[0]
    across = sqrt(x * x + y * y + z * z)
    best, at = -1e300, first
    for i in range(first, last):
        value = n[0] * disc[i, 0] + n[1] * disc[i, 1] + n[2] * disc[i, 2] + disc[i, 3] * across
        if value > best:
            best, at = value, i
    return at, best


@njit(cache=True, nogil=True, inline='always')
def support_point(
    disc: FloatArray,
    first: int,
    last: int,
    a: tuple[float, float, float],
    n: tuple[float, float, float],
) -> tuple[float, float, float]:
    """Return the farthest point of a piece along n, without the radius r [m]."""
    at, _ = support(disc, first, last, a, n)
    along = n[0] * a[0] + n[1] * a[1] + n[2] * a[2]
    x, y, z = n[0] - along * a[0], n[1] - along * a[1], n[2] - along * a[2]
    across = sqrt(x * x + y * y + z * z)
    scale = disc[at, 3] / across if across > 1e-12 else 0.0
    return disc[at, 0] + scale * x, disc[at, 1] + scale * y, disc[at, 2] + scale * z
