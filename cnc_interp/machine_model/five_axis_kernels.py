"""The five-axis transformation, compiled: jets of machine axes (see ``five_axis.py``)."""

from math import atan2, cos, floor, pi, sin, sqrt

import numpy as np

from cnc_interp.core import FloatArray, jet
from cnc_interp.core.jet import Jet, Vector, VectorJet
from cnc_interp.core.kernels import njit

#: Places of the vectors in the packed geometry: directions of both rotary axes [-], then m, d, e
#: and both arms of the tool [m]; see ``FiveAxis.of``.
PRIMARY, SECONDARY, WORKPIECE, SECOND_OFFSET, FIRST_OFFSET, TIP_ARM, HEAD_ARM = range(0, 21, 3)
#: Places of the numbers: whether each of the two rotary axes carries the tool, index of the outer
#: axis, senses of outer and inner axis; then the vector Head(0) [m].
ON_HEAD, OUTER, OUTER_SIGN, INNER_SIGN, HEAD_ZERO, SIZE = 21, 23, 24, 25, 26, 29
#: From SIZE on follow the directions of the extra axes, three values each.


@njit(cache=True, nogil=True)
def vector_at(packed: FloatArray, place: int) -> Vector:
    return (packed[place], packed[place + 1], packed[place + 2])


@njit(cache=True, nogil=True)
def outer_and_inner(packed: FloatArray) -> tuple[Vector, Vector]:
    """Return the directions of the outer and of the inner rotary axis."""
    first, second = vector_at(packed, PRIMARY), vector_at(packed, SECONDARY)
    return (second, first) if packed[OUTER] > 0.5 else (first, second)


@njit(cache=True, nogil=True)
def near(angle: float, reference: float) -> float:
    """Return the angle plus the whole turns that bring it nearest to the reference [rad]."""
    return angle + 2.0 * pi * floor((reference - angle) / (2.0 * pi) + 0.5)


@njit(cache=True, nogil=True, inline='always')
def crossed(a: VectorJet, u: Vector) -> VectorJet:
    return (
        jet.subtract(jet.scale(a[1], u[2]), jet.scale(a[2], u[1])),
        jet.subtract(jet.scale(a[2], u[0]), jet.scale(a[0], u[2])),
        jet.subtract(jet.scale(a[0], u[1]), jet.scale(a[1], u[0])),
    )


@njit(cache=True, nogil=True, error_model='numpy')  # at the pole the jets are not finite
def rotary_jets(
    packed: FloatArray, o: VectorJet, branch: float, tilt_near: float, turn_near: float
) -> tuple[Jet, Jet, float]:
    """Solve the rotary axes for a unit tool axis ``o`` in W, nearest to given positions.

    Returns inner and outer axis [rad], and the squared sine of the tilt. The latter is negative
    out of reach, and zero at the pole, where the jets are not finite.
    """
    u, w = outer_and_inner(packed)
    c0 = w[2] * (w[0] * u[0] + w[1] * u[1] + w[2] * u[2])
    c1 = u[2] - c0
    c2 = w[1] * u[0] - w[0] * u[1]  # (w x e_z) . u
    radius = sqrt(c1 * c1 + c2 * c2)
    x = jet.add(jet.add(jet.scale(o[0], u[0]), jet.scale(o[1], u[1])), jet.scale(o[2], u[2]))
    cosine = (x[0] - c0, x[1], x[2], x[3])
    cross = (
        o[1][0] * u[2] - o[2][0] * u[1],
        o[2][0] * u[0] - o[0][0] * u[2],
        o[0][0] * u[1] - o[1][0] * u[0],
    )
    across = cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2]
    square = jet.multiply(cosine, cosine)
    sine_squared = radius * radius - square[0]
    if x[0] > 0.0:  # an equivalent formula that loses no digits near the pole +u
        sine_squared = (across / (1.0 + x[0]) + (radius + c0 - 1.0)) * (radius + cosine[0])
    elif radius - c0 > 1.0 - 1e-12:
        sine_squared = across / (1.0 - x[0]) * (radius - cosine[0])
    nothing = jet.constant(0.0)
    if sine_squared < -1e-12:
        return nothing, nothing, sine_squared
    sine = jet.square_root((max(sine_squared, 0.0), -square[1], -square[2], -square[3]))
    inner = jet.arctangent(jet.scale(sine, branch), cosine)
    inner = (inner[0] + atan2(c2, c1), inner[1], inner[2], inner[3])
    s, c = jet.sine_cosine(inner)
    one, zero = jet.constant(1.0), jet.constant(0.0)
    a = jet.rotated(w, s, c, (zero, zero, one))
    # from a x u to o x u: near the pole, what a and o have along u would hide the rest
    a, o = crossed(a, u), crossed(o, u)
    axo = (
        jet.subtract(jet.multiply(a[1], o[2]), jet.multiply(a[2], o[1])),
        jet.subtract(jet.multiply(a[2], o[0]), jet.multiply(a[0], o[2])),
        jet.subtract(jet.multiply(a[0], o[1]), jet.multiply(a[1], o[0])),
    )
    y = jet.add(jet.add(jet.scale(axo[0], u[0]), jet.scale(axo[1], u[1])), jet.scale(axo[2], u[2]))
    z = jet.dot(a, o)
    turn = jet.scale(jet.arctangent(y, z), packed[OUTER_SIGN])
    tilt = jet.scale(inner, packed[INNER_SIGN])
    tilt = (near(tilt[0], tilt_near), tilt[1], tilt[2], tilt[3])
    turn = (near(turn[0], turn_near), turn[1], turn[2], turn[3])
    return tilt, turn, sine_squared


@njit(cache=True, nogil=True)
def guided_jets(
    packed: FloatArray, o: VectorJet, turn: Jet, tilt_near: float, turn_near: float
) -> tuple[Jet, Jet]:
    """Return the jets of tilt and turn for a tool axis, given the turn [rad].

    With the outer axis at a, the tool can reach the small circle of ``Rot(w, b) e_z`` about w.
    The nearest point to o' = Rot(u, -a) o on it has the azimuth of o' about w. So the tool axis
    deviates by the difference of the angles that o' and e_z have with w, and no pole exists.
    """
    u, w = outer_and_inner(packed)
    s, c = jet.sine_cosine(jet.scale(turn, -packed[OUTER_SIGN]))
    o = jet.rotated(u, s, c, o)
    y = jet.subtract(jet.scale(o[0], w[1]), jet.scale(o[1], w[0]))  # (w x e_z) . o'
    along = jet.add(jet.add(jet.scale(o[0], w[0]), jet.scale(o[1], w[1])), jet.scale(o[2], w[2]))
    x = jet.subtract(o[2], jet.scale(along, w[2]))
    tilt = jet.scale(jet.arctangent(y, x), packed[INNER_SIGN])
    tilt = (near(tilt[0], tilt_near), tilt[1], tilt[2], tilt[3])
    return tilt, (near(turn[0], turn_near), turn[1], turn[2], turn[3])


@njit(cache=True, nogil=True)
def guided_gap(packed: FloatArray, o: VectorJet, turn: float) -> float:
    """Return the angle by which the tool axis of ``guided_jets`` deviates from o [rad]."""
    u, w = outer_and_inner(packed)
    s, c = jet.sine_cosine(jet.constant(-packed[OUTER_SIGN] * turn))
    o = jet.rotated(u, s, c, o)
    along = w[0] * o[0][0] + w[1] * o[1][0] + w[2] * o[2][0]
    x, y = o[2][0] - along * w[2], w[1] * o[0][0] - w[0] * o[1][0]
    radius = sqrt(w[0] * w[0] + w[1] * w[1])  # of the small circle
    across = sqrt(x * x + y * y) / radius  # (x, y) is perpendicular to w, stretched by radius
    return atan2(along, across) - atan2(w[2], radius)


@njit(cache=True, nogil=True, inline='always')
def moved(v: VectorJet, packed: FloatArray, place: int) -> VectorJet:
    x, y, z = v
    return (
        (x[0] + packed[place], x[1], x[2], x[3]),
        (y[0] + packed[place + 1], y[1], y[2], y[3]),
        (z[0] + packed[place + 2], z[1], z[2], z[3]),
    )


@njit(cache=True, nogil=True)
def linear_jets(packed: FloatArray, p: VectorJet, first: Jet, second: Jet) -> VectorJet:
    """Return the jets of X Y Z [m] for a tool tip [m] and both rotary axes [rad]."""
    s1, c1 = jet.sine_cosine(first)
    s2, c2 = jet.sine_cosine(second)
    u1, u2 = vector_at(packed, PRIMARY), vector_at(packed, SECONDARY)
    first_on_head, second_on_head = packed[ON_HEAD] > 0.5, packed[ON_HEAD + 1] > 0.5
    v = moved(p, packed, WORKPIECE)
    if not second_on_head:
        v = jet.rotated(u2, s2, c2, v)
    v = moved(v, packed, SECOND_OFFSET)
    if not first_on_head:
        v = jet.rotated(u1, s1, c1, v)
    v = moved(v, packed, FIRST_OFFSET)
    if first_on_head or second_on_head:
        zero = jet.constant(0.0)
        arm = moved((zero, zero, zero), packed, TIP_ARM)
        if second_on_head:
            arm = jet.rotated(u2, s2, c2, arm)
        arm = moved(arm, packed, HEAD_ARM)
        if first_on_head:
            arm = jet.rotated(u1, s1, c1, arm)
        v = (jet.add(v[0], arm[0]), jet.add(v[1], arm[1]), jet.add(v[2], arm[2]))
        rest = jet.constant(packed[HEAD_ZERO])
        rest_y, rest_z = jet.constant(packed[HEAD_ZERO + 1]), jet.constant(packed[HEAD_ZERO + 2])
        v = (jet.subtract(v[0], rest), jet.subtract(v[1], rest_y), jet.subtract(v[2], rest_z))
    return v


@njit(cache=True, nogil=True)
def linear_position(
    packed: FloatArray, tip: FloatArray, first: float, second: float
) -> FloatArray:
    """Return X Y Z [m] of one tool tip [m], both shape (3,), at given rotary positions [rad]."""
    p = (jet.constant(tip[0]), jet.constant(tip[1]), jet.constant(tip[2]))
    v = linear_jets(packed, p, jet.constant(first), jet.constant(second))
    return np.array([v[0][0], v[1][0], v[2][0]])


@njit(cache=True, nogil=True)
def turned(u: Vector, angle: float, x: float, y: float, z: float) -> Vector:
    """Rotate the vector (x, y, z) about a unit axis by an angle [rad]."""
    s, c = sin(angle), cos(angle)
    along = (u[0] * x + u[1] * y + u[2] * z) * (1.0 - c)
    return (
        x * c + (u[1] * z - u[2] * y) * s + u[0] * along,
        y * c + (u[2] * x - u[0] * z) * s + u[1] * along,
        z * c + (u[0] * y - u[1] * x) * s + u[2] * along,
    )


@njit(cache=True, nogil=True)
def forward(packed: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return tool tips [m] and axes [-], shape (n, 3), of n axis positions, shape (n, 5)."""
    n = len(q)
    tip, axis = np.empty((n, 3)), np.empty((n, 3))
    u1, u2 = vector_at(packed, PRIMARY), vector_at(packed, SECONDARY)
    first_on_head, second_on_head = packed[ON_HEAD] > 0.5, packed[ON_HEAD + 1] > 0.5
    for i in range(n):
        x, y, z = q[i, 0], q[i, 1], q[i, 2]
        o = (0.0, 0.0, 1.0)
        if first_on_head or second_on_head:
            arm = vector_at(packed, TIP_ARM)
            if second_on_head:
                o = turned(u2, q[i, 4], o[0], o[1], o[2])
                arm = turned(u2, q[i, 4], arm[0], arm[1], arm[2])
            more = vector_at(packed, HEAD_ARM)
            arm = (arm[0] + more[0], arm[1] + more[1], arm[2] + more[2])
            if first_on_head:
                o = turned(u1, q[i, 3], o[0], o[1], o[2])
                arm = turned(u1, q[i, 3], arm[0], arm[1], arm[2])
            x = x - arm[0] + packed[HEAD_ZERO]
            y = y - arm[1] + packed[HEAD_ZERO + 1]
            z = z - arm[2] + packed[HEAD_ZERO + 2]
        x -= packed[FIRST_OFFSET]
        y -= packed[FIRST_OFFSET + 1]
        z -= packed[FIRST_OFFSET + 2]
        if not first_on_head:
            x, y, z = turned(u1, -q[i, 3], x, y, z)
            o = turned(u1, -q[i, 3], o[0], o[1], o[2])
        x -= packed[SECOND_OFFSET]
        y -= packed[SECOND_OFFSET + 1]
        z -= packed[SECOND_OFFSET + 2]
        if not second_on_head:
            x, y, z = turned(u2, -q[i, 4], x, y, z)
            o = turned(u2, -q[i, 4], o[0], o[1], o[2])
        tip[i, 0] = x - packed[WORKPIECE]
        tip[i, 1] = y - packed[WORKPIECE + 1]
        tip[i, 2] = z - packed[WORKPIECE + 2]
        axis[i, 0], axis[i, 1], axis[i, 2] = o
    return tip, axis


@njit(cache=True, nogil=True, error_model='numpy')  # at the pole they are not finite
def rates(
    packed: FloatArray,
    outer: int,
    tip: FloatArray,
    axis: FloatArray,
    step: FloatArray,
    turn: FloatArray,
) -> FloatArray:
    """Return q_s of the branch with the positive tilt, (n, 5); rows as in ``Transform.rates``."""
    found = np.full((len(tip), 5), np.nan)
    for i in range(len(tip)):
        o, w = axis[i], turn[i]
        slope = (w[1] * o[2] - w[2] * o[1], w[2] * o[0] - w[0] * o[2], w[0] * o[1] - w[1] * o[0])
        tool = ((o[0], slope[0], 0.0, 0.0), (o[1], slope[1], 0.0, 0.0), (o[2], slope[2], 0.0, 0.0))
        tilt, turned, sine_squared = rotary_jets(packed, tool, 1.0, 0.0, 0.0)
        if sine_squared <= 0.0:
            continue
        first, second = (tilt, turned) if outer == 1 else (turned, tilt)
        point = (
            (tip[i, 0], step[i, 0], 0.0, 0.0),
            (tip[i, 1], step[i, 1], 0.0, 0.0),
            (tip[i, 2], step[i, 2], 0.0, 0.0),
        )
        x, y, z = linear_jets(packed, point, first, second)
        found[i, 0], found[i, 1], found[i, 2] = x[1], y[1], z[1]
        found[i, 3], found[i, 4] = first[1], second[1]
    return found
