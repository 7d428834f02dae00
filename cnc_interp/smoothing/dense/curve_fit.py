"""One curve through a run of short blocks: fitted, certified and committed window by window."""

from math import sqrt
from typing import NamedTuple

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, IntArray, bspline
from cnc_interp.core.kernels import njit
from cnc_interp.smoothing.dense import knots as spacing
from cnc_interp.smoothing.dense.certificate import certify
from cnc_interp.smoothing.dense.polyline import Polyline, pieces
from cnc_interp.smoothing.dense.tube_fit import STIFFNESS, TYPICAL, QuinticBasis, fit
from cnc_interp.smoothing.orientation import rotation_between, share_near_pole

#: Spans in a window, spans committed of it, and most spans in the last window of a run.
WINDOW, COMMIT, LAST = 40, 20, 60
LEAST = 6  #: Smallest number of spans of a curve between its ends.
#: Attempts for a window, in order: fewest and most sweeps, aim, factor of the knot spacing.
ATTEMPTS = ((1, 40, 0.85, 1.0), (1, 80, 0.7, 1.0), (1, 60, 0.75, 0.5), (1, 60, 0.75, 0.25))


class Curve(NamedTuple):
    """Properties shared by all windows of a run."""

    turning: bool  #: Whether the tool turns; else only the tip is fitted.
    height: float  #: Flank height [m].
    share: float  #: Part of the tolerances that the curve may use [-].
    #: (3,) or (0,): Direction beside which it leaves a part of the orientation tolerance [-].
    pole: FloatArray


class Window(NamedTuple):
    found: bool  #: Whether a curve within the tolerances was found; else there are no spans.
    last: bool  #: Whether the run ends there.
    t: float  #: Curve parameter at its end, or where the deviation was too large [m].
    axis: FloatArray  #: (3,): Tool axis there [-].
    jet: FloatArray  #: (5, 6): Value and derivatives there, divided by factorials.
    #: (n, 6, 3): Bezier points of tip and second point of the spans to commit [m].
    bottom: FloatArray
    top: FloatArray
    feed: FloatArray  #: (n,): Programmed speed [m/s].
    #: (n, 2, 2): Row and line of the program in the middle of the first and second half.
    origin: IntArray
    #: (n, 3): Contour and orientation deviation, and what is left of that tolerance [m].
    deviation: FloatArray


class RunEnds(NamedTuple):
    """Whether a run, or a window of it, begins and ends where the tool is led by lines."""

    begun: bool  #: Whether a part of the curve is committed already.
    ended: bool  #: Whether the end of the run is known.
    jet: FloatArray  #: (m, 6): Value and derivatives over factorials at the start of what is left.
    end_jet: FloatArray  #: The same at the end; no rows if it is free.


class DenseRun:
    """A run of short blocks, and the curve through it as far as it is committed.

    The polyline grows while blocks arrive. ``jet`` (m, 6) has value and derivatives at the start
    of the curve, divided by factorials of their order.
    """

    def __init__(self, line: Polyline, jet: FloatArray, longest: float, curve: Curve):
        self.line = self.whole = line
        self.curve = curve
        self.t = 0.0
        self.begun = self.ended = False
        self._jet, self._end_jet = jet, jet[:0]
        self._longest = longest

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
        same = self.whole is self.line
        self.line, self.whole = (
            line._replace(vertex=np.where(line.vertex >= 0, line.vertex - first, -1))
            for line in (self.line, self.whole)
        )
        if same:
            self.whole = self.line

    def window(self) -> Window | None:
        """Fit the next window; None if more blocks are necessary."""
        if not self.ended:
            self.whole = self.line
        line, end = self.line, float(self.line.u[-1])
        limit = end
        if not self.ended:  # the spacing at a vertex depends on the vertices up to AHEAD after it
            known = int(np.searchsorted(line.u, end - spacing.AHEAD * self._longest, 'right')) - 1
            limit = float(line.u[max(known, 0)])
            if limit <= self.t:
                return None
        window: Window
        enough, window = fit_window(
            line,
            self.curve,
            self.t,
            limit,
            self._longest,
            RunEnds(self.begun, self.ended, self._jet, self._end_jet),
        )
        if not enough:
            return None
        if window.found:
            self.t, self._jet = window.t, window.jet
            here = min(int(np.searchsorted(line.u, self.t, 'right')), len(line.feed)) - 1
            self._longest = spacing.LONGEST * float(line.tolerance[here].min())
            if not window.last:
                self._drop()
        return window

    def _drop(self) -> None:
        """Drop vertices that no later window depends on."""
        if self.ended:
            return
        first = (
            int(np.searchsorted(self.line.u, self.t - 1.05 * spacing.AHEAD * self._longest)) - 1
        )
        if first > 256:
            self.line = self.line.part(first, len(self.line.u) - 1)


@njit(cache=True, nogil=True)
def fit_window(
    line: Polyline,
    curve: Curve,
    t: float,
    limit: float,
    longest: float,
    ends: RunEnds,
) -> tuple[bool, Window]:
    """Fit a window from t on, with knots up to a limit; False if more blocks are necessary."""
    left = _left_over(line, curve)
    wanted = spacing.knot_spacings(line, left, curve.height, longest)
    window = _nothing(t)
    for attempt, (fewest, most, aim, factor) in enumerate(ATTEMPTS):
        knots = spacing.place_knots(line.u, wanted, t, limit, factor, LAST)
        last = ends.ended and knots[-1] >= limit
        if not ends.ended and (len(knots) <= WINDOW or knots[WINDOW] > limit):
            if attempt == 0:
                return False, window
            continue
        knots = _to_the_end(knots, line.u[-1]) if last else knots[: WINDOW + 1]
        end_jet = ends.end_jet if last else ends.jet[:0]
        of_window = RunEnds(ends.begun, last, ends.jet, end_jet)
        window = _fitted(line, curve, left, knots, of_window, (fewest, most), aim)
        if window.found:
            break
    return True, window


@njit(cache=True, nogil=True)
def _left_over(line: Polyline, curve: Curve) -> FloatArray:
    """Return the tolerances that are left for a curve on each segment, shape (n, 2) [m]."""
    left = np.empty((len(line.feed), 2))
    for k in range(len(left)):
        for i in range(2):
            left[k, i] = curve.share * line.tolerance[k, i] - line.used[k, i]
        if curve.turning and len(curve.pole):
            axis = line.pose[k, 3:]
            turn = rotation_between(axis, line.pose[k + 1, 3:])
            angle = line.tolerance[k, 1] / curve.height
            left[k, 1] *= share_near_pole(curve.pole, axis, turn, angle, False)
    return left


@njit(cache=True, nogil=True)
def _nothing(t: float) -> Window:
    """Return a window without spans; the deviation is too large at t."""
    none = np.empty((0, 6, 3))
    return Window(
        False,
        False,
        t,
        np.empty(3),
        np.empty((5, 6)),
        none,
        none,
        np.empty(0),
        np.empty((0, 2, 2), np.int64),
        np.empty((0, 3)),
    )


@njit(cache=True, nogil=True)
def _to_the_end(knots: FloatArray, end: float) -> FloatArray:
    """Return knots that end at the end of the run, with enough spans for both ends."""
    count, t = len(knots) - 1, knots[0]
    stretch = (end - t) / (knots[-1] - t)
    for i in range(count + 1):
        knots[i] = t + (knots[i] - t) * stretch
    if count < LEAST:
        known, knots = knots, np.empty(LEAST + 1)
        for i in range(LEAST):
            x = i * (count / LEAST)
            j = int(x)
            knots[i] = (known[j + 1] - known[j]) * (x - j) + known[j]
    knots[-1] = end
    return knots


@njit(cache=True, nogil=True)
def _fitted(
    line: Polyline,
    curve: Curve,
    left: FloatArray,
    knots: FloatArray,
    of_window: RunEnds,
    sweeps: tuple[int, int],
    aim: float,
) -> Window:
    """Return the spans to commit, or the place where the deviation is too large."""
    begun, last, jet, end_jet = of_window
    height, turning, spans = curve.height, curve.turning, len(knots) - 1
    full = bspline.clamped_knots(knots)
    matrices = bspline.quintic_bezier_matrices(full, spans)
    basis = QuinticBasis(full, matrices, knots)
    samples = spacing.sample_points(line, left, knots, height)
    narrow, apart = _tolerances(line, knots)
    stiffness = STIFFNESS * narrow.min() / TYPICAL
    coefficients, _ = fit(basis, jet, end_jet, samples, turning, sweeps, aim, stiffness)
    count = spans if last else COMMIT
    points = bspline.quintic_bezier_points(coefficients, matrices, count)
    if last:  # exact to the last bit
        for i in range(points.shape[2]):
            points[count - 1, 5, i] = end_jet[0, i]
    deviation, excess, advances = certify(points, knots, line, height, turning, curve.share)
    worst, most_excess = 0, 0.0
    for s in range(count):
        here = max(excess[s, 0], excess[s, 1]) if advances[s] else np.inf
        if here > most_excess:
            worst, most_excess = s, here
    if most_excess > 1.0:
        nothing: Window = _nothing(0.5 * (knots[worst] + knots[worst + 1]))
        return nothing
    # Each piece lies in blocks of equal tolerances, and keeps its own.
    source, cut, ends, speed, segment = pieces(points, knots, line, apart)
    n = len(source)
    if apart[:count].any():
        deviation, _, _ = certify(cut, ends, line, height, turning, curve.share)
        narrow, _ = _tolerances(line, ends)
        source = np.arange(n)
    # The motion starts in the first block and ends in the last one, however short they are.
    if not begun:
        segment[0, 0] = 0
    if last:
        segment[-1, 1] = len(line.feed) - 1
    end = bspline.quintic_end_jet(points[-1], knots[count] - knots[count - 1])
    axis = line.pose[-1, 3:].copy()
    bottom, top = np.empty((n, 6, 3)), np.empty((n, 6, 3))
    origin, spent = np.empty((n, 2, 2), np.int64), np.empty((n, 3))
    for s in range(n):
        for i in range(2):
            spent[s, i] = deviation[source[s], i]
            for half in range(2):
                origin[s, half, i] = line.origin[segment[s, half], i]
        spent[s, 2] = narrow[source[s], 1] - spent[s, 1]
        for k in range(6):
            for i in range(3):
                bottom[s, k, i] = cut[s, k, i]
                other = cut[s, k, 3 + i] if turning else cut[s, k, i] + height * axis[i]
                top[s, k, i] = other
    size = 0.0
    if turning and not last:
        for i in range(3):
            axis[i] = top[-1, 5, i] - bottom[-1, 5, i]
            size += axis[i] ** 2
        for i in range(3):
            axis[i] /= sqrt(size)
    found = np.zeros((5, 6))
    for k in range(5):
        for i in range(points.shape[2]):
            found[k, i] = end[k, i]
    return Window(True, last, knots[count], axis, found, bottom, top, speed, origin, spent)


@njit(cache=True, nogil=True)
def _tolerances(line: Polyline, knots: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the least tolerances between knots, shape (n, 2) [m]; and where they change."""
    n = len(knots) - 1
    least, apart = np.empty((n, 2)), np.zeros(n, np.bool_)
    for s in range(n):
        first = min(np.searchsorted(line.u, knots[s], 'right'), len(line.feed)) - 1
        after = max(np.searchsorted(line.u, knots[s + 1]), first + 1)
        for i in range(2):
            most = least[s, i] = line.tolerance[first, i]
            for k in range(first + 1, after):
                most = max(most, line.tolerance[k, i])
                least[s, i] = min(least[s, i], line.tolerance[k, i])
            apart[s] |= most > least[s, i]
    return least, apart
