"""Drives moved along trajectories by the joint_trajectory_controller of ros2_control.

The controller executes played setpoints after a fixed delay. Each trajectory contains the played
setpoints that are not executed yet, and then a stop. All trajectories of a motion count time from
the same instant, and their points lie on the same time grid, so that each continues the previous
one exactly. If no further trajectory arrives, the controller comes to rest on the path.
"""

import time
from typing import NamedTuple, Protocol

import numpy as np

from cnc_interp.core import DEG, MM, FloatArray, IntArray
from cnc_interp.machine.drives import AxisFeedback, AxisRows, DelayedDrives, DriveFaultError
from cnc_interp.machine_model.machine import Machine

SPACING = 0.004  #: Time between the points of a trajectory [s].
SENDING = 0.02  #: Least time between two trajectories that are sent [s].
OVERLAP = 0.02  #: A trajectory begins this long before the point being executed [s].
RESERVE = 0.25  #: Points must be sent earlier than due by this share of the delay [-].
LATEST = 1.0  #: Older reports are not compared with the commands of their time [s].
#: One call counts at most this much silence, because this program may have stalled [s].
SILENCE_OF_A_CALL = 0.05
SLOWER = 2e-3  #: A robot that runs slower than full speed by more than this share is stopped [-].
POWER_UP, SETTLING = 5.0, 0.1  #: Longest wait for the controller; settling time [s].


class Trajectory(NamedTuple):
    """Points for the controller in the order of time; the last one is at rest."""

    start: int  #: ROS time from which ``times`` count [ns].
    times: IntArray  #: (K,): Time at which each point is due, after ``start`` [ns].
    rows: AxisRows  #: The points.


class JointReport(NamedTuple):
    stamp: int  #: ROS time of the measurement [ns].
    #: (n_axes,): Actual axis coordinates and velocities [m, rad, per s].
    position: FloatArray
    velocity: FloatArray


class Controller(Protocol):
    @property
    def name(self) -> str:
        """Names of the controller and of its position topic, for messages to users."""

    def now(self) -> int:
        """Return the current ROS time [ns]."""

    def listens(self) -> bool:
        """Return whether a controller is subscribed to the trajectories."""

    def speed(self) -> float:
        """Return the speed that the controller reported last, as a share of full speed [-]."""

    def send(self, trajectory: Trajectory) -> None:
        """Send a trajectory that replaces the previous one."""

    def take_reports(self) -> list[JointReport]:
        """Return the reports since the last call."""

    def close(self) -> None:
        """Release the controller."""


class TrajectoryDrives(DelayedDrives):
    """Drives that are moved by a trajectory controller; see ``drives.DelayedDrives``.

    ``delay``: time from a setpoint in the cycle to its execution [s]; ``limits``: largest
    following error of each axis [m, rad]; ``silence``: time after which the feedback counts as
    lost [s]. Raises DriveFaultError if the positions of the axes are not reported.
    """

    lag = 0.02  #: Typical lag of drives with a following error [s].

    def __init__(
        self,
        machine: Machine,
        period: float,
        controller: Controller,
        delay: float,
        limits: FloatArray,
        silence: float,
    ):
        self._names, self._controller = machine.axis_names, controller
        self.outputs = np.zeros(machine.signals.wired)
        self.inputs = np.zeros(len(machine.signals.inputs))
        self._period = round(period * 1e9)
        self._delay = round(delay * 1e9)
        self._step = max(1, round(SPACING / period))
        self._linear = machine.is_linear
        self._limits = limits
        #: Number of played rows that the controller may still need; then the number of rows
        #: that are kept, with older ones for late reports.
        self._needed = int(np.ceil((delay + OVERLAP) / period)) + self._step
        self._kept = self._needed + round(LATEST / period)
        self._on, self.alarm = False, ''
        self._silence, self._longest_silence = 0.0, silence
        self._report = self._first_report()
        self._forget(self._report.position)

    def _first_report(self) -> JointReport:
        deadline = time.monotonic() + POWER_UP
        while time.monotonic() < deadline:
            reports = self._controller.take_reports()
            if reports:
                return reports[-1]
            time.sleep(0.01)
        self._controller.close()
        raise DriveFaultError(f'{self._controller.name}: {self._silent}')

    @property
    def _silent(self) -> str:
        return f'no positions of {" ".join(self._names)}; is the joint_state_broadcaster active?'

    def _forget(self, position: FloatArray) -> None:
        self._rows = AxisRows.held(position, self._kept)  # the last ones that were played
        self._played = self._kept  # rows so far; the last of them has number ``_played - 1``
        self._told = AxisRows.held(position, 1)  # rows from number ``_told_from`` on, as sent
        self._told_from, self._sent_at = self._played - 1, 0
        #: Time at which row 0 was due, so that the last row is due now [ns].
        self._zero = self._controller.now() - (self._played - 1) * self._period

    @property
    def position(self) -> FloatArray:
        self._take_reports()
        settles, found = self._told.position[-1], self._report.position
        near = bool(np.all(np.abs(settles - found) <= self._limits))
        return (settles if near else found).copy()

    def switch_on(self) -> None:
        """Wait until the controller holds the axes at rest."""
        asked = self._controller.now()
        settled = max(asked, self._time_of(self._told_from + len(self._told)))
        settled += round(SETTLING * 1e9)
        deadline = time.monotonic() + POWER_UP + 1e-9 * (settled - asked)
        while not (self._controller.listens() and self._report.stamp > settled):
            if time.monotonic() > deadline:
                listens = self._controller.listens()
                cause = self._silent if listens else 'it accepts no trajectories; is it active?'
                raise DriveFaultError(f'{self._controller.name}: {cause}')
            time.sleep(0.01)
            self._take_reports()
        if slow := self._slow():
            raise DriveFaultError(slow)
        self._forget(self.position)
        self._on, self.alarm, self._silence = True, '', 0.0

    def switch_off(self) -> None:
        """Send no further trajectory. The controller ends the last one and holds the axes."""
        none = AxisRows.held(self._rows.position[-1], 0)
        if self._on and self._news(none) is not None:
            self._send(none)
        self._on, self.alarm = False, ''

    def close(self) -> None:
        self._controller.close()

    def follow(self, played: AxisRows, stop: AxisRows) -> AxisFeedback:
        """Accept played setpoints and the stop after them; send them if they are new."""
        self._remember(played)
        news = self._news(stop) if self._on else None
        if news is not None:
            self._refuse_late(news)
            if self._controller.now() - self._sent_at >= SENDING * 1e9:
                self._send(stop)
        return self._feedback(len(played))

    def _remember(self, played: AxisRows) -> None:
        """Append rows to the played ones. At rest, reset the instant from which times count."""
        self._played += len(played)
        self._rows = AxisRows.concatenate([self._rows, played])[-self._kept :]
        recent = self._rows.position[-self._needed :]
        if np.any(recent != recent[-1]):
            return
        self._zero = self._controller.now() - (self._played - 1) * self._period
        if np.array_equal(self._told.position[-1], recent[-1]):
            self._told, self._told_from = self._rows[-1:], self._played - 1

    def _time_of(self, number: int) -> int:
        return self._zero + number * self._period + self._delay

    def _news(self, stop: AxisRows) -> int | None:
        """Return the number of the first row that differs from what was sent, or None."""
        count = min(self._played - self._told_from, self._kept)
        first = self._played - count  # rows before it are forgotten
        told = self._told.position[min(first - self._told_from, len(self._told) - 1) :]
        now = np.concatenate([self._rows.position[self._kept - count :], stop.position])
        length = max(len(now), len(told))
        differs = np.any(padded(now, length) != padded(told, length), axis=1)
        return first + int(np.argmax(differs)) if differs.any() else None

    def _refuse_late(self, news: int) -> None:
        late = self._controller.now() - (self._time_of(news) - round(RESERVE * self._delay))
        if late > 0:
            self._on = False
            raise DriveFaultError(
                f'setpoints were {1e-6 * late:.0f} ms too late for the controller, which has '
                'stopped on the path; raise controller_delay'
            )

    def _send(self, stop: AxisRows) -> None:
        now, step = self._controller.now(), self._step
        moment = (now - self._delay - self._zero) / self._period - 1e9 * OVERLAP / self._period
        first = min(int(moment // step) * step, self._played - 1)
        first = max(first, -((self._kept - self._played) // step) * step)
        told = AxisRows.concatenate([self._rows[first - self._played :], stop])
        chosen = np.arange(0, len(told), step)
        rows = AxisRows.concatenate([told[chosen], AxisRows.held(told.position[-1], 1)])
        times = self._period * np.append(chosen, chosen[-1] + step)
        self._controller.send(Trajectory(self._time_of(first), times, rows))
        self._told, self._told_from, self._sent_at = told, first, now

    def _take_reports(self) -> list[JointReport]:
        reports = self._controller.take_reports()
        if reports:
            self._report = reports[-1]
        return reports

    def _feedback(self, count: int) -> AxisFeedback:
        """Return the feedback of the last ``count`` periods: the latest report before each end."""
        before = self._report
        new = self._take_reports()
        self._silence += min(count * self._period * 1e-9, SILENCE_OF_A_CALL)
        if new:
            self._silence = 0.0
        reports = [before, *new]
        stamps = np.array([report.stamp for report in reports])
        position = np.array([report.position for report in reports])
        velocity = np.array([report.velocity for report in reports])
        answered = self._answered(stamps) if self._on else position
        if self._on and not self.alarm:
            self.alarm = self._cause(answered[1:] - position[1:])
        ends = self._zero + self._period * np.arange(self._played - count, self._played)
        last = np.maximum(np.searchsorted(stamps, ends, side='right') - 1, 0)
        return AxisFeedback(position[last], velocity[last], answered[last])

    def _answered(self, stamps: IntArray) -> FloatArray:
        """Return the commanded positions at ROS times [ns], interpolated by cubics [m, rad]."""
        at = (stamps - (self._zero + self._delay)) / self._period - (self._played - self._kept)
        at = np.clip(at, 0.0, self._kept - 1.0)
        row = np.minimum(at.astype(np.int64), self._kept - 2)
        u = (at - row)[:, None]
        p, v = self._rows.position, self._rows.velocity * (1e-9 * self._period)
        step, slope = p[row + 1] - p[row], v[row]
        bend = v[row + 1] + slope - 2.0 * step
        return p[row] + u * (slope + u * (step - slope - bend + u * bend))

    def _slow(self) -> str:
        """Return the alarm text if the robot runs slower than commanded, else ''."""
        share = self._controller.speed()
        if not share < 1.0 - SLOWER:
            return ''
        return (
            f'{self._controller.name}: the robot executes trajectories at {share:.0%} of their '
            'speed; set it to 100 %, press reset, and use the feed override instead'
        )

    def _cause(self, errors: FloatArray) -> str:
        if self._silence > self._longest_silence:
            return f'{self._controller.name} is silent: {self._silent}'
        if slow := self._slow():
            return slow
        beyond = np.any(np.abs(errors) > self._limits, axis=0)
        if not beyond.any():
            return ''
        k = int(np.argmax(beyond))
        unit, word = (MM, 'mm') if self._linear[k] else (DEG, 'deg')
        return f'{self._names[k]}: following error over {self._limits[k] / unit:g} {word}'


def padded(rows: FloatArray, count: int) -> FloatArray:
    return np.concatenate([rows, np.repeat(rows[-1:], count - len(rows), axis=0)])
