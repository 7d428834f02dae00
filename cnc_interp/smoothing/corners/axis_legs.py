"""Blocks whose rotary axes run linearly, as lines in coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.core.arrays import BoolArray, FloatArray
from cnc_interp.machine_model.transform import Transform
from cnc_interp.program.blocks import AXES_LINEAR, Blocks

#: Places of X Y Z (or the tip), of the rotary axes and of the extra axes among the coordinates.
POINT, TURN, EXTRA = slice(0, 3), slice(3, 5), slice(5, None)


@dataclass(frozen=True)
class AxisLegs:
    """The blocks between n + 1 vertices as lines in coordinates."""

    #: (n,): Whether the rotary axes run linearly, and whether X Y Z do so, too.
    linear: BoolArray
    in_axes: BoolArray
    #: (n, 5 + k): Coordinates at the start of linear blocks, and what they move by [m, rad].
    start: FloatArray
    step: FloatArray
    length: FloatArray  #: (n,): Length of linear blocks [m].

    @staticmethod
    def of(blocks: Blocks, machine: Transform, height: float) -> AxisLegs:
        """Compute the lines between the rows of blocks; the flank height is in metres."""
        kind, extra = blocks.interpolation[1:], blocks.extra
        linear, in_axes = blocks.by_rotary[1:], kind == AXES_LINEAR
        ends = []
        for rows, rotary in (
            (slice(None, -1), blocks.rotary_from[1:]),
            (slice(1, None), blocks.rotary[1:]),
        ):
            found = np.zeros((len(linear), 5 + extra.shape[1]))
            found[:, POINT], found[:, EXTRA] = blocks.tip[rows], extra[rows]
            found[linear, TURN] = rotary[linear]
            found[in_axes, POINT] = positions(machine, found[in_axes])
            ends.append(found)
        step = ends[1] - ends[0]
        return AxisLegs(linear, in_axes, ends[0], step, size_of(step, height))


def positions(machine: Transform, coordinates: FloatArray) -> FloatArray:
    """Return X Y Z for tips, rotary axes and extra axes, shape (n, 5 + k), as (n, 3) [m]."""
    stands = machine.linear(coordinates[:, POINT], coordinates[:, TURN]).reshape(-1, 3)
    return np.asarray(stands - coordinates[:, EXTRA] @ machine.extra_direction)


def size_of(step: FloatArray, height: float) -> FloatArray:
    """Return the lengths of steps in coordinates, shape (..., 5 + k), as (...) [m]."""
    squares = step**2
    turned = height**2 * squares[..., TURN].sum(axis=-1)
    return np.asarray(
        np.sqrt(squares[..., POINT].sum(axis=-1) + turned + squares[..., EXTRA].sum(axis=-1))
    )
