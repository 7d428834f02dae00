"""
Faces of STEP files (ISO 10303-21) as surfaces, read by OpenCASCADE (docs/how_it_works/cam.md).

Planes, cylinders, spheres and tori become our own shapes. B-splines keep their knots, weights and
control points. Cones, extrusions, surfaces of revolution and Bezier patches are converted exactly
to rational B-splines. The package ``cadquery-ocp-novtk`` (module ``OCP``) is optional.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.cam.shapes import Cylinder, Placed, Plane, RationalSurface, Torus
from cnc_interp.cam.surface import BSplineSurface, Domain, Surface, SurfaceError
from cnc_interp.cam.vectors import norm
from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.units import MM

#: What to do where the optional package is missing.
INSTALL = 'reading STEP needs OpenCASCADE: pip install cadquery-ocp-novtk'
#: OpenCASCADE's classes of surfaces and their names in lists and messages.
SPLINE, BEZIER = 'Geom_BSplineSurface', 'Geom_BezierSurface'
ANALYTIC = {
    'Geom_Plane': 'plane',
    'Geom_CylindricalSurface': 'cylinder',
    'Geom_SphericalSurface': 'sphere',
    'Geom_ToroidalSurface': 'torus',
}
CONVERTED = {
    BEZIER: 'Bezier patch',
    'Geom_ConicalSurface': 'cone',
    'Geom_SurfaceOfLinearExtrusion': 'extrusion',
    'Geom_SurfaceOfRevolution': 'surface of revolution',
}
NAMES = {SPLINE: 'B-spline', **ANALYTIC, **CONVERTED, 'Geom_OffsetSurface': 'offset surface'}
#: A boundary within this distance of the rectangle of parameters is the rectangle [m].
ON_BORDER = 10e-6
#: Points along an edge that are compared with the rectangle.
EDGE_POINTS = 65
#: Extents of shapes, replaced by those of the face.
ANY = 1.0


def read_step_face(
    path: Path, face: int | None, note: Callable[[str], None] | None = None
) -> Surface:
    """
    Read the surface of one face.

    Parameters
    ----------
    path : Path
        The STEP file. Its unit of length is converted to metres.
    face : int or None
        Number of the face in the order of the shells, from 1. None is enough for a single face.
    note : callable, optional
        Gets a sentence if the surface extends beyond the boundary of the face, or if parts of the
        file could not be read.

    Returns
    -------
    Surface
        The surface in part coordinates [m]. Its normal is the normal of the face.

    Raises
    ------
    SurfaceError
        If OpenCASCADE is missing, the file or the face cannot be read, or no face is chosen among
        several. In the last case the message lists them.

    """
    faces = _faces(path, note)
    if face is None and len(faces) > 1:
        lines = [f'{k:6}  {one.description()}' for k, one in enumerate(faces, 1)]
        heading = f'{path}: choose one of {len(faces)} faces with --face N:'
        raise SurfaceError('\n'.join([heading, *lines]))
    number = 1 if face is None else face
    if not 1 <= number <= len(faces):
        raise SurfaceError(
            f'{path}: there is no face {number}; the faces are numbered from 1 to {len(faces)}'
        )
    try:
        surface, whole = faces[number - 1].surface()
    except SurfaceError as error:
        raise SurfaceError(f'{path}: face {number}: {error}') from error
    if note and not whole:
        note(
            f'{path}: face {number} is trimmed; its boundary is not followed, the surface is '
            f'{_extent(surface)}'
        )
    return surface


def _faces(path: Path, note: Callable[[str], None] | None) -> list[_Face]:
    """Read all faces of a file, each once, without the placements of an assembly."""
    try:
        path.open('rb').close()
    except OSError as error:
        raise SurfaceError(f'{path}: cannot be opened: {error.strerror}') from error
    try:
        from OCP.collections import Sequence_TCollection_AsciiString as Names
        from OCP.IFSelect import IFSelect_ReturnStatus
        from OCP.Message import Message
        from OCP.STEPControl import STEPControl_Reader
        from OCP.TopAbs import TopAbs_ShapeEnum
        from OCP.TopExp import TopExp_Explorer
        from OCP.TopLoc import TopLoc_Location
    except ImportError as error:
        raise SurfaceError(f'{path}: {INSTALL}') from error
    messenger = Message.DefaultMessenger_s()
    for printer in list(messenger.Printers()):  # they write to standard output
        messenger.RemovePrinter(printer)
    reader = STEPControl_Reader()
    if reader.ReadFile(str(path)) != IFSelect_ReturnStatus.IFSelect_RetDone:
        raise SurfaceError(f'{path}: is not a complete STEP file')
    if faults := _faults(reader, reader.WS().ModelCheckList(True)):
        raise SurfaceError(f'{path}: {faults[0]}')
    lengths = Names()
    reader.FileUnits(lengths, Names(), Names())
    if reader.TransferRoots() == 0:
        raise SurfaceError(f'{path}: holds no shape of a product')
    if not all(name.ToCString() for name in lengths):
        raise SurfaceError(f'{path}: has no unit of length (LENGTH_UNIT)')
    faults = _faults(reader, reader.WS().TransferReader().LastCheckList())
    found: dict[Any, Any] = {}
    explorer = TopExp_Explorer(reader.OneShape(), TopAbs_ShapeEnum.TopAbs_FACE)
    while explorer.More():
        shape = explorer.Current().Located(TopLoc_Location())
        found.setdefault(shape.TShape(), shape)
        explorer.Next()
    if not found:
        raise SurfaceError(f'{path}: {(faults or ["holds no face"])[0]}')
    if note and faults:
        note(f'{path}: {len(faults)} entities were left out; {faults[0]}')
    return [_Face(shape) for shape in found.values()]


def _faults(reader: Any, checks: Any) -> list[str]:
    """List what OpenCASCADE could not read of the geometry and topology of a file."""
    found, model = [], reader.StepModel()
    checks.Start()
    while checks.More():
        number, check = checks.Number(), checks.Value()
        kind = type(model.Value(number)).__name__ if number else ''
        if check.NbFails() and kind.startswith(('StepGeom_', 'StepShape_')):
            entity = f'entity {number} in the order of the file, {kind.split("_")[1]}'
            found.append(f'{entity}: {check.CFail(1).strip()}')
        checks.Next()
    return found


class _Face:
    """
    One face of a file.

    Parameters
    ----------
    shape : TopoDS_Face
        The face; lengths are in mm.

    """

    def __init__(self, shape: Any):
        from OCP.BRep import BRep_Tool
        from OCP.BRepTools import BRepTools
        from OCP.Geom import Geom_RectangularTrimmedSurface
        from OCP.TopAbs import TopAbs_Orientation, TopAbs_ShapeEnum
        from OCP.TopoDS import TopoDS

        self.shape = TopoDS.Face(shape)
        self.flip = self.shape.Orientation() == TopAbs_Orientation.TopAbs_REVERSED
        self.geometry = BRep_Tool.Surface_s(self.shape)
        while isinstance(self.geometry, Geom_RectangularTrimmedSurface):
            self.geometry = self.geometry.BasisSurface()
        self.kind = type(self.geometry).__name__
        self.loops = len(_parts(self.shape, TopAbs_ShapeEnum.TopAbs_WIRE))
        #: Smallest and largest u, smallest and largest v of the boundary [mm, rad].
        self.bounds: tuple[float, float, float, float] = BRepTools.UVBounds_s(self.shape)

    def description(self) -> str:
        """Return the name of the kind and the size, or why the face cannot be used."""
        name = NAMES.get(self.kind, self.kind)
        try:
            return f'{name}, {_extent(self.surface()[0])}'
        except SurfaceError as error:
            return f'{name}, cannot be used: {error}'

    def surface(self) -> tuple[Surface, bool]:
        """
        Make the surface.

        Returns
        -------
        surface : Surface
            A whole B-spline patch, or the rectangle of parameters around the boundary.
        whole : bool
            True if the border of the surface is the boundary of the face.

        Raises
        ------
        SurfaceError
            If the kind of surface is not supported, or the boundary does not limit it.

        """
        surface: Surface
        if self.kind == SPLINE:
            surface = _patch(self.geometry, self.flip)
        elif self.kind in ANALYTIC:
            surface = self._analytic()
        elif self.kind in CONVERTED:
            surface = self._converted()
        else:
            *first, last = [NAMES[kind] for kind in (SPLINE, *ANALYTIC, *CONVERTED)]
            raise SurfaceError(
                f'a surface of the kind {NAMES.get(self.kind, self.kind)} is not supported; '
                f'use one of {", ".join(first)} or {last}'
            )
        return surface, self.loops <= 1 and self._distance_inside(surface) < ON_BORDER

    def _analytic(self) -> Surface:
        """Make a plane, cylinder, sphere or torus over the rectangle of the boundary."""
        u, v = self._limits()
        position = self.geometry.Position()
        x, y, z = (
            _vector(direction)
            for direction in (position.XDirection(), position.YDirection(), position.Direction())
        )
        shape: Surface
        axes, top = np.stack([y, z, x]), 0.0
        if self.kind == 'Geom_Plane':
            shape, axes = Plane((ANY, ANY)), np.stack([x, y, z])
            u = u[0] * MM, u[1] * MM
        elif self.kind == 'Geom_CylindricalSurface':
            top = self.geometry.Radius() * MM
            shape = Cylinder(top, ANY, ANY)
        elif self.kind == 'Geom_SphericalSurface':
            top = self.geometry.Radius() * MM
            shape = Torus(0.0, top, ANY, ANY)
        else:
            ring, radius = self.geometry.MajorRadius() * MM, self.geometry.MinorRadius() * MM
            shape, top = Torus(ring, radius, ANY, ANY), ring + radius
        if self.kind in ('Geom_Plane', 'Geom_CylindricalSurface'):
            v = v[0] * MM, v[1] * MM
        # Our round shapes turn about y, and their highest point u = v = 0 is the origin.
        origin = _vector(position.Location()) * MM + top * x
        return Placed(shape, axes.T, origin, (u, v), self.flip)

    def _converted(self) -> Surface:
        """Convert the rectangle of the boundary exactly to a rational B-spline surface."""
        from OCP.Geom import Geom_RectangularTrimmedSurface
        from OCP.GeomConvert import GeomConvert

        u, v = self._limits()
        trimmed = self.geometry
        if self.kind != BEZIER:
            trimmed = Geom_RectangularTrimmedSurface(self.geometry, *u, *v)
        return _patch(GeomConvert.SurfaceToBSplineSurface_s(trimmed), self.flip)

    def _limits(self) -> Domain:
        """Return the ranges of u and v of the boundary [mm, rad]."""
        u0, u1, v0, v1 = self.bounds
        # Either kind of parameter: 1e-7 mm or 1e-7 rad.
        if u1 - u0 < 1e-7 or v1 - v0 < 1e-7:
            raise SurfaceError('the boundary spans no rectangle of parameters')
        round_u, round_v = self.geometry.IsUPeriodic(), self.geometry.IsVPeriodic()
        if (round_u and u1 - u0 > self.geometry.UPeriod() - 1e-6) or (
            round_v and v1 - v0 > self.geometry.VPeriod() - 1e-6
        ):
            raise SurfaceError('the face goes all the way round; split it in the CAD system')
        return (u0, u1), (v0, v1)

    def _distance_inside(self, surface: Surface) -> float:
        """Return how far the boundary lies inside the border of the surface at most [m]."""
        from OCP.BRepAdaptor import BRepAdaptor_Curve2d
        from OCP.TopAbs import TopAbs_ShapeEnum
        from OCP.TopoDS import TopoDS

        if self.kind == SPLINE:
            low, high = (np.array(ends) for ends in zip(*surface.domain, strict=True))
        else:
            low, high = np.array(self.bounds).reshape(2, 2).T
        scale = np.array([
            b - a for a, b in surface.domain
        ]) / (np.array(surface.growth(1.0)) * (high - low))  # fmt: skip
        farthest = 0.0
        for edge in _parts(self.shape, TopAbs_ShapeEnum.TopAbs_EDGE):
            curve = BRepAdaptor_Curve2d(TopoDS.Edge(edge), self.shape)
            places = np.linspace(curve.FirstParameter(), curve.LastParameter(), EDGE_POINTS)
            uv = np.array([(p.X(), p.Y()) for p in (curve.Value(t) for t in places.tolist())])
            inside = np.min(np.minimum(uv - low, high - uv) * scale, axis=1)
            farthest = max(farthest, float(inside.max()))
        return farthest


def _parts(shape: Any, kind: Any) -> list[Any]:
    """List the parts of a kind of a TopoDS shape."""
    from OCP.TopExp import TopExp_Explorer

    found, explorer = [], TopExp_Explorer(shape, kind)
    while explorer.More():
        found.append(explorer.Current())
        explorer.Next()
    return found


def _vector(one: Any) -> FloatArray:
    """Return a point or a direction of OpenCASCADE as an array, shape (3,) [mm or 1]."""
    return np.array([one.X(), one.Y(), one.Z()])


def _patch(geometry: Any, flip: bool) -> Surface:
    """Make our surface of a Geom_BSplineSurface; a direction of degree 1 is raised to 2."""
    spline = geometry.Copy()
    if spline.IsUPeriodic():
        spline.SetUNotPeriodic()
    if spline.IsVPeriodic():
        spline.SetVNotPeriodic()
    rows, columns = range(1, spline.NbUPoles() + 1), range(1, spline.NbVPoles() + 1)
    points = np.array([[_vector(spline.Pole(i, j)) for j in columns] for i in rows]) * MM
    weights = np.array([[spline.Weight(i, j) for j in columns] for i in rows])
    net = np.concatenate([points * weights[..., None], weights[..., None]], axis=2)
    knots = [
        np.repeat(
            [spline.UKnot(k) for k in range(1, spline.NbUKnots() + 1)],
            [spline.UMultiplicity(k) for k in range(1, spline.NbUKnots() + 1)],
        ),
        np.repeat(
            [spline.VKnot(k) for k in range(1, spline.NbVKnots() + 1)],
            [spline.VMultiplicity(k) for k in range(1, spline.NbVKnots() + 1)],
        ),
    ]
    degree = [spline.UDegree(), spline.VDegree()]
    for axis in (0, 1):
        if degree[axis] == 1 and net.shape[axis] == 2:  # a straight line is a parabola too
            net = np.insert(net, 1, net.mean(axis=axis), axis=axis)
            degree[axis], knots[axis] = 2, np.repeat(knots[axis][1:3], 3)
    points, weights = net[..., :3] / net[..., 3:], net[..., 3]
    both, degrees = (knots[0], knots[1]), (degree[0], degree[1])
    if np.ptp(weights) == 0.0:
        return BSplineSurface(both, points, degrees, flip)
    return RationalSurface(both, points, weights, degrees, flip)


def _extent(surface: Surface) -> str:
    """Return the lengths of the middle lines in words."""
    s = surface.at(*surface.grid(101, 101)).position
    along = norm(np.diff(s[:, 50], axis=0)).sum(), norm(np.diff(s[50], axis=0)).sum()
    return f'{along[0] / MM:.4g} x {along[1] / MM:.4g} mm'
