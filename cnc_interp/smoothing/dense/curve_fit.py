"""One curve through a run of short blocks: fitted, certified and committed window by window."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.bezier import quintic_end_jet
from cnc_interp.core.bspline import clamped_knots, quintic_bezier_matrices, quintic_bezier_points
from cnc_interp.smoothing.dense import certificate, knots, polyline, tube_fit
from cnc_interp.smoothing.dense.path_rows import Spans
from cnc_interp.smoothing.dense.polyline import Polyline
from cnc_interp.smoothing.orientation import rotations_between
from cnc_interp.smoothing.pole import shares_near_pole

#: Longest and shortest spacing of knots, in tolerances.
LONGEST, FINEST = 100.0, 2.0
#: Spans in a window, spans committed of it, and most spans in the last window of a run.
WINDOW, COMMIT, LAST = 40, 20, 60
#: Smallest number of spans of a curve between its ends.
LEAST = 6
#: Distance after a window up to which the polyline influences its knots, in longest spacings.
AHEAD = 3.0
#: Attempts for a window, in order: fewest and most sweeps, aim, factor of the knot spacing.
ATTEMPTS = ((1, 40, 0.85, 1.0), (1, 80, 0.7, 1.0), (1, 60, 0.75, 0.5), (1, 60, 0.75, 0.25))


@dataclass(frozen=True)
class Window:
    """The result of a window."""

    spans: Spans | None  #: Spans to commit; None if no curve within the tolerances was found.
    axis: FloatArray  #: (3,): Tool axis at the end of these spans [-].
    last: bool  #: Whether the run ends there.
    worst: float  #: Curve parameter at which the deviation was too large [m].


class Run:
    """
    A run of short blocks, and the curve through it as far as it is committed.

    The polyline grows while blocks arrive. ``jet`` (m, 6) has value and derivatives at the start
    of the curve, divided by factorials of their order. Beside the direction ``pole`` the curve
    leaves a part of the orientation tolerance.
    """

    def __init__(
        self, line: Polyline, jet: FloatArray, turning: bool, height: float, longest: float,
        share: float, pole: FloatArray | None = None,
    ):  # fmt: skip
        self.line = self.whole = line
        self.turning = turning
        self.t = 0.0
        self.begun = self.ended = False
        self._jet, self._end_jet = jet, jet[:0]
        self._height, self._longest, self._share = height, longest, share
        self._pole = pole

    @property
    def passed(self) -> int:
        """Return the last skeleton vertex that the committed curve has passed, or -1."""
        known = self.line.vertex[: int(np.searchsorted(self.line.u, self.t, 'right'))]
        return int(known.max(initial=-1))

    def end(self, line: Polyline, jet: FloatArray) -> None:
        """Set the complete polyline, and value and derivatives at its end as in ``jet``."""
        self.whole, self.line = self.line, line
        self.ended, self._end_jet = True, jet

    def reopen(self, vertex: int) -> None:
        """Shorten the run to an earlier vertex; ``end`` must be called again."""
        line = self.whole if self.ended else self.line
        self.line = self.whole = line.upto(vertex)
        self.ended, self._end_jet = False, self._jet[:0]

    def shift(self, first: int) -> None:
        """Renumber the skeleton vertices after the first ones were dropped."""
        lines = [self.line] if self.whole is self.line else [self.line, self.whole]
        for line in lines:
            line.vertex = np.where(line.vertex >= 0, line.vertex - first, -1)

    def window(self, final: bool) -> Window | None:
        """Fit the next window, the last one if ``final``; None if more blocks are necessary."""
        if not final:
            self.whole = self.line
        line, end = self.line, float(self.line.u[-1])
        limit = end
        if not final:  # the spacing at a vertex depends on the vertices up to AHEAD after it
            known = int(np.searchsorted(line.u, end - AHEAD * self._longest, 'right')) - 1
            limit = float(line.u[max(known, 0)])
            if limit <= self.t:
                return None
        left = self._share * line.tolerance - line.used
        if self.turning and self._pole is not None:
            turn = rotations_between(line.axis[:-1], line.axis[1:])
            angle = line.tolerance[:, 1] / self._height
            left[:, 1] *= shares_near_pole(self._pole, line.axis[:-1], turn, angle)
        least = line.tolerance.min(axis=1)
        wanted = knots.knot_spacings(
            line.tip, line.axis, line.u, left, self._height, self._longest,
            LONGEST * least, FINEST * least,
        )  # fmt: skip
        worst = self.t
        for attempt, (fewest, most, aim, factor) in enumerate(ATTEMPTS):
            found = knots.place_knots(line.u, wanted, self.t, limit, factor, LAST)
            whole = found[-1] >= limit
            if not final and (len(found) <= WINDOW or found[WINDOW] > limit):
                if attempt == 0:
                    return None
                continue
            last = final and whole
            found = self._to_the_end(found, end) if last else found[: WINDOW + 1]
            fitted = self._fitted(found, left, last, (fewest, most), aim)
            if not isinstance(fitted, float):
                return fitted
            worst = fitted
        return Window(None, line.axis[-1], False, worst)

    def _to_the_end(self, found: FloatArray, end: float) -> FloatArray:
        """Return knots that end at the end of the run, with enough spans for both ends."""
        count = len(found) - 1
        found = self.t + (found - self.t) * ((end - self.t) / (found[-1] - self.t))
        if count < LEAST:
            found = np.interp(np.arange(LEAST + 1) * (count / LEAST), np.arange(count + 1), found)
        found[-1] = end
        return found

    def _fitted(
        self, found: FloatArray, left: FloatArray, last: bool, sweeps: tuple[int, int], aim: float
    ) -> Window | float:
        """Return the spans to commit, or the place where the deviation is too large [m]."""
        line, height = self.line, self._height
        spans = len(found) - 1
        full = clamped_knots(found)
        matrices = quintic_bezier_matrices(full, spans)
        samples = knots.sample_points(line.tip, line.axis, line.u, left, found, height)
        narrow = self._tolerances(np.minimum, found)
        stiffness = tube_fit.STIFFNESS * narrow.min() / tube_fit.TYPICAL
        coefficients, _ = tube_fit.fit(
            full, matrices, found, self._jet, self._end_jet if last else self._jet[:0], samples,
            self.turning, sweeps, aim, stiffness,
        )  # fmt: skip
        count = spans if last else COMMIT
        points = quintic_bezier_points(coefficients, matrices, count)
        if last:  # exact to the last bit
            points[-1, 5] = self._end_jet[0, : points.shape[2]]
        deviation, excess, advances = certificate.certify(
            points, found, line.tip, line.axis, line.u, line.used, height, self.turning,
            self._share * line.tolerance,
        )  # fmt: skip
        excess = np.where(advances, excess.max(axis=1), np.inf)
        if not excess.max() <= 1.0:  # also true for NaN, if the solution broke down
            worst = int(np.argmax(excess))
            return float(0.5 * (found[worst] + found[worst + 1]))
        # Each piece lies in blocks of equal tolerances, and keeps its own.
        apart = (self._tolerances(np.maximum, found) > narrow).any(axis=1)[:count]
        source, cut, ends, speed, segment = polyline.pieces(
            points, found, line.u, line.feed, line.tolerance, apart
        )
        deviation, narrow = deviation[source], narrow[source]
        if apart.any():
            deviation, _, _ = certificate.certify(
                cut, ends, line.tip, line.axis, line.u, line.used, height, self.turning,
                self._share * line.tolerance,
            )  # fmt: skip
            narrow = self._tolerances(np.minimum, ends)
        # The motion starts in the first block and ends in the last one, however short they are.
        if not self.begun:
            segment[0, 0] = 0
        if last:
            segment[-1, 1] = len(line.row) - 1
        bottom = np.ascontiguousarray(cut[:, :, :3])
        axis = line.axis[-1]
        if self.turning:
            top = np.ascontiguousarray(cut[:, :, 3:])
            tool = top[-1, 5] - bottom[-1, 5]
            axis = line.axis[-1] if last else tool / np.sqrt(tool @ tool)
        else:
            top = bottom + height * axis
        jet = quintic_end_jet(points[-1], found[count] - found[count - 1])
        self.t = float(found[count])
        here = min(int(np.searchsorted(line.u, self.t, 'right')), len(line.row)) - 1
        self._longest = LONGEST * float(line.tolerance[here].min())
        self._jet = jet if self.turning else np.concatenate([jet, np.zeros((5, 3))], axis=1)
        if not last:
            self._drop()
        return Window(
            Spans(
                bottom, top, np.repeat(speed[:, None], 2, axis=1), line.row[segment],
                line.line[segment[:, 1]], deviation, narrow[:, 1] - deviation[:, 1],
            ),
            axis, last, self.t,
        )  # fmt: skip

    def _tolerances(self, extreme: np.ufunc, knots: FloatArray) -> FloatArray:
        """Return the extreme tolerances between these parameters, shape (n - 1, 2) [m]."""
        line = self.line
        first = np.searchsorted(line.u, knots[:-1], 'right') - 1
        after = np.maximum(np.searchsorted(line.u, knots[1:]), first + 1)
        known = np.vstack([line.tolerance, line.tolerance[-1:]])
        return np.asarray(extreme.reduceat(known, np.stack([first, after], 1).ravel())[::2])

    def _drop(self) -> None:
        """Drop vertices that no later window depends on."""
        if self.ended:
            return
        first = int(np.searchsorted(self.line.u, self.t - 1.05 * AHEAD * self._longest)) - 1
        if first > 256:
            self.line = self.line.part(first, len(self.line.u) - 1)
