"""Corners at which a stop may be faster, and short runs of blocks that may be faster as lines.

Rounding nearly always saves time. It may lose time where the axes move differently on the corner
than on the lines beside it: near the pole, where the rounded orientation may turn the outer rotary
axis by half a turn; beside a block on which the tip hardly moves while the tool turns; and where
the path almost reverses. Beside a line of a micrometre a rounded corner is so small that passing
it at low speed may take longer than resting. Other corners are always rounded.

A curve needs room: a few spans, and a part of the lines beside it. On a run only a few tolerances
long, the lines and their corners may be shorter and straighter. Near the pole a curve may use the
whole orientation tolerance, and the outer rotary axis follows each of its waves.

No simple measure of the path predicts how long the axes take in these cases, and smoothing plans
no motion. Therefore it proposes two sets of alternatives for the next blocks, and a stage that can
plan them chooses (``Choice``). At a corner, the alternatives have a stop or none; with each, the
corners after it are either all rounded or all stops. A run is a curve, or lines with rounded
corners; if one of these corners is doubtful, also lines with a stop at every corner.

An alternative begins and ends at rest. It begins at the last stop, at most three lines before the
corner, and ends at the next stop, at most six lines after it. Its lines, and the choice, do not
depend on how the blocks arrive.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cnc_interp.core import DEG, MM, UM, BoolArray, IntArray, dot, norm
from cnc_interp.machine_model.machine_traits import MachineTraits
from cnc_interp.program.blocks import OPEN_CORNER, STOP_CORNER, WITHIN_MOTION, Blocks
from cnc_interp.smoothing.corners.vertices import ROUND, STOP, Legs
from cnc_interp.smoothing.dense.path_rows import Rows
from cnc_interp.smoothing.dense.skeleton import Skeleton
from cnc_interp.smoothing.orientation import angles_between

BEFORE, AFTER = 3, 6  #: Most lines of an alternative before and after its corner.
#: A stop is tried at corners where the outer rotary axis may turn faster on one side [rad/m].
FAST = 2.0 / MM
SHARP = 160.0 * DEG  #: A stop is tried at corners where the path turns more than this [rad].
MICRO = 3.0 * UM  #: A stop is tried at corners beside a line shorter than this [m].
#: Most blocks of a run that is tried as lines; a run shorter than this always is [tolerances].
MOST_BLOCKS, TINY = 8, 15.0


@dataclass(frozen=True)
class Way:
    """A few blocks from rest to rest, each corner rounded unless it has an exact stop."""

    blocks: Blocks  #: The start pose and the blocks.
    curves: bool = False  #: Whether runs of short blocks become curves.


#: Port: returns whether the fastest of the first alternatives is faster than all of the second.
Choice = Callable[[Sequence[Way], Sequence[Way]], bool]


def doubtful(rows: Rows, legs: Legs, height: float, machine: MachineTraits) -> BoolArray:
    """Return True for vertices at which a rounded corner may be slower than a stop."""
    found = np.zeros(len(rows), dtype=np.bool_)
    found[1:-1] = np.minimum(legs.length[:-1], legs.length[1:]) < MICRO
    found[1:-1] |= turns_fast(rows.blocks, legs, height, machine)
    # There may be thousands of pieces. Line numbers do not identify them, as loops repeat lines.
    found &= rows.blocks.corner != WITHIN_MOTION
    found[1:-1] |= dot(legs.direction[:-1], legs.direction[1:]) < np.cos(SHARP)
    plain = _plain(rows)
    found[1:-1] &= plain[1:-1] & plain[2:]
    return found


def turns_fast(blocks: Blocks, legs: Legs, height: float, machine: MachineTraits) -> BoolArray:
    """Return True for inner vertices at which the outer rotary axis may turn fast on one side."""
    turn = np.maximum(legs.turn[:-1], legs.turn[1:])
    rate = norm(legs.rate)
    rate = np.maximum(rate[:-1], rate[1:])
    if machine.pole is None:
        return np.asarray(rate > FAST)
    angle = angles_between(blocks.axis[1:-1], np.asarray(machine.pole))
    reach = turn + 2.0 * blocks.orientation_tolerance[1:-1] / height
    near = (turn > 0.0) & (np.minimum(angle, np.pi - angle) < reach)
    return np.asarray(near | (rate > FAST * np.sin(angle)))  # the outer axis turns faster there


def may_be_slow(
    skeleton: Skeleton, start: int, last: int, height: float, machine: MachineTraits
) -> bool:
    least = float(skeleton.tolerance[start + 1 : last + 1].min())
    if skeleton.u[last] - skeleton.u[start] < TINY * least:
        return True
    if not skeleton.turning[start + 1 : last + 1].any():
        return False
    blocks = skeleton.blocks[start : last + 1]
    return bool(turns_fast(blocks, Legs.of(blocks, machine, height), height, machine).any())


def ways_of_run(
    skeleton: Skeleton, start: int, last: int, height: float, machine: MachineTraits
) -> tuple[list[Way], list[Way]]:
    """Return two sets of alternatives for a run: as lines, with or without stops; as a curve."""
    first = start if skeleton.stop[start] else start - 1
    end = last if skeleton.stop[last] else last + 1
    blocks = skeleton.blocks[first : end + 1]
    ways = [Way(blocks)]
    if doubtful(Rows.plain(blocks, 0), Legs.of(blocks, machine, height), height, machine).any():
        ways.append(Way(replace(blocks, exact_stop=np.ones(len(blocks), dtype=np.bool_))))
    return ways, [Way(blocks, curves=True)]


class StopChoice:
    def __init__(
        self, choice: Choice | None, machine: MachineTraits, height: float, found: list[int]
    ):
        self._choice, self._machine, self._height, self._found = choice, machine, height, found
        self._stops: dict[int, bool] = {}  # of corners tried, by program row
        self._past: Blocks | None = None  # decided rows up to the first known one
        self._plain = np.zeros(0, dtype=np.bool_)  # which of them are lines of poses

    def decide(self, rows: Rows, legs: Legs, vertex: IntArray, final: bool) -> int:
        """Turn rounded corners into stops where that is faster; return how many rows are final."""
        known = rows.blocks.corner
        vertex[(vertex == ROUND) & (known == STOP_CORNER)] = STOP
        tried = (vertex == ROUND) & (known == OPEN_CORNER)
        if self._choice is None or not tried.any():
            return len(rows)
        tried &= doubtful(rows, legs, self._height, self._machine)
        for v in np.flatnonzero(tried):
            row = int(rows.row[v])
            if row not in self._stops:
                end = self._end(rows, vertex, int(v), final)
                if end is None:
                    return int(v)
                blocks, plain = self._decided(rows[: end + 1], vertex)
                at = len(blocks) - 1 - end + int(v)
                begin = at - 1
                while (
                    begin > max(at - BEFORE, 0) and plain[begin] and not blocks.exact_stop[begin]
                ):
                    begin -= 1
                self._stops[row] = self._choice(*_ways_at(blocks[begin:], at - begin))
                if self._stops[row]:
                    self._found.append(row)
            if self._stops[row]:
                vertex[v] = STOP
        return len(rows)

    def keep(self, rows: Rows, vertex: IntArray, last: int) -> None:
        """Record that the rows up to ``last`` are final; the next call starts at row ``last``."""
        if self._choice is None:
            return
        blocks, plain = self._decided(rows[: last + 1], vertex)
        self._past, self._plain = blocks[-BEFORE:], plain[-BEFORE:]
        row = int(rows.row[last])
        self._stops = {key: stop for key, stop in self._stops.items() if key > row}

    def _decided(self, rows: Rows, vertex: IntArray) -> tuple[Blocks, BoolArray]:
        """Return the rows, and those before them, with their stops; and which rows are lines."""
        blocks = replace(rows.blocks, exact_stop=vertex[: len(rows)] == STOP)
        plain = _plain(rows)
        if self._past is None:
            return blocks, plain
        return (
            Blocks.concatenate([self._past, blocks[1:]]),
            np.concatenate([self._plain, plain[1:]]),
        )

    @staticmethod
    def _end(rows: Rows, vertex: IntArray, v: int, final: bool) -> int | None:
        """Return the vertex at which an alternative ends; None if it is not known yet."""
        plain = _plain(rows)
        for end in range(v + 1, v + AFTER + 1):
            if end == len(rows) - 1:
                return end if final else None
            if vertex[end] == STOP or not plain[end + 1]:
                return end
        return v + AFTER


def _ways_at(blocks: Blocks, at: int) -> list[list[Way]]:
    ways: list[list[Way]] = [[], []]
    for stops in (1, 0):
        for later in (False, True)[: len(blocks) - at - 1]:
            exact = blocks.exact_stop.copy()
            exact[at], exact[at + 1 :] = stops, exact[at + 1 :] | later
            ways[1 - stops].append(Way(replace(blocks, exact_stop=exact)))
    return ways


def _plain(rows: Rows) -> BoolArray:
    return np.asarray((rows.count == 0) & ~rows.blocks.by_rotary)
