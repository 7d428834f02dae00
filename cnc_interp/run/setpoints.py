"""MotionLaw -> Setpoints -> Chunk: one sample per interpolation period; chunks have stop tails."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.core.columns import Table, column
from cnc_interp.core.limits_by_position import COULOMB, DRIVE, VISCOUS, largest_between
from cnc_interp.feedrate.feed_planner import PlannedPiece
from cnc_interp.kinematics.axis_path import evaluate_along
from cnc_interp.program.functions import Functions

NO_FUNCTIONS = Functions.none()


class Setpoints(Table):
    """Commanded positions and their derivatives, one row per interpolation period."""

    time: FloatArray = column()  #: Since the start of the motion, multiples of the period [s].
    #: Commanded axes and their time derivatives [m or rad, per s, per s2, per s3].
    position: FloatArray = column('axes')
    velocity: FloatArray = column('axes')
    acceleration: FloatArray = column('axes')
    jerk: FloatArray = column('axes')
    block: IntArray = column()  #: Row of the block being executed.
    s: FloatArray = column()  #: Path position [m].

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
        self._rest: Setpoints | None = None

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
        k = law.piece_at(time)
        s, s_dot, s_ddot, s_dddot = law.evaluate(time, k)
        cell = law.cell[k]
        along = law.s[k] - path.s[cell] + law.moved(time, k)
        q, q_s, q_ss, q_sss = evaluate_along(path, along, cell)
        v, a, j = s_dot[:, None], s_ddot[:, None], s_dddot[:, None]
        # The sample after the piece, as if the motion ended there.
        self._rest = Setpoints.at_rest(
            self.next_number * self.period, path.cell_right[0, -1:].copy(),
            path.cell_block[-1:].copy(), path.s[-1:].copy(),
        )  # fmt: skip
        return Setpoints(
            time=time,
            position=q,
            velocity=q_s * v,  # Eq. 6
            acceleration=q_ss * (v * v) + q_s * a,  # Eq. 7
            jerk=q_sss * v**3 + 3.0 * q_ss * v * a + q_s * j,  # Eq. 8
            block=path.cell_block[cell],
            s=s,
        )

    def _end_of(self, piece: PlannedPiece) -> int:
        return int(np.ceil(piece.law.end_time / self.period - 1e-9))

    def finish(self) -> Setpoints:
        assert self._rest is not None, 'nothing was pushed'
        return self._rest


class Wait(IntEnum):
    """What the machine does at rest after the last setpoint of a chunk."""

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
    #: From the last of them to rest on the path; empty where that is at rest already.
    tail: Setpoints
    wait: Wait  #: What the machine waits for after the last one.
    #: What is switched at the begin of blocks of samples and tail; after the end of the program.
    functions: Functions = NO_FUNCTIONS
    first_function: int = 0  #: Number in the run of the first of them.

    @property
    def ends_approach(self) -> bool:
        """Tell whether the machine rests at the start pose after the chunk, before the program."""
        return not len(self.tail) and self.samples.block[-1] == 0

    @property
    def rests(self) -> bool:
        return self.wait is not Wait.NOTHING or self.ends_approach

    def head(self, count: int) -> Chunk:
        rest = self.samples[count:]
        tail = Setpoints.concatenate([rest, self.tail])
        kept = self.functions, self.first_function
        return Chunk(self.samples[:count], tail, Wait.NOTHING, *kept)


BEFORE = 3  #: Setpoints that must be known before the first one whose differences are taken.
STILL = 1e-12  #: Steps of an axis below this are rest [m, rad].


def limit_shares(positions: FloatArray, table: FloatArray, period: float) -> FloatArray:
    """Divide the first, second and third differences of setpoints by the largest allowed.

    They are means of derivatives, so the largest limit between the setpoints counts. ``positions``
    (3 + K, n_axes) with the three before; ``table`` (7, n_axes, m): see ``limits_by_position.py``.
    Returns (3, K, n_axes): signed shares [-]; row k belongs to those that end at setpoint k.
    """
    constant = table.shape[2] == 1
    shares = np.empty((3, len(positions) - BEFORE, positions.shape[1]))
    for row, order in enumerate((1, 2, 3)):
        held = positions[BEFORE - order :]
        if constant:
            limit = table[row, :, 0]
        else:
            around = sliding_window_view(held, order + 1, axis=0)
            limit = largest_between(table, around.min(axis=-1), around.max(axis=-1))[row]
        shares[row] = np.diff(held, order, axis=0) / (limit * period**order)
    return shares


def torque_shares(positions: FloatArray, table: FloatArray, period: float) -> FloatArray:
    """Divide the torques that three setpoints in a row need by the largest ones, (K, n_axes).

    Where an axis turns, Coulomb friction has both signs, so the smaller torque counts.
    """
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
