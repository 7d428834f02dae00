"""Grid points where a limit of an axis has a kink: at places of its table, or where it turns."""

from __future__ import annotations

import numba
import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.limit_table import DRIVE, PLACE, has_loads
from cnc_interp.kinematics.axis_path import AxisPath, refine, septic_coefficients, septic_value

NEAR = 1e-6
"""A kink nearer to a border of its cell gets no grid point, as a part of the cell [-]."""


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _kinks(s: FloatArray, left: FloatArray, right: FloatArray, table: FloatArray) -> FloatArray:
    """
    Return the path positions inside cells at which an axis passes a kink of its limits [m].

    These are the places of its table, and velocity zero if it has a largest torque.
    """
    found = [0.0 for _ in range(0)]
    c, jet = np.empty(8), np.empty(4)
    for i in range(left.shape[1]):
        h = s[i + 1] - s[i]
        for k in range(left.shape[2]):
            septic_coefficients(left[:, i, k], right[:, i, k], h, c)
            turns = table[DRIVE, k, 0] < np.inf and left[1, i, k] * right[1, i, k] < 0.0
            for p in range(table.shape[2] + int(turns)):
                order = int(p == table.shape[2])
                place = 0.0 if order else table[PLACE, k, p]
                start, end = left[order, i, k], right[order, i, k]
                if (place - start) * (end - place) <= 0.0:
                    continue
                low, high = 0.0, 1.0
                for _ in range(60):
                    u = 0.5 * (low + high)
                    septic_value(c, u, h, jet)
                    if (jet[order] < place) == (start < end):
                        low = u
                    else:
                        high = u
                if NEAR < low < 1.0 - NEAR:
                    found.append(s[i] + low * h)
    return np.array(found)


def with_kinks(path: AxisPath, table: FloatArray) -> AxisPath:
    """
    Add grid points where the limits of an axis have a kink, so that they are linear in each cell.

    Without the points, a cell as long as a block would hide a low limit in its middle. The torque
    that Coulomb friction leaves jumps where the axis turns.
    """
    if (table.shape[2] == 1 and not has_loads(table)) or len(path.s) < 2:
        return path
    return refine(path, _kinks(path.s, path.cell_left, path.cell_right, table))
