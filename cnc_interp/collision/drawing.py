"""Triangles of the bodies of a scene, for the page, RViz, URDF and STL files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull

from cnc_interp.collision.mesh_file import stl_of
from cnc_interp.collision.scene import Placed, Role, Scene
from cnc_interp.collision.shapes import Piece
from cnc_interp.core import FloatArray
from cnc_interp.machine_model.machine import Machine

AROUND = 24  #: Points on the rim of a disc.


@dataclass(frozen=True, eq=False)
class DrawnBody:
    name: str  #: Its name in the scene; reports of hits use it too.
    link: str  #: Link of the machine that carries it.
    role: Role
    tool: int  #: Number of the tool that it belongs to; 0 if it is always present.
    triangles: FloatArray  #: (m, 3, 3): Outward triangles of the surface in the link's frame [m].

    def stl(self) -> bytes:
        """Return the surface as a binary STL file, in metres."""
        return stl_of(self.triangles, 'cnc_interp, metres')


def drawn_bodies(scene: Scene, machine: Machine) -> Iterator[DrawnBody]:
    """Yield the bodies of a scene; SceneError if the machine has no link for a body."""
    for body in Placed.of(scene, machine).scene.bodies:
        triangles = body.triangles
        if triangles is None:
            triangles = np.concatenate([surface(piece) for piece in body.pieces])
        yield DrawnBody(body.name, body.link, body.role, body.tool, triangles)


def surface(piece: Piece, around: int = AROUND) -> FloatArray:
    """Return triangles of a convex piece, (m, 3, 3) [m]; rims of discs become polygons."""
    points = rim_points(piece.discs, piece.along, piece.round, around)
    hull = ConvexHull(points)
    corners = points[hull.simplices]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum('ij,ij->i', normal, hull.equations[:, :3]) < 0.0
    return np.where(inward[:, None, None], corners[:, ::-1], corners)


def rim_points(
    disc: FloatArray,
    along: FloatArray,
    round: float,  # noqa: A002
    around: int = AROUND,
) -> FloatArray:
    """Return points whose convex hull approximates a piece, for a drawing, (k, 3) [m]."""
    side = np.linalg.svd(along[None, :])[2][1:]
    angle = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)
    rim = np.cos(angle)[:, None] * side[0] + np.sin(angle)[:, None] * side[1]
    points = (disc[:, None, :3] + disc[:, None, 3:] * rim).reshape(-1, 3)
    if round:
        tilts = np.linspace(-0.5 * np.pi, 0.5 * np.pi, around // 4 + 1)
        ball = np.vstack([np.cos(tilt) * rim + np.sin(tilt) * along for tilt in tilts])
        points = (points[:, None] + round * ball).reshape(-1, 3)
    return np.unique(points, axis=0)
