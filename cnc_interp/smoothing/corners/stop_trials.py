"""
Corners at which an exact stop is faster than the rounded path.

Rounding nearly always saves time. It may not where the axes move in another way on the corner
than on the lines beside it: near the pole, where the rounded orientation may lead the outer rotary
axis half a turn round; beside a block on which the tip hardly moves while the tool turns; and
where the path almost reverses. No simple size of the corner tells how long the axes take there.
So the motion over the next few lines is planned both ways, and the faster one is taken. Other
corners are not tried.

A trial begins at rest at the vertex before the corner, and knows as many lines after it however
the blocks arrive. So the result does not depend on that.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cnc_interp.core.arrays import BoolArray, IntArray
from cnc_interp.core.units import DEG, MM
from cnc_interp.program.blocks import Blocks
from cnc_interp.smoothing.corners.vertices import ROUND, STOP, Legs
from cnc_interp.smoothing.dense.path_rows import Rows
from cnc_interp.smoothing.machine_traits import MachineTraits
from cnc_interp.smoothing.orientation import angles_between, dot, norm

#: Lines after the corner that a trial knows.
LINES = 3
#: A corner is tried where the tool turns faster than this on one side [rad/m].
FAST = 2.0 / MM
#: A corner is tried where the path turns more than this [rad].
SHARP = 165.0 * DEG
#: A stop must save this part of the time of its trial [-].
WORTH = 1e-3


def doubtful(rows: Rows, legs: Legs, height: float, machine: MachineTraits) -> BoolArray:
    """
    Tell at which vertices a rounded corner may be slower than a stop.

    Parameters
    ----------
    rows : Rows
        Lines and curves with n end poses.
    legs : Legs
        Geometry between these poses.
    height : float
        Flank height [m].
    machine : MachineTraits
        Its pole.

    Returns
    -------
    ndarray of bool, shape (n,)
        False for the first and the last vertex, and beside curves.

    """
    blocks, found = rows.blocks, np.zeros(len(rows), dtype=np.bool_)
    turn = np.maximum(legs.turn[:-1], legs.turn[1:])
    rate = norm(legs.rate)
    found[1:-1] = np.maximum(rate[:-1], rate[1:]) > FAST
    found[1:-1] |= dot(legs.direction[:-1], legs.direction[1:]) < np.cos(SHARP)
    if machine.pole is not None:
        angle = angles_between(blocks.axis[1:-1], np.asarray(machine.pole))
        angle = np.minimum(angle, np.pi - angle)
        reach = turn + 2.0 * blocks.orientation_tolerance[1:-1] / height
        found[1:-1] |= (turn > 0.0) & (angle < reach)
    plain = (rows.count == 0) & ~blocks.by_rotary
    found[1:-1] &= plain[1:-1] & plain[2:]
    return found


class StopTrials:
    """
    Rest at corners where this is faster.

    Parameters
    ----------
    machine : MachineTraits
        The machine, whose ``motion_time`` plans the trials. Without it nothing is tried.
    height : float
        Flank height [m].

    """

    def __init__(self, machine: MachineTraits, height: float):
        self._machine, self._height = machine, height
        self._stops: dict[int, bool] = {}  # of corners tried, by program row

    def decide(self, rows: Rows, legs: Legs, vertex: IntArray, final: bool) -> int:
        """
        Turn rounded corners into stops where the tool is faster so.

        Parameters
        ----------
        rows : Rows
            Lines and curves with n end poses; the kind of the first vertex is decided.
        legs : Legs
            Geometry between these poses.
        vertex : ndarray of int, shape (n,)
            PASS, ROUND or STOP; changed in place.
        final : bool
            Whether the path ends with the last row.

        Returns
        -------
        int
            All vertices before this one are decided.

        """
        if self._machine.motion_time is None:
            return len(rows)
        tried = doubtful(rows, legs, self._height, self._machine) & (vertex == ROUND)
        for v in np.flatnonzero(tried):
            row = int(rows.row[v])
            if row not in self._stops:
                end = self._end(rows, vertex, int(v), final)
                if end is None:
                    return int(v)
                self._stops[row] = self._is_faster(rows.blocks[v - 1 : end + 1])
            if self._stops[row]:
                vertex[v] = STOP
        return len(rows)

    def forget(self, row: int) -> None:
        """Forget the corners up to a program row."""
        self._stops = {key: stop for key, stop in self._stops.items() if key > row}

    @staticmethod
    def _end(rows: Rows, vertex: IntArray, v: int, final: bool) -> int | None:
        """Return the vertex at which a trial ends; None if it is not known yet."""
        for end in range(v + 1, v + LINES + 1):
            if end == len(rows) - 1:
                return end if final else None
            if vertex[end] == STOP or rows.count[end + 1] > 0 or rows.blocks.by_rotary[end + 1]:
                return end
        return v + LINES

    def _is_faster(self, blocks: Blocks) -> bool:
        """Tell whether a stop at the second pose is faster."""
        times = []
        for stops in (False, True):
            exact = blocks.exact_stop.copy()
            exact[1] = stops
            assert self._machine.motion_time is not None
            times.append(self._machine.motion_time(replace(blocks, exact_stop=exact)))
        return times[1] < (1.0 - WORTH) * times[0]
