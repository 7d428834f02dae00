"""Axes and derivatives at one point of a segment; ``inside`` selects the piece at a break."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from cnc_interp.core import FloatArray, IntArray, jet
from cnc_interp.core.bspline import corner_spline_jet, quintic_jet
from cnc_interp.core.jet import Jet, VectorJet
from cnc_interp.core.kernels import njit
from cnc_interp.kinematics.axis_path import septic_jet
from cnc_interp.machine_model import chain_kernels
from cnc_interp.machine_model import five_axis_kernels as kernel
from cnc_interp.machine_model.joint import ARM
from cnc_interp.smoothing import segments as kinds
from cnc_interp.smoothing.segments import PathSegments

PLAIN_GRID = np.array([0.0, 0.5, 1.0])
SLOWEST_TIP = 1e-6  #: A tip slower than this share of the top's speed counts as resting [-].
#: Motion of the rotary axes on a segment: at rest, following the tool axis, or as coordinates of
#: the path beside the tip (LINEAR). With ALL_AXES, X Y Z are coordinates too, instead of the tip.
#: DRIFTING axes move smoothly to the tool axis at the end of a curve whose turn is hardly above
#: rounding. The jets of such a turn would be noise, and resting axes would leave a step at its
#: end.
RESTING, FOLLOWING, LINEAR, ALL_AXES, DRIFTING = 0, 1, 2, 3, -1
SAME_ANGLE = 1e-8  #: Rotary positions and tool axes that differ less are the same [rad].
#: Layout of a row of ``guides`` (``pole_passage.py``): parameters between which the outer axis
#: is a septic in path length, the branch after it, path length from the start of the septic to the
#: start of the segment, length of the septic [m], and its coefficients from the lowest on.
#: For an arm follow the number of the leading joint (from 1, with the sign of the determinant of
#: the rates), the same columns for the spin, which leads wherever no joint does, and the height of
#: a bump (4 u (1 - u))^4 that is added to the joint's septic.
GUIDE_FROM, GUIDE_TO, BRANCH_AFTER, GUIDE_BEGUN, GUIDE_LENGTH = range(5)
GUIDE, GUIDE_JOINT, SPIN_BEGUN, SPIN, GUIDE_BUMP = slice(5, 13), 13, 14, slice(16, 24), 24
NO_GUIDE = np.array([2.0, 2.0] + [0.0] * 11)
#: Rows of a segment's ``shape``.
BOTTOM, TOP = slice(0, kinds.POINTS), slice(kinds.POINTS, 2 * kinds.POINTS)
AXIS, ROTATION, CONNECTION = (
    2 * kinds.POINTS,
    2 * kinds.POINTS + 1,
    slice(2 * kinds.POINTS + 2, None),
)
# Gauss-Legendre points and weights for the arc length of half a corner
_GAUSS = np.array(np.polynomial.legendre.leggauss(10))  # type: ignore[no-untyped-call]


def beside_of(segments: PathSegments) -> FloatArray:
    """Stack the control values of rotary and extra axes for the kernels, shape (n, 6, 2 + k)."""
    return np.concatenate([segments.rotary, segments.extra], axis=2)


def shapes_of(segments: PathSegments) -> FloatArray:
    """Stack the geometry of segments for the kernels, shape (n, 20 or 22, 3)."""
    axis, rotation = segments.axis[:, None], segments.rotation[:, None]
    parts = (segments.bottom, segments.top, axis, rotation, segments.connection)
    return np.concatenate(parts, axis=1)


class Segment(NamedTuple):
    """The parts of a segment that kernels need."""

    kind: int
    motion: int
    shape: FloatArray  #: (20 or 22, 3): See ``shapes_of``.
    beside: FloatArray  #: (6, 2 + k): Control values of rotary and k extra axes [m, rad].
    f: FloatArray  #: (spans, 8): Parametrization.
    length: float  #: [m].


class SegmentRows(NamedTuple):
    """The fields of ``Segment`` for consecutive segments, as columns."""

    kind: IntArray
    motion: IntArray
    shape: FloatArray
    beside: FloatArray
    f: FloatArray
    length: FloatArray

    @staticmethod
    def of(segments: PathSegments, motion: IntArray) -> SegmentRows:
        shape, beside = shapes_of(segments), beside_of(segments)
        f, length = segments.parametrization, segments.length
        return SegmentRows(segments.kind, motion, shape, beside, f, length)


class Stands(NamedTuple):
    """The latest positions of the axes; kernels continue from them and update them."""

    #: (5 + k,), or (n,) for n joints: Positions; the solutions nearest to them are taken [m, rad].
    q: FloatArray
    branch: FloatArray  #: (1,): +1 or -1, the one of two solutions that rotary axes follow.
    height: float  #: Flank height [m].


class Pose(NamedTuple):
    """Jets in u of a pose: tool tip [m], unit tool axis, and ds/du [m]."""

    p: VectorJet
    o: VectorJet
    speed: Jet


class Place(NamedTuple):
    """A point of a segment; ``inside`` selects the piece at a break."""

    way: float  #: Path length from the start of the segment [m].
    u: float
    inside: float


@njit(cache=True, nogil=True)
def segment_at(rows: SegmentRows, i: int) -> Segment:
    shape, beside = rows.shape[i], rows.beside[i]
    return Segment(rows.kind[i], rows.motion[i], shape, beside, rows.f[i], rows.length[i])


@njit(cache=True, nogil=True)
def sample(
    packed: FloatArray, segment: Segment, stands: Stands, guide: FloatArray, place: Place
) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return the axes at one point of a segment.

    Returns the axes and three derivatives by path length, (4, 5 + k), or (4, n) for n joints; tool
    tip and tool axis, which are meaningless if rotary axes are coordinates; and the measure of
    ``axis_jets``.
    """
    kind, motion, shape, beside, f, length = segment
    u, inside = place.u, place.inside
    if kind == kinds.CORNER and motion >= LINEAR:
        p = bottom_jets(shape[BOTTOM], u, inside)
        o = p
        speed = speed_beside(p, beside, stands.height, u, inside)
    else:
        p, o = pose_jets(kind, shape, f, u, inside)
        curved = kind == kinds.CORNER or kind == kinds.SPLINE
        speed = speed_of(p) if curved else jet.constant(length)
    q, measure = axis_jets(packed, segment, Pose(p, o, speed), stands, guide, place)
    tip = np.array([p[0][0], p[1][0], p[2][0]])
    tool = np.array([o[0][0], o[1][0], o[2][0]])
    return q, tip, tool, measure


@njit(cache=True, nogil=True)
def axis_jets(
    packed: FloatArray,
    segment: Segment,
    pose: Pose,
    stands: Stands,
    guide: FloatArray,
    place: Place,
) -> tuple[FloatArray, float]:
    """Return the axes and three derivatives by path length for the jets of a pose, (4, 5 + k).

    Axes that follow the tool keep their branch, and the whole turns nearest to their positions.
    The measure is the squared sine of the tilt from the pole; it is negative if the pose is
    unreachable, and 1 if nothing is solved. Whether ``packed`` is a five-axis machine or a chain
    of joints is decided by its type at compile time.
    """
    kind, motion, beside = segment.kind, segment.motion, segment.beside
    p, o, speed = pose
    way, u, inside = place
    if packed.ndim == 2:
        leads, begun = chain_kernels.NO_JOINT, SPIN_BEGUN
        sense = stands.branch[0] if inside < guide[GUIDE_TO] else guide[BRANCH_AFTER]
        if guide[GUIDE_FROM] <= inside < guide[GUIDE_TO]:
            leads, begun, sense = int(abs(guide[GUIDE_JOINT])) - 1, GUIDE_BEGUN, guide[GUIDE_JOINT]
        s = (way, speed[0], 0.5 * speed[1], speed[2] / 3.0)
        lead = guide_jet(guide, way, begun)
        if leads >= 0 and guide[GUIDE_BUMP] != 0.0:
            lead = jet.add(lead, bump_jet(guide, way))
        lead = jet.compose(lead, s)
        further = beside.shape[1] - 2
        joints = np.empty((4, ARM + further))
        for k in range(further):
            w, j = beside_jet(kind, beside, 2 + k, u, inside), ARM + k
            p, o = chain_kernels.carried(packed[chain_kernels.BESIDE + k], p, o, w)
            joints[0, j], joints[1, j], joints[2, j], joints[3, j] = w
        found = chain_kernels.joint_jets(packed, p, o, stands.q[:ARM], sense, leads, lead)
        joints[:, :ARM] = found[0]
        for j in range(ARM + further):
            of_u = (joints[0, j], joints[1, j], joints[2, j], joints[3, j])
            joints[0, j], joints[1, j], joints[2, j], joints[3, j] = jet.by_arc_length(of_u, speed)
        return joints, found[1]
    sine_squared, outer = 1.0, int(packed[kernel.OUTER])
    tilted, turned = stands.q[4 - outer], stands.q[3 + outer]
    if guide[GUIDE_FROM] <= inside < guide[GUIDE_TO]:
        s = (way, speed[0], 0.5 * speed[1], speed[2] / 3.0)
        turn = jet.compose(guide_jet(guide, way, GUIDE_BEGUN), s)
        tilt, turn = kernel.guided_jets(packed, o, turn, tilted, turned)
        first, second = (tilt, turn) if outer == 1 else (turn, tilt)
    elif motion == RESTING:
        first, second = jet.constant(stands.q[3]), jet.constant(stands.q[4])
    elif motion == DRIFTING:
        _, end = pose_jets(kind, segment.shape, segment.f, 1.0, 1.0)
        tilt, turn, _ = kernel.rotary_jets(packed, end, stands.branch[0], tilted, turned)
        goals = (tilt[0], turn[0]) if outer == 1 else (turn[0], tilt[0])
        first = drift_jet(stands.q[3], goals[0], u)
        second = drift_jet(stands.q[4], goals[1], u)
    elif motion != FOLLOWING:
        first = beside_jet(kind, beside, 0, u, inside)
        second = beside_jet(kind, beside, 1, u, inside)
    else:
        branch = stands.branch[0] if inside < guide[GUIDE_TO] else guide[BRANCH_AFTER]
        tilt, turn, sine_squared = kernel.rotary_jets(packed, o, branch, tilted, turned)
        first, second = (tilt, turn) if outer == 1 else (turn, tilt)
    v = p if motion == ALL_AXES else kernel.linear_jets(packed, p, first, second)
    count = beside.shape[1] - 2
    q = np.empty((4, 5 + count))
    for i, component in enumerate((v[0], v[1], v[2], first, second)):
        q[0, i], q[1, i], q[2, i], q[3, i] = jet.by_arc_length(component, speed)
    for k in range(count):
        w = beside_jet(kind, beside, 2 + k, u, inside)
        j = 5 + k
        q[0, j], q[1, j], q[2, j], q[3, j] = jet.by_arc_length(w, speed)
        if motion == ALL_AXES:
            continue
        for i in range(3):  # (x, y, z) = XYZ + w d, so XYZ gives way
            direction = packed[kernel.SIZE + 3 * k + i]
            for order in range(4):
                q[order, i] -= direction * q[order, j]
    return q, sine_squared


@njit(cache=True, nogil=True)
def pose_jets(
    kind: int, shape: FloatArray, f: FloatArray, u: float, inside: float
) -> tuple[VectorJet, VectorJet]:
    if kind == kinds.CORNER:
        return kinds.corner_jets(shape[BOTTOM], shape[TOP], shape[CONNECTION], f, u, inside)
    if kind == kinds.SPLINE:
        return kinds.spline_jets(shape[BOTTOM], shape[TOP], shape[CONNECTION], u)
    if kind == kinds.LINE:
        return kinds.line_jets(shape[BOTTOM], shape[AXIS], shape[ROTATION], u)
    p = (jet.constant(shape[0, 0]), jet.constant(shape[0, 1]), jet.constant(shape[0, 2]))
    return p, kinds.great_circle_jets(shape[AXIS], shape[ROTATION], u)


@njit(cache=True, nogil=True)
def guide_jet(guide: FloatArray, way: float, begun: int) -> Jet:
    """Return the jet by path length [rad] of the septic whose columns begin at ``begun``."""
    length = guide[begun + 1]
    u = (guide[begun] + way) / length
    value, first, second, third = septic_jet(guide[begun + 2 : begun + 10], u, length)
    return (value, first, 0.5 * second, third / 6.0)


@njit(cache=True, nogil=True)
def bump_jet(guide: FloatArray, way: float) -> Jet:
    rate = 1.0 / guide[GUIDE_LENGTH]
    u = (guide[GUIDE_BEGUN] + way) * rate
    hill = (4.0 * u * (1.0 - u), 4.0 * (1.0 - 2.0 * u) * rate, -4.0 * rate * rate, 0.0)
    square = jet.multiply(hill, hill)
    return jet.scale(jet.multiply(square, square), guide[GUIDE_BUMP])


@njit(cache=True, nogil=True)
def drift_jet(begin: float, goal: float, u: float) -> Jet:
    """Return the jet in u of an axis that moves smoothly to ``goal``, if the angles agree."""
    if not abs(goal - begin) <= SAME_ANGLE:
        goal = begin
    points = np.array([begin, begin, begin, goal, goal, goal]).reshape(6, 1)
    return quintic_jet(points, 0, u)


@njit(cache=True, nogil=True)
def beside_jet(kind: int, beside: FloatArray, k: int, u: float, inside: float) -> Jet:
    """Return the jet in u of column k of ``beside``: an axis that is a coordinate [m or rad]."""
    if kind == kinds.CORNER:
        return corner_spline_jet(beside, k, u, inside > 0.5)
    if kind == kinds.SPLINE:
        return quintic_jet(beside, k, u)
    rate = beside[1, k] - beside[0, k]
    return (beside[0, k] + u * rate, rate, 0.0, 0.0)


@njit(cache=True, nogil=True)
def bottom_jets(bottom: FloatArray, u: float, inside: float) -> VectorJet:
    """Return the jet in u of the bottom curve of a corner; control points of shape (6, 3) [m]."""
    late = inside > 0.5
    return (
        corner_spline_jet(bottom, 0, u, late),
        corner_spline_jet(bottom, 1, u, late),
        corner_spline_jet(bottom, 2, u, late),
    )


@njit(cache=True, nogil=True)
def speed_beside(p: VectorJet, beside: FloatArray, height: float, u: float, inside: float) -> Jet:
    """Return the jet of ds/du [m] of a corner whose path length counts the axes of ``beside``."""
    square = squared_rate(p[0])
    for i in range(1, 3):
        square = jet.add(square, squared_rate(p[i]))
    for k in range(beside.shape[1]):
        w = jet.scale(corner_spline_jet(beside, k, u, inside > 0.5), height if k < 2 else 1.0)
        square = jet.add(square, squared_rate(w))
    return jet.square_root(square)


@njit(cache=True, nogil=True, inline='always')
def squared_rate(p: Jet) -> Jet:
    """Return the jet of (dp/du)^2; its third coefficient is meaningless."""
    rate = (p[1], 2.0 * p[2], 3.0 * p[3], 0.0)
    return jet.multiply(rate, rate)


@njit(cache=True, nogil=True, inline='always')
def speed_of(p: VectorJet) -> Jet:
    """Return the jet of ds/du [m], given that of the tip; its third coefficient is meaningless."""
    dx = (p[0][1], 2.0 * p[0][2], 3.0 * p[0][3], 0.0)
    dy = (p[1][1], 2.0 * p[1][2], 3.0 * p[1][3], 0.0)
    dz = (p[2][1], 2.0 * p[2][2], 3.0 * p[2][3], 0.0)
    return jet.square_root(jet.dot((dx, dy, dz), (dx, dy, dz)))


@njit(cache=True, nogil=True)
def arc_length(
    kind: int,
    motion: int,
    shape: FloatArray,
    beside: FloatArray,
    height: float,
    length: float,
    a: float,
    b: float,
) -> float:
    """Return the path length between two u on one half of a segment [m]."""
    if kind != kinds.CORNER and kind != kinds.SPLINE:
        return length * (b - a)
    late = 0.5 * (a + b) > 0.5
    total = 0.0
    for i in range(_GAUSS.shape[1]):
        u = 0.5 * (a + b) + 0.5 * (b - a) * _GAUSS[0, i]
        square = 0.0
        for k in range(3):
            if kind == kinds.CORNER:
                rate = corner_spline_jet(shape[BOTTOM], k, u, late)[1]
            else:
                rate = quintic_jet(shape[BOTTOM], k, u)[1]
            square += rate * rate
        if motion >= LINEAR:
            for k in range(beside.shape[1]):
                rate = corner_spline_jet(beside, k, u, late)[1] * (height if k < 2 else 1.0)
                square += rate * rate
        total += _GAUSS[1, i] * sqrt(square)
    return 0.5 * (b - a) * total


@njit(cache=True, nogil=True)
def tip_rests(shape: FloatArray) -> bool:
    """Return whether the tip of a spline rests at u = 0, 0.5 or 1; ``shape`` as in ``sample``."""
    for u in PLAIN_GRID:
        tip = top = 0.0
        for k in range(3):
            tip += quintic_jet(shape[BOTTOM], k, u)[1] ** 2
            top += quintic_jet(shape[TOP], k, u)[1] ** 2
        if tip <= SLOWEST_TIP**2 * top:
            return True
    return False
