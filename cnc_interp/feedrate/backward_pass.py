"""The largest squared speed at which the rest of a path can be followed: toppra's linear programs.

The backward pass of TOPP-RA [PP2018, Algorithm 1] with ``seidel``. The unknowns of a step are
b = s_dot^2 at its start and the change of b, divided by the largest b, so that the result does not
depend on the units.
"""

import sys
from importlib.util import find_spec
from typing import Any

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.core.late_package import LatePackage

if 'toppra' not in sys.modules and (_spec := find_spec('toppra')) is not None:
    sys.modules['toppra'] = LatePackage(_spec)  # its plots (matplotlib) take a second

from toppra.constraint import LinearConstraint
from toppra.interpolator import AbstractGeometricPath
from toppra.solverwrapper.cy_seidel_solverwrapper import seidelWrapper

ROUNDING = 1e-7  #: Share of the largest b that is added, because the solver's tolerance is fixed.


class _Steps(AbstractGeometricPath):  # type: ignore[misc]
    """A path of n steps in the form that toppra expects; the rows contain its geometry."""

    def __init__(self, n: int):
        self.n = n

    @property
    def path_interval(self) -> FloatArray:
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


class BackwardPass:
    """The linear programs of the steps between points of a path; each is solved alone."""

    def __init__(self, start: FloatArray, end: FloatArray, cap: FloatArray):
        self._largest = float(cap.max())
        self._scaled = cap / self._largest
        rows = _Rows(start * self._largest, end * self._largest, self._scaled)
        n = len(start)
        self._solver = seidelWrapper([rows], _Steps(n), 0.5 * np.arange(n + 1))
        self._solver.setup_solver()
        self._fastest = np.array([-1e-9, -1.0])

    def largest(self, i: int, after: float) -> float:
        """Return the largest b at point i from which b can fall to ``after`` at the next point."""
        b = self._solver.solve_stagewise_optim(
            i, None, self._fastest, np.nan, np.nan, 0.0, after / self._largest
        )[1]
        cap = float(self._scaled[i])
        return self._largest * (min(cap, b + ROUNDING) if np.isfinite(b) else cap)
