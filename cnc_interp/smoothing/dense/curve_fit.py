"""One curve in the making: fitted window by window, certified, committed by halves of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.smoothing.dense import certificate, knots, polyline, tube
from cnc_interp.smoothing.dense.polyline import Polyline
from cnc_interp.smoothing.dense.rows import Spans

#: Longest and shortest spacing of knots, in tolerances.
LONGEST, FINEST = 100.0, 2.0
#: Spans solved together, and committed; the last window of a run may have ``LAST``.
WINDOW, COMMIT, LAST = 40, 20, 60
#: Fewest spans of a curve between its ends.
LEAST = 6
#: Way beyond a window that knots depend on, in longest spacings.
AHEAD = 3.0
#: What is tried with a window, one after another: fewest and most sweeps, aim, spacing.
ATTEMPTS = ((1, 40, 0.85, 1.0), (1, 80, 0.7, 1.0), (1, 60, 0.75, 0.5), (1, 60, 0.75, 0.25))


@dataclass(frozen=True)
class Window:
    """
    What came of a window.

    Parameters
    ----------
    spans : Spans or None
        The spans to commit; None where no curve was found in the tube.
    axis : ndarray, shape (3,)
        Tool axis at their end [-].
    last : bool
        Whether the run ends with them.
    worst : float
        Where the deviation was too large [m].

    """

    spans: Spans | None
    axis: FloatArray
    last: bool
    worst: float


class Run:
    """
    A run of short blocks and the curve through it, as far as it is committed.

    Parameters
    ----------
    line : Polyline
        What the curve follows; grows as blocks come.
    jet : ndarray, shape (m, 6)
        Value and derivatives, divided by their factorials, with which the curve begins.
    turning : bool
        Whether the tool turns.
    height, longest : float
        Flank height and longest spacing of knots [m].
    share : float
        Share of the tolerances that the curve may use [-].

    """

    def __init__(
        self,
        line: Polyline,
        jet: FloatArray,
        turning: bool,
        height: float,
        longest: float,
        share: float,
    ):
        self.line = self.whole = line
        self.turning = turning
        self.t = 0.0
        self.begun = self.ended = False
        self._jet, self._end_jet = jet, jet[:0]
        self._height, self._longest, self._share = height, longest, share

    @property
    def passed(self) -> int:
        """The last vertex of the chain that is committed; -1 if none."""
        known = self.line.vertex[: int(np.searchsorted(self.line.u, self.t, 'right'))]
        return int(known.max(initial=-1))

    def end(self, line: Polyline, jet: FloatArray) -> None:
        """Say how the run ends: what it follows and the derivatives at its end."""
        self.whole, self.line = self.line, line
        self.ended, self._end_jet = True, jet

    def reopen(self, vertex: int) -> None:
        """Let the run end at an earlier vertex, in a way that is still to be said."""
        line = self.whole if self.ended else self.line
        self.line = self.whole = line.upto(vertex)
        self.ended, self._end_jet = False, self._jet[:0]

    def shift(self, first: int) -> None:
        """Count the vertices of the chain from a later one."""
        lines = [self.line] if self.whole is self.line else [self.line, self.whole]
        for line in lines:
            line.vertex = np.where(line.vertex >= 0, line.vertex - first, -1)

    def window(self, tolerance: FloatArray, final: bool) -> Window | None:
        """
        Fit the next window; None when it is not all there yet.

        Parameters
        ----------
        tolerance : ndarray, shape (2,)
            Contour and orientation tolerance [m].
        final : bool
            Whether the run has its end.

        """
        if not final:
            self.whole = self.line
        least = float(tolerance.min())
        line, end = self.line, float(self.line.u[-1])
        limit = end
        if not final:  # the spacing wanted at a vertex is final when that way behind it is known
            known = int(np.searchsorted(line.u, end - AHEAD * self._longest, 'right')) - 1
            limit = float(line.u[max(known, 0)])
            if limit <= self.t:
                return None
        left = self._share * tolerance - line.used
        wanted = knots.spacings(
            line.tip, line.axis, line.u, left, self._height, self._longest, FINEST * least
        )
        worst = self.t
        for attempt, (fewest, most, aim, factor) in enumerate(ATTEMPTS):
            found = knots.march(
                line.u, wanted, self.t, limit, factor, factor * FINEST * least, LAST
            )
            whole = found[-1] >= limit
            if not final and (len(found) <= WINDOW or found[WINDOW] > limit):
                if attempt == 0:
                    return None
                continue
            last = final and whole
            found = self._to_the_end(found, end) if last else found[: WINDOW + 1]
            fitted = self._fitted(found, left, tolerance, last, (fewest, most), aim)
            if not isinstance(fitted, float):
                return fitted
            worst = fitted
        return Window(None, line.axis[-1], False, worst)

    def _to_the_end(self, found: FloatArray, end: float) -> FloatArray:
        """Return knots that meet the end of the run, with spans enough for both ends."""
        count = len(found) - 1
        found = self.t + (found - self.t) * ((end - self.t) / (found[-1] - self.t))
        if count < LEAST:
            found = np.interp(np.arange(LEAST + 1) * (count / LEAST), np.arange(count + 1), found)
        found[-1] = end
        return found

    def _fitted(
        self,
        found: FloatArray,
        left: FloatArray,
        tolerance: FloatArray,
        last: bool,
        sweeps: tuple[int, int],
        aim: float,
    ) -> Window | float:
        """Return the spans to commit between knots, or where the deviation is too large."""
        line, height = self.line, self._height
        spans = len(found) - 1
        full = tube.clamped(found)
        matrices = tube.bezier_matrices(full, spans)
        cloud = knots.samples(line.tip, line.axis, line.u, left, found, height)
        stiffness = tube.STIFFNESS * float(tolerance.min()) / tube.TYPICAL
        coefficients, _ = tube.fit(
            full, matrices, found, self._jet, self._end_jet if last else self._jet[:0], cloud,
            self.turning, sweeps, aim, stiffness,
        )  # fmt: skip
        count = spans if last else COMMIT
        points = tube.span_points(coefficients, matrices, count)
        if last:  # to the last bit where it must be
            points[-1, 5] = self._end_jet[0, : points.shape[2]]
        deviation, advances = certificate.certify(
            points, found, line.tip, line.axis, line.u, line.used, height, self.turning,
            self._share * tolerance,
        )  # fmt: skip
        excess = np.where(advances, (deviation / (self._share * tolerance)).max(axis=1), np.inf)
        if not excess.max() <= 1.0:  # nor where a solution broke down
            worst = int(np.argmax(excess))
            return float(0.5 * (found[worst] + found[worst + 1]))
        source, cut, speed, segment = polyline.pieces(points, found, line.u, line.feed, line.row)
        # the motion starts in the first block and ends in the last, however short they are
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
        jet = tube.end_jet(points[-1], found[count] - found[count - 1])
        self.t = float(found[count])
        self._jet = jet if self.turning else np.concatenate([jet, np.zeros((5, 3))], axis=1)
        if not last:
            self._drop()
        return Window(
            Spans(
                bottom, top, np.repeat(speed[:, None], 2, axis=1), line.row[segment],
                line.line[segment[:, 1]], deviation[source],
            ),
            axis, last, self.t,
        )  # fmt: skip

    def _drop(self) -> None:
        """Forget vertices that no window depends on any more."""
        if self.ended:
            return
        first = int(np.searchsorted(self.line.u, self.t - 1.05 * AHEAD * self._longest)) - 1
        if first > 256:
            self.line = self.line.part(first, len(self.line.u) - 1)
