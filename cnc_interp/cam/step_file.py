"""Faces of STEP files as surfaces, read by OpenCASCADE (docs/how_it_works/cam.md)."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.cam import shapes
from cnc_interp.cam.gouge import Neighbours
from cnc_interp.cam.surface import Domain, Placed, Surface, SurfaceError, demand
from cnc_interp.core import MM, FloatArray, norm, refuse_if

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
#: A boundary this near to the rectangle of parameters counts as the rectangle [m].
ON_BORDER = 10e-6
EDGE_POINTS = 65  #: Points along an edge that are compared with the rectangle.
#: Largest distance of a polyline from its edge [m], and the least and largest number of pairs of
#: its pieces.
CHORD, EDGE_PIECES, MOST_PIECES = 2e-6, 8, 2048
ANY = 1.0  #: Preliminary size of a shape, until that of the face is known.


@dataclass(frozen=True)
class Part:
    #: Surfaces by the number of their face, in the order in which they are machined.
    surfaces: dict[int, Surface]
    #: Points on all faces of the part, including the machined faces; None for a single face.
    neighbours: Neighbours | None = None


class StepFace:
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
        name = NAMES.get(self.kind, self.kind)
        try:
            return f'{name}, {extent(self.surface())}'
        except SurfaceError as error:
            return f'{name}, cannot be used: {error}'

    def surface(self) -> Surface:
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
        if self.loops <= 1 and self._distance_inside(surface) < ON_BORDER:
            return surface
        own = [self._own_parameters(surface, edge) for edge in self.edges()]
        return shapes.Trimmed(surface, own)

    def _curves(self) -> Iterator[Callable[[int], FloatArray]]:
        from OCP.BRepAdaptor import BRepAdaptor_Curve2d
        from OCP.TopAbs import TopAbs_ShapeEnum
        from OCP.TopoDS import TopoDS

        def uv_at(curve: Any, count: int) -> FloatArray:
            places = np.linspace(curve.FirstParameter(), curve.LastParameter(), count).tolist()
            return np.array([(p.X(), p.Y()) for p in map(curve.Value, places)])

        for edge in _parts(self.shape, TopAbs_ShapeEnum.TopAbs_EDGE):
            yield partial(uv_at, BRepAdaptor_Curve2d(TopoDS.Edge(edge), self.shape))

    def edges(self) -> list[FloatArray]:
        found = []
        for uv_at in self._curves():
            count = EDGE_PIECES
            while True:
                uv = uv_at(2 * count + 1)
                chord = 0.5 * (uv[:-2:2] + uv[2::2])
                away = norm(self.points(uv[1::2]) - self.points(chord))
                if float(away.max()) < CHORD or count >= MOST_PIECES:
                    break
                count *= 2
            found.append(uv)
        return found

    def points(self, uv: FloatArray) -> FloatArray:
        return np.array([_vector(self.geometry.Value(u, v)) for u, v in uv.tolist()]) * MM

    def samples(self, spacing: float, most: int) -> FloatArray:
        edges = shapes.joined(self.edges())
        corners = np.concatenate(edges)
        low, high = corners.min(axis=0), corners.max(axis=0)
        u, v = np.meshgrid(*np.linspace(low, high, 9).T, indexing='ij')
        rough = self.points(np.stack([u.ravel(), v.ravel()], axis=1)).reshape(9, 9, 3)
        sizes = [float(norm(np.diff(rough, axis=k)).sum(axis=k).max()) for k in (0, 1)]
        spacing = max(spacing, float(np.sqrt(sizes[0] * sizes[1] / most)))
        count = [max(2, int(np.ceil(size / spacing)) + 1) for size in sizes]
        u, v = (x.ravel() for x in np.meshgrid(*map(np.linspace, low, high, count)))
        pieces = np.concatenate([np.hstack([e[:-1], e[1:]]) for e in edges])
        inside = shapes.within(pieces, u, v)
        lines = []
        for edge in edges:
            way = np.concatenate([[0.0], np.cumsum(norm(np.diff(self.points(edge), axis=0)))])
            at = np.linspace(0.0, way[-1], max(2, int(np.ceil(way[-1] / spacing)) + 1))
            lines.append(np.stack([np.interp(at, way, x) for x in edge.T], axis=1))
        return self.points(np.concatenate([np.stack([u, v], axis=1)[inside], *lines]))

    def _own_parameters(self, surface: Surface, uv: FloatArray) -> FloatArray:
        low, high = np.transpose(surface.domain)
        if self.kind == SPLINE:
            # A patch that closes on itself may have edges in its next turn.
            demand(
                (np.abs(uv - 0.5 * (low + high)) <= (0.5 + 1e-6) * (high - low)).all(),
                'the face crosses the seam; split it in the CAD system',
            )
            return uv
        (u0, u1), (v0, v1) = np.reshape(self.bounds, (2, 2)).tolist()
        share = (uv - [u0, v0]) / [u1 - u0, v1 - v0]
        guess = low + share * (high - low)
        if self.kind in ANALYTIC:
            return np.asarray(guess)
        u, v, away = surface.project(self.points(uv), guess[:, 0], guess[:, 1])
        demand(
            np.all(np.abs(away) < ON_BORDER),
            'the boundary is not on the surface; repair the face in the CAD system',
        )
        return np.stack([u, v], axis=1)

    def _analytic(self) -> Surface:
        u, v = self._limits()
        position = self.geometry.Position()
        x, y, z = (
            _vector(direction)
            for direction in (position.XDirection(), position.YDirection(), position.Direction())
        )
        shape: Surface
        axes = np.stack([y, z, x])
        if self.kind == 'Geom_Plane':
            shape, axes, top = shapes.Plane((ANY, ANY)), np.stack([x, y, z]), 0.0
            u = u[0] * MM, u[1] * MM
        elif self.kind == 'Geom_ToroidalSurface':
            ring, radius = self.geometry.MajorRadius() * MM, self.geometry.MinorRadius() * MM
            shape, top = shapes.Torus(ring, radius, ANY, ANY), ring + radius
        else:
            top = self.geometry.Radius() * MM
            ball = self.kind == 'Geom_SphericalSurface'
            shape = shapes.Torus(0.0, top, ANY, ANY) if ball else shapes.Cylinder(top, ANY, ANY)
        if self.kind in ('Geom_Plane', 'Geom_CylindricalSurface'):
            v = v[0] * MM, v[1] * MM
        # Our round shapes have the axis y, and their highest point u = v = 0 is the origin.
        origin = _vector(position.Location()) * MM + top * x
        return Placed(shape, axes.T, origin, (u, v), self.flip)

    def _converted(self) -> Surface:
        from OCP.Geom import Geom_RectangularTrimmedSurface
        from OCP.GeomConvert import GeomConvert

        u, v = self._limits()
        trimmed = self.geometry
        if self.kind != BEZIER:
            trimmed = Geom_RectangularTrimmedSurface(self.geometry, *u, *v)
        return _patch(GeomConvert.SurfaceToBSplineSurface_s(trimmed), self.flip)

    def _limits(self) -> Domain:
        u0, u1, v0, v1 = self.bounds
        # Either kind of parameter: 1e-7 mm or 1e-7 rad.
        demand(
            u1 - u0 >= 1e-7 and v1 - v0 >= 1e-7,
            'the face has no width in u or v; remove it in the CAD system',
        )
        round_u, round_v = self.geometry.IsUPeriodic(), self.geometry.IsVPeriodic()
        refuse_if(
            (round_u and u1 - u0 > self.geometry.UPeriod() - 1e-6)
            or (round_v and v1 - v0 > self.geometry.VPeriod() - 1e-6),
            SurfaceError('the face is closed around its axis; split it in the CAD system'),
        )
        return (u0, u1), (v0, v1)

    def _distance_inside(self, surface: Surface) -> float:
        if self.kind == SPLINE:
            low, high = (np.array(ends) for ends in zip(*surface.domain, strict=True))
        else:
            low, high = np.array(self.bounds).reshape(2, 2).T
        scale = np.array([b - a for a, b in surface.domain]) / (
            np.array(surface.growth(1.0)) * (high - low)
        )
        farthest = 0.0
        for uv_at in self._curves():
            uv = uv_at(EDGE_POINTS)
            inside = np.min(np.minimum(uv - low, high - uv) * scale, axis=1)
            farthest = max(farthest, float(inside.max()))
        return farthest


def _parts(shape: Any, kind: Any) -> list[Any]:
    from OCP.TopExp import TopExp_Explorer

    found, explorer = [], TopExp_Explorer(shape, kind)
    while explorer.More():
        found.append(explorer.Current())
        explorer.Next()
    return found


def _vector(one: Any) -> FloatArray:
    return np.array([one.X(), one.Y(), one.Z()])


def _patch(geometry: Any, flip: bool) -> Surface:
    """Convert a Geom_BSplineSurface to a Surface; degree 1 is raised to 2."""
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
        np.repeat([value(k) for k in numbers], [count(k) for k in numbers])
        for value, count, numbers in (
            (spline.UKnot, spline.UMultiplicity, range(1, spline.NbUKnots() + 1)),
            (spline.VKnot, spline.VMultiplicity, range(1, spline.NbVKnots() + 1)),
        )
    ]
    degree = [spline.UDegree(), spline.VDegree()]
    for axis in (0, 1):
        if degree[axis] == 1 and net.shape[axis] == 2:  # a straight line is a parabola too
            net = np.insert(net, 1, net.mean(axis=axis), axis=axis)
            degree[axis], knots[axis] = 2, np.repeat(knots[axis][1:3], 3)
    points, weights = net[..., :3] / net[..., 3:], net[..., 3]
    both, degrees = (knots[0], knots[1]), (degree[0], degree[1])
    if np.ptp(weights) == 0.0:
        return shapes.BSplineSurface(both, points, degrees, flip)
    return shapes.RationalSurface(both, points, weights, degrees, flip)


def extent(surface: Surface) -> str:
    s = surface.at(*surface.grid(101, 101)).position
    along = norm(np.diff(s[:, 50], axis=0)).sum(), norm(np.diff(s[50], axis=0)).sum()
    return f'{along[0] / MM:.4g} x {along[1] / MM:.4g} mm'


INSTALL = 'reading STEP needs OpenCASCADE: pip install cadquery-ocp-novtk'
SYSTEM_LIBRARY = 'OpenCASCADE cannot be loaded: apt-get install libgl1'


#: Distance of the points that represent the faces of a part [m], and their largest number.
SPACING, MOST_POINTS = 0.25 * MM, 150_000


def read_step_part(path: Path, numbers: Sequence[int], note: Callable[[str], None]) -> Part:
    faces = _faces(path, note)
    if not numbers and len(faces) > 1:
        lines = [f'{k:6}  {one.description()}' for k, one in enumerate(faces, 1)]
        heading = f'{path}: choose one of {len(faces)} faces with --face N:'
        raise SurfaceError('\n'.join([heading, *lines]))
    surfaces = {}
    for number in numbers or [1]:
        demand(
            1 <= number <= len(faces),
            f'{path}: there is no face {number}; the faces are numbered from 1 to {len(faces)}',
        )
        demand(number not in surfaces, f'{path}: face {number} is named twice')
        try:
            surfaces[number] = faces[number - 1].surface()
        except SurfaceError as error:
            raise SurfaceError(f'{path}: face {number}: {error}') from error
    return Part(surfaces, _neighbours(path, faces, note))


def _neighbours(
    path: Path, faces: list[StepFace], note: Callable[[str], None]
) -> Neighbours | None:
    if len(faces) == 1:
        return None
    spacing, found = SPACING, []
    for number, face in enumerate(faces, 1):
        try:
            found.append(face.samples(spacing, MOST_POINTS // len(faces)))
        except Exception as fault:  # bindings of OpenCASCADE raise anything
            found.append(np.zeros((0, 3)))
            note(
                f'{path}: the mill is not tested against face {number}, which has no points: '
                f'{" ".join(str(fault).split())[:100]}'
            )
    counts = [len(points) for points in found]
    owner = np.repeat(np.arange(1, len(faces) + 1), counts)
    return Neighbours(np.ascontiguousarray(np.concatenate(found)), owner)


def _faces(path: Path, note: Callable[[str], None]) -> list[StepFace]:
    try:
        path.open('rb').close()
    except OSError as error:
        raise SurfaceError(f'{path}: cannot be opened: {error.strerror}') from error
    demand(path.is_file(), f'{path}: it is not a file')
    try:
        from OCP.collections import Sequence_TCollection_AsciiString as Names
        from OCP.IFSelect import IFSelect_ReturnStatus
        from OCP.Message import Message
        from OCP.STEPControl import STEPControl_Reader
        from OCP.TopAbs import TopAbs_ShapeEnum
        from OCP.TopLoc import TopLoc_Location
    except ModuleNotFoundError as error:
        raise SurfaceError(f'{path}: {INSTALL}') from error
    except ImportError as error:  # installed, but a system library is missing
        raise SurfaceError(f'{path}: {SYSTEM_LIBRARY} ({error})') from error
    messenger = Message.DefaultMessenger_s()
    for printer in list(messenger.Printers()):  # they write to standard output
        messenger.RemovePrinter(printer)
    reader = STEPControl_Reader()
    demand(
        reader.ReadFile(str(path)) == IFSelect_ReturnStatus.IFSelect_RetDone,
        f'{path}: is not a complete STEP file; export it again',
    )
    if faults := _faults(reader, reader.WS().ModelCheckList(True)):
        raise SurfaceError(f'{path}: {faults[0]}')
    lengths = Names()
    reader.FileUnits(lengths, Names(), Names())
    demand(reader.TransferRoots() != 0, f'{path}: holds no shape of a product; export it again')
    demand(
        all(name.ToCString() for name in lengths),
        f'{path}: has no unit of length (LENGTH_UNIT); export it again',
    )
    faults = _faults(reader, reader.WS().TransferReader().LastCheckList())
    found: dict[Any, Any] = {}
    for face in _parts(reader.OneShape(), TopAbs_ShapeEnum.TopAbs_FACE):
        shape = face.Located(TopLoc_Location())
        found.setdefault(shape.TShape(), shape)
    demand(found, f'{path}: {(faults or ["holds no face"])[0]}')
    if faults:
        note(f'{path}: {len(faults)} entities were left out; {faults[0]}')
    return [StepFace(shape) for shape in found.values()]


def _faults(reader: Any, checks: Any) -> list[str]:
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
