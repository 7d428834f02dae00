"""Sample a motion law once per interpolation period, and form chunks with stop tails."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.axis_limits import Limits
from cnc_interp.core.kernels import njit
from cnc_interp.core.limit_kernels import COULOMB, DRIVE, VISCOUS, largest_between
from cnc_interp.core.tables import Table, column
from cnc_interp.feedrate.motion_law import axis_motion
from cnc_interp.feedrate.planning_windows import PlannedPiece
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.program.blocks.functions import Functions

NO_FUNCTIONS = Functions.none()


class Setpoints(Table):
    """Commanded positions and their derivatives, one row per interpolation period."""

    #: Time since the start of the motion, in multiples of the period [s].
    time: FloatArray = column()
    #: Commanded axes and their time derivatives [m or rad, per s, per s2, per s3].
    position: FloatArray = column('axes')
    velocity: FloatArray = column('axes')
    acceleration: FloatArray = column('axes')
    jerk: FloatArray = column('axes', in_plans=False)  # the proof differentiates positions
    block: IntArray = column()  #: Row of the block being executed.
    s: FloatArray = column()  #: Path position [m].
    #: Line of the source; 0 while unknown. Plan files store it per block.
    line: IntArray = column(default=0, in_plans=False)

    @staticmethod
    def at_rest(time: float, position: FloatArray, block: IntArray, s: FloatArray) -> Setpoints:
        """Return one setpoint that rests at a position, shape (1, n_axes) [m or rad]."""
        still = np.zeros_like(position)
        return Setpoints(np.array([time]), position, still, still, still, block, s)


class Interpolator:
    """Samples planned pieces as they arrive; sample k lies at k times the period."""

    def __init__(self, period: float, first: int = 0):
        self.period = period
        self.next_number = first
        self._path: AxisPath | None = None  # of the last piece

    def parts(self, piece: PlannedPiece, most: int = 1 << 16) -> Iterator[Setpoints]:
        while True:
            yield self.push(piece, most)
            if self.next_number >= self._end_of(piece):
                return

    def push(self, piece: PlannedPiece, most: int | None = None) -> Setpoints:
        """Sample one piece, or its next ``most`` samples; its end is excluded."""
        law, path = piece.law, piece.path
        last = self._end_of(piece)
        last = last if most is None else min(last, self.next_number + most)
        time = np.arange(self.next_number, last) * self.period
        self.next_number = max(self.next_number, last)
        self._path = path
        return Setpoints(time, *axis_motion(path, law, time))

    def _end_of(self, piece: PlannedPiece) -> int:
        return int(np.ceil(piece.law.end_time / self.period - 1e-9))

    def finish(self) -> Setpoints:
        path = self._path
        assert path is not None, 'nothing was pushed'
        return Setpoints.at_rest(
            self.next_number * self.period,
            path.cell_right[0, -1:].copy(),
            path.cell_block[-1:].copy(),
            path.s[-1:].copy(),
        )


class Wait(IntEnum):
    """Action of the machine at rest after the last setpoint of a chunk."""

    NOTHING = 0  # goes on with the next chunk
    OVERRIDE = 1  # rests while the feed override is 0
    PROGRAM_STOP = 2  # rests until cycle_start (M0)
    END = 3  # the program ends here
    OPTIONAL_STOP = 4  # rests until cycle_start (M1)
    SINGLE_BLOCK = 5  # rests until cycle_start
    APPROACH = 6  # rests until cycle_start; the way to the path follows
    FUNCTION = 7  # rests until the functions there are answered


@dataclass(frozen=True)
class Chunk:
    samples: Setpoints  #: The setpoints to be executed.
    #: Stop tail from the last sample to rest on the path; empty if the sample is at rest.
    tail: Setpoints
    wait: Wait  #: What the machine waits for after the last one.
    #: Functions at the begins of the blocks of samples and tail; and those after the program's
    #: end.
    functions: Functions = NO_FUNCTIONS
    first_function: int = 0  #: Number of the first function in the run.

    @property
    def rests(self) -> bool:
        ends_approach = not len(self.tail) and self.samples.block[-1] == 0
        return self.wait is not Wait.NOTHING or ends_approach

    def head(self, count: int) -> Chunk:
        rest = self.samples[count:]
        tail = Setpoints.concatenate([rest, self.tail])
        kept = self.functions, self.first_function
        return Chunk(self.samples[:count], tail, Wait.NOTHING, *kept)


BEFORE = 3  #: Number of setpoints needed before the first one to form its differences.
STILL = 1e-12  #: Smaller steps of an axis count as rest [m, rad].


def limit_shares(positions: FloatArray, limits: Limits, period: float) -> FloatArray:
    """Divide the first, second and third differences of setpoints by the largest allowed.

    Differences are means of derivatives, so the largest limit between the setpoints applies.
    ``positions`` (3 + K, n_axes) includes the three setpoints before. Returns signed shares,
    (3, K, n_axes) [-]; row k belongs to the differences that end at setpoint k.
    """
    shares = np.empty((3, len(positions) - BEFORE, positions.shape[1]))
    _compare(positions, limits.table, np.array([period, period**2, period**3]), shares)
    return shares


def largest_shares(positions: FloatArray, limits: Limits, period: float) -> FloatArray:
    """Return the largest of ``limit_shares`` without its sign, (3, n_axes) [-]."""
    unwanted = np.empty((3, 0, positions.shape[1]))
    return _compare(positions, limits.table, np.array([period, period**2, period**3]), unwanted)


@njit(cache=True, nogil=True, error_model='numpy')
def _compare(
    positions: FloatArray, table: FloatArray, units: FloatArray, shares: FloatArray
) -> FloatArray:
    """Write the shares, if there is room, and return the largest; ``units``: T, T^2 and T^3."""
    largest, plain = np.zeros((3, positions.shape[1])), table.shape[2] == 1
    difference = np.empty(3)
    for m in range(len(positions) - BEFORE):
        for k in range(positions.shape[1]):
            p0, p1 = positions[m, k], positions[m + 1, k]
            p2, p3 = positions[m + 2, k], positions[m + 3, k]
            second = (p3 - p2) - (p2 - p1)
            difference[0], difference[1] = p3 - p2, second
            difference[2] = second - ((p2 - p1) - (p1 - p0))
            if plain and shares.shape[1] == 0:  # the limit divides the largest one below
                for row in range(3):
                    largest[row, k] = np.maximum(largest[row, k], abs(difference[row]))
                continue
            low, high = min(p2, p3), max(p2, p3)
            for row in range(3):
                if not plain and row > 0:
                    before = p1 if row == 1 else p0
                    low, high = min(low, before), max(high, before)
                limit = largest_between(table, row, k, low, high)
                share = difference[row] / (limit * units[row])
                largest[row, k] = np.maximum(largest[row, k], abs(share))  # keeps NaN
                if shares.shape[1] > 0:
                    shares[row, m, k] = share
    if plain and shares.shape[1] == 0:
        for row in range(3):
            for k in range(positions.shape[1]):
                largest[row, k] /= table[row, k, 0] * units[row]
    return largest


def torque_shares(positions: FloatArray, limits: Limits, period: float) -> FloatArray:
    """Return the torques of three successive setpoints over the largest torques, (K, n_axes).

    Where an axis turns, Coulomb friction has both signs, so the smaller torque counts.
    """
    table = limits.table
    steps = np.diff(positions[BEFORE - 2 :], axis=0)
    sign = np.where(np.abs(steps) < STILL, 0.0, np.sign(steps))
    asked = np.diff(steps, axis=0) / period**2
    asked += table[VISCOUS, :, 0] * (steps[1:] + steps[:-1]) / (2.0 * period)
    friction, way = table[COULOMB, :, 0], np.sign(sign[1:] + sign[:-1])
    turns = sign[1:] * sign[:-1] < 0.0
    torque = np.where(
        turns, np.maximum(np.abs(asked) - friction, 0.0), np.abs(asked + way * friction)
    )
    shares: FloatArray = torque / table[DRIVE, :, 0]
    return shares
