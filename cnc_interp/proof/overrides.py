"""The operator's overrides during a run, and the feed that they allow in each row."""

from __future__ import annotations

from collections.abc import Iterator
from copy import copy
from itertools import pairwise

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import FEED_FIXED, PER_TURN, SPINDLE_FIXED
from cnc_interp.proof.plan_files import PlanFiles, spans


class Overrides:
    """Factors on the programmed feed; factor k begins at setpoint ``first[k]``."""

    def __init__(self, plan: PlanFiles, machine: Machine):
        steps = np.array(plan.summary.get('overrides', [[0, 1.0, 1.0]]), dtype=float)
        # The period that leads to the first setpoint of a step belongs to both of its sides.
        before = np.concatenate([steps[1:, :1] - 1, np.maximum(steps[1:], steps[:-1])[:, 1:]], 1)
        steps = np.insert(steps, range(1, len(steps)), before, axis=0)
        self.first: IntArray = steps[:, 0].astype(np.int64)
        self._feed, self._spindle = steps[:, 1], steps[:, 2]
        self.largest = float((self._feed * np.maximum(self._spindle, 1.0)).max())
        rows = np.arange(len(plan.blocks['tip']))
        self._fixed = value_in_rows(plan, machine, FEED_FIXED, rows) != 0.0
        self._turns = value_in_rows(plan, machine, PER_TURN, rows) != 0.0
        self._turns &= value_in_rows(plan, machine, SPINDLE_FIXED, rows) == 0.0

    def in_rows(self, row: IntArray) -> Overrides:
        """Return the overrides for rows derived from the program; ``row``: their program rows."""
        found = copy(self)
        found._fixed, found._turns = self._fixed[row], self._turns[row]
        return found

    def share(self, k: int) -> FloatArray:
        """Return factor k for the feed of each row; M49 and G95 make it differ between rows."""
        feed = np.where(self._fixed, 1.0, self._feed[k])
        return np.asarray(feed * np.where(self._turns, self._spindle[k], 1.0))

    def spans(self, count: int) -> Iterator[tuple[int, int, FloatArray]]:
        """Yield ranges (first, last) of setpoints with one override, and its feed factors."""
        for a, b in spans(count):
            inner = self.first[(self.first > a) & (self.first < b)].tolist()
            for first, last in pairwise([a, *inner, b]):
                if last > first:
                    yield first, last, self.share(self._at(first))

    def _at(self, sample: int) -> int:
        return max(int(np.searchsorted(self.first, sample, side='right')) - 1, 0)

    def near(self, place: FloatArray, s: FloatArray, rows: IntArray) -> FloatArray:
        """Return the largest factor between the two neighbours of each path position.

        ``place`` [m] has one more entry at each end than ``rows``; ``s`` [m] is the path position
        at which each factor begins.
        """
        low = np.searchsorted(s, place[:-2], side='right') - 1
        high = np.searchsorted(s, place[2:], side='right') - 1
        share = np.zeros(len(rows))
        for k in range(len(s)):
            here = (np.maximum(low, 0) <= k) & (k <= np.maximum(high, 0))
            if here.any():
                share[here] = np.maximum(share[here], self.share(k)[rows[here]])
        return share


def value_in_rows(plan: PlanFiles, machine: Machine, name: str, rows: IntArray) -> FloatArray:
    """Return the value of an output in rows of the program, 0 before it is set."""
    signals, found = machine.signals, plan.functions
    outputs = [k for k, signal in enumerate(signals.outputs) if signal.name == name]
    mine = [k for k, step in enumerate(signals.steps) if step.output in outputs]
    chosen = np.isin(found['step'], mine)
    values = np.concatenate([[0.0], found['value'][chosen]])
    return np.asarray(values[np.searchsorted(found['block'][chosen], rows, side='right')])


def scaled(feed: FloatArray, share: FloatArray) -> FloatArray:
    """Multiply feeds by factors; rows without a feed (not finite) are unchanged."""
    return np.where(np.isfinite(feed), feed, 0.0) * share + np.where(np.isfinite(feed), 0.0, feed)
