"""
The toppra stage: the squared speed from which a path can be driven on, node by node.

It is the backward pass of TOPP-RA [PP2018, Algorithm 1]; the linear programs are solved by
toppra's ``seidel``. The unknowns of a step are b = s_dot^2 at its start and the change of b over
it, both divided by the largest b. So they lie between -1 and 1, whatever the unit of length is.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

import numpy as np

from cnc_interp.core.arrays import FloatArray

# toppra imports matplotlib for its plots, which takes longer than all the rest. It gets a module
# without content instead, unless matplotlib is there already.
_PLOTS = [name for name in ('matplotlib', 'matplotlib.pyplot') if name not in sys.modules]
for _name in _PLOTS:
    sys.modules[_name] = ModuleType(_name)
if _PLOTS:
    sys.modules['matplotlib'].pyplot = sys.modules['matplotlib.pyplot']  # type: ignore[attr-defined]
try:
    from toppra.constraint import LinearConstraint
    from toppra.interpolator import AbstractGeometricPath
    from toppra.solverwrapper.cy_seidel_solverwrapper import seidelWrapper
finally:
    for _name in _PLOTS:
        del sys.modules[_name]

ROUNDING = 1e-7
"""Share of the largest b that is added, because the solver compares with fixed small numbers."""


class _Steps(AbstractGeometricPath):  # type: ignore[misc]
    """A path of n steps as toppra wants it; its geometry stands in the rows."""

    def __init__(self, n: int):
        self.n = n

    @property
    def path_interval(self) -> FloatArray:
        """Return the interval of the path variable: half a unit for each step."""
        return np.array([0.0, 0.5 * self.n])


class _Rows(LinearConstraint):  # type: ignore[misc]
    """Rows |change e_1 + b (e_1 - e_0)| <= 1 with b <= cap; e are squares of q_s."""

    def __init__(self, start: FloatArray, end: FloatArray, cap: FloatArray):
        super().__init__()
        self.identical = True
        self.change = np.vstack([end, np.zeros_like(end[:1])])
        self.b = np.vstack([end - start, np.zeros_like(end[:1])])
        self.cap = cap

    def compute_constraint_params(self, path: Any, gridpoints: Any, *args: Any) -> Any:
        """Return a, b, c, F, g, no bounds of the change, and the bounds of b."""
        axes = self.b.shape[1]
        both = np.vstack([np.eye(axes), -np.eye(axes)])
        bounds = np.column_stack([np.zeros_like(self.cap), self.cap])
        return self.change, self.b, np.zeros_like(self.b), both, np.ones(2 * axes), None, bounds


def controllable(start: FloatArray, end: FloatArray, cap: FloatArray) -> FloatArray:
    """Return the largest squared speeds from which the rest of a path can be driven."""
    largest = float(cap.max())
    scaled = cap / largest
    n = len(start)
    rows = _Rows(start * largest, end * largest, scaled)
    solver = seidelWrapper([rows], _Steps(n), 0.5 * np.arange(n + 1))
    fastest = np.array([-1e-9, -1.0])
    found = scaled.copy()
    solver.setup_solver()
    for i in range(n - 1, -1, -1):
        b = solver.solve_stagewise_optim(i, None, fastest, np.nan, np.nan, 0.0, found[i + 1])[1]
        if np.isfinite(b):
            found[i] = min(found[i], b + ROUNDING)
    solver.close_solver()
    squared: FloatArray = found * largest
    return squared
