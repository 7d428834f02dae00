"""Choose the spin of an arm, its tool's rotation about the tool axis, by planned time.

A cut lasts from one rapid move to the next. The arm follows each cut with many spins. Of the spins
that stay within travel and away from singular poses, some are planned. The spin changes on the
rapid moves between cuts. The setting ``best`` then replaces the constant spin by a quartic.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import inf, pi
from typing import NamedTuple

import numpy as np

from cnc_interp.core import DEG, BlockError, FloatArray, InterpError
from cnc_interp.feedrate.limit_use import limits_at
from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import plan_path
from cnc_interp.kinematics.axis_path import AxisPath, septic_coefficients, septic_jet
from cnc_interp.kinematics.path_ahead import PathAhead
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.kinematics.segment_axes import FOLLOWING, NO_GUIDE
from cnc_interp.machine_model.joint_chain import JointChain
from cnc_interp.program.blocks import Blocks
from cnc_interp.run.path_chain import segments_of
from cnc_interp.settings.options import Settings

#: Spins that are tried, in addition to that of the machine file [rad].
SPINS = np.arange(24) * 15.0 * DEG
SAME = 1e-9  #: Spins that differ by less than this are equal [rad].
EVERY, OTHERS = 3, 4  #: Every third spin is planned, and the 4 others that turn least.
#: Coefficients of the Legendre polynomials on 0 ... 1, by ascending powers of u.
LEGENDRE = np.array(
    [
        [1.0, 0.0, 0.0, 0.0, 0.0],
        [-1.0, 2.0, 0.0, 0.0, 0.0],
        [1.0, -6.0, 6.0, 0.0, 0.0],
        [-1.0, 12.0, -30.0, 20.0, 0.0],
        [1.0, -20.0, 90.0, -140.0, 70.0],
    ]
)
KEPT = 3  #: Number of fastest ways that are continued after each cut.
MOST_POSES = 600  #: Number of poses on a cut that the arm must follow.
#: Search for a quartic: first step [rad], number of rounds of ten plans, least gain of time [-].
BEND, ROUNDS, GAIN = 20.0 * DEG, 5, 1e-4


@dataclass(frozen=True)
class SpinChoice:
    chain: JointChain  #: The arm in its chosen first configuration.
    spins: FloatArray  #: (n, 10): Spin of each segment: a septic, as in ``guides``.
    why: str  #: Text: how the spin was chosen.


class _Way(NamedTuple):
    """One way in which the arm follows the program, up to the start or the end of a cut."""

    start: FloatArray  # (n,): joints at the first pose of the program [rad]
    here: FloatArray  # (n,): joints at its end so far
    time: float  # of the cuts so far [s]
    curves: tuple[FloatArray, ...]  # (8,): the septic of the spin on each cut
    turning: float = 0.0  # least time in which the joints turn on the next cut [s]


class SpinSearch:
    def __init__(self, chain: JointChain, settings: Settings, blocks: Blocks):
        self._chain, self._settings, self._blocks = chain, settings, blocks
        self._segments = segments_of(blocks, chain, settings)
        self._limits = limits_at(chain.machine, settings.interpolation_period)
        n, height = len(self._segments), settings.flank_height
        nothing = np.full(n, FOLLOWING), np.tile(NO_GUIDE, (n, 1))
        self._ends = PathAhead.of(height, self._segments, *nothing).ends
        cutting = np.isfinite(self._segments.feed).any(axis=1)
        edges = np.flatnonzero(np.diff(cutting, prepend=False, append=False)).tolist()
        self._cuts = list(zip(edges[::2], edges[1::2], strict=True)) or [(0, n)]
        # Rapid moves before the first cut and after the last cut have the spin of that cut.
        self._cuts[0] = 0, self._cuts[0][1]
        self._cuts[-1] = self._cuts[-1][0], n
        self._plans = self._furthest = 0

    def chosen(self) -> SpinChoice:
        """Return the chosen spins of all segments; BlockError if a cut allows no constant spin."""
        nothing = np.zeros(0)
        ways = [_Way(nothing, nothing, 0.0, ())]
        for number in range(len(self._cuts)):
            ways = self._further(ways, number)
        search, way = self._smoothed(ways)
        curves, tried = way.curves, self._plans
        text = f'{len(curves)} spins, one for each cut'
        if len(curves) == 1:
            text = f'spin {curves[0][0] / DEG:g} deg'
        text += f', the fastest of {tried} ways that were planned'
        if self._settings.spin == 'best':
            curves, saved = search._bent(way)
            text += f'; bending it saves {saved:.1%} of the time'
        return SpinChoice(search._chain, search._rows(curves), text)

    def _smoothed(self, ways: list[_Way]) -> tuple[SpinSearch, _Way]:
        """Return the fastest way, and its search with a path smoothed for its spin.

        The spin affects at which corners a stop is faster than rounding.
        """
        found = []
        for way in ways:
            chain = self._chain.spun(float(way.curves[0][0])).starting(way.start)
            found.append((SpinSearch(chain, self._settings, self._blocks), way))
        bottom = self._segments.bottom
        if all(np.array_equal(search._segments.bottom, bottom) for search, _ in found):
            return found[0]
        return min(
            found,
            key=lambda one: one[0]._time_of(one[1].curves, one[1].start, 0, len(one[0]._segments)),
        )

    def _further(self, ways: list[_Way], number: int) -> list[_Way]:
        """Return the ways continued to the end of cut ``number``, the fastest first."""
        first, last = self._cuts[number]
        self._furthest = 0
        done = self._planned(ways, number, True) or self._planned(ways, number, False)
        if not done:
            row = int(
                np.linspace(first, last - 1, MOST_POSES)[min(self._furthest, MOST_POSES - 1)]
            )
            remedy = 'retract before it with more room to turn, or move the part'
            raise BlockError(
                f'no constant spin of {self._chain.machine.name} follows the cut further than '
                f'about here, within the travel and past singular poses; '
                f'{remedy if number else "move the part"}',
                int(self._segments.line_number[row]),
            )
        return done

    def _planned(self, ways: list[_Way], number: int, avoids: bool) -> list[_Way]:
        """Return the fastest ways through a cut; ``avoids``: only away from singular poses."""
        begun, spins = dict[int, list[_Way]](), [self._chain.spin]
        spins += [float(spin) for spin in SPINS if abs(spin - self._chain.spin) > SAME]
        for count, spin in enumerate(spins):
            some = [each for way in ways for each in self._begun(way, spin, number, avoids)]
            if some:
                begun[count] = sorted(some, key=lambda way: way.time + way.turning)
        order = sorted(begun, key=lambda count: (count % EVERY > 0, begun[count][0].turning))
        tried = order[: sum(count % EVERY == 0 for count in begun) + OTHERS]
        done = {count: self._executed(begun[count][0], number) for count in tried}
        fastest = min(done, key=lambda count: done[count].time, default=None)
        # Other configurations, and other ways to this cut, with the fastest spin.
        others = begun[fastest][1:] if fastest is not None else []
        found = [*done.values(), *(self._executed(way, number) for way in others)]
        return sorted((way for way in found if way.time < inf), key=lambda way: way.time)[:KEPT]

    def _executed(self, way: _Way, number: int) -> _Way:
        """Return a way continued to the end of a cut; if it cannot be planned, its time is inf."""
        first, last = self._cuts[number]
        path = self._follow(self._rows(way.curves)[first:last], way.here, first, last)
        if path is None:
            return way._replace(time=inf)
        here = path.cell_right[0, -1].copy()
        return way._replace(here=here, time=way.time + self._time(path))

    def _begun(self, way: _Way, spin: float, number: int, avoids: bool) -> Iterator[_Way]:
        """Yield ways, continued to the start of a cut, that can follow it at a constant spin."""
        first, last = self._cuts[number]
        poses, (low, high) = self._poses(first, last), self._chain.machine.travel.T
        chain = self._chain.spun(spin)
        if number:
            spin += 2.0 * pi * round((float(way.curves[-1][0]) - spin) / (2.0 * pi))
        curve = np.array([spin] + [0.0] * 7)
        starts = self._arrivals(way, curve, number)
        if not number:
            starts = list(chain.branches(*(rows[0] for rows in poses)))
        for start in starts:
            q, least = chain.followed(*poses, start)
            self._furthest = max(self._furthest, len(q))
            shift = np.zeros(len(start)) if number else _shift(q, self._chain.machine.travel)
            inside = ((q + shift >= low) & (q + shift <= high)).all()
            if not avoids and (len(q) < len(poses[0]) or least <= chain.least):
                yield _Way(way.start if number else start, start, way.time, (*way.curves, curve))
            elif len(q) == len(poses[0]) and least > chain.least and inside:
                turned = np.abs(np.diff(q, axis=0)) / self._chain.machine.max_velocity
                here = start + shift
                begin = way.start if number else here
                turning = float(turned.max(axis=1).sum())
                yield _Way(begin, here, way.time, (*way.curves, curve), turning)

    def _arrivals(self, way: _Way, curve: FloatArray, number: int) -> list[FloatArray]:
        """Return the joints at the start of a cut; [] if the way cannot turn to the cut's spin."""
        first, last = self._cuts[number - 1][1] if number else 0, self._cuts[number][0]
        if first >= last:
            kept = number > 0 and curve[0] == way.curves[-1][0]
            return [way.here] if kept else []
        rows = self._rows((*way.curves, curve))[first:last]
        path = self._follow(rows, way.here, first, last)
        return [] if path is None else [path.cell_right[0, -1].copy()]

    def _poses(self, first: int, last: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return tips, tool axes and further joints at poses evenly distributed over segments."""
        row = np.linspace(first, last - 1.0, MOST_POSES)
        known, some = np.arange(first, last), slice(first, last)
        segments = self._segments
        both = np.hstack([segments.bottom[some, 0], segments.axis[some], segments.extra[some, 0]])
        poses = np.stack([np.interp(row, known, column) for column in both.T], axis=1)
        tip, axis, beside = (
            np.ascontiguousarray(part) for part in np.split(poses, [3, 6], axis=1)
        )
        return tip, axis / np.linalg.norm(axis, axis=1, keepdims=True), beside

    def _rows(self, curves: Sequence[FloatArray]) -> FloatArray:
        """Return the spin of each segment up to the last cut in ``curves``, (n, 10)."""
        found = np.zeros((self._cuts[len(curves) - 1][1], 10))
        for number, curve in enumerate(curves):
            first, last = self._cuts[number]
            if number:
                before = self._cuts[number - 1][1]
                ramp, lengths = np.empty(8), self._ends[[self._cuts[number - 1][0], before, first]]
                jets = (
                    np.array(septic_jet(curves[number - 1], 1.0, lengths[1] - lengths[0])),
                    np.array(septic_jet(curve, 0.0, self._ends[last] - lengths[2])),
                )
                if first > before:
                    septic_coefficients(*jets, lengths[2] - lengths[1], ramp)
                    self._lead(found, before, first, ramp)
            self._lead(found, first, last, curve)
        return found

    def _lead(self, rows: FloatArray, first: int, last: int, curve: FloatArray) -> None:
        rows[first:last, 0] = self._ends[first:last] - self._ends[first]
        rows[first:last, 1], rows[first:last, 2:] = self._ends[last] - self._ends[first], curve

    def _follow(self, rows: FloatArray, q: FloatArray, first: int, last: int) -> AxisPath | None:
        """Return the path of segments, from joints ``q`` and rest to rest; None if rejected."""
        segments = self._segments[first:last]
        stop = segments.stop.copy()
        stop[-1] = True
        chain = self._chain.spun(float(septic_jet(rows[0, 2:], rows[0, 0] / rows[0, 1], 1.0)[0]))
        given = self._settings.flank_height, self._settings.interpolation_period, rows
        try:
            builder = AxisPathBuilder(chain.starting(q), *given)
            return builder.push(replace(segments, stop=stop))
        except InterpError:
            return None

    def _time(self, path: AxisPath) -> float:
        """Return the motion time of a path [s]; infinite if it cannot be planned."""
        self._plans += 1
        try:
            return float(plan_path(path, self._limits, PlanOptions(bound=False)).law.end_time)
        except InterpError:
            return inf

    def _bent(self, way: _Way) -> tuple[tuple[FloatArray, ...], float]:
        """Return the fastest quartics near the constant spins of a way; and the saved time [-]."""
        curves, here, n = list(way.curves), way.start, len(self._segments)
        for number, (_, end) in enumerate(self._cuts):
            first = self._cuts[number - 1][1] if number else 0
            last = self._cuts[number + 1][0] if number + 1 < len(curves) else n
            time, bend, step = self._time_of(curves, here, first, last), np.zeros(5), BEND
            for _ in range(ROUNDS):
                gained = False
                for order, sign in product(range(5), (1.0, -1.0)):
                    moved, trial = bend.copy(), curves.copy()
                    moved[order] += sign * step
                    trial[number] = _bent_by(way.curves[number], moved)
                    found = self._time_of(trial, here, first, last)
                    if found < (1.0 - GAIN) * time:
                        time, bend, curves, gained = found, moved, trial, True
                step = step if gained else 0.5 * step
            path = self._follow(self._rows(curves)[first:end], here, first, end)
            here = here if path is None else path.cell_right[0, -1].copy()
        before, after = (self._time_of(some, way.start, 0, n) for some in (way.curves, curves))
        return (tuple(curves), 1.0 - after / before) if after < before else (way.curves, 0.0)

    def _time_of(
        self, curves: Sequence[FloatArray], here: FloatArray, first: int, last: int
    ) -> float:
        path = self._follow(self._rows(curves)[first:last], here, first, last)
        return inf if path is None else self._time(path)


def _bent_by(curve: FloatArray, bend: FloatArray) -> FloatArray:
    """Return a spin curve plus a quartic; ``bend``: its Legendre coefficients [rad]."""
    found = curve.copy()
    found[:5] += LEGENDRE.T @ bend
    return found


def _shift(q: FloatArray, travel: FloatArray) -> FloatArray:
    """Return the whole turns (n,) [rad] that bring motion ``q`` into the travel; NaN if none."""
    turn = 2.0 * pi
    low, high = (
        np.ceil((travel[:, 0] - q.min(axis=0)) / turn),
        np.floor((travel[:, 1] - q.max(axis=0)) / turn),
    )
    return np.where(low <= high, turn * np.clip(0.0, low, high), np.nan)
