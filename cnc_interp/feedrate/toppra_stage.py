"""
The toppra stage: time-optimal under programmed feed, velocity and acceleration, jerk left out.

Its squared speed is a ceiling of the jerk-limited law (to discretisation), and can bound the start
of the jerk stage: ``PlanOptions.toppra``. It takes longer than the jerk stage itself, whose own
first guess is as good a start, so windows use it only when they are tried again. Always SI, solver
``seidel`` and our own grid points: toppra's default grid and its internal speed cap depend on the
unit of length.
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
    """An AxisPath as toppra sees it: derivatives at the grid points, nothing in between."""

    def __init__(self, path: AxisPath):
        self.s = path.s
        self.jets = np.concatenate([path.cell_left, path.cell_right[:, -1:]], axis=1)

    def __call__(self, path_positions: Any, order: int = 0) -> FloatArray:
        """Look up value, first or second derivative at grid points."""
        found = np.searchsorted(self.s, np.asarray(path_positions) - 1e-15)
        row: FloatArray = self.jets[order, np.minimum(found, len(self.s) - 1)]
        return row

    @property
    def dof(self) -> int:
        """Count the axes."""
        return int(self.jets.shape[2])

    @property
    def path_interval(self) -> FloatArray:
        """Tell where the path begins and ends."""
        return self.s[[0, -1]]


class SpeedConstraint(LinearConstraint):  # type: ignore[misc]
    """A bound of s_dot at every grid point: programmed feed and velocity limits of the axes."""

    def __init__(self, cap: FloatArray):
        super().__init__()
        self.cap = cap

    def compute_constraint_params(self, path: Any, gridpoints: Any, *args: Any) -> Any:
        """Bound x = s_dot^2, nothing else."""
        bound = np.column_stack([np.zeros_like(self.cap), self.cap**2])
        return None, None, None, None, None, None, bound


def ceiling(
    path: AxisPath, limits: AxisLimits | FloatArray, v_start: float = 0.0
) -> FloatArray | None:
    """
    Plan with toppra from a speed to rest at the end of the path.

    Parameters
    ----------
    path : AxisPath
        Path without inner stops, N grid points: its grid is toppra's.
    limits : AxisLimits or ndarray, shape (3, n_axes)
        Limits of the axes; those of velocity and acceleration are used.
    v_start : float
        s_dot at its start [m/s].

    Returns
    -------
    ndarray, shape (N,), or None
        s_dot^2 at the grid points [m2/s2]; None where toppra finds the start infeasible.

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
