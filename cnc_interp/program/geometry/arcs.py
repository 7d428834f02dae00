"""Arcs and helices of G2 and G3, for many blocks at once; and rounded or chamfered corners.

Let c be the centre, n the unit normal, and v the vector from c to the start. The distance r from
the axis changes linearly, because programs round both radii. The point at u is

    p(u) = c + (n . v) n + r(u) / r(0) Rot(n, u sweep) v_across + u rise n
"""

from cmath import phase
from collections.abc import Callable
from dataclasses import dataclass
from math import nan, pi, sin, tan

import numpy as np

from cnc_interp.core import INCH, MM, BoolArray, FloatArray, IntArray, ProgramError

#: First, second and normal axis of each plane; G2 is clockwise, seen against the normal.
PLANES = {'G17': (0, 1, 2), 'G18': (2, 0, 1), 'G19': (1, 2, 0)}
#: Allowed difference of the radii at start and end, as in LinuxCNC: share of the radius [-], and
#: its lower and upper limit [m], by unit. The chord may exceed the diameter by as much.
RADIUS_SHARE, RADIUS_LEAST = 1e-3, {MM: 0.02 * np.sqrt(2.0) * MM, INCH: 2e-3 * np.sqrt(2.0) * INCH}
LEAST_TO_MOST = 100.0
SHORTAGE, SHORTAGE_MOST = 0.0127 * MM, 0.5 * MM
#: A larger difference of the radii gives a notice [m].
TOLD = 0.0127 * MM
_SAME_POINT = 1e-12
_FARTHEST_CENTRE = 1e6  #: A centre farther away than this is an error of the program [m].


@dataclass(frozen=True)
class Arcs:
    centre: FloatArray  #: (n, 3): Point on the axis, at the height of the start [m].
    sweep: FloatArray  #: (n,): Signed angle, positive counter-clockwise [rad].
    fault: IntArray  #: (n,): 0 if the arc exists, else a key of ``FAULTS``.
    #: (n,): Difference of both radii, or excess of the chord over the diameter [m].
    mismatch: FloatArray


_OFF = 'start and end differ in their distance from the centre; correct I, J, K'
FAULTS = {
    1: 'an arc needs its centre (I, J, K in the plane) or its radius (R)',
    2: 'radius and centre in one arc; keep one of them',
    3: _OFF,
    4: 'the radius is smaller than half the distance from start to end; correct R',
    5: 'a full circle cannot be given by its radius; give I, J, K',
    6: 'the centre is at the start of the arc; correct I, J, K',
    7: 'the centre is more than 1000 km away; correct R or I, J, K',
    8: f'{_OFF}; they fit as absolute centres: write G90.1 before, or --arc-centres absolute',
    9: f'{_OFF}; they fit as the vector from the centre to the start: --arc-centres reversed',
}
#: Numbers of faults whose only cause may be a wrong start point.
OF_PLACE = (3, 4, 5, 6, 8, 9)


def arcs_of(
    plane: str,
    counter_clockwise: BoolArray,
    start: FloatArray,
    end: FloatArray,
    offset: FloatArray,
    radius: FloatArray,
    absolute: BoolArray | bool = False,
    turns: FloatArray | float = 1.0,
    unit: float = MM,
) -> Arcs:
    a, b, normal = PLANES[plane]
    chord = end - start
    by_radius = np.isfinite(radius)
    given = np.isfinite(offset[:, [a, b]])
    far = np.abs(np.nan_to_num(np.column_stack([offset, radius]))).max(axis=1) > _FARTHEST_CENTRE
    offset, radius = np.where(far[:, None], np.nan, offset), np.where(far, np.nan, radius)
    fault = np.where(by_radius & given.any(axis=1), 2, 0)
    fault = np.where(~by_radius & ~given.any(axis=1), 1, fault)
    fault = np.where(far, 7, fault)
    relative = np.where(absolute, offset - start, offset)
    relative = np.where(np.isfinite(relative), relative, 0.0)
    half = 0.5 * np.hypot(chord[:, a], chord[:, b])
    fault = np.where(by_radius & (half <= _SAME_POINT), 5, fault)
    # With a radius: the centre is beside the middle of the chord; left of it for a short G3 arc.
    with np.errstate(invalid='ignore', divide='ignore', over='ignore'):
        short = half - np.abs(radius)
        height = np.sqrt(np.maximum(radius**2 - half**2, 0.0))
        side = np.where(counter_clockwise, 1.0, -1.0) * np.sign(radius) * height / half
        centre_a = 0.5 * chord[:, a] - side * 0.5 * chord[:, b]
        centre_b = 0.5 * chord[:, b] + side * 0.5 * chord[:, a]
    allowed = np.clip(RADIUS_SHARE * np.abs(radius), SHORTAGE, SHORTAGE_MOST)
    fault = np.where(by_radius & (short > allowed), 4, fault)
    relative[:, a] = np.where(by_radius, np.nan_to_num(centre_a), relative[:, a])
    relative[:, b] = np.where(by_radius, np.nan_to_num(centre_b), relative[:, b])
    relative[:, normal] = 0.0
    # With a centre: the radii at start and end must agree.
    first = np.hypot(relative[:, a], relative[:, b])
    second = np.hypot(chord[:, a] - relative[:, a], chord[:, b] - relative[:, b])
    gap = np.abs(second - first)
    fault = np.where((fault == 0) & (first <= _SAME_POINT), 6, fault)
    off = ~by_radius & (gap > allowed_mismatch(np.maximum(first, second), unit))
    fault = np.where((fault == 0) & off, 3, fault)
    begin = np.arctan2(-relative[:, b], -relative[:, a])
    finish = np.arctan2(chord[:, b] - relative[:, b], chord[:, a] - relative[:, a])
    sign = np.where(counter_clockwise, 1.0, -1.0)
    sweep = np.mod(sign * (finish - begin), 2.0 * np.pi)
    # Rounding may turn a full circle into a sweep of zero, and a sweep of zero into a full circle.
    closed = half <= _SAME_POINT
    sweep = np.where(closed | (sweep <= 0.0), 2.0 * np.pi, sweep)
    sweep = sign * (sweep + 2.0 * np.pi * (turns - 1.0))
    mismatch = np.where(by_radius, np.maximum(short, 0.0), gap)
    return Arcs(start + relative, sweep, fault.astype(np.int64), mismatch)


def allowed_mismatch(radius: FloatArray, unit: float = MM) -> FloatArray:
    least = RADIUS_LEAST[unit]
    return np.asarray(np.clip(RADIUS_SHARE * radius, least, LEAST_TO_MOST * least))


def points_on(
    start: FloatArray,
    end: FloatArray,
    centre: FloatArray,
    normal: FloatArray,
    sweep: FloatArray,
    u: FloatArray,
) -> FloatArray:
    arm, other = start - centre, end - centre
    level = np.sum(arm * normal, axis=1)
    rise = np.sum(other * normal, axis=1) - level
    across = arm - level[:, None] * normal
    first = np.linalg.norm(across, axis=1)
    second = np.linalg.norm(other - (level + rise)[:, None] * normal, axis=1)
    growth = 1.0 + u * (second - first) / first
    angle = u * sweep
    turned = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(normal, across)
    return np.asarray(centre + growth[:, None] * turned + (level + u * rise)[:, None] * normal)


def lengths(
    start: FloatArray, end: FloatArray, centre: FloatArray, normal: FloatArray, sweep: FloatArray
) -> FloatArray:
    rise = np.sum((end - start) * normal, axis=1)
    arm, other = start - centre, end - centre
    radius = 0.5 * sum(
        np.linalg.norm(v - np.sum(v * normal, axis=1)[:, None] * normal, axis=1)
        for v in (arm, other)
    )
    return np.asarray(np.hypot(radius * sweep, rise))


#: Smaller lengths and angles count as zero [m, rad].
_NOTHING = 1e-9
Fault = Callable[[str, str], ProgramError]


@dataclass(frozen=True)
class Corner:
    kind: str  #: RND: radius; CHR: length along both lines; CHF: length of the chamfer.
    size: float  #: [m]
    modal: bool = False  #: Whether every corner is rounded (RNDM).

    def joint(
        self,
        here: FloatArray,
        corner: FloatArray,
        after: FloatArray,
        frame: FloatArray,
        fault: Fault,
    ) -> tuple[FloatArray, FloatArray, tuple[float, ...]] | None:
        """Return where both lines end and the arc between [m]; None if RNDM finds no corner.

        The columns of ``frame`` (3, 3) are the two axes of the plane and its normal.
        """
        start, vertex, end = (complex(*(frame[:, :2].T @ p)) for p in (here, corner, after))
        heights = [float(p @ frame[:, 2]) for p in (here, corner, after)]
        into, out = vertex - start, end - vertex
        angle = phase(out / into) if abs(into) > _NOTHING < abs(out) else 0.0
        if np.ptp(heights) > _NOTHING or not _NOTHING < abs(angle) < pi - _NOTHING:
            if self.modal:
                return None
            raise fault('needs two lines in the plane that make a corner', self.kind)
        cut = self.size
        if self.kind == 'RND':
            cut *= tan(0.5 * abs(angle))
        elif self.kind == 'CHF':
            cut /= 2.0 * sin(0.5 * (pi - abs(angle)))
        if cut > min(abs(into), abs(out)):
            raise fault('does not fit between the lines; make it smaller', self.kind)
        first = corner + cut / abs(into) * (here - corner)
        last = corner + cut / abs(out) * (after - corner)
        if self.kind != 'RND':
            return first, last, (nan,) * 7
        side = 1j * (1.0 if angle > 0.0 else -1.0) * self.size * into / abs(into)
        centre = first + side.real * frame[:, 0] + side.imag * frame[:, 1]
        return first, last, (*centre, *frame[:, 2], angle)
