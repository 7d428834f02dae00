"""
The five-axis transformation: tool tip and tool axis in W <-> machine axes.

With T the product of the rotary axes that carry the workpiece and H of those that carry the tool,

    o_W = T^-1 H e_z = Rot(u, a) Rot(w, b) e_z
    (x, y, z) = Table(p_W) + Head(rotary) - Head(0)

with (x, y, z) where the tool stands in M: X Y Z plus the extra axes along their directions.
The *outer* axis u turns about the pole and the *inner* axis w, next to the tool, tilts:
table-table: u secondary, w primary, both negated; head-head: u primary, w secondary;
one of each: u the table axis, negated, w the head axis.

``o . u = c0 + R cos(b - b0)`` gives the tilt, two branches (sign of the sine); the outer angle
follows from the projections on the plane normal to u. Near the pole o -> +-u the sine is taken
from |o x u|, which keeps full relative accuracy.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, floor, pi, sin, sqrt

import numpy as np
from numba import njit

from cnc_interp.core import jet
from cnc_interp.core.arrays import FloatArray
from cnc_interp.kinematics.machine import Machine

#: Layout of the packed geometry: outer direction and sign, inner direction and sign, c0 c1 c2 ...
#: see ``Transform.of``; one flat array keeps the kernels' signatures short.
PRIMARY, SECONDARY, WORKPIECE, SECOND_OFFSET, FIRST_OFFSET, TIP_ARM, HEAD_ARM = range(0, 21, 3)
ON_HEAD, OUTER, OUTER_SIGN, INNER_SIGN, HEAD_ZERO, SIZE = 21, 23, 24, 25, 26, 29
#: From SIZE on follow the directions of the extra axes, three values each.


@dataclass(frozen=True)
class Transform:
    """
    Geometry of a machine, packed for the kernels.

    Parameters
    ----------
    machine : Machine
        The machine.
    packed : ndarray, shape (29 + 3 k,)
        Its geometry as one array; the last 3 k values are directions of k extra axes.

    """

    machine: Machine
    packed: FloatArray

    @staticmethod
    def of(machine: Machine) -> Transform:
        """Pack the geometry of a machine."""
        first_on_head, second_on_head = machine.rotary_on_head
        if first_on_head == second_on_head:
            outer = 0 if first_on_head else 1
        else:
            outer = 1 if first_on_head else 0
        packed = np.zeros(SIZE)
        packed[PRIMARY : PRIMARY + 6] = machine.rotary_direction.ravel()
        packed[WORKPIECE : WORKPIECE + 9] = machine.offsets.ravel()
        packed[TIP_ARM : TIP_ARM + 6] = machine.tool_offset.ravel()
        packed[ON_HEAD : ON_HEAD + 2] = machine.rotary_on_head
        packed[OUTER] = outer
        packed[OUTER_SIGN] = 1.0 if machine.rotary_on_head[outer] else -1.0
        packed[INNER_SIGN] = 1.0 if machine.rotary_on_head[1 - outer] else -1.0
        packed[HEAD_ZERO : HEAD_ZERO + 3] = machine.tool_offset.sum(axis=0) * (
            first_on_head or second_on_head
        )
        return Transform(machine, np.concatenate([packed, machine.extra_direction.ravel()]))

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Letters of the machine's axes."""
        return self.machine.axis_names

    @property
    def extra_names(self) -> tuple[str, ...]:
        """Letters of the machine's extra axes."""
        return self.machine.extra_names

    @property
    def extra_direction(self) -> FloatArray:
        """Unit vectors in M along which the extra axes move the tool, shape (k, 3)."""
        return self.machine.extra_direction

    @property
    def outer(self) -> int:
        """Index of the rotary axis that is undefined at the pole: 0 primary, 1 secondary."""
        return int(self.packed[OUTER])

    @property
    def pole(self) -> FloatArray:
        """Direction in W at which the outer rotary axis is undefined, shape (3,)."""
        return np.asarray(self.machine.rotary_direction[self.outer])

    @property
    def pole_cone(self) -> float:
        """Angle around the pole in which a direction does not give rotary positions [rad]."""
        return self.machine.singular_cone

    def nearest_to_pole(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """
        Return the smallest angle between tool axis and pole while the rotary axes run linearly.

        The cosine is ``o . u = c0 + R cos(b - b0)`` (module docstring), so its extremes lie at
        the ends or where b - b0 is a multiple of 180 deg.

        Parameters
        ----------
        start, end : ndarray, shape (n, 2)
            Rotary positions [rad].

        Returns
        -------
        ndarray, shape (n,)
            Angles to the nearer one of both directions of the pole [rad].

        """
        inner = 1 - self.outer
        u, w = self.machine.rotary_direction[[self.outer, inner]]
        c0 = w[2] * float(w @ u)
        c1, c2 = u[2] - c0, w[1] * u[0] - w[0] * u[1]
        radius, b0 = np.hypot(c1, c2), np.arctan2(c2, c1)
        ends = self.packed[INNER_SIGN] * np.stack([start[:, inner], end[:, inner]]) - b0
        low, high = ends.min(axis=0), ends.max(axis=0)
        cosine = c0 + radius * np.cos(ends)
        top = np.where(np.ceil(low / (2 * pi)) * 2 * pi <= high, c0 + radius, cosine.max(axis=0))
        turn = np.ceil((low - pi) / (2 * pi)) * 2 * pi + pi
        bottom = np.where(turn <= high, c0 - radius, cosine.min(axis=0))
        return np.asarray(np.arccos(np.clip(np.maximum(top, -bottom), -1.0, 1.0)))

    def levers(self, stands: FloatArray, rotary: FloatArray, height: float) -> FloatArray:
        """
        Return how far a point on the tool axis moves in W per radian of each rotary axis.

        Parameters
        ----------
        stands : ndarray, shape (n, 3)
            X Y Z plus the extra axes along their directions [m].
        rotary : ndarray, shape (n, 2)
            Rotary positions [rad].
        height : float
            Height of the point above the tip [m].

        Returns
        -------
        ndarray, shape (n, 2)
            Distances of the point from the primary and the secondary axis [m].

        """
        machine = self.machine
        u1, u2 = machine.rotary_direction
        first_on_head, second_on_head = machine.rotary_on_head
        tip_arm, head_arm = machine.tool_offset
        on_head = first_on_head or second_on_head
        up = np.array([0.0, 0.0, height])
        # From the point to the pivots, as in ``forward``; a tool that never turns is vertical.
        arm = np.broadcast_to(tip_arm - up if on_head else -up, stands.shape)
        levers = np.zeros((len(stands), 2))
        if second_on_head:
            levers[:, 1] = norm_of(np.cross(u2, arm))
            arm = rotated(u2, rotary[:, 1], arm)
        arm = arm + (head_arm if on_head else 0.0)
        if first_on_head:
            levers[:, 0] = norm_of(np.cross(u1, arm))
            arm = rotated(u1, rotary[:, 0], arm)
        point = stands - arm + self.packed[HEAD_ZERO : HEAD_ZERO + 3] - machine.offsets[2]
        if not first_on_head:
            levers[:, 0] = norm_of(np.cross(u1, point))
            point = rotated(u1, -rotary[:, 0], point)
        if not second_on_head:
            levers[:, 1] = norm_of(np.cross(u2, point - machine.offsets[1]))
        return levers

    def tool_axis(self, rotary: FloatArray) -> FloatArray:
        """
        Return the tool axis of rotary positions.

        Parameters
        ----------
        rotary : ndarray, shape (n, 2)
            Primary and secondary rotary positions [rad].

        Returns
        -------
        ndarray, shape (n, 3)
            Unit tool axis in W.

        """
        q = np.concatenate([np.zeros((len(rotary), 3)), np.asarray(rotary, float)], axis=1)
        return np.asarray(forward(self.packed, q)[1])

    def forward(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """
        Return tool tips and tool axes of axis positions.

        Parameters
        ----------
        q : ndarray, shape (n, n_axes)
            Axis positions [m, rad]; extra axes may be left out and count as 0 then.

        Returns
        -------
        tip, axis : ndarray, shape (n, 3)
            ``p_WT`` [m] and ``o_W`` [-].

        """
        q = np.asarray(q, float)
        own = 5 if self.machine.has_rotary else 3
        if q.shape[1] > own:
            stands = q[:, :3] + q[:, own:] @ self.extra_direction
            q = np.concatenate([stands, q[:, 3:own]], axis=1)
        if own == 3:
            q = np.concatenate([q, np.zeros((len(q), 2))], axis=1)
        return forward(self.packed, q)  # type: ignore[no-any-return]

    def linear(self, tip: FloatArray, rotary: FloatArray) -> FloatArray:
        """
        Return X Y Z [m], shape (n, 3), of tool tips [m] at given rotary positions [rad].

        Extra axes stand at 0.
        """
        return np.array(
            [linear_position(self.packed, p, r[0], r[1]) for p, r in zip(tip, rotary, strict=True)]
        )

    def rotary_solutions(self, axis: FloatArray) -> list[FloatArray]:
        """
        Return both branches of the rotary positions for one tool axis.

        Parameters
        ----------
        axis : ndarray, shape (3,)
            Unit tool axis in W.

        Returns
        -------
        list of ndarray, shape (2,)
            Primary and secondary position in (-pi, pi] [rad]; empty when unreachable.

        """
        o = (jet.constant(axis[0]), jet.constant(axis[1]), jet.constant(axis[2]))
        found = []
        for branch in (1.0, -1.0):
            tilt, turn, sine_squared = rotary_jets(self.packed, o, branch, 0.0, 0.0)
            if sine_squared < -1e-12:
                continue
            pair = np.array([tilt[0], turn[0]] if self.outer == 1 else [turn[0], tilt[0]])
            found.append(pair)
        return found


def norm_of(rows: FloatArray) -> FloatArray:
    """Return the lengths of the rows of an array, shape (n,)."""
    return np.asarray(np.sqrt((rows**2).sum(axis=1)))


def rotated(u: FloatArray, angle: FloatArray, v: FloatArray) -> FloatArray:
    """Rotate vectors, shape (n, 3), about a unit axis by angles, shape (n,) [rad]."""
    s, c = np.sin(angle)[:, None], np.cos(angle)[:, None]
    return np.asarray(v * c + np.cross(u, v) * s + u * ((v @ u)[:, None] * (1.0 - c)))


@njit(cache=True, nogil=True)
def vector_at(packed, place):  # type: ignore[no-untyped-def]
    """Read a constant vector as a tuple."""
    return (packed[place], packed[place + 1], packed[place + 2])


@njit(cache=True, nogil=True)
def near(angle, reference):  # type: ignore[no-untyped-def]
    """Return the angle plus the whole turns that bring it nearest to the reference."""
    return angle + 2.0 * pi * floor((reference - angle) / (2.0 * pi) + 0.5)


@njit(cache=True, nogil=True, inline='always')
def crossed(a, u):  # type: ignore[no-untyped-def]
    """Return a x u of a vector jet and a constant vector."""
    return (
        jet.subtract(jet.scale(a[1], u[2]), jet.scale(a[2], u[1])),
        jet.subtract(jet.scale(a[2], u[0]), jet.scale(a[0], u[2])),
        jet.subtract(jet.scale(a[0], u[1]), jet.scale(a[1], u[0])),
    )


@njit(cache=True, nogil=True, error_model='numpy')  # at the pole the jets are not finite
def rotary_jets(packed, o, branch, tilt_near, turn_near):  # type: ignore[no-untyped-def]
    """
    Solve the rotary axes for a tool axis.

    Returns
    -------
    tilt, turn : jet
        Inner and outer axis position [rad], turned to the whole turn nearest to the references.
    sine_squared : float
        Negative where the orientation cannot be reached; zero at the pole, where the jets are
        not finite.

    """
    outer = int(packed[OUTER])
    u = vector_at(packed, SECONDARY if outer == 1 else PRIMARY)
    w = vector_at(packed, PRIMARY if outer == 1 else SECONDARY)
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
def guided_jets(packed, o, turn, tilt_near, turn_near):  # type: ignore[no-untyped-def]
    """
    Return the jets of tilt and turn for a tool axis, where the turn is given.

    With the outer axis at a, the tool can reach the small circle of ``Rot(w, b) e_z`` about w.
    The nearest point to o' = Rot(u, -a) o on it has the azimuth of o' about w. So the tool axis
    deviates by the difference of the angles that o' and e_z have with w, and no pole exists.
    """
    outer = int(packed[OUTER])
    u = vector_at(packed, SECONDARY if outer == 1 else PRIMARY)
    w = vector_at(packed, PRIMARY if outer == 1 else SECONDARY)
    s, c = jet.sine_cosine(jet.scale(turn, -packed[OUTER_SIGN]))
    o = jet.rotated(u, s, c, o)
    y = jet.subtract(jet.scale(o[0], w[1]), jet.scale(o[1], w[0]))  # (w x e_z) . o'
    along = jet.add(jet.add(jet.scale(o[0], w[0]), jet.scale(o[1], w[1])), jet.scale(o[2], w[2]))
    x = jet.subtract(o[2], jet.scale(along, w[2]))
    tilt = jet.scale(jet.arctangent(y, x), packed[INNER_SIGN])
    tilt = (near(tilt[0], tilt_near), tilt[1], tilt[2], tilt[3])
    return tilt, (near(turn[0], turn_near), turn[1], turn[2], turn[3])


@njit(cache=True, nogil=True)
def guided_gap(packed, o, turn):  # type: ignore[no-untyped-def]
    """Return by what angle a tool axis deviates where the turn is given, as above [rad]."""
    outer = int(packed[OUTER])
    u = vector_at(packed, SECONDARY if outer == 1 else PRIMARY)
    w = vector_at(packed, PRIMARY if outer == 1 else SECONDARY)
    s, c = jet.sine_cosine(jet.constant(-packed[OUTER_SIGN] * turn))
    o = jet.rotated(u, s, c, o)
    along = w[0] * o[0][0] + w[1] * o[1][0] + w[2] * o[2][0]
    x, y = o[2][0] - along * w[2], w[1] * o[0][0] - w[0] * o[1][0]
    radius = sqrt(w[0] * w[0] + w[1] * w[1])  # of the small circle
    across = sqrt(x * x + y * y) / radius  # (x, y) is perpendicular to w, stretched by radius
    return atan2(along, across) - atan2(w[2], radius)


@njit(cache=True, nogil=True, inline='always')
def moved(v, packed, place):  # type: ignore[no-untyped-def]
    """Add a constant vector to a vector jet."""
    x, y, z = v
    return (
        (x[0] + packed[place], x[1], x[2], x[3]),
        (y[0] + packed[place + 1], y[1], y[2], y[3]),
        (z[0] + packed[place + 2], z[1], z[2], z[3]),
    )


@njit(cache=True, nogil=True)
def linear_jets(packed, p, first, second):  # type: ignore[no-untyped-def]
    """Return the jets of X Y Z for a tool tip and both rotary axes."""
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
def linear_position(packed, tip, first, second):  # type: ignore[no-untyped-def]
    """Return X Y Z of one tool tip at given rotary positions."""
    p = (jet.constant(tip[0]), jet.constant(tip[1]), jet.constant(tip[2]))
    v = linear_jets(packed, p, jet.constant(first), jet.constant(second))
    return np.array([v[0][0], v[1][0], v[2][0]])


@njit(cache=True, nogil=True)
def turned(u, angle, x, y, z):  # type: ignore[no-untyped-def]
    """Rotate a vector about a unit axis by an angle."""
    s, c = sin(angle), cos(angle)
    along = (u[0] * x + u[1] * y + u[2] * z) * (1.0 - c)
    return (
        x * c + (u[1] * z - u[2] * y) * s + u[0] * along,
        y * c + (u[2] * x - u[0] * z) * s + u[1] * along,
        z * c + (u[0] * y - u[1] * x) * s + u[2] * along,
    )


@njit(cache=True, nogil=True)
def forward(packed, q):  # type: ignore[no-untyped-def]
    """Return tool tips and tool axes, shape (n, 3), of axis positions, shape (n, 5)."""
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
