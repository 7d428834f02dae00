"""Motion by hand: any number of axes, at a velocity or to a target; axes may already move.

ruckig (Berscheid and Kroeger, 2021) computes the fastest motion within velocity, acceleration and
jerk limits. The setpoints are samples of it, so their differences keep the limits too. Near an end
of travel, a velocity towards it becomes a motion to that end. Setpoints are sent only if they and
the stop after them stay within the travel and hit no body of the scene. Otherwise the axes make
the stop that follows the setpoints sent before.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress

import numpy as np
import ruckig

from cnc_interp.core import FloatArray, StreamError
from cnc_interp.machine.slides import THERE, Slides
from cnc_interp.run.clearance_stage import ContactError, Foresight
from cnc_interp.run.setpoints import Chunk, Setpoints, Wait

#: A smaller share of a velocity limit counts as rest, because a move would take too long [-].
LEAST_SHARE = 1e-3
#: Motion at a velocity is planned for this time, and planned anew after half of it [s].
HORIZON = 10.0
#: Factors on the jerk limit. Where two of ruckig's profiles meet within rounding, it may find no
#: motion, as at a distance of 2 A^3 / J^2. A slightly lower jerk avoids this.
SEAMS = (1.0, 1.0 - 1e-9, 1.0 - 1e-6)

VELOCITY, POSITION = ruckig.ControlInterface.Velocity, ruckig.ControlInterface.Position
EACH_ALONE, TOGETHER = ruckig.Synchronization.No, ruckig.Synchronization.Time


class JogMotion:
    def __init__(
        self,
        slides: Slides,
        period: float,
        x: FloatArray,
        contact: Foresight | None = None,
    ):
        self.slides, self._period = slides, period
        self._contact = contact
        self.blocked: ContactError | None = None  #: Contact before which the motion stops.
        self._solver = ruckig.Ruckig(len(x))
        #: (3, m): Position, velocity and acceleration at the last setpoint that was returned.
        self._state = np.stack([x, np.zeros_like(x), np.zeros_like(x)])
        self._velocity: FloatArray | None = None
        self._count = 0  # setpoints handed out
        self.stop()

    @property
    def x(self) -> FloatArray:
        """Coordinates of the last setpoint that was returned, shape (m,) [m, rad]."""
        return self._state[0]

    @property
    def over(self) -> bool:
        """Whether all setpoints down to rest have been returned."""
        return self._next >= self._last

    def stop(self) -> None:
        """Stop each slide as fast as its limits allow."""
        self._velocity = None
        self._follow(self._stop(self._state), rests=True)

    def run(self, velocity: FloatArray) -> None:
        """Move at a velocity (m,) until the next command; stop at the end of the travel."""
        self._velocity = velocity
        largest, acceleration, jerk = self.slides.limits.by_order
        x, v, a = self._state
        low, high = self.slides.limits.travel.T
        end = np.where(velocity > 0.0, high, low)
        share = np.abs(velocity) / largest
        left = np.where(velocity > 0.0, end - x, x - end)
        there = (left <= THERE) & (v == 0.0) & (a == 0.0)
        wanted = np.where((share < LEAST_SHARE) | there, 0.0, velocity)
        stop_length = largest * (largest / acceleration + acceleration / jerk)
        near = (wanted != 0.0) & (np.abs(end - x) < HORIZON * np.abs(wanted) + stop_length)
        planned = self._solve(self._state, wanted, np.where(near, end, np.nan), EACH_ALONE)
        self._follow(planned, rests=not (wanted[~near]).any())

    def go(self, target: FloatArray, share: float) -> None:
        """Move to ``target`` at ``share`` of the velocity limits; all slides arrive together."""
        self._velocity = None
        x, v, a = self._state
        if (np.abs(target - x) <= THERE).all() and not (v.any() or a.any()):
            self.stop()
            return
        most = share * self.slides.limits.max_velocity
        self._follow(self._solve(self._state, most, target, TOGETHER), rests=True)

    def piece(self, count: int) -> Chunk:
        """Return the next ``count`` setpoints, with the stop after them as stop tail."""
        if self._velocity is not None and self._next * self._period > 0.5 * HORIZON:
            self.run(self._velocity)
        rows, tail = self._next_rows(count)
        hit = self._hit(rows, tail)
        if hit or not (self._inside(rows) and self._inside(tail)):
            self.stop()
            rest = self._planned.at_time(self._planned.duration)[0]
            if hit is not None:
                self.blocked = hit(self.slides.positions(np.array([rest]))[0])
            if self.over:  # at rest already
                raise self.blocked or StreamError('the motion would leave the travel')
            rows, tail = self._next_rows(count)
        before = self._state[2]
        self._next += len(rows)
        self._state = rows[-1]
        samples = self._setpoints(rows, before, self._count)
        self._count += len(rows)
        stop = self._setpoints(tail, rows[-1, 2], self._count)
        return Chunk(samples, stop, Wait.END if self.over else Wait.NOTHING)

    def _solve(
        self, state: FloatArray, velocity: FloatArray, target: FloatArray, together: object
    ) -> ruckig.Trajectory:
        """Return ruckig's motion to ``target``; slides with target NaN reach ``velocity``."""
        largest, acceleration, jerk = self.slides.limits.by_order
        aims = np.isfinite(target)
        wanted = ruckig.InputParameter(len(target))
        wanted.current_position = state[0].tolist()
        wanted.current_velocity = state[1].tolist()
        wanted.current_acceleration = np.clip(state[2], -acceleration, acceleration).tolist()
        wanted.target_position = np.where(aims, target, state[0]).tolist()
        wanted.target_velocity = np.where(aims, 0.0, velocity).tolist()
        wanted.max_velocity = np.where(aims, np.abs(velocity), largest).tolist()
        wanted.max_acceleration = acceleration.tolist()
        wanted.per_dof_control_interface = [POSITION if aim else VELOCITY for aim in aims]
        wanted.synchronization = together
        found = ruckig.Trajectory(len(target))
        for share in SEAMS:
            wanted.max_jerk = (share * jerk).tolist()
            with suppress(ruckig.RuckigError):
                self._solver.calculate(wanted, found)
                return found
        raise StreamError('no motion was found; choose a nearer target or a higher speed')

    def _stop(self, state: FloatArray) -> ruckig.Trajectory:
        still = np.zeros(state.shape[1])
        return self._solve(state, still, np.full_like(still, np.nan), EACH_ALONE)

    def _follow(self, planned: ruckig.Trajectory, rests: bool) -> None:
        self._planned, self._next = planned, 0  # the next row is that of period _next + 1
        self._last = self._length(planned) if rests else math.inf

    def _length(self, planned: ruckig.Trajectory) -> int:
        return math.ceil(float(planned.duration) / self._period - 1e-9)

    def _next_rows(self, count: int) -> tuple[FloatArray, FloatArray]:
        last = min(self._next + count, self._last)
        rows = self._rows(self._planned, self._next, int(last), self._last)
        stop = self._stop(rows[-1])
        length = self._length(stop)
        return rows, self._rows(stop, 0, length, length)

    def _rows(self, planned: ruckig.Trajectory, first: int, last: int, end: float) -> FloatArray:
        longest = planned.duration if math.isfinite(end) else math.inf
        times = [min(k * self._period, longest) for k in range(first + 1, last + 1)]
        rows = np.array([planned.at_time(t) for t in times])
        rows = rows.reshape(len(times), 3, self._state.shape[1])
        if last >= end and len(rows):
            rows[-1, 1:] = 0.0
        return rows

    def _inside(self, rows: FloatArray) -> bool:
        return self.slides.within_travel(rows[:, 0])

    def _hit(
        self, rows: FloatArray, tail: FloatArray
    ) -> Callable[[FloatArray], ContactError] | None:
        if self._contact is None:
            return None
        x = np.concatenate([self._state[:1], rows[:, 0], tail[:, 0]])
        return self._contact(self.slides.positions(x))

    def _setpoints(self, rows: FloatArray, before: FloatArray, number: int) -> Setpoints:
        """Return slide states as setpoints of the axes; ``before``: acceleration before them."""
        count = len(rows)
        jerk = np.diff(np.concatenate([before[None, :], rows[:, 2]]), axis=0) / self._period
        position, velocity, acceleration, axis_jerk = self.slides.motion(rows, jerk)
        return Setpoints(
            time=(number + np.arange(count)) * self._period,
            position=position,
            velocity=velocity,
            acceleration=acceleration,
            jerk=axis_jerk,
            block=np.zeros(count, dtype=np.int64),
            s=np.zeros(count),
        )
