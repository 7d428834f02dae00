"""Make the pieces of a mesh: a binary tree of boxes with the exact triangles as leaves.

Each box contains the triangles below it. So the tree never hides a contact, but clears distant
parts of the mesh with one test.
"""

from __future__ import annotations

import numpy as np

from cnc_interp.collision.shapes import Piece, box, hull
from cnc_interp.core import FloatArray, IntArray


def triangle_tree(triangles: FloatArray, round: float = 0.0) -> tuple[list[Piece], IntArray]:  # noqa: A002
    """Return pieces, the root first, and the children of each, (n, 2); -1 for a triangle.

    ``triangles`` (m, 3, 3): corners [m]. ``round``: growth of each triangle [m].
    """
    low, high = triangles.min(axis=1) - round, triangles.max(axis=1) + round
    middle = 0.5 * (low + high)
    pieces: list[Piece] = []
    child: list[tuple[int, int]] = []
    waiting = [(np.arange(len(triangles)), -1, 0)]
    while waiting:
        rows, parent, side = waiting.pop()
        number = len(pieces)
        if parent >= 0:
            one, other = child[parent]
            child[parent] = (number, other) if side == 0 else (one, number)
        child.append((-1, -1))
        if len(rows) == 1:
            pieces.append(hull(triangles[rows[0]], round))
            continue
        pieces.append(box(low[rows].min(axis=0), high[rows].max(axis=0)))
        axis = int(np.argmax(np.ptp(middle[rows], axis=0)))
        order = rows[np.argsort(middle[rows, axis], kind='stable')]
        half = len(order) // 2
        waiting += [(order[half:], number, 1), (order[:half], number, 0)]
    return pieces, np.array(child, dtype=np.int64)


def winding(triangles: FloatArray, point: FloatArray) -> float:
    """Return how often a closed mesh winds around a point: 1 inside, 0 outside [-]."""
    a, b, c = (triangles[:, k] - point for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    volume = np.einsum('ij,ij->i', a, np.cross(b, c))
    ab, bc, ca = (np.einsum('ij,ij->i', u, v) for u, v in ((a, b), (b, c), (c, a)))
    angle = 2.0 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
    return float(angle.sum() / (4.0 * np.pi))
