"""The map between nominal and commanded axes of a machine with geometric errors.

A chain of frames leads from the workpiece to the tool. Axis a moves its frame by c_a; its errors
at c_a turn all that it carries by w_a about a place p_a, and displace it by d_a. The place is
where the tip was while a was measured, less what a and the axes before it moved. From the tool to
the workpiece, with v the tip in the frame of a:

    l = v - p_a,   v <- v + d_a + w_a x l + w_a x (w_a x l) / 2 + c_a

So commanded axes c reach the *nominal* axes c + D(c), with D the sum of all that errors add: an
ideal machine has its tip there. The inverse is the limit of c = q - D(q - D(q - ...)). Errors
change slowly with the position, so that each step makes the rest hundreds of times smaller.

Rotary axes are not changed: the tool axis keeps its error, and no pole makes corrections large.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial

import numpy as np

from cnc_interp.core import FloatArray, jet
from cnc_interp.core.jet import Jet, VectorJet
from cnc_interp.core.kernels import njit
from cnc_interp.machine_model import five_axis_kernels as kernel
from cnc_interp.machine_model.geometric_errors import DEGREE, GeometricErrors

#: Places in the packed errors: X Y Z by their numbers from the tool to the workpiece, (3, 3) the
#: place p of each [m], the length of the tool [m], and of each axis where its table begins and of
#: how many pieces it is. A table has the ends of its pieces, and of each piece the coefficients of
#: six polynomials in the distance from its beginning, from the lowest on.
CHAIN, PLACE, LENGTH, BEGINS, PIECES, HEAD = 0, 3, 12, 13, 16, 19
FUNCTIONS, ORDERS = 6, DEGREE + 1
STEPS = 3  #: Steps of the inverse along a path; what is left is below 1e-9 m.
STEPS_AT_REST = 8  #: Of single positions; what is left is rounding.
OFF = np.zeros(0)  #: The packed errors of a machine that has none.


def packed_errors(errors: GeometricErrors | None) -> FloatArray:
    if errors is None:
        return OFF
    head, parts, place = np.zeros(HEAD), [], HEAD
    for a, table in enumerate(errors.tables):
        spline = table.spline
        ends = spline.t[DEGREE : len(spline.t) - DEGREE]
        orders = [spline(ends[:-1], order) / factorial(order) for order in range(ORDERS)]
        rows = np.stack(orders, axis=2)  # (pieces, functions, orders)
        parts += [ends, rows.ravel()]
        head[BEGINS + a], head[PIECES + a] = place, len(rows)
        place += len(rows) + 1 + rows.size
        for i in errors.chain[errors.chain.index(a) + 1 :]:
            head[PLACE + 3 * a + i] = errors.measured_at[a, i]
    head[CHAIN : CHAIN + 3] = errors.chain[::-1]
    head[LENGTH] = errors.tool_length
    return np.concatenate([head, *parts])


@njit(cache=True, nogil=True)
def table_jets(errors: FloatArray, a: int, x: Jet) -> FloatArray:
    """Return the jets of the six errors of an axis where it moves as ``x``, (6, 4) [m, rad]."""
    begins, pieces = int(errors[BEGINS + a]), int(errors[PIECES + a])
    ends = errors[begins : begins + pieces + 1]
    i = min(max(int(np.searchsorted(ends, x[0], 'right')) - 1, 0), pieces - 1)
    inside = ends[0] <= x[0] <= ends[pieces]
    t = min(max(x[0], ends[0]), ends[pieces]) - ends[i]
    found = np.empty((FUNCTIONS, 4))
    for k in range(FUNCTIONS):
        at = begins + pieces + 1 + (FUNCTIONS * i + k) * ORDERS
        c0 = c1 = c2 = c3 = 0.0
        for order in range(DEGREE, -1, -1):
            c3 = c3 * t + c2
            c2 = c2 * t + c1
            c1 = c1 * t + c0
            c0 = c0 * t + errors[at + order]
        if not inside:
            c1 = c2 = c3 = 0.0
        found[k] = jet.compose((c0, c1, c2, c3), x)
    return found


@njit(cache=True, nogil=True)
def spacing(errors: FloatArray, a: int) -> float:
    """Return the mean distance of the nodes of a table [m]."""
    begins, pieces = int(errors[BEGINS + a]), int(errors[PIECES + a])
    return float((errors[begins + pieces] - errors[begins]) / pieces)


@njit(cache=True, nogil=True)
def tool_jets(errors: FloatArray, geometry: FloatArray, q: FloatArray) -> VectorJet:
    """Return the jets of the tip in the frame that X Y Z carry [m], for axes (4, 5 + k)."""
    extra = np.zeros((4, 3))
    for k in range(q.shape[1] - 5):
        for i in range(3):
            extra[:, i] += geometry[kernel.SIZE + 3 * k + i] * q[:, 5 + k]
    x, y, z = taylor(extra, 0), taylor(extra, 1), taylor(extra, 2)
    zero = jet.constant(0.0)
    arm = (zero, zero, jet.constant(errors[LENGTH]))
    first_on_head = geometry[kernel.ON_HEAD] > 0.5
    second_on_head = geometry[kernel.ON_HEAD + 1] > 0.5
    if first_on_head or second_on_head:
        arm = kernel.moved(arm, geometry, kernel.TIP_ARM)
        if second_on_head:
            s, c = jet.sine_cosine(taylor(q, 4))
            arm = jet.rotated(kernel.vector_at(geometry, kernel.SECONDARY), s, c, arm)
        arm = kernel.moved(arm, geometry, kernel.HEAD_ARM)
        if first_on_head:
            s, c = jet.sine_cosine(taylor(q, 3))
            arm = jet.rotated(kernel.vector_at(geometry, kernel.PRIMARY), s, c, arm)
        x, y, z = kernel.moved((x, y, z), geometry, kernel.HEAD_ZERO)
    return jet.subtract(x, arm[0]), jet.subtract(y, arm[1]), jet.subtract(z, arm[2])


@njit(cache=True, nogil=True)
def taylor(q: FloatArray, i: int) -> Jet:
    """Return the jet of an axis of derivatives (4, n)."""
    return (q[0, i], q[1, i], 0.5 * q[2, i], q[3, i] / 6.0)


@njit(cache=True, nogil=True)
def crossed(a: VectorJet, b: VectorJet) -> VectorJet:
    return (
        jet.subtract(jet.multiply(a[1], b[2]), jet.multiply(a[2], b[1])),
        jet.subtract(jet.multiply(a[2], b[0]), jet.multiply(a[0], b[2])),
        jet.subtract(jet.multiply(a[0], b[1]), jet.multiply(a[1], b[0])),
    )


@njit(cache=True, nogil=True)
def displacement(errors: FloatArray, geometry: FloatArray, c: FloatArray) -> FloatArray:
    """Return D and three derivatives by path length, (4, 3) [m], for those of axes (4, 5 + k)."""
    x, y, z = tool_jets(errors, geometry, c)
    found, moved = np.zeros((3, 4)), np.zeros((3, 4))
    for place in errors[CHAIN : CHAIN + 3]:
        a = int(place)
        at = taylor(c, a)
        e = table_jets(errors, a, at)
        lever = moved + found
        for i, tool in enumerate((x, y, z)):
            lever[i] += np.array(tool)
            lever[i, 0] -= errors[PLACE + 3 * a + i]
        turn = vector_of(e[3:])
        once = crossed(turn, vector_of(lever))
        twice = crossed(turn, once)
        for i in range(3):
            found[i] += e[i] + np.array(once[i]) + 0.5 * np.array(twice[i])
        moved[a] += np.array(at)
    out = found.T.copy()
    out[2] *= 2.0
    out[3] *= 6.0
    return out


@njit(cache=True, nogil=True)
def vector_of(rows: FloatArray) -> VectorJet:
    return (
        (rows[0, 0], rows[0, 1], rows[0, 2], rows[0, 3]),
        (rows[1, 0], rows[1, 1], rows[1, 2], rows[1, 3]),
        (rows[2, 0], rows[2, 1], rows[2, 2], rows[2, 3]),
    )


@njit(cache=True, nogil=True)
def commanded(errors: FloatArray, geometry: FloatArray, q: FloatArray, steps: int) -> FloatArray:
    """Return commanded axes and three derivatives, (4, 5 + k), for nominal ones."""
    found = q.copy()
    for _ in range(steps):
        found[:, :3] = q[:, :3] - displacement(errors, geometry, found)
    return found


@njit(cache=True, nogil=True)
def mapped(
    errors: FloatArray, geometry: FloatArray, rows: FloatArray, own: int, inverse: bool
) -> FloatArray:
    """Map rows of axes (n, own + k), commanded to nominal ones or by the inverse."""
    out, count = rows.copy(), rows.shape[1]
    q = np.zeros((4, 5 + count - own))
    for row in range(len(rows)):
        q[0, :own], q[0, 5:] = rows[row, :own], rows[row, own:]
        if inverse:
            out[row, :3] = commanded(errors, geometry, q, STEPS_AT_REST)[0, :3]
        else:
            out[row, :3] += displacement(errors, geometry, q)[0]
    return out


@njit(cache=True, nogil=True)
def mapped_motion(
    errors: FloatArray, geometry: FloatArray, motion: FloatArray, own: int
) -> FloatArray:
    """Map nominal axes and their derivatives by time, (4, n, own + k), to commanded ones."""
    out, count = motion.copy(), motion.shape[2]
    q = np.zeros((4, 5 + count - own))
    for row in range(motion.shape[1]):
        q[:, :own], q[:, 5:] = motion[:, row, :own], motion[:, row, own:]
        out[:, row, :3] = commanded(errors, geometry, q, STEPS_AT_REST)[:, :3]
    return out


@dataclass(frozen=True)
class ErrorMap:
    """Rows of commanded axes to nominal ones and back; without errors, what was given."""

    packed: FloatArray  #: See ``packed_errors``.
    geometry: FloatArray  #: The geometry of the machine, as kernels have it.
    own: int  #: Axes before the extra axes.

    def nominal(self, c: FloatArray) -> FloatArray:
        """Return nominal axes (n, n_axes) for commanded ones [m, rad]."""
        return self._mapped(c, False)

    def commanded(self, q: FloatArray) -> FloatArray:
        """Return commanded axes (n, n_axes) for nominal ones [m, rad]."""
        return self._mapped(q, True)

    def motion(self, nominal: FloatArray) -> FloatArray:
        """Return commanded axes and three derivatives by time, (4, n, n_axes)."""
        if not len(self.packed):
            return nominal
        rows = np.ascontiguousarray(nominal)
        return np.asarray(mapped_motion(self.packed, self.geometry, rows, self.own))

    def _mapped(self, rows: FloatArray, inverse: bool) -> FloatArray:
        if not len(self.packed):
            return rows
        rows = np.ascontiguousarray(rows, dtype=float)
        return np.asarray(mapped(self.packed, self.geometry, rows, self.own, inverse))


NO_ERRORS = ErrorMap(OFF, OFF, 0)
