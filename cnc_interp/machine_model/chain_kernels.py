"""A chain of joints from the part to the tool, compiled: forward, inverse, and exact jets.

Each joint is a line in W at q = 0: the direction and a point of its axis. A point x of the tool is

  x(q) = S_1(q_1) ... S_n(q_n) x(0),   S_i(q) x = a_i + Rot(u_i, q) (x - a_i)

where joint n is nearest to the tool. Directions turn likewise, without the points a_i.

Further joints, a rail or a positioner, lie between the part and joint 1. The path has their
positions, so poses are first moved to where the arm sees them (``carried``).
"""

from math import pi

import numpy as np

from cnc_interp.core import FloatArray, jet
from cnc_interp.core.jet import Jet, VectorJet
from cnc_interp.core.kernels import njit
from cnc_interp.machine_model.joint import ARM

#: Places in a row of the packed chain: direction and point of a joint, and whether it slides. Two
#: rows follow the joints of the arm: the tip and the side of the tool at q = 0; its axis, then
#: reach [m], spin [rad]. The last rows are further joints, from the part on.
DIRECTION, POINT, SLIDES, BESIDE = slice(0, 3), slice(3, 6), 6, ARM + 2
TIP, SIDE, AXIS, REACH, SPIN = 0, 3, 0, 3, 4
#: Newton's method: most steps, longest step [rad], and misfit at which it ends [-].
STEPS, LONGEST, ENDED = 60, 0.4, 1e-13
#: Measures of poses that are out of reach, or beyond a singular pose.
UNSOLVED, REVERSED = -1.0, 0.0
NO_JOINT = -1  #: Value of ``leads`` if the spin leads.
#: Below this sine of the angle to part -Z, the side of the tool is undefined [-].
LEAST_UPRIGHT = 1e-6


@njit(cache=True, nogil=True)
def posture(packed: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return tip [m], side and axis of the tool in W, (3, 3), at joint positions (n,) [rad].

    Also return the rates of the tip, divided by the reach, and of the turn of the tool with each
    joint, (6, n) [1/rad, -].
    """
    n, reach = len(q), packed[len(q) + 1, REACH]
    turn, shift, step = np.eye(3), np.zeros(3), np.empty((3, 3))
    tool, rates, points = np.empty((3, 3)), np.empty((6, n)), np.empty((n, 3))
    for k in range(n):
        u, a = packed[k, DIRECTION], packed[k, POINT]
        s, c = np.sin(q[k]), np.cos(q[k])
        for i in range(3):
            along = points_at = 0.0
            for j in range(3):
                along += turn[i, j] * u[j]
                points_at += turn[i, j] * a[j]
            rates[3 + i, k], points[k, i] = along, points_at + shift[i]
        for i in range(3):
            for j in range(3):
                step[i, j] = (1.0 - c) * u[i] * u[j] + skew(u, i, j) * s
            step[i, i] += c
        turn = turned_by(turn, step)
        for i in range(3):
            shift[i] = points[k, i] - turn[i, 0] * a[0] - turn[i, 1] * a[1] - turn[i, 2] * a[2]
    for i in range(3):
        tool[0, i], tool[1, i], tool[2, i] = shift[i], 0.0, 0.0
        for j in range(3):
            tool[0, i] += turn[i, j] * packed[n, TIP + j]
            tool[1, i] += turn[i, j] * packed[n, SIDE + j]
            tool[2, i] += turn[i, j] * packed[n + 1, AXIS + j]
    for k in range(n):
        for i in range(3):
            j, m = (i + 1) % 3, (i + 2) % 3
            rates[i, k] = rates[3 + j, k] * (tool[0, m] - points[k, m])
            rates[i, k] -= rates[3 + m, k] * (tool[0, j] - points[k, j])
            rates[i, k] /= reach
    return tool, rates


@njit(cache=True, nogil=True)
def turned_by(a: FloatArray, b: FloatArray) -> FloatArray:
    found = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            found[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
    return found


@njit(cache=True, nogil=True)
def skew(u: FloatArray, i: int, j: int) -> float:
    """Return one number of the matrix of u x."""
    if i == j:
        return 0.0
    found: float = u[3 - i - j] if (j - i) % 3 == 2 else -u[3 - i - j]
    return found


@njit(cache=True, nogil=True)
def factorised(a: FloatArray, order: FloatArray) -> tuple[float, float]:
    """Factorise a square matrix in place; return its smallest pivot and the determinant's sign.

    ``order`` (n,) receives the pivot rows.
    """
    n, sign, least = len(a), 1.0, np.inf
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(a[i, k]) > abs(a[best, k]):
                best = i
        order[k] = best
        if best != k:
            sign = -sign
            for j in range(n):
                a[k, j], a[best, j] = a[best, j], a[k, j]
        pivot = a[k, k]
        least = min(least, abs(pivot))
        sign = sign if pivot >= 0.0 else -sign
        if pivot == 0.0:
            return 0.0, sign
        for i in range(k + 1, n):
            a[i, k] /= pivot
            for j in range(k + 1, n):
                a[i, j] -= a[i, k] * a[k, j]
    return least, sign


@njit(cache=True, nogil=True)
def solved(a: FloatArray, order: FloatArray, b: FloatArray) -> None:
    """Solve for ``b`` (n,) in place with a factorised matrix."""
    n = len(a)
    for k in range(n):
        best = int(order[k])
        b[k], b[best] = b[best], b[k]
    for i in range(n):
        for j in range(i):
            b[i] -= a[i, j] * b[j]
    for k in range(n):
        i = n - 1 - k
        for j in range(i + 1, n):
            b[i] -= a[i, j] * b[j]
        b[i] /= a[i, i]


@njit(cache=True, nogil=True, inline='always')
def crossed(a: VectorJet, b: VectorJet) -> VectorJet:
    return (
        jet.subtract(jet.multiply(a[1], b[2]), jet.multiply(a[2], b[1])),
        jet.subtract(jet.multiply(a[2], b[0]), jet.multiply(a[0], b[2])),
        jet.subtract(jet.multiply(a[0], b[1]), jet.multiply(a[1], b[0])),
    )


@njit(cache=True, nogil=True, error_model='numpy')  # not finite where the tool points down
def side_jets(o: VectorJet, spin: Jet) -> VectorJet:
    """Return the jets of the side of a tool along ``o``, turned about it by ``spin`` [rad].

    At spin zero it is part X, carried along by the least turn from part Z to o.
    """
    share = jet.divide(o[0], (1.0 + o[2][0], o[2][1], o[2][2], o[2][3]))
    x = (
        jet.subtract(jet.constant(1.0), jet.multiply(share, o[0])),
        jet.scale(jet.multiply(share, o[1]), -1.0),
        jet.scale(o[0], -1.0),
    )
    y = crossed(o, x)
    s, c = jet.sine_cosine(spin)
    return (
        jet.add(jet.multiply(x[0], c), jet.multiply(y[0], s)),
        jet.add(jet.multiply(x[1], c), jet.multiply(y[1], s)),
        jet.add(jet.multiply(x[2], c), jet.multiply(y[2], s)),
    )


@njit(cache=True, nogil=True)
def tool_jets(packed: FloatArray, q: FloatArray, last: int) -> FloatArray:
    """Return the jets of tip [m], side and axis of the tool, (3, 3, 4), for jets (4, n) of q.

    ``last``: the highest coefficient that is known.
    """
    n = q.shape[1]
    tool, turn, before = np.zeros((3, 3, 4)), np.empty((3, 3, 4)), np.empty((3, 4))
    for i in range(3):
        tool[0, i, 0], tool[1, i, 0] = packed[n, TIP + i], packed[n, SIDE + i]
        tool[2, i, 0] = packed[n + 1, AXIS + i]
    for back in range(n):
        k = n - 1 - back
        joint = packed[k]
        s, c = jet.sine_cosine((q[0, k], q[1, k], q[2, k], q[3, k]))
        for i in range(3):
            for j in range(3):
                along, across = joint[i] * joint[j], skew(joint, i, j)
                same = 1.0 if i == j else 0.0
                for m in range(last + 1):
                    turn[i, j, m] = c[m] * (same - along) + s[m] * across
                turn[i, j, 0] += along
        for v in range(3):
            before[:] = tool[v]
            if v == 0:
                before[:, 0] -= joint[POINT]
            for i in range(3):
                for m in range(last + 1):
                    total = 0.0
                    for j in range(3):
                        for order in range(m + 1):
                            total += turn[i, j, order] * before[j, m - order]
                    tool[v, i, m] = total
            if v == 0:
                tool[0, :, 0] += joint[POINT]
    return tool


@njit(cache=True, nogil=True)
def misfit(tool: FloatArray, wanted: FloatArray, reach: float, k: int, first: int) -> FloatArray:
    """Return coefficient k of wanted minus found pose, (6,): tip over reach, turn [-].

    Both are jets of tip, side and axis, (3, 3, 4). If all lower orders agree, a turn d moves the
    sum of r x e over side and axis (``first`` 1) by d + y (y . d), with y across both. For the
    axis alone (``first`` 2) it moves by the part of d across the axis.
    """
    found, y = np.zeros(6), np.empty(3)
    for i in range(3):
        j, m = (i + 1) % 3, (i + 2) % 3
        found[i] = (wanted[0, i, k] - tool[0, i, k]) / reach
        y[i] = tool[2, j, 0] * tool[1, m, 0] - tool[2, m, 0] * tool[1, j, 0]
        for v in range(first, 3):
            for order in range(k + 1):
                found[3 + i] += tool[v, j, order] * wanted[v, m, k - order]
                found[3 + i] -= tool[v, m, order] * wanted[v, j, k - order]
    if first == 1:
        along = 0.5 * (y[0] * found[3] + y[1] * found[4] + y[2] * found[5])
        for i in range(3):
            found[3 + i] -= along * y[i]
    return found


@njit(cache=True, nogil=True)
def joint_jets(
    packed: FloatArray,
    p: VectorJet,
    o: VectorJet,
    near: FloatArray,
    sense: float,
    leads: int,
    lead: Jet,
) -> tuple[FloatArray, float]:
    """Return the joints with three Taylor coefficients, (4, n), for jets of tip and tool axis.

    ``lead`` is the jet of the sixth degree of freedom: of joint ``leads``, or of the spin if that
    is ``NO_JOINT``. Newton's method begins at ``near`` (n,). The returned measure is the square of
    the smallest pivot of the pose rates. It is ``UNSOLVED`` out of reach. It is ``REVERSED`` if
    the sign of their determinant differs from ``sense``, because a singular pose then lies
    between;
    ``sense`` 0 accepts both signs.
    """
    n, spins = len(near), leads == NO_JOINT
    q, order = np.zeros((4, n)), np.empty(n)
    q[0] = near
    if spins and o[2][0] < LEAST_UPRIGHT - 1.0:
        return q, UNSOLVED
    first, side = 2, o
    if spins:
        first, side = 1, side_jets(o, lead)
    else:
        for k in range(4):
            q[k, leads] = lead[k]
    wanted, reach = np.array((p, side, o)), packed[n + 1, REACH]
    size, last, tool = np.inf, False, np.zeros((3, 3, 4))
    for _ in range(STEPS):
        tool[:, :, 0], rates = posture(packed, q[0])
        if not spins:  # the turn about the axis takes the place of that joint
            for i in range(3):
                rates[i, leads], rates[3 + i, leads] = 0.0, tool[2, i, 0]
        gap = misfit(tool, wanted, reach, 0, first)
        size, before = np.sqrt((gap * gap).sum()), size
        least, sign = factorised(rates, order)
        if least == 0.0:
            return q, REVERSED
        if last or size == 0.0:
            break
        last = size < ENDED or (size < 1e3 * ENDED and size >= before)
        solved(rates, order, gap)
        longest = np.abs(gap).max()
        gap *= min(1.0, LONGEST / max(longest, LONGEST))
        for j in range(n):
            if j != leads:
                q[0, j] += gap[j]
    alike = 0.0  # 2, or below 0 where half a turn lies between, which is no misfit either
    for i in range(3):
        alike += tool[first, i, 0] * wanted[first, i, 0] + tool[2, i, 0] * wanted[2, i, 0]
    if alike < 1.0 or (not last and size > 0.0):
        return q, UNSOLVED
    for k in range(1, 4):
        if k > 1 or not spins:
            tool = tool_jets(packed, q, k)
        gap = misfit(tool, wanted, reach, k, first)
        solved(rates, order, gap)
        for j in range(n):
            if j != leads:
                q[k, j] = gap[j]
    return q, REVERSED if sense * sign < 0.0 else least * least


@njit(cache=True, nogil=True, inline='always')
def spin_of(packed: FloatArray) -> Jet:
    return jet.constant(packed[ARM + 1, SPIN])


@njit(cache=True, nogil=True)
def carried(joint: FloatArray, p: VectorJet, o: VectorJet, w: Jet) -> tuple[VectorJet, VectorJet]:
    """Return the jets of a pose as seen beyond a further joint at w: S(w)^-1 of it."""
    u, a = (joint[0], joint[1], joint[2]), (joint[3], joint[4], joint[5])
    if joint[SLIDES] != 0.0:
        moved = (
            jet.subtract(p[0], jet.scale(w, u[0])),
            jet.subtract(p[1], jet.scale(w, u[1])),
            jet.subtract(p[2], jet.scale(w, u[2])),
        )
        return moved, o
    s, c = jet.sine_cosine(w)
    s = jet.scale(s, -1.0)
    arm = (
        jet.subtract(p[0], jet.constant(a[0])),
        jet.subtract(p[1], jet.constant(a[1])),
        jet.subtract(p[2], jet.constant(a[2])),
    )
    turned = jet.rotated(u, s, c, arm)
    back = (
        jet.add(turned[0], jet.constant(a[0])),
        jet.add(turned[1], jet.constant(a[1])),
        jet.add(turned[2], jet.constant(a[2])),
    )
    return back, jet.rotated(u, s, c, o)


@njit(cache=True, nogil=True)
def seen(
    packed: FloatArray, tip: FloatArray, axis: FloatArray, beside: FloatArray, back: bool
) -> tuple[FloatArray, FloatArray]:
    """Return poses (m, 3) as the arm sees them, with further joints at (m, k); or the way back."""
    tips, axes, still = tip.copy(), axis.copy(), np.zeros(3)
    for i in range(len(tip)):
        for j in range(beside.shape[1]):
            k, sense = (beside.shape[1] - 1 - j, -1.0) if back else (j, 1.0)
            p, o = pose_jets(tips[i], axes[i], still, still)
            p, o = carried(packed[BESIDE + k], p, o, jet.constant(sense * beside[i, k]))
            for c in range(3):
                tips[i, c], axes[i, c] = p[c][0], o[c][0]
    return tips, axes


@njit(cache=True, nogil=True)
def forward(packed: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return tool tips [m] and axes [-], shape (m, 3), of joint positions (m, n)."""
    tip, axis = np.empty((len(q), 3)), np.empty((len(q), 3))
    for i in range(len(q)):
        tool = posture(packed, q[i, :ARM])[0]
        tip[i], axis[i] = tool[0], tool[2]
    return seen(packed, tip, axis, q[:, ARM:], True)


@njit(cache=True, nogil=True)
def pose_jets(
    tip: FloatArray, axis: FloatArray, step: FloatArray, slope: FloatArray
) -> tuple[VectorJet, VectorJet]:
    """Return the jets of a pose (3,) with its first derivatives."""
    return (
        (tip[0], step[0], 0.0, 0.0),
        (tip[1], step[1], 0.0, 0.0),
        (tip[2], step[2], 0.0, 0.0),
    ), (
        (axis[0], slope[0], 0.0, 0.0),
        (axis[1], slope[1], 0.0, 0.0),
        (axis[2], slope[2], 0.0, 0.0),
    )


@njit(cache=True, nogil=True)
def solutions(
    packed: FloatArray, tip: FloatArray, axis: FloatArray, seeds: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Solve a pose from seeds (m, n); return joints (m, n) in (-pi, pi], and measures (m,)."""
    still = np.zeros(3)
    p, o = pose_jets(tip, axis, still, still)
    found, measure = np.empty_like(seeds), np.empty(len(seeds))
    for i in range(len(seeds)):
        q, measure[i] = joint_jets(packed, p, o, seeds[i], 0.0, NO_JOINT, spin_of(packed))
        for j in range(seeds.shape[1]):
            found[i, j] = q[0, j] - 2.0 * pi * np.ceil(q[0, j] / (2.0 * pi) - 0.5)
    return found, measure


@njit(cache=True, nogil=True)
def followed(
    packed: FloatArray, tip: FloatArray, axis: FloatArray, start: FloatArray
) -> tuple[FloatArray, float]:
    """Follow poses (m, 3) from joints near the first one; return joints (m, n), least measure.

    Following ends at a pose that is out of reach, or beyond a singular pose.
    """
    q, least, sense = np.empty((len(tip), len(start))), np.inf, 0.0
    near, still, order = start.copy(), np.zeros(3), np.empty(len(start))
    for i in range(len(tip)):
        p, o = pose_jets(tip[i], axis[i], still, still)
        found, measure = joint_jets(packed, p, o, near, sense, NO_JOINT, spin_of(packed))
        least = min(least, measure)
        if measure <= 0.0:
            return q[:i], least
        if sense == 0.0:
            sense = factorised(posture(packed, found[0])[1], order)[1]
        near = found[0]
        q[i] = near
    return q, least


@njit(cache=True, nogil=True)
def rates(
    packed: FloatArray,
    home: FloatArray,
    beside: FloatArray,
    tip: FloatArray,
    axis: FloatArray,
    step: FloatArray,
    turn: FloatArray,
) -> FloatArray:
    """Return q_s of the joints nearest to ``home``, (m, n); rows as in ``Transform.rates``.

    Further joints rest at ``beside`` (k,).
    """
    found = np.full((len(tip), len(home)), np.nan)
    for i in range(len(tip)):
        o, w = axis[i], turn[i]
        slope = np.array(
            [w[1] * o[2] - w[2] * o[1], w[2] * o[0] - w[0] * o[2], w[0] * o[1] - w[1] * o[0]]
        )
        p, tool = pose_jets(tip[i], o, step[i], slope)
        for k in range(len(beside)):
            p, tool = carried(packed[BESIDE + k], p, tool, jet.constant(beside[k]))
        q, measure = joint_jets(packed, p, tool, home, 0.0, NO_JOINT, spin_of(packed))
        if measure > 0.0:
            found[i] = q[1]
    return found
