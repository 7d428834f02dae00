"""
Needles: where the machined surface is measured.

The surface is evaluated in patches of one size that begin at multiples of it. So a needle has the
same place, bit for bit, whatever part of the grid is asked for.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from cnc_interp.cam.surface import Surface
from cnc_interp.cam.vectors import norm
from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray
from cnc_interp.core.errors import InterpError
from cnc_interp.core.units import MM

#: Needles in each direction of a patch.
PATCH = 64
#: Approximate number of needles in a group, which is tested as a whole.
GROUP = 64
#: Most needles at once, most in a row or column of a grid, and most of a grid.
MOST_AT_ONCE, MOST_IN_LINE, MOST = 50_000_000, 1 << 24, 1 << 40


@dataclass(frozen=True)
class Needles:
    """Needles that stand on a surface."""

    base: FloatArray  #: (rows, columns, 3): Points of the surface [m].
    normal: FloatArray  #: (rows, columns, 3): Unit normals there [-].
    #: (rows, columns): Needles on the face, where it does not fill the rectangle of parameters.
    counted: BoolArray | None = None

    @staticmethod
    def on(surface: Surface, spacing: float, margin: float = 0.0) -> Needles:
        """Return all needles of ``NeedleGrid.on``."""
        grid = NeedleGrid.on(surface, spacing, margin)
        if len(grid.u) * len(grid.v) > MOST_AT_ONCE:
            raise InterpError(
                f'needles every {spacing / MM:g} mm make {len(grid.u)} x {len(grid.v)}; cut them '
                'in tiles: cam simulate --tiles DIR'
            )
        needles = grid.needles(slice(0, grid.shape[0]), slice(0, grid.shape[1]))
        u, v = np.meshgrid(grid.u, grid.v, indexing='ij')
        counted = surface.contains(u, v, -margin)
        if not counted.any():
            raise InterpError(
                f'no needle lies {margin / MM:g} mm inside the border; take a smaller margin'
            )
        return needles if counted.all() else replace(needles, counted=counted)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.base.shape[0], self.base.shape[1]

    @property
    def ball(self) -> tuple[FloatArray, float]:
        """Centre, shape (3,), and radius of a ball around the bases [m]."""
        points = self.base.reshape(-1, 3)
        low, high = points.min(axis=0), points.max(axis=0)
        return 0.5 * (low + high), 0.5 * float(norm(high - low))

    def part(self, rows: slice, columns: slice) -> Needles:
        """Return a part of the needles."""
        return Needles(self.base[rows, columns], self.normal[rows, columns])

    def group_size(self) -> tuple[int, int]:
        """
        Return rows and columns of a group.

        The rows of sections are far apart and their columns close; a group is still nearly square.
        """
        steps = [
            float(np.median(norm(np.diff(self.base, axis=k)))) if n > 1 else 1.0
            for k, n in enumerate(self.shape)
        ]
        share = GROUP * min(steps[0] / max(steps[1], 1e-12), GROUP)
        wide = int(np.clip(np.sqrt(share), 1, GROUP))
        return GROUP // wide, wide

    def groups(self) -> tuple[IntArray, IntArray, FloatArray]:
        """Return needles by group, where each group begins, and a ball around it [m]."""
        rows, columns = self.shape
        index = np.arange(rows * columns).reshape(rows, columns)
        tall, wide = self.group_size()
        groups = [
            index[i : i + tall, j : j + wide].ravel()
            for i in range(0, rows, tall)
            for j in range(0, columns, wide)
        ]
        order = np.concatenate(groups)
        starts = np.concatenate([[0], np.cumsum([len(g) for g in groups])])
        points = self.base.reshape(-1, 3)[order]
        low, high = (edge.reduceat(points, starts[:-1]) for edge in (np.minimum, np.maximum))
        ball = np.empty((len(groups), 4))
        ball[:, :3] = 0.5 * (low + high)
        ball[:, 3] = 0.5 * norm(high - low)
        return order, starts, ball


@dataclass(frozen=True)
class NeedleGrid:
    """A grid of needles over a surface, of which any part can be made."""

    surface: Surface  #: The surface.
    u: FloatArray  #: (rows,): First parameter of the rows.
    v: FloatArray  #: (columns,): Second parameter of the columns.

    @staticmethod
    def on(surface: Surface, spacing: float, margin: float = 0.0) -> NeedleGrid:
        """Place needles on a surface at nearly equal distances."""
        grow = surface.growth(-margin) if margin else (0.0, 0.0)
        (u0, u1), (v0, v1) = surface.domain
        u0, u1, v0, v1 = u0 - grow[0], u1 + grow[0], v0 - grow[1], v1 + grow[1]
        rate = surface.growth(spacing)
        count = [int(np.ceil((b - a) / r)) + 1 for a, b, r in zip((u0, v0), (u1, v1), rate)]
        if min(count) < 2 or max(count) > MOST_IN_LINE or count[0] * count[1] > MOST:
            raise InterpError(
                f'needles every {spacing / MM:g} mm make {count[0]} x {count[1]}; choose another '
                'spacing or margin'
            )
        return NeedleGrid(surface, np.linspace(u0, u1, count[0]), np.linspace(v0, v1, count[1]))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return len(self.u), len(self.v)

    def needles(self, rows: slice, columns: slice) -> Needles:
        """Return the needles of some rows and columns."""
        assert rows.start % PATCH == columns.start % PATCH == 0
        high, wide = rows.stop - rows.start, columns.stop - columns.start
        base, normal = np.empty((high, wide, 3)), np.empty((high, wide, 3))
        for i, j in patches(high, wide, PATCH, PATCH):
            # A patch at the end is filled up: its last needles are made again and again.
            row = np.minimum(np.arange(i, i + PATCH), high - 1) + rows.start
            column = np.minimum(np.arange(j, j + PATCH), wide - 1) + columns.start
            u, v = np.meshgrid(self.u[row], self.v[column], indexing='ij')
            point = self.surface.at(u, v)
            tall, long = min(PATCH, high - i), min(PATCH, wide - j)
            base[i : i + tall, j : j + long] = point.position[:tall, :long]
            normal[i : i + tall, j : j + long] = point.normal[:tall, :long]
        return Needles(base, normal)


def patches(rows: int, columns: int, tall: int, wide: int) -> Iterator[tuple[int, int]]:
    """Yield first row and first column of the rectangles that cover a grid."""
    for i in range(0, rows, tall):
        for j in range(0, columns, wide):
            yield i, j
