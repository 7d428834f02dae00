"""
Faces of STEP files as surfaces (ISO 10303-42; docs/how_it_works/cam.md, "STEP files").

Parameters are those of the standard: lengths along planes, angles about the axis of the placement
[rad], knots of B-splines. The face says on which side of its surface the material lies.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from cnc_interp.cam.part21 import Enumeration, Record, Reference, StepFile
from cnc_interp.cam.shapes import Cylinder, Placed, Plane, RationalSurface, Torus
from cnc_interp.cam.step_boundary import Geometry, knot_vector
from cnc_interp.cam.surface import BSplineSurface, Surface, SurfaceError
from cnc_interp.cam.vectors import norm
from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.units import MM

FACES = 'ADVANCED_FACE', 'FACE_SURFACE'
ANALYTIC = 'PLANE', 'CYLINDRICAL_SURFACE', 'SPHERICAL_SURFACE', 'TOROIDAL_SURFACE'
SPLINE, RATIONAL = 'B_SPLINE_SURFACE_WITH_KNOTS', 'RATIONAL_B_SPLINE_SURFACE'
PREFIXES = {None: 1.0, 'MILLI': 1e-3, 'CENTI': 1e-2, 'DECI': 1e-1, 'MICRO': 1e-6, 'KILO': 1e3}
#: A boundary within this distance of the rectangle is the rectangle [m].
ON_BORDER = 10e-6
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
        The STEP file.
    face : int or None
        Its number in the order of the file, from 1; not needed where there is only one.
    note : callable
        Is told when the surface goes beyond the face.

    Raises
    ------
    SurfaceError
        If the file or the face cannot be read, or several faces are there and none is chosen: then
        they are listed.

    """
    file = StepFile(path)
    numbers = [number for keyword in FACES for number in file.having(keyword)]
    if not numbers:
        raise file.fault(f'holds no face ({" or ".join(FACES)})')
    length = _unit_of(file)
    faces = [_Face(Geometry(file, length), number) for number in numbers]
    if face is None and len(faces) > 1:
        lines = [f'{k:6}  {one.described()}' for k, one in enumerate(faces, 1)]
        raise file.fault('\n'.join([f'choose one of {len(faces)} faces with --face N:', *lines]))
    face = 1 if face is None else face
    if not 1 <= face <= len(faces):
        raise file.fault(f'there is no face {face}; they are numbered from 1 to {len(faces)}')
    surface, whole = faces[face - 1].surface()
    if note and not whole:
        note(
            f'{path}: face {face} is trimmed; its boundary is not followed, the surface is '
            f'{_extent(surface)}'
        )
    return surface


def _unit_of(file: StepFile) -> float:
    """Return the unit of length of the file [m]."""
    found = set()
    for number in file.having('GLOBAL_UNIT_ASSIGNED_CONTEXT'):
        context = file.records(number)['GLOBAL_UNIT_ASSIGNED_CONTEXT']
        for one in context.items(0, Reference):
            if 'LENGTH_UNIT' in file.records(one, context):
                found.add(_length(file, one, context))
    if len(found) != 1:
        units = ', '.join(f'{one / MM:.6g} mm' for one in sorted(found)) or 'none'
        raise file.fault(f'must have one unit of length (LENGTH_UNIT), and has {units}')
    return found.pop()


def _length(file: StepFile, number: int, wanted_by: Record) -> float:
    """Return a unit of length, metric or converted from a metric one [m]."""
    records = file.records(number, wanted_by)
    factor = 1.0
    if 'CONVERSION_BASED_UNIT' in records:
        conversion = records['CONVERSION_BASED_UNIT']
        number = conversion.get(1, Reference)
        for measure in file.records(number, conversion).values():
            if 'MEASURE_WITH_UNIT' in measure.keyword and measure.values:
                factor = measure.get(0, float)
                records = file.records(measure.get(1, Reference), measure)
    if 'SI_UNIT' in records:
        prefix, name = (*records['SI_UNIT'].values, None, None)[:2]
        if name == 'METRE' and prefix in PREFIXES and factor > 0.0:
            return factor * PREFIXES[prefix]
    raise wanted_by.fault(f'the unit of length #{number} is neither metric nor converted from it')


def _extent(surface: Surface) -> str:
    """Return the lengths of the middle lines in words."""
    s = surface.at(*surface.grid(101, 101)).position
    along = norm(np.diff(s[:, 50], axis=0)).sum(), norm(np.diff(s[50], axis=0)).sum()
    return f'{along[0] / MM:.4g} x {along[1] / MM:.4g} mm'


class _Face:
    """One face of a file."""

    def __init__(self, geometry: Geometry, number: int):
        records = geometry.file.records(number)
        self.geometry = geometry
        self.record = next(records[keyword] for keyword in FACES if keyword in records)
        self.basis = geometry.file.records(self.record.get(2, Reference), self.record)
        self.flip = self.record.get(3, Enumeration) == 'F'
        known = [k for k in (RATIONAL, SPLINE, *ANALYTIC) if k in self.basis]
        self.kind = known[0] if known else ' '.join(self.basis)

    def described(self) -> str:
        """Return kind and size."""
        try:
            return f'{self.kind}, {_extent(self.surface()[0])}'
        except SurfaceError as error:
            reason = str(error).removeprefix(f'{self.geometry.file.path}:')
            return f'{self.kind}, cannot be taken: line {reason}'

    def surface(self) -> tuple[Surface, bool]:
        """Return the surface, and whether its border is the boundary of the face."""
        try:
            if SPLINE in self.basis:
                return self._spline()
            if self.kind in ANALYTIC:
                return self._analytic(self.basis[self.kind])
        except SurfaceError as error:
            if str(error).startswith(f'{self.geometry.file.path}:'):
                raise
            raise self.record.fault(str(error)) from error
        raise self.record.fault(
            f'a surface of the kind {self.kind} is not read; B-splines with knots, planes, '
            'cylinders, spheres and tori are'
        )

    def _spline(self) -> tuple[Surface, bool]:
        """Make the whole patch; a complex instance spreads its parameters over two records."""
        tail, shape, first, then = self.basis[SPLINE], self.basis[SPLINE], 1, 8
        if 'B_SPLINE_SURFACE' in self.basis:
            shape, first, then = self.basis['B_SPLINE_SURFACE'], 0, 0
        rows = shape.rows(first + 2, Reference)
        points = np.array([[self.geometry.point(n, shape) for n in row] for row in rows])
        weights = np.ones(points.shape[:2])
        if RATIONAL in self.basis:
            weights = np.array(self.basis[RATIONAL].rows(0, float))
            if weights.shape != points.shape[:2] or not weights.min() > 0.0:
                raise self.basis[RATIONAL].fault('each control point must have a positive weight')
        net = np.concatenate([points * weights[..., None], weights[..., None]], axis=2)
        knots, degree = [], []
        for axis in (0, 1):
            t, k = knot_vector(
                tail, then + axis, shape.get(first + axis, float), net.shape[axis],
                f' in {"uv"[axis]}', 2,
            )  # fmt: skip
            if k == 1 and net.shape[axis] == 2:  # a straight line is a parabola too
                net = np.insert(net, 1, net.mean(axis=axis), axis=axis)
                k, t = 2, np.repeat(t[1:3], 3)
            knots.append(t)
            degree.append(k)
        both, degrees = (knots[0], knots[1]), (degree[0], degree[1])
        points, weights = net[..., :3] / net[..., 3:], net[..., 3]
        surface: Surface
        if np.ptp(weights) == 0.0:
            surface = BSplineSurface(both, points, degrees, self.flip)
        else:
            surface = RationalSurface(both, points, weights, degrees, self.flip)
        corners = surface.at(*surface.grid(2, 2)).position.reshape(-1, 3)
        loops = self.geometry.loops(self.record)
        ends = [self.geometry.ends(e) for loop in loops for e, _ in self.geometry.edges(loop)]
        away = [float(norm(corners - end).min()) for pair in ends for end in pair]
        return surface, len(loops) <= 1 and max(away, default=0.0) < ON_BORDER

    def _analytic(self, record: Record) -> tuple[Surface, bool]:
        """Make the rectangle of parameters that the outer boundary spans."""
        frame = self.geometry.frame(record.get(1, Reference), record)
        loops = [
            frame.local(self.geometry.followed(loop, frame.axes))
            for loop in self.geometry.loops(self.record)
        ]
        if not loops:
            raise SurfaceError('the face has no boundary, so its surface has no end')
        radii = [record.get(k, float) * self.geometry.length for k in range(2, len(record.values))]
        ring = radii[0] if self.kind == 'TOROIDAL_SURFACE' else 0.0
        shape: Surface
        x, y, z = frame.axes
        if self.kind == 'PLANE':
            shape, top, scale = Plane((ANY, ANY)), 0.0, np.ones(2)
        elif self.kind == 'CYLINDRICAL_SURFACE':
            shape, top, scale = Cylinder(radii[0], ANY, ANY), radii[0], np.array([radii[0], 1.0])
        else:
            shape, top = Torus(ring, radii[-1], ANY, ANY), ring + radii[-1]
            scale = np.array([top, radii[-1]])
        spans = [_parameters(self.kind, loop, ring) for loop in loops]
        span = max(spans, key=lambda s: float(np.prod(np.ptp(s, axis=0) * scale)))
        low, high = span.min(axis=0), span.max(axis=0)
        if np.any((high - low) * scale < ON_BORDER):
            raise SurfaceError('the boundary spans no rectangle of parameters')
        if self.kind != 'PLANE' and high[0] - low[0] > 2.0 * np.pi - 1e-6:
            raise SurfaceError('the face goes all the way round; split it in the CAD system')
        # Our round shapes turn about y, and their highest point u = v = 0 is the origin.
        axes = frame.axes if self.kind == 'PLANE' else np.stack([y, z, x])
        domain = (float(low[0]), float(high[0])), (float(low[1]), float(high[1]))
        surface = Placed(shape, axes.T, frame.origin + top * x, domain, self.flip)
        inside = np.min(np.minimum(span - low, high - span) * scale, axis=1)
        return surface, len(loops) == 1 and float(inside.max()) < ON_BORDER


def _parameters(kind: str, points: FloatArray, ring: float) -> FloatArray:
    """Return u and v of points along a boundary, without jumps of a turn, shape (n, 2)."""
    x, y, z = points.T
    if kind == 'PLANE':
        return points[:, :2]
    u = np.unwrap(np.arctan2(y, x))
    v = z if kind == 'CYLINDRICAL_SURFACE' else np.unwrap(np.arctan2(z, np.hypot(x, y) - ring))
    return np.stack([u, v], axis=1)
