"""Enclose the path in an interval: every axis lies near a chord, within a known bound.

With t in [-1, 1] along the interval of s, axis j satisfies

    q_j(s) = c_j + a_j t + e_j,    |e_j| <= eps_j

where c + a t is the chord between the ends of the interval, shifted to the middle of the
deviations. A septic lies between the least and
the greatest of its Bezier values. Its deviation from the chord is also a septic, so the same
holds.
"""

from __future__ import annotations

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.core.kernels import njit
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.kinematics.path_checks import MIRROR, TO_BEZIER

DEGREE = 7


def bezier_table(path: AxisPath) -> FloatArray:
    """Return the Bezier values of all axes in all cells, (N - 1, n_axes, 8) [m, rad]."""
    powers = np.diff(path.s) ** np.arange(4.0)[:, None]
    left, right = (
        np.einsum('km,mca->kca', TO_BEZIER, scale[:, :, None] * end)
        for scale, end in ((powers, path.cell_left), (powers * MIRROR, path.cell_right))
    )
    values = np.concatenate([left, right[::-1]]).transpose(1, 2, 0)
    return np.ascontiguousarray(values)


@njit(cache=True, nogil=True)
def split(values: FloatArray, u: float, before: FloatArray, after: FloatArray) -> None:
    """Divide a Bezier polynomial at u (de Casteljau): write its values before and after."""
    after[:] = values
    for k in range(DEGREE + 1):
        before[k] = after[0]
        for i in range(DEGREE - k):
            after[i] += u * (after[i + 1] - after[i])


@njit(cache=True, nogil=True)
def part(values: FloatArray, u0: float, u1: float, out: FloatArray) -> None:
    """Write the Bezier values of the part from u0 to u1 of a cell, (8,)."""
    spare = np.empty(DEGREE + 1)
    out[:] = values
    if u1 < 1.0:
        split(values, u1, out, spare)
    if u0 > 0.0:
        kept = out.copy()
        split(kept, u0 / u1, spare, out)


@njit(cache=True, nogil=True)
def enclose(
    s: FloatArray,
    bezier: FloatArray,
    begin: float,
    end: float,
    first: int,
    last: int,
    out: FloatArray,
) -> None:
    """Write centre c, half-way a and bound eps of all axes, (3, n_axes), for s in an interval [m].

    ``first`` and ``last``: the first and last cell that the interval meets.
    """
    n = bezier.shape[1]
    values = np.empty(DEGREE + 1)
    u0 = (begin - s[first]) / (s[first + 1] - s[first])
    u1 = (end - s[last]) / (s[last + 1] - s[last])
    for j in range(n):
        part(bezier[first, j], u0, 1.0 if last > first else u1, values)
        start = values[0]
        if last > first:
            part(bezier[last, j], 0.0, u1, values)
        stop = values[DEGREE]
        low, high = 0.0, 0.0
        for cell in range(first, last + 1):
            whole = not ((cell == first and u0 > 0.0) or (cell == last and u1 < 1.0))
            left, right = max(begin, s[cell]), min(end, s[cell + 1])
            if not whole:
                part(
                    bezier[cell, j],
                    u0 if cell == first else 0.0,
                    u1 if cell == last else 1.0,
                    values,
                )
            row = bezier[cell, j] if whole else values
            chord = start + (stop - start) * (left - begin) / (end - begin)
            slope = (stop - start) * (right - left) / (end - begin) / DEGREE
            for k in range(DEGREE + 1):
                beside = row[k] - chord - slope * k
                low, high = min(low, beside), max(high, beside)
        middle = 0.5 * (low + high)
        out[0, j] = 0.5 * (start + stop) + middle
        out[1, j] = 0.5 * (stop - start)
        out[2, j] = 0.5 * (high - low)


@njit(cache=True, nogil=True)
def position(bezier: FloatArray, cell: int, u: float, out: FloatArray) -> None:
    """Write the axis positions at u in a cell, (n_axes,) [m, rad]."""
    values = np.empty(DEGREE + 1)
    for j in range(bezier.shape[1]):
        values[:] = bezier[cell, j]
        for k in range(DEGREE, 0, -1):
            for i in range(k):
                values[i] += u * (values[i + 1] - values[i])
        out[j] = values[0]
