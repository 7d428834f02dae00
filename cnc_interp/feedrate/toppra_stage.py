"""
The toppra stage: time-optimal under programmed feed, velocity and acceleration, without jerk.

The squared speed from TOPP-RA [PP2018] is an upper bound of the jerk-limited law, up to the
discretisation. ``PlanOptions.toppra`` starts the jerk stage below it. TOPP-RA takes longer than
the jerk stage, and the guess of ``speed_guess`` is as good a start. Therefore it is used only
when a window is planned a second time. All values are SI, the solver is ``seidel`` and the grid
points are given, because toppra's default grid and speed limit depend on the unit of length.
"""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
from toppra.algorithm import TOPPRA
from toppra.constraint import DiscretizationType, JointAccelerationConstraint, LinearConstraint
from toppra.interpolator import AbstractGeometricPath

from cnc_interp.core.arrays import FloatArray
from cnc_interp.feedrate.limits import AxisLimits, limit_table
from cnc_interp.feedrate.speed_guess import FASTEST, speed_bounds
from cnc_interp.kinematics.axis_path import AxisPath

logging.getLogger('toppra').setLevel(logging.ERROR)


class GridPath(AbstractGeometricPath):  # type: ignore[misc]
    """An AxisPath in the interface of toppra; it can be evaluated only at the grid points."""

    def __init__(self, path: AxisPath):
        self.s = path.s
        self.jets = np.concatenate([path.cell_left, path.cell_right[:, -1:]], axis=1)

    def __call__(self, path_positions: Any, order: int = 0) -> FloatArray:
        """
        Return q (order 0), q_s (order 1) or q_ss (order 2) at grid points.

        Parameters
        ----------
        path_positions : array_like, shape (k,) or scalar
            Path positions, equal to grid points [m].
        order : int
            Order of the derivative, 0 to 2.

        Returns
        -------
        ndarray, shape (k, n_axes) or (n_axes,)
            Values of the axes [m or rad, per m to the power ``order``].

        """
        found = np.searchsorted(self.s, np.asarray(path_positions) - 1e-15)
        row: FloatArray = self.jets[order, np.minimum(found, len(self.s) - 1)]
        return row

    @property
    def dof(self) -> int:
        """Return the number of axes."""
        return int(self.jets.shape[2])

    @property
    def path_interval(self) -> FloatArray:
        """Return the path positions of start and end, shape (2,) [m]."""
        return self.s[[0, -1]]


class SpeedConstraint(LinearConstraint):  # type: ignore[misc]
    """Upper limit of s_dot at every grid point, from feed and axis velocities [m/s]."""

    def __init__(self, cap: FloatArray):
        super().__init__()
        self.cap = cap

    def compute_constraint_params(self, path: Any, gridpoints: Any, *args: Any) -> Any:
        """Return the bounds 0 <= s_dot^2 <= cap^2; all other terms of toppra are None."""
        bound = np.column_stack([np.zeros_like(self.cap), self.cap**2])
        return None, None, None, None, None, None, bound


def ceiling(
    path: AxisPath, limits: AxisLimits | FloatArray, v_start: float = 0.0
) -> FloatArray | None:
    """
    Plan the fastest motion to rest at the end of the path, without jerk limits [PP2018].

    Parameters
    ----------
    path : AxisPath
        Path without stops inside, with N grid points. TOPP-RA uses these grid points.
    limits : AxisLimits or ndarray, shape (3, n_axes)
        Limits of the axes. Only velocity and acceleration limits are used.
    v_start : float
        s_dot at the start of the path [m/s].

    Returns
    -------
    ndarray, shape (N,), or None
        s_dot^2 at the grid points [m2/s2]. None if toppra finds no solution from this start.

    """
    table = limits if isinstance(limits, np.ndarray) else limit_table(limits)
    h = np.diff(path.s)
    fast = speed_bounds(h, path.cell_left, path.cell_right, path.cell_feed, table)[:, 0]
    cap = np.minimum(np.append(fast, FASTEST), np.append(FASTEST, fast))
    rows = JointAccelerationConstraint(
        np.column_stack([-table[1], table[1]]), DiscretizationType.Collocation
    )
    problem = TOPPRA(
        [SpeedConstraint(cap), rows],
        GridPath(path),
        gridpoints=path.s,
        solver_wrapper='seidel',
    )
    _, s_dot, _ = problem.compute_parameterization(v_start, 0.0)
    if s_dot is None or not np.all(np.isfinite(s_dot)):
        return None
    squared: FloatArray = np.asarray(s_dot, dtype=np.float64) ** 2
    return squared
