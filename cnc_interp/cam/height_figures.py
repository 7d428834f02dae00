"""
Figures of the heights on needles, gathered part by part.

Sums are made with whole numbers, so they do not depend on the order of the parts: the figures of
a surface are the same bits whether it is measured as a whole or in tiles.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from fractions import Fraction
from math import sqrt
from typing import Any

import numpy as np

from cnc_interp.cam.needle_cuts import TOP
from cnc_interp.core.arrays import BoolArray, FloatArray
from cnc_interp.core.errors import InterpError
from cnc_interp.core.units import UM

#: Depth from which a needle counts as gouged [m].
GOUGE = 0.5 * UM
#: Width of the classes of the histogram [m].
CLASS = 0.1 * UM
#: Heights are summed in units of 2 ** -HEIGHT_BITS m, their squares in 2 ** -SQUARE_BITS m2.
HEIGHT_BITS, SQUARE_BITS = 60, 75
#: Where such numbers are divided, so that neither half overflows when millions are added.
HALF = 24


@dataclass(frozen=True, order=True)
class Extreme:
    """A lowest or highest height and its place; of equal heights the first needle counts."""

    height: float  #: The height [m]; the negative of it for a highest one.
    #: Place of the needle.
    row: int
    column: int


@dataclass(frozen=True)
class Figures:
    """Sums over the needles that were cut."""

    #: Number of needles, of those that the mill has reached, and of those deeper than ``GOUGE``.
    needles: int = 0
    cut: int = 0
    gouged: int = 0
    #: Sum of the heights and of their squares, in the units of ``exact_sum``.
    total: int = 0
    squares: int = 0
    #: The extremes; None if no needle was cut.
    lowest: Extreme | None = None
    highest: Extreme | None = None
    #: Number of needles in each class of the histogram: from n CLASS to (n + 1) CLASS.
    classes: dict[int, int] = field(default_factory=dict)

    @staticmethod
    def of(height: FloatArray, row: int = 0, column: int = 0) -> Figures:
        """Return the figures of a part of a surface."""
        reached = is_cut(height)
        h = height[reached]
        total = int(np.count_nonzero(~np.isnan(height)))
        if not len(h):
            return Figures(total)
        ends = [
            Extreme(sign * float(height[place]), row + int(place[0]), column + int(place[1]))
            for sign, place in (
                (1.0, np.unravel_index(
                    np.argmin(np.where(reached, height, np.inf)), height.shape
                )),
                (-1.0, np.unravel_index(
                    np.argmax(np.where(reached, height, -np.inf)), height.shape
                )),
            )
        ]  # fmt: skip
        number, count = np.unique(np.floor(h / CLASS).astype(int), return_counts=True)
        return Figures(
            total, len(h), int(np.count_nonzero(h < -GOUGE)), exact_sum(h, HEIGHT_BITS),
            exact_sum(h * h, SQUARE_BITS), ends[0], ends[1],
            dict(zip(number.tolist(), count.tolist(), strict=True)),
        )  # fmt: skip

    def __add__(self, other: Figures) -> Figures:
        """Return the figures of two parts together."""
        lows = [x.lowest for x in (self, other) if x.lowest]
        highs = [x.highest for x in (self, other) if x.highest]
        return Figures(
            self.needles + other.needles, self.cut + other.cut, self.gouged + other.gouged,
            self.total + other.total, self.squares + other.squares, min(lows, default=None),
            min(highs, default=None), dict(Counter(self.classes) + Counter(other.classes)),
        )  # fmt: skip

    @property
    def mean(self) -> float:
        """Mean height [m]."""
        if not self.cut:
            raise InterpError('the program cuts nothing of the surface; is it the right one?')
        return float(Fraction(self.total, self.cut << HEIGHT_BITS))

    def statistics(self, deviations: int) -> dict[str, float]:
        """Return the roughness figures of the needles that were cut."""
        mean = self.mean
        assert self.lowest and self.highest
        low, high = self.lowest.height, -self.highest.height
        square = Fraction(self.squares, self.cut << SQUARE_BITS)
        spread = square - Fraction(self.total, self.cut << HEIGHT_BITS) ** 2
        return {
            'highest': high,
            'lowest': low,
            'mean': mean,
            'Sa': float(Fraction(deviations, self.cut << HEIGHT_BITS)),
            'Sq': sqrt(max(float(spread), 0.0)),
            'Sz': high - low,
            'gouged': self.gouged / self.cut,
            'uncut': 1.0 - self.cut / self.needles,
        }

    def to_json(self) -> dict[str, Any]:
        """Return the figures for a file; long numbers are texts."""
        ends = [[e.height, e.row, e.column] if e else None for e in (self.lowest, self.highest)]
        return {
            'needles': self.needles, 'cut': self.cut, 'gouged': self.gouged,
            'total': str(self.total), 'squares': str(self.squares), 'extremes': ends,
            'classes': [[n, k] for n, k in sorted(self.classes.items())],
        }  # fmt: skip

    @staticmethod
    def of_json(found: dict[str, Any]) -> Figures:
        """Return the figures of a file; raises KeyError, TypeError or ValueError."""
        low, high = (Extreme(*e) if e else None for e in found['extremes'])
        return Figures(
            found['needles'], found['cut'], found['gouged'], int(found['total']),
            int(found['squares']), low, high, {int(n): int(k) for n, k in found['classes']},
        )  # fmt: skip


def is_cut(height: FloatArray) -> BoolArray:
    """Return True for needles that the mill has reached; same shape."""
    return np.asarray(height < 0.999 * TOP)


def deviations(height: FloatArray, mean: float) -> int:
    """Return the sum of |h - mean| over the needles that were cut, as ``exact_sum`` does."""
    return exact_sum(np.abs(height[is_cut(height)] - mean), HEIGHT_BITS)


def exact_sum(values: FloatArray, bits: int) -> int:
    """Sum numbers so that the order does not matter."""
    whole = np.rint(np.ldexp(values, bits)).astype(np.int64)
    return (int((whole >> HALF).sum()) << HALF) + int((whole & ((1 << HALF) - 1)).sum())
