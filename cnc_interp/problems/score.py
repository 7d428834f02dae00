"""Score a feed law by its sampled motion alone: time, largest use of a limit, deviation."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit

from cnc_interp.core import UM, FloatArray, InterpError
from cnc_interp.drives.tool_error import HEIGHT, on_chord
from cnc_interp.kinematics.axis_path import evaluate
from cnc_interp.problems.paths import Problem, known
from cnc_interp.run.setpoints import BEFORE, STILL, largest_shares

#: Largest use that counts as kept [-], largest deviation from the path [m].
KEPT, BESIDE = 1.001, 1.0 * UM
CHORDS = 200_000  #: Chords, about, that stand for a path.
#: A motion is sought so many of its steps ahead on the path, and this far at least [m].
AHEAD, LEAST = 8.0, 2e-6


@dataclass(frozen=True)
class Score:
    name: str
    time: float  #: Duration of the motion [s].
    use: float  #: Largest use of feed, velocity, acceleration and jerk by differences [-].
    deviation: float  #: Largest distance from the path; an angle counts by ``HEIGHT`` [m].

    @cached_property
    def ratio(self) -> float:
        """Time over the optimum of the independent solver; NaN where there is none."""
        return self.time / known(self.name).optimum

    @property
    def kept(self) -> bool:
        return self.use <= KEPT and self.deviation <= BESIDE


def score(
    problem: Problem, position: FloatArray, period: float, time: float | None = None
) -> Score:
    """Compare a sampled motion with its problem.

    Parameters
    ----------
    position : FloatArray
        (K, n_axes): q(t) at multiples of the period, from rest to rest [m, rad].
    period : float
        Time between two samples [s]; at 1 ms or more, rounding is no jerk.
    time : float, optional
        Exact duration [s]; otherwise whole periods count.

    Raises
    ------
    InterpError
        The motion has other axes, or is no motion.

    """
    path, axes = problem.path, problem.path.cell_left.shape[2]
    q = np.ascontiguousarray(position, dtype=float)
    if q.ndim != 2 or q.shape[1] != axes or len(q) < 2 or not np.isfinite(q).all():
        raise InterpError(
            f'{problem.name}: a motion has 2 or more finite rows of {axes} axes, not {q.shape}'
        )
    held = np.concatenate([q[:1].repeat(BEFORE, 0), q, q[-1:].repeat(BEFORE, 0)])
    use = float(largest_shares(held, problem.limits.limit_table, period).max())
    per_cell = max(8, CHORDS // len(path.cell_feed))
    part = np.arange(per_cell) / per_cell
    fine = np.append((path.s[:-1, None] + np.diff(path.s)[:, None] * part).ravel(), path.s[-1])
    scale = np.where(np.arange(axes) < 3, 1.0, HEIGHT)
    chords = evaluate(path, fine)[0] * scale
    place, off = _along(chords, q * scale)
    ends = np.abs((q[[0, -1]] - path.q[[0, -1]]) * scale).max()
    s = np.interp(place, np.arange(len(fine)), fine)
    cell = np.minimum(place.astype(np.int64) // per_cell, len(path.cell_feed) - 1)
    feed = np.maximum(path.cell_feed[cell[1:]], path.cell_feed[cell[:-1]])
    use = max(use, float((np.diff(s) / (period * feed)).max()))
    moving = np.flatnonzero(np.abs(np.diff(q, axis=0)).max(axis=1) > STILL)
    periods = moving[-1] + 1 - moving[0] if len(moving) else 0
    lasts = period * float(periods) if time is None else time
    return Score(problem.name, lasts, use, max(float(off.max()), float(ends)))


@njit(cache=True, nogil=True)
def _along(path: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the places of points that go along chords, in chords, and their distances."""
    place, off = np.empty(len(points)), np.empty(len(points))
    chord, last = 0, len(path) - 2
    for m in range(len(points)):
        step = np.sqrt(((points[m] - points[max(m - 1, 0)]) ** 2).sum())
        far, way, least, found = AHEAD * step + LEAST, 0.0, np.inf, chord
        for k in range(chord, last + 1):
            part, distance_sq = on_chord(path, k, points[m])
            if distance_sq < least:
                least, found, place[m] = distance_sq, k, k + part
            if k > chord:
                way += np.sqrt(((path[k + 1] - path[k]) ** 2).sum())
            if way > far:
                break
        chord, off[m] = found, np.sqrt(least)
    return place, off
