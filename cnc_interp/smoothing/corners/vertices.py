"""What a vertex between two blocks becomes: a corner, a stop, or nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray
from cnc_interp.core.errors import BlockError
from cnc_interp.program.blocks import Blocks
from cnc_interp.smoothing.corners.corner import Corners
from cnc_interp.smoothing.dense.growing_skeleton import STANDSTILL
from cnc_interp.smoothing.dense.rows import Rows
from cnc_interp.smoothing.machine_traits import MachineTraits
from cnc_interp.smoothing.orientation import angles_between, dot, norm, rotations_between

#: Directions (relative to 1) and rates at flank height that differ less go straight on.
STRAIGHT = 1e-9
#: The path goes on, is rounded, or rests.
PASS, ROUND, STOP = 0, 1, 2


@dataclass
class Legs:
    """Geometry of the blocks between consecutive vertices, one row per block."""

    length: FloatArray
    direction: FloatArray
    rotation: FloatArray
    turn: FloatArray
    rate: FloatArray
    resting: BoolArray

    @staticmethod
    def of(blocks: Blocks) -> Legs:
        """Measure the blocks; row i leads from vertex i to vertex i + 1."""
        step = np.diff(blocks.tip, axis=0)
        length = norm(step)
        resting = length < STANDSTILL
        direction = step / np.where(resting, 1.0, length)[:, None]
        rotation = rotations_between(blocks.axis[:-1], blocks.axis[1:])
        rate = rotation / np.where(resting, 1.0, length)[:, None]
        return Legs(length, direction, rotation, norm(rotation), rate, resting)


def refuse_reversals(rows: Rows, legs: Legs) -> None:
    """Refuse blocks whose orientations are antiparallel: their great circle is undefined."""
    blocks = rows.blocks
    cosine = dot(blocks.axis[:-1], blocks.axis[1:])
    programmed = np.isfinite(blocks.rotary[1:]).all(axis=1) & legs.resting
    bad = np.flatnonzero((cosine < -1.0 + 1e-12) & ~programmed & (rows.count[1:] == 0))
    if len(bad):
        raise BlockError(
            'the tool axis reverses within one block, so its plane of rotation is undefined; '
            'add a block with an orientation in between',
            int(blocks.line_number[bad[0] + 1]),
        )


def classify(rows: Rows, legs: Legs, flank_height: float, machine: MachineTraits) -> IntArray:
    """
    Decide what each vertex becomes.

    Parameters
    ----------
    rows : Rows
        The blocks, n vertices.
    legs : Legs
        Their geometry.
    flank_height : float
        Height at which orientation is measured [m].
    machine : MachineTraits
        Where the machine has to stop.

    Returns
    -------
    ndarray of int, shape (n,)
        PASS, ROUND or STOP; the ends are stops.

    """
    blocks, curve = rows.blocks, rows.count > 0
    kind = np.full(len(blocks), STOP)
    before, after = slice(None, -1), slice(1, None)
    resting = legs.resting[before] | legs.resting[after]
    cosine = dot(legs.direction[before], legs.direction[after])
    turning = (legs.turn[before] > 0.0) | (legs.turn[after] > 0.0)
    sharpest = np.where(turning, machine.sharpest_swing, machine.sharpest_turn)
    sharp = cosine < np.cos(sharpest)
    bend = norm(np.diff(legs.direction, axis=0))
    twist = norm(np.diff(legs.rate, axis=0)) * flank_height
    straight = (bend < STRAIGHT) & (twist < STRAIGHT)
    kind[1:-1] = np.where(straight, PASS, ROUND)
    at_pole = np.zeros(len(kind) - 2, dtype=bool)
    if machine.pole is not None:
        o = blocks.axis[1:-1]
        pole = np.broadcast_to(np.asarray(machine.pole), o.shape)
        angle = angles_between(o, pole)
        close = np.minimum(angle, np.pi - angle) < machine.pole_cone
        at_pole = close & turning
    stop = resting | sharp | at_pole | blocks.exact_stop[1:-1]
    kind[1:-1][stop] = STOP
    beside = curve[1:-1] | curve[2:]
    kind[1:-1][beside] = np.where(rows.smooth[2:], PASS, STOP)[beside]
    return kind


def corners_at(blocks: Blocks, legs: Legs, rows: IntArray) -> Corners:
    """Collect what the program says about the corners at some vertices."""
    tolerances = [
        np.minimum(column[rows], column[rows + 1])
        for column in (blocks.contour_tolerance, blocks.orientation_tolerance)
    ]
    return Corners(
        tip=blocks.tip[rows],
        axis=blocks.axis[rows],
        legs=np.stack([-legs.direction[rows - 1], legs.direction[rows]], axis=1),
        rates=np.stack([legs.rate[rows - 1], legs.rate[rows]], axis=1),
        tolerances=np.stack(tolerances, axis=1),
    )
