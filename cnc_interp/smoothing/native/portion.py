"""A pair of cubic B-splines with one knot vector: a portion of a 5-axis path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.bspline import cubic_bezier_points
from cnc_interp.smoothing.native.joining import Jets, span_jets

if TYPE_CHECKING:
    from scipy.interpolate import BSpline


@dataclass(frozen=True)
class Portion:
    """A pair of cubic B-splines with one clamped knot vector, one row for each control point."""

    #: (n, 3): Control points of tool tip and second point [m].
    bottom: FloatArray
    top: FloatArray
    #: (n,): Knot interval of each control point: t_(i+3) - t_(i+2) of row i. It is 0 in the first
    #: and in the last two rows.
    knot_interval: FloatArray

    @property
    def knots(self) -> FloatArray:
        """The knots from 0, shape (n + 4,)."""
        inner = np.cumsum(self.knot_interval)
        return np.concatenate([np.zeros(3), inner, inner[-1:]])

    @property
    def curve(self) -> BSpline:
        """Tip and second point as one spline of u with six coordinates [m]."""
        from scipy.interpolate import BSpline  # takes a tenth of a second

        return BSpline(self.knots, np.hstack([self.bottom, self.top]), 3)

    def end_span(self, at_end: bool) -> tuple[FloatArray, FloatArray, float]:
        """Return Bezier points, shape (1, 4, 3), of the span at one end, inward; its length."""
        step = self.knot_interval[1:4] if not at_end else self.knot_interval[-3:-6:-1]
        ends = np.cumsum(np.concatenate([step, np.zeros(3)]))[:3]  # a lone span has two
        knots = np.concatenate([np.zeros(3), ends])[None]
        rows = slice(None, 4) if not at_end else slice(None, -5, -1)
        bottom, top = (
            cubic_bezier_points(points[rows][None], knots) for points in (self.bottom, self.top)
        )
        return bottom, top, float(step[0])

    def jets(self, at_end: bool) -> Jets:
        """Return the jets at the start or the end, in the direction of motion."""
        bottom, top, _ = self.end_span(at_end)
        jets = span_jets(bottom, top, np.zeros((1, 4, 3)))
        return jets.backwards() if at_end else jets
