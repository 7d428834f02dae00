"""Triangles of the bodies of a scene: what the page, RViz and URDF draw, and STL files of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from cnc_interp.collision.mesh_file import HEADER, TRIANGLE
from cnc_interp.collision.scene import Placed, Role, Scene
from cnc_interp.collision.shapes import Piece
from cnc_interp.core import FloatArray
from cnc_interp.machine_model.machine import Machine

AROUND = 24  #: Points on the rim of a disc.


@dataclass(frozen=True, eq=False)
class DrawnBody:
    name: str  #: Its name in the scene, which hits name too.
    link: str  #: Link of the machine that carries it.
    role: Role
    tool: int  #: Number of the tool that it belongs to; 0: always there.
    triangles: FloatArray  #: (m, 3, 3): Surface in the frame of the link, seen from outside [m].

    def stl(self) -> bytes:
        """Return the surface as a binary STL file, in metres."""
        rows = np.zeros(len(self.triangles), TRIANGLE)
        rows['corners'] = self.triangles
        head = b'cnc_interp, metres'.ljust(HEADER - 4)
        return head + len(rows).to_bytes(4, 'little') + rows.tobytes()


def drawn_bodies(scene: Scene, machine: Machine) -> Iterator[DrawnBody]:
    """Yield the bodies of a scene; SceneError names one whose link the machine does not have."""
    for body in Placed.of(scene, machine).scene.bodies:
        triangles = body.triangles
        if triangles is None:
            triangles = np.concatenate([surface(piece) for piece in body.pieces])
        yield DrawnBody(body.name, body.link, body.role, body.tool, triangles)


def surface(piece: Piece) -> FloatArray:
    """Return triangles of a convex piece, with rims and balls of some points, (m, 3, 3) [m]."""
    points = rim_points(piece.discs, piece.along, piece.round)
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum('ij,ij->i', normal, hull.equations[:, :3]) < 0.0
    return np.where(inward[:, None, None], corners[:, ::-1], corners)


def rim_points(disc: FloatArray, along: FloatArray, round: float) -> FloatArray:  # noqa: A002
    """Return points whose hull is a piece, for a drawing, (k, 3) [m]."""
    side = np.linalg.svd(along[None, :])[2][1:]
    angle = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    rim = np.cos(angle)[:, None] * side[0] + np.sin(angle)[:, None] * side[1]
    points = (disc[:, None, :3] + disc[:, None, 3:] * rim).reshape(-1, 3)
    if round:
        ball = np.vstack([rim, along, -along])
        tilted = [np.cos(t) * rim + np.sin(t) * along for t in (-1.0, -0.5, 0.5, 1.0)]
        points = (points[:, None] + round * np.vstack([ball, *tilted])).reshape(-1, 3)
    return np.unique(points, axis=0)
