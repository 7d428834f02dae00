"""Read the triangles of STL and STEP files, and check that they close a solid."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.core import MM, FloatArray, InterpError

#: Bytes of the header of a binary STL file; record of a triangle: normal, corners, unused bytes.
HEADER = 84
TRIANGLE = np.dtype([('normal', '<f4', 3), ('corners', '<f4', (3, 3)), ('rest', '<u2')])
LARGEST_FILE = 1 << 28  #: [bytes]
WELDED = 1e-9 * MM  #: Corners of STEP faces nearer than this are merged [m].


class SceneError(InterpError):
    """A scene cannot be used; the message names the entry and says what to do."""


def triangles_of(file: Path, unit: float, chord: float) -> FloatArray:
    """Return the triangles of a closed mesh, (m, 3, 3) [m]; SceneError says what is wrong.

    ``unit``: length of one unit of an STL file [m]; STEP files contain their unit. ``chord``:
    largest distance of the triangles from curved faces of a STEP file [m].
    """
    if not file.is_file():
        raise SceneError(f'{file}: no such file; the path counts from the scene file')
    if file.stat().st_size > LARGEST_FILE:
        raise SceneError(f'{file}: is larger than {LARGEST_FILE >> 20} MB; reduce the mesh')
    if file.suffix.lower() in ('.stp', '.step'):
        corners = np.round(_step_triangles(file, chord) / WELDED) * WELDED
    elif file.suffix.lower() == '.stl':
        corners = _stl_triangles(file) * unit
    else:
        raise SceneError(f'{file}: not a mesh; give an .stl, .stp or .step file')
    if not len(corners) or not np.isfinite(corners).all():
        raise SceneError(f'{file}: holds no triangles, or some that are not finite')
    return _closed(file, corners)


def stl_of(corners: FloatArray, head: str) -> bytes:
    """Return triangles, (m, 3, 3), as a binary STL file."""
    rows = np.zeros(len(corners), TRIANGLE)
    rows['corners'] = corners
    return head.encode().ljust(80) + len(rows).to_bytes(HEADER - 80, 'little') + rows.tobytes()


def _stl_triangles(file: Path) -> FloatArray:
    content = file.read_bytes()
    count = int.from_bytes(content[80:HEADER], 'little')
    if len(content) == HEADER + count * TRIANGLE.itemsize:
        rows = np.frombuffer(content, TRIANGLE, count, HEADER)
        return np.asarray(rows['corners'], dtype=float)
    try:
        words = content.decode('ascii').split()
        places = [words[k + 1 : k + 4] for k, word in enumerate(words) if word == 'vertex']
        return np.array(places, dtype=float).reshape(-1, 3, 3)
    except ValueError:
        raise SceneError(f'{file}: is neither a binary nor a text STL file') from None


def _step_triangles(file: Path, chord: float) -> FloatArray:
    try:
        from OCP.BRep import BRep_Tool
        from OCP.BRepMesh import BRepMesh_IncrementalMesh
        from OCP.IFSelect import IFSelect_ReturnStatus
        from OCP.STEPControl import STEPControl_Reader
        from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum
        from OCP.TopExp import TopExp_Explorer
        from OCP.TopLoc import TopLoc_Location
        from OCP.TopoDS import TopoDS
    except ImportError:
        why = 'STEP files need OpenCASCADE'
        raise SceneError(f'{file}: {why}; pip install "cnc_interp[step]", or export STL') from None
    reader = STEPControl_Reader()
    if reader.ReadFile(str(file)) != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise SceneError(f'{file}: cannot be read as STEP')
    reader.TransferRoots()
    shape = reader.OneShape()
    BRepMesh_IncrementalMesh(shape, chord / MM, False, 0.3)
    found: list[Any] = []
    faces = TopExp_Explorer(shape, TopAbs_ShapeEnum.TopAbs_FACE)
    while faces.More():
        face, place = TopoDS.Face(faces.Current()), TopLoc_Location()
        mesh = BRep_Tool.Triangulation_s(face, place)
        turn = place.Transformation()
        flip = face.Orientation() == TopAbs_Orientation.TopAbs_REVERSED
        for k in range(1, mesh.NbTriangles() + 1):
            nodes = mesh.Triangle(k).Get()
            nodes = nodes[::-1] if flip else nodes
            points = [mesh.Node(node).Transformed(turn) for node in nodes]
            found.append([(p.X(), p.Y(), p.Z()) for p in points])
        faces.Next()
    return np.array(found, dtype=float).reshape(-1, 3, 3) * MM


def _closed(file: Path, corners: FloatArray) -> FloatArray:
    """Return all but degenerate triangles; raise SceneError unless they enclose a solid."""
    _, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    face = number.reshape(-1, 3)
    flat = (face == np.roll(face, 1, axis=1)).any(axis=1)
    corners, face = corners[~flat], face[~flat]
    edges = np.stack([face, np.roll(face, -1, axis=1)], axis=-1).reshape(-1, 2)
    there, many = np.unique(edges, axis=0, return_counts=True)
    back = np.unique(edges[:, ::-1], axis=0)
    if (many > 1).any() or len(there) != len(back) or (there != back).any():
        lonely = len({*map(tuple, there)} ^ {*map(tuple, back)}) // 2
        shared = int((many > 1).sum())
        raise SceneError(
            f'{file}: the mesh is not watertight ({lonely} open edges, {shared} with more than '
            'two faces); repair it, or describe the body by simple shapes'
        )
    volume = np.einsum('ij,ij->', corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    return corners if volume > 0.0 else corners[:, ::-1].copy()
