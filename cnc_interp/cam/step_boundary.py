"""Points, placements and boundaries of STEP faces (ISO 10303-42) in metres."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from cnc_interp.cam.part21 import Enumeration, Record, Reference, StepFile
from cnc_interp.cam.vectors import cross, norm, unit
from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.units import DEG

#: Arcs of a boundary are followed in steps of this angle, and through their extremes [rad].
ARC = 1.0 * DEG
#: B-spline edges are followed by this many points a span.
SPAN = 64
CURVES = 'LINE', 'CIRCLE', 'B_SPLINE_CURVE_WITH_KNOTS'
#: The curve itself is the first parameter after the name of these.
WITH_CURVE = 'SURFACE_CURVE', 'SEAM_CURVE', 'INTERSECTION_CURVE', 'TRIMMED_CURVE'


@dataclass(frozen=True)
class Frame:
    """
    A placement.

    Parameters
    ----------
    origin : ndarray, shape (3,)
        Its location [m].
    axes : ndarray, shape (3, 3)
        Directions x, y, z as rows.

    """

    origin: FloatArray
    axes: FloatArray

    def local(self, points: FloatArray) -> FloatArray:
        """Return coordinates in this frame, shape (n, 3)."""
        return np.asarray((points - self.origin) @ self.axes.T)


@dataclass(frozen=True)
class Geometry:
    """
    The geometry of a file.

    Parameters
    ----------
    file : StepFile
        The file.
    length : float
        Its unit of length [m].

    """

    file: StepFile
    length: float

    def record(self, number: int, wanted_by: Record, *keywords: str) -> Record:
        """Read an instance that must have one of these keywords."""
        records = self.file.records(number, wanted_by)
        for keyword in keywords:
            if keyword in records:
                return records[keyword]
        raise wanted_by.fault(
            f'#{number} is a {" ".join(records)} and must be a {" or ".join(keywords)}'
        )

    def point(self, number: int, wanted_by: Record) -> FloatArray:
        """Read a point, shape (3,) [m]."""
        return self._vector(number, wanted_by, 'CARTESIAN_POINT') * self.length

    def frame(self, number: int, wanted_by: Record) -> Frame:
        """Read a placement; directions that are left out are those of the standard."""
        record = self.record(number, wanted_by, 'AXIS2_PLACEMENT_3D')
        origin = self.point(record.get(1, Reference), record)
        given = [
            None if one is None else self._vector(record.get(k, Reference), record, 'DIRECTION')
            for k, one in enumerate(record.values[2:4], 2)
        ]
        z, x = (*given, None, None)[:2]
        z = np.array([0.0, 0.0, 1.0]) if z is None else z
        if x is None:
            x = np.array(
                [1.0, 0.0, 0.0] if norm(cross(z, np.eye(3)[0])) > 0.0 else [0.0, 1.0, 0.0]
            )
        if not norm(cross(z, x)) > 0.0:
            raise record.fault('the directions of the placement must not be parallel or zero')
        z = unit(z)
        y = unit(cross(z, x))
        return Frame(origin, np.stack([cross(y, z), y, z]))

    def loops(self, face: Record) -> list[Record]:
        """Read the closed boundaries of a face."""
        bounds = [
            self.record(number, face, 'FACE_OUTER_BOUND', 'FACE_BOUND')
            for number in face.items(1, Reference)
        ]
        return [self.record(b.get(1, Reference), b, 'EDGE_LOOP') for b in bounds]

    def edges(self, loop: Record) -> Iterator[tuple[Record, bool]]:
        """Read the edges of a boundary, and whether they run along it."""
        for number in loop.items(1, Reference):
            oriented = self.record(number, loop, 'ORIENTED_EDGE')
            edge = self.record(oriented.get(3, Reference), oriented, 'EDGE_CURVE')
            yield edge, oriented.get(4, Enumeration) == 'T'

    def ends(self, edge: Record) -> FloatArray:
        """Read the ends of an edge, shape (2, 3) [m]."""
        vertices = [self.record(edge.get(k, Reference), edge, 'VERTEX_POINT') for k in (1, 2)]
        return np.array([self.point(v.get(1, Reference), v) for v in vertices])

    def followed(self, loop: Record, directions: FloatArray) -> FloatArray:
        """
        Follow a boundary of lines, circles and B-splines.

        Parameters
        ----------
        loop : Record
            The boundary.
        directions : ndarray, shape (m, 3)
            The farthest points of arcs in these directions are among the points.

        Returns
        -------
        ndarray, shape (n, 3)
            Points in order: of lines both ends and the middle [m].

        """
        found = []
        for edge, along in self.edges(loop):
            points = self._points(edge, directions)
            found.append(points if along else points[::-1])
        return np.concatenate(found) if found else np.zeros((0, 3))

    def _points(self, edge: Record, directions: FloatArray) -> FloatArray:
        """Follow one edge from its first vertex."""
        start, end = self.ends(edge)
        curve = self.record(edge.get(3, Reference), edge, *CURVES, *WITH_CURVE)
        forward = edge.get(4, Enumeration) == 'T'
        for _ in WITH_CURVE:
            if curve.keyword in WITH_CURVE:
                if curve.keyword == 'TRIMMED_CURVE':
                    forward ^= curve.get(4, Enumeration) == 'F'
                curve = self.record(curve.get(1, Reference), curve, *CURVES, *WITH_CURVE)
        if curve.keyword == 'B_SPLINE_CURVE_WITH_KNOTS':
            if forward:
                return self._along_spline(curve, start, end)
            return self._along_spline(curve, end, start)[::-1]
        if curve.keyword == 'LINE':
            return np.stack([start, 0.5 * (start + end), end])
        frame = self.frame(curve.get(1, Reference), curve)
        radius = curve.get(2, float) * self.length
        sense = 1.0 if forward else -1.0
        first, last = np.arctan2(*frame.local(np.stack([start, end])).T[1::-1])
        whole = 2.0 * np.pi
        turn = whole if edge.values[1] == edge.values[2] else sense * (last - first) % whole
        extremes = np.arctan2(*(directions @ frame.axes.T).T[1::-1])
        ahead = sense * (np.concatenate([extremes, extremes + np.pi]) - first) % whole
        steps = np.linspace(0.0, turn, 2 + int(turn / ARC))
        at = first + sense * np.sort(np.concatenate([steps, ahead[ahead < turn]]))
        x, y, _ = frame.axes
        arc = frame.origin + radius * (np.outer(np.cos(at), x) + np.outer(np.sin(at), y))
        return np.concatenate([start[None], arc[1:-1], end[None]])

    def _along_spline(self, tail: Record, start: FloatArray, end: FloatArray) -> FloatArray:
        """Follow a B-spline, with rising parameter, between the points nearest to two vertices."""
        records = self.file.records(tail.number)
        shape, first, then = tail, 1, 6
        if 'B_SPLINE_CURVE' in records:
            shape, first, then = records['B_SPLINE_CURVE'], 0, 0
        points = np.array([self.point(n, shape) for n in shape.items(first + 1, Reference)])
        weights = np.ones(len(points))
        if 'RATIONAL_B_SPLINE_CURVE' in records:
            weights = np.array(records['RATIONAL_B_SPLINE_CURVE'].items(0, float))
        knots, degree = knot_vector(tail, then, shape.get(first, float), len(points))
        if weights.shape != (len(points),) or not weights.min() > 0.0:
            raise tail.fault('each control point must have a positive weight')
        net = np.concatenate([points * weights[:, None], weights[:, None]], axis=1)
        breaks = np.unique(knots[degree : len(points) + 1])
        at = np.interp(
            np.arange(SPAN * (len(breaks) - 1) + 1) / SPAN, np.arange(len(breaks)), breaks
        )
        values = BSpline(knots, net, degree)(at)
        points = values[:, :3] / values[:, 3:]
        a, b = (int(norm(points - vertex).argmin()) for vertex in (start, end))
        # Backward only on a closed curve, through the point where it closes.
        between = points[a : b + 1] if a < b else np.concatenate([points[a:], points[: b + 1]])
        return np.concatenate([start[None], between[1:-1], end[None]])

    def _vector(self, number: int, wanted_by: Record, keyword: str) -> FloatArray:
        """Read three numbers."""
        record = self.record(number, wanted_by, keyword)
        values = record.items(1, float)
        if len(values) != 3:
            raise record.fault(f'{keyword} must have three numbers')
        return np.array(values)


def knot_vector(
    record: Record, index: int, degree: float, count: int, axis: str = '', directions: int = 1
) -> tuple[FloatArray, int]:
    """
    Read knots with their multiplicities.

    Parameters
    ----------
    record : Record
        Has the multiplicities at ``index``, the knots ``directions`` further.
    index : int
        Where the multiplicities are.
    degree : float
        The degree as written.
    count : int
        Number of control points.
    axis : str
        Name of the direction, for errors.
    directions : int
        How many knot vectors the record has.

    Returns
    -------
    (ndarray, int)
        The knot vector, of length count + degree + 1, and the degree.

    """
    k = int(degree)
    counts = np.array(record.items(index, float))
    values = np.array(record.items(index + directions, float))
    sound = len(counts) == len(values) and np.all(counts >= 1.0)
    if k < 1 or not sound or np.sum(counts) != count + k + 1:
        raise record.fault(
            f'degree, knots and multiplicities{axis} do not fit {count} control points'
        )
    knots = np.repeat(values, counts.astype(int))
    if np.any(np.diff(knots) < 0.0) or not knots[k] < knots[count]:
        raise record.fault(f'the knots{axis} must not fall')
    return knots, k
