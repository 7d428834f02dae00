"""Needles and the motion that cuts them; needles do not depend on the division into tiles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.needle_cuts import DEPTH, ROUNDING, SHORT, TOP
from cnc_interp.cam.surface import Surface
from cnc_interp.core import (
    MM,
    BoolArray,
    FloatArray,
    IntArray,
    InterpError,
    demand,
    dot,
    norm,
    refuse_if,
)
from cnc_interp.program.geometry.subdivide import great_circle, ragged

PATCH = 64  #: Needles in each direction of a patch.
GROUP = 64  #: Approximate number of needles in a group; a group is tested as a whole.
#: Largest number of needles at once, in a row or column of a grid, and in a grid.
MOST_AT_ONCE, MOST_IN_LINE, MOST = 50_000_000, 1 << 24, 1 << 40


@dataclass(frozen=True)
class Needles:
    base: FloatArray  #: (rows, columns, 3): Points of the surface [m].
    normal: FloatArray  #: (rows, columns, 3): Unit normals there [-].
    #: (rows, columns): True for needles on the face; None if all needles are on it.
    counted: BoolArray | None = None

    @staticmethod
    def on(surface: Surface, spacing: float, margin: float = 0.0) -> Needles:
        grid = NeedleGrid.on(surface, spacing, margin)
        refuse_if(
            len(grid.u) * len(grid.v) > MOST_AT_ONCE,
            InterpError(
                f'{len(grid.u)} x {len(grid.v)} needles, every {spacing / MM:g} mm, are too many; '
                'cut them in tiles: cam simulate --tiles DIR'
            ),
        )
        needles = grid.needles(slice(0, grid.shape[0]), slice(0, grid.shape[1]))
        u, v = np.meshgrid(grid.u, grid.v, indexing='ij')
        counted = surface.contains(u, v, -margin)
        demand(
            counted.any(),
            InterpError(
                f'no needle lies {margin / MM:g} mm inside the border; use a smaller margin'
            ),
        )
        return needles if counted.all() else replace(needles, counted=counted)

    @property
    def shape(self) -> tuple[int, int]:
        return self.base.shape[0], self.base.shape[1]

    @property
    def ball(self) -> tuple[FloatArray, float]:
        points = self.base.reshape(-1, 3)
        low, high = points.min(axis=0), points.max(axis=0)
        return 0.5 * (low + high), 0.5 * float(norm(high - low))

    def part(self, rows: slice, columns: slice) -> Needles:
        return Needles(self.base[rows, columns], self.normal[rows, columns])

    def group_size(self) -> tuple[int, int]:
        """Return the rows and columns of a group that is nearly square on the surface."""
        steps = [
            float(np.median(norm(np.diff(self.base, axis=k)))) if n > 1 else 1.0
            for k, n in enumerate(self.shape)
        ]
        share = GROUP * min(steps[0] / max(steps[1], 1e-12), GROUP)
        wide = int(np.clip(np.sqrt(share), 1, GROUP))
        return GROUP // wide, wide

    def groups(self) -> tuple[IntArray, IntArray, FloatArray]:
        """Return needles ordered by group, the start of each group, and a ball around it [m]."""
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
    surface: Surface  #: The surface.
    u: FloatArray  #: (rows,): First parameter of the rows.
    v: FloatArray  #: (columns,): Second parameter of the columns.

    @staticmethod
    def on(surface: Surface, spacing: float, margin: float = 0.0) -> NeedleGrid:
        grow = surface.growth(-margin) if margin else (0.0, 0.0)
        (u0, u1), (v0, v1) = surface.domain
        u0, u1, v0, v1 = u0 - grow[0], u1 + grow[0], v0 - grow[1], v1 + grow[1]
        rate = surface.growth(spacing)
        count = [int(np.ceil((b - a) / r)) + 1 for a, b, r in zip((u0, v0), (u1, v1), rate)]
        refuse_if(
            min(count) < 2 or max(count) > MOST_IN_LINE or count[0] * count[1] > MOST,
            InterpError(
                f'needles every {spacing / MM:g} mm make {count[0]} x {count[1]}; choose another '
                'spacing or margin'
            ),
        )
        return NeedleGrid(surface, np.linspace(u0, u1, count[0]), np.linspace(v0, v1, count[1]))

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.u), len(self.v)

    def needles(self, rows: slice, columns: slice) -> Needles:
        assert rows.start % PATCH == columns.start % PATCH == 0
        high, wide = rows.stop - rows.start, columns.stop - columns.start
        base, normal = np.empty((high, wide, 3)), np.empty((high, wide, 3))
        for i, j in patches(high, wide, PATCH, PATCH):
            # A patch at the end is filled up with copies of its last needles.
            row = np.minimum(np.arange(i, i + PATCH), high - 1) + rows.start
            column = np.minimum(np.arange(j, j + PATCH), wide - 1) + columns.start
            u, v = np.meshgrid(self.u[row], self.v[column], indexing='ij')
            point = self.surface.at(u, v)
            tall, long = min(PATCH, high - i), min(PATCH, wide - j)
            base[i : i + tall, j : j + long] = point.position[:tall, :long]
            normal[i : i + tall, j : j + long] = point.normal[:tall, :long]
        return Needles(base, normal)


def patches(rows: int, columns: int, tall: int, wide: int) -> Iterator[tuple[int, int]]:
    for i in range(0, rows, tall):
        for j in range(0, columns, wide):
            yield i, j


PIECE = 0.3  #: Longest piece of motion, as a share of the corner radius.
#: Largest turn of the axis in a piece [rad]; centre and tip then both move nearly straight.
TURN = 2.5e-3
COARSE = 0.4 * MM  #: Distance of the poses of a first, rough cut [m].
BATCH = 2000  #: Number of pieces in a batch; each batch begins with a rough cut.


@dataclass(frozen=True)
class MotionPieces:
    """Pieces of the motion of a mill; in each, tip and axis move straight between two poses.

    Pieces are so short that a parabola through three heights locates the lowest height.
    """

    cutter: Cutter  #: The mill.
    #: (n, 6): C_L [m] and unit tool axis [-] at the beginning, in the middle and at the end of a
    #: piece.
    first: FloatArray
    middle: FloatArray
    last: FloatArray
    #: (n,): Largest motion of the mill between the middle and an end of a piece [m].
    slack: FloatArray
    rough: BoolArray  #: (n,): Pieces of the first cut of a batch.
    batch: IntArray  #: (n,): Batch of each piece, in increasing order.

    @staticmethod
    def of(cutter: Cutter, tip: FloatArray, axis: FloatArray) -> MotionPieces:
        refuse_if(
            len(tip) < 2 or not (np.isfinite(tip).all() and np.isfinite(axis).all()),
            InterpError('a simulation needs two finite poses or more'),
        )
        R, r = cutter.tool_radius, cutter.corner_radius
        tip, axis = pieces(tip, axis, PIECE * min(max(r, 0.5 * MM), 5.0 * MM), R + r)
        pose = np.concatenate([tip + r * axis, axis], axis=1)
        middle = 0.5 * (pose[1:] + pose[:-1])
        middle[:, 3:] /= norm(middle[:, 3:])[:, None]
        step = np.abs(np.diff(pose, axis=0))
        slack = 0.6 * (norm(step[:, :3]) + (R + r + TOP) * norm(step[:, 3:]))
        usual = float(np.median(norm(step[:, :3])))
        stride = max(1, int(COARSE / max(usual, 1e-9)))
        number = np.arange(len(middle))
        rough = number % BATCH % stride == 0
        return MotionPieces(cutter, pose[:-1], middle, pose[1:], slack, rough, number // BATCH)

    def __len__(self) -> int:
        return len(self.middle)

    @property
    def skin(self) -> float:
        """Distance of the mill's surface from its inner cylinder [m]; 1 nm for a flat mill."""
        return max(self.cutter.corner_radius, 1e-9)

    @property
    def search(self) -> tuple[int, float]:
        """Number of stages of the search for the lowest height; half of its first interval [-]."""
        return (2, 0.25) if self.cutter.corner_radius > 0.05 * MM else (14, 1.0)

    def near(self, centre: FloatArray, radius: float) -> MotionPieces:
        v = centre - self.middle[:, :3]
        along = dot(v, self.middle[:, 3:])
        across = np.sqrt(np.maximum(dot(v, v) - along * along, 0.0))
        beyond = np.maximum(across - self.cutter.tool_radius, 0.0)
        away = np.hypot(np.minimum(along, 0.0), beyond)
        reach = radius + self.skin + max(TOP, DEPTH) + SHORT + ROUNDING
        kept = away <= reach + self.slack
        return MotionPieces(
            self.cutter,
            self.first[kept],
            self.middle[kept],
            self.last[kept],
            self.slack[kept],
            self.rough[kept],
            self.batch[kept],
        )


def pieces(
    tip: FloatArray, axis: FloatArray, longest: float, arm: float
) -> tuple[FloatArray, FloatArray]:
    """Divide motions so that neither tip nor rim moves further than ``longest`` in a piece."""
    turn = norm(np.diff(axis, axis=0))
    way = norm(np.diff(tip, axis=0)) + arm * turn
    count = np.ceil(np.maximum(way / longest, turn / TURN)).astype(int).clip(1)
    row, nth = ragged(count)
    share = nth / count[row]
    finer_tip = tip[row] + share[:, None] * (tip[row + 1] - tip[row])
    finer_axis = great_circle(axis[row], axis[row + 1], share)
    return np.vstack([finer_tip, tip[-1:]]), np.vstack([finer_axis, axis[-1:]])
