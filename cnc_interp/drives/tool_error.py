"""The error of the drives at the tool: deviations of tip and tool axis from their path."""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.core.axis_limits import DriveLoad
from cnc_interp.core.kernels import njit
from cnc_interp.drives.compensation import Compensation, compensate_all
from cnc_interp.drives.drive_model import follow_all, lag_of, memory_of, words_of
from cnc_interp.machine_model.axis_drives import AxisDrive
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform

#: Height of a second point on the tool axis, with which distances of poses are measured [m].
HEIGHT = 0.03
SETTLING = 0.1  #: Time after the last setpoint in which the axes settle [s].
AHEAD = 0.01  #: A table that brakes is ahead of its setpoints by less than this [s].


@dataclass(frozen=True)
class ToolError:
    """Errors of the executed motion, one row per period, without lags along the path."""

    tip: FloatArray  #: (K,): Distance of the tip from the path of the commanded tips [m].
    axis: FloatArray  #: (K,): Angle between tool axis and the commanded one at that place [rad].


class ToolMotion:
    """Simulated drives, beginning at ``position``, and their error at the tool."""

    def __init__(
        self, machine: Machine, period: float, position: FloatArray, model: Machine | None = None
    ):
        self._words, self.lag = words_of(machine, period, position), lag_of(machine)
        self._transform = Transform.of(machine)
        self._compensation, self._known = np.empty((0, 0)), 0
        if model is not None:
            compensation = Compensation(model, period, position)
            self._compensation, self._known = compensation.words, compensation.known
            self.lag = compensation.lead
        self._memory = memory_of(period, self.lag)
        #: Number of rows by which errors are returned later.
        self.late = math.ceil(AHEAD / period)
        self._period, self._last = period, position
        tip, axis = self._transform.forward(position[None, :])
        known = self._memory + self.late
        self._tips, self._axes = (np.repeat(x, known, axis=0) for x in (tip, axis))
        self._waiting = tuple(np.repeat(x, self.late, axis=0) for x in (tip, axis))

    def copy(self) -> ToolMotion:
        found = copy(self)
        found._words, found._compensation = self._words.copy(), self._compensation.copy()
        return found

    def push(self, positions: FloatArray, velocities: FloatArray) -> ToolError:
        """Take setpoints (K, n_axes) [m, rad, per s]; return errors, ``late`` periods old."""
        if not len(positions):
            return ToolError(np.empty(0), np.empty(0))
        sent = np.ascontiguousarray(positions, dtype=float)
        rates = np.ascontiguousarray(velocities, dtype=float)
        self._last = sent[-1]
        tips, axes = self._transform.forward(sent)
        if self._known:
            sent, rates = compensate_all(self._compensation, self._known, sent)
        x, _ = follow_all(self._words, sent, rates)
        tip, axis = (
            np.concatenate([waiting, new])
            for waiting, new in zip(self._waiting, self._transform.forward(x), strict=True)
        )
        self._waiting = tip[len(x) :], axis[len(x) :]
        tips, axes = np.concatenate([self._tips, tips]), np.concatenate([self._axes, axes])
        self._tips, self._axes = tips[len(x) :], axes[len(x) :]
        found = path_and_axis_errors(
            tips, axes, tip[: len(x)], axis[: len(x)], self._memory + self.late
        )
        return ToolError(found[:, 0], found[:, 1])

    def settle(self, position: FloatArray | None = None) -> ToolError:
        """Measure the error while the axes settle at a position, by default the last setpoint."""
        at = self._last if position is None else position
        rest = np.tile(at, (round((SETTLING + self.lag) / self._period) + self.late, 1))
        return self.push(rest, np.zeros_like(rest))


def tool_error(
    machine: Machine,
    period: float,
    positions: FloatArray,
    velocities: FloatArray,
    model: Machine | None = None,
) -> ToolError:
    """Simulate drives on setpoints (K, n_axes) until they settle; return the error at the tool."""
    motion = ToolMotion(machine, period, np.asarray(positions[0], dtype=float), model)
    parts = motion.push(positions, velocities), motion.settle()
    tip, axis = (np.concatenate([getattr(p, of) for p in parts]) for of in ('tip', 'axis'))
    return ToolError(tip[motion.late :], axis[motion.late :])


@njit(cache=True, nogil=True)
def on_chord(path: FloatArray, k: int, point: FloatArray) -> tuple[float, float]:
    """Return the nearest place on chord k of a path, 0 to 1, and its distance squared [m2]."""
    along, length_sq = 0.0, 0.0
    for c in range(len(point)):
        chord = path[k + 1, c] - path[k, c]
        along += (point[c] - path[k, c]) * chord
        length_sq += chord * chord
    part = min(1.0, max(0.0, along / length_sq)) if length_sq > 0.0 else 0.0
    distance_sq = 0.0
    for c in range(len(point)):
        gap = point[c] - path[k, c] - part * (path[k + 1, c] - path[k, c])
        distance_sq += gap * gap
    return part, distance_sq


@njit(cache=True, nogil=True)
def path_and_axis_errors(
    tips: FloatArray, axes: FloatArray, tip: FloatArray, axis: FloatArray, memory: int
) -> FloatArray:
    """Find the errors of pose i by nearest tip and by nearest pose, searching from chord i on."""
    path = np.concatenate((tips, HEIGHT * axes), axis=1)
    poses = np.concatenate((tip, HEIGHT * axis), axis=1)
    found = np.zeros((len(poses), 2))
    for i in range(len(poses)):
        least, nearest, turn_sq = np.inf, np.inf, 0.0
        for k in range(i, i + memory):
            nearest = min(nearest, on_chord(tips, k, tip[i])[1])
            part, distance_sq = on_chord(path, k, poses[i])
            if distance_sq < least:
                least, turn_sq = distance_sq, 0.0
                for c in range(3):
                    lean = axis[i, c] - axes[k, c] - part * (axes[k + 1, c] - axes[k, c])
                    turn_sq += lean * lean
        found[i, 0], found[i, 1] = np.sqrt(nearest), np.sqrt(turn_sq)
    return found


TERMS = 3  #: Terms of the series: 1, s, s^2.


@dataclass(frozen=True)
class ErrorSeries:
    #: (n_axes,): c1 and c2 [s, s2].
    by_velocity: FloatArray
    by_acceleration: FloatArray
    away: FloatArray  #: (n_axes,): Error that remains in steady motion, opposite to it [m or rad].
    lag: float  #: The common lag; if compensated, beyond ``Compensation.lead`` [s].


def error_series(machine: Machine, model: Machine | None = None) -> ErrorSeries:
    count = len(machine.axis_names)
    series, away = np.empty((count, TERMS)), np.empty(count)
    for j, own in enumerate(machine.driven):
        found = _as_it_is(*own) if model is None else _compensated(*own, *model.driven[j])
        series[j], away[j] = found
    lag = -0.5 * (series[:, 1].min() + series[:, 1].max())
    for j in range(count):
        series[j] = _times(series[j], _delay(-lag))
    return ErrorSeries(series[:, 1].copy(), series[:, 2].copy(), away, float(lag))


def _as_it_is(drive: AxisDrive, load: DriveLoad | None) -> tuple[FloatArray, float]:
    kv = drive.position_gain
    told = np.array([kv, drive.feed_forward, 0.0])
    series = _over(_times(told, _mode(drive)), _loops(drive, load))
    return _times(series, _delay(drive.delay)), _friction(drive, load) / kv + drive.backlash / 2


def _compensated(
    drive: AxisDrive, load: DriveLoad | None, model: AxisDrive, its_load: DriveLoad | None
) -> tuple[FloatArray, float]:
    share = drive.feed_forward / model.feed_forward
    told = share * _over(_loops(model, its_load), _mode(model))
    told[0] += drive.position_gain - share * model.position_gain
    series = _over(_times(told, _mode(drive)), _loops(drive, load))
    series = _times(series, _delay(drive.delay - model.delay))
    force = _friction(drive, load) - share * _friction(model, its_load)
    crossed = share * model.position_gain / drive.position_gain * model.backlash
    return series, force / drive.position_gain + 0.5 * (drive.backlash - crossed)


def _friction(drive: AxisDrive, load: DriveLoad | None) -> float:
    """Return tau C / J: the velocity that friction takes [m/s or rad/s]."""
    return 0.0 if load is None else drive.time_constant * load.coulomb / load.inertia


def _loops(drive: AxisDrive, load: DriveLoad | None) -> FloatArray:
    """Return kv + (1 + tau B) s + tau s^2."""
    viscous = 0.0 if load is None else load.viscous / load.inertia
    tau = drive.time_constant
    return np.array([drive.position_gain, 1.0 + tau * viscous, tau])


def _mode(drive: AxisDrive) -> FloatArray:
    if not drive.mode_frequency:
        return np.array([1.0, 0.0, 0.0])
    return np.array([1.0, 0.0, -1.0 / (2.0 * math.pi * drive.mode_frequency) ** 2])


def _delay(time: float) -> FloatArray:
    """Return the first terms of exp(-time s)."""
    return np.array([1.0, -time, 0.5 * time**2])


def _times(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.convolve(one, other)[:TERMS]


def _over(one: FloatArray, other: FloatArray) -> FloatArray:
    found = np.empty(TERMS)
    for k in range(TERMS):
        found[k] = (one[k] - found[:k] @ other[k:0:-1]) / other[0]
    return found
