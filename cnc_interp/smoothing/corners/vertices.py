"""Classification of the vertices between blocks: passed, rounded or stopped at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.core import MM, BlockError, BoolArray, FloatArray, IntArray, dot, norm
from cnc_interp.machine_model.machine_traits import MachineTraits
from cnc_interp.program.blocks import Blocks
from cnc_interp.smoothing.corners.axis_corner import AxisCorners, AxisLegs
from cnc_interp.smoothing.corners.corner_curve import Corners
from cnc_interp.smoothing.dense.path_rows import STANDSTILL, Rows
from cnc_interp.smoothing.orientation import rotations_between, shares_at_corners

#: The path passes a vertex if directions [-], and axis rates times h, differ by less than this.
STRAIGHT = 1e-9
#: Above this rotation per travel of the tip, the tip counts as resting, and the tool stops at both
#: ends of the block [rad/m]. Rotary axes at 20 rev/min move such a tip at 0.1 mm/s. A rounded
#: corner would be smaller than this travel, and no feed solver converges on the derivatives of the
#: corner by path length.
SWIVEL = 20.0 / MM
PASS, ROUND, STOP = 0, 1, 2  #: Kinds of vertices: the path passes, is rounded, or the tool rests.


@dataclass
class Legs:
    """Geometry of the n blocks between consecutive vertices."""

    length: FloatArray  #: (n,): Length of the block [m].
    direction: FloatArray  #: (n, 3): Unit direction of the tip [-].
    rotation: FloatArray  #: (n, 3): Rotation vector of the tool axis over the block [rad].
    turn: FloatArray  #: (n,): Angle of this rotation [rad].
    rate: FloatArray  #: (n, 3): Rotation vector per metre of path [rad/m].
    resting: BoolArray  #: (n,): Whether the tip rests.
    extra_step: FloatArray  #: (n, k): Motion of the extra axes over the block [m].
    extra_rate: FloatArray  #: (n, k): The same per metre of path [-].
    #: Blocks whose rotary axes run linearly. Their ``length`` is that of the coordinates, the tool
    #: axis does not count as turning, and nothing rests. None without such blocks.
    axes: AxisLegs | None = None

    @staticmethod
    def of(blocks: Blocks, machine: MachineTraits, flank_height: float) -> Legs:
        """Compute the geometry of n blocks; block i leads from vertex i to vertex i + 1."""
        step = np.diff(blocks.tip, axis=0)
        length = norm(step)
        resting = length < STANDSTILL
        axes = None
        linear = blocks.by_rotary[1:]
        if linear.any() and machine.geometry is not None:
            axes = AxisLegs.of(blocks, machine.geometry, flank_height)
            length, resting = np.where(linear, axes.length, length), resting & ~linear
        direction = step / np.where(resting, 1.0, length)[:, None]
        rotation = rotations_between(blocks.axis[:-1], blocks.axis[1:])
        rotation[linear] = 0.0
        rate = rotation / np.where(resting, 1.0, length)[:, None]
        extra_step = np.diff(blocks.extra, axis=0)
        extra_rate = extra_step / np.where(resting, 1.0, length)[:, None]
        return Legs(
            length,
            direction,
            rotation,
            norm(rotation),
            rate,
            resting,
            extra_step,
            extra_rate,
            axes,
        )

    @property
    def swivels(self) -> BoolArray:
        """Return True for blocks in which the tip hardly moves while the tool turns, (n,)."""
        return np.asarray(~self.resting & (self.turn > SWIVEL * self.length))

    @property
    def still(self) -> BoolArray:
        """Return True for blocks of poses in which only the tip moves, (n,)."""
        still = ~self.resting & (self.turn == 0.0) & ~self.extra_step.any(axis=1)
        return np.asarray(still if self.axes is None else still & ~self.axes.linear)


def refuse_reversals(rows: Rows, legs: Legs) -> None:
    """Raise BlockError for a block with antiparallel tool axes: its great circle is undefined."""
    blocks = rows.blocks
    cosine = dot(blocks.axis[:-1], blocks.axis[1:])
    programmed = np.isfinite(blocks.rotary[1:]).all(axis=1) & legs.resting
    programmed |= blocks.by_rotary[1:]
    bad = np.flatnonzero((cosine < -1.0 + 1e-12) & ~programmed & (rows.count[1:] == 0))
    if len(bad):
        raise BlockError(
            'the tool axis reverses within one block, so its plane of rotation is undefined; '
            'add a block with an orientation in between',
            int(blocks.line_number[bad[0] + 1]),
        )


def classify(rows: Rows, legs: Legs, flank_height: float, machine: MachineTraits) -> IntArray:
    blocks, curve = rows.blocks, rows.count > 0
    kind = np.full(len(blocks), STOP)
    before, after = slice(None, -1), slice(1, None)
    still = legs.resting | legs.swivels
    resting = still[before] | still[after]
    cosine = dot(legs.direction[before], legs.direction[after])
    turning = (legs.turn[before] > 0.0) | (legs.turn[after] > 0.0)
    sharpest = np.where(turning, machine.sharpest_swing, machine.sharpest_turn)
    sharp = cosine < np.cos(sharpest)
    bend = norm(np.diff(legs.direction, axis=0))
    twist = norm(np.diff(legs.rate, axis=0)) * flank_height
    drift = np.abs(np.diff(legs.extra_rate, axis=0)).max(axis=1, initial=0.0)
    straight = (bend < STRAIGHT) & (twist < STRAIGHT) & (drift < STRAIGHT)
    kind[1:-1] = np.where(straight, PASS, ROUND)
    stop = resting | sharp | blocks.exact_stop[1:-1]
    kind[1:-1][stop] = STOP
    beside = curve[1:-1] | curve[2:]
    kind[1:-1][beside] = np.where(rows.smooth[2:], PASS, STOP)[beside]
    found = axis_corners(rows, legs, flank_height, machine)
    if found is not None:
        sharp = found.cosine < np.cos(machine.sharpest_swing)
        own = np.where(found.bend < STRAIGHT, PASS, ROUND)
        own[sharp | ~found.joined | blocks.exact_stop[found.row]] = STOP
        kind[found.row] = own
    return kind


def axis_corners(
    rows: Rows, legs: Legs, flank_height: float, machine: MachineTraits, at: IntArray | None = None
) -> AxisCorners | None:
    """Collect the corners beside blocks whose rotary axes run linearly."""
    if legs.axes is None or machine.geometry is None:
        return None
    linear = legs.axes.linear
    at = np.arange(1, len(rows) - 1) if at is None else at
    at = at[linear[at - 1] | linear[at]]
    still = legs.still & (rows.count[1:] == 0)
    return AxisCorners.at(at, rows.blocks, legs.axes, still, machine.geometry, flank_height)


def corners_at(
    blocks: Blocks, legs: Legs, rows: IntArray, machine: MachineTraits, flank_height: float
) -> Corners:
    """Collect the programmed data of the corners at some vertices."""
    tolerances = [
        np.minimum(column[rows], column[rows + 1])
        for column in (blocks.contour_tolerance, blocks.orientation_tolerance)
    ]
    near = np.zeros(len(rows), dtype=np.bool_)
    if machine.pole is not None:
        turns = np.stack([-legs.rotation[rows - 1], legs.rotation[rows]], axis=1)
        share = shares_at_corners(
            np.array(machine.pole), blocks.axis[rows], turns, tolerances[1] / flank_height
        )
        tolerances[1], near = tolerances[1] * share, share < 1.0
    return Corners(
        tip=blocks.tip[rows],
        axis=blocks.axis[rows],
        legs=np.stack([-legs.direction[rows - 1], legs.direction[rows]], axis=1),
        rates=np.stack([legs.rate[rows - 1], legs.rate[rows]], axis=1),
        tolerances=np.stack(tolerances, axis=1),
        extra_rates=np.stack([legs.extra_rate[rows - 1], legs.extra_rate[rows]], axis=1),
        near_pole=near,
    )
