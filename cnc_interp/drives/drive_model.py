"""
The model of the simulated drives: how each axis follows its setpoints.

Every axis is a position loop with velocity feed-forward around a velocity loop that answers as a
first-order lag. With m the motor's position and all forces divided by the inertia,

    m' = v,    v' = u - B v - F,    u = (kv (r - m) + f r' - v) / tau,    |u| <= T,

so without friction M/R = (f s + kv) / (tau s^2 + s + kv): stable for all kv, tau > 0, damping
1 / (2 sqrt(kv tau)). On a ramp of speed V it lags by (1 - f) V / kv, under constant acceleration a
by tau a / kv more. The setpoint r comes after a dead time. Friction F is that of Stribeck,

    F = sign(v) (C + (S - C) exp(-(v / v_s)^2)),    |F| <= S at rest.

The table follows the motor after a backlash of width w, through one flexible mode:

    |m - b| <= w / 2,    x'' = omega^2 (b - x) + 2 zeta omega (b' - x').

The measuring system reads x in steps of its resolution. Between two setpoints the drive
interpolates r and r' linearly (first-order hold). Without friction, backlash, mode and the like
the step over one period is exact, by the matrix exponential, whatever the period. Otherwise the
period is divided: within a step the loops and the mode are exact, friction is implicit.
"""

from __future__ import annotations

import math

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.drives import drive_kernels as kernels
from cnc_interp.machine_model.axis_drives import IDEAL, AxisDrive
from cnc_interp.machine_model.drive_loads import DriveLoad
from cnc_interp.machine_model.machine import Machine

#: Longest step where one exact step does not do [s].
STEP = 1e-4
#: The path on which the contour error is measured reaches back by this many lags of the drives.
LAGS_REMEMBERED = 5.0
SHORTEST_MEMORY, LONGEST_MEMORY = 2, 1000


def words_of(machine: Machine, period: float, position: FloatArray) -> FloatArray:
    """
    Compute the words of all axes, which stand still.

    Parameters
    ----------
    machine : Machine
        Its drives and loads.
    period : float
        Interpolation period [s].
    position : ndarray, shape (n_axes,)
        Where the axes stand [m, rad].

    Returns
    -------
    ndarray, shape (n_axes, n_words)
        See ``drive_kernels.py``.

    """
    drives = [machine.drives.get(j, IDEAL) for j in range(len(machine.axis_names))]
    longest = max(drive.delay for drive in drives)
    words = np.zeros((len(drives), room_of_delay(longest, period)))
    for j, drive in enumerate(drives):
        load = machine.loads.get(j) if j in machine.drives else None
        axis_words(words[j], drive, load, period)
        place(words[j], float(position[j]))
    return words


def room_of_delay(delay: float, period: float) -> int:
    """Return the number of words of an axis for a dead time up to ``delay`` [s]."""
    return kernels.RING + 2 * (int(delay / period) + 3)


def lag_of(machine: Machine) -> float:
    """Return how much later than their setpoints the axes are there, about [s]."""
    return max(machine.drives.get(j, IDEAL).lag for j in range(len(machine.axis_names)))


def memory_of(period: float, lag: float) -> int:
    """Return how many commanded tips the contour error is measured against."""
    wanted = int(np.ceil(LAGS_REMEMBERED * lag / period)) + 1
    return min(LONGEST_MEMORY, max(SHORTEST_MEMORY, wanted))


def place(words: FloatArray, position: float) -> None:
    """Let an axis stand at a position [m or rad]."""
    words[kernels.MOTOR :] = 0.0
    words[[kernels.MOTOR, kernels.PLAY, kernels.TABLE]] = position
    words[kernels.RING :: 2] = position


def axis_words(words: FloatArray, drive: AxisDrive, load: DriveLoad | None, period: float) -> None:
    """Write the words of one axis, without its state."""
    if load is not None:
        torque, coulomb, viscous = (float(x) for x in load.row)
        excess = max(drive.static / load.inertia - coulomb, 0.0) if drive.static else 0.0
    else:
        torque, coulomb, viscous, excess = np.inf, 0.0, 0.0, 0.0
    plain = not (drive.backlash or drive.mode_frequency or drive.resolution or drive.delay)
    steps = 0 if plain and load is None else math.ceil(period / STEP - 1e-9)
    span = period / max(steps, 1)
    loop = discretise(drive, viscous, span)
    words[kernels.SUBSTEPS] = steps
    words[kernels.LOOP : kernels.LOOP + 12] = np.ravel(loop)
    # A force acts as a setpoint that is further by tau / kv times it.
    words[kernels.FORCE : kernels.FORCE + 2] = (
        loop[1][:, 0] * drive.time_constant / drive.position_gain
    )
    # At the largest torque: v' = T - B v.
    decay = math.exp(-viscous * span)
    way = -math.expm1(-viscous * span) / viscous if viscous else span
    words[kernels.COAST], words[kernels.COAST + 1] = way, decay
    fallen = (span - way) / viscous if viscous * span > 1e-4 else 0.5 * span**2
    words[kernels.COAST_FORCE], words[kernels.COAST_FORCE + 1] = fallen, way
    words[kernels.GAIN] = drive.position_gain
    words[kernels.FEED_FORWARD], words[kernels.LAG] = drive.feed_forward, drive.time_constant
    words[kernels.TORQUE], words[kernels.COULOMB], words[kernels.EXCESS] = torque, coulomb, excess
    words[kernels.STRIBECK] = drive.stribeck_velocity
    words[kernels.HALF_PLAY] = 0.5 * drive.backlash
    words[kernels.HAS_MODE] = float(drive.mode_frequency > 0.0)
    words[kernels.MODE : kernels.MODE + 4] = np.ravel(_mode(drive, span))
    words[kernels.RESOLUTION] = drive.resolution
    words[kernels.DELAY], words[kernels.RATE] = drive.delay / period, 1.0 / span


def discretise(
    drive: AxisDrive, viscous: float, span: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solve the loops over one step exactly for inputs (r, r') that run linearly."""
    from scipy.linalg import expm  # takes a tenth of a second that other nodes need not wait

    kv, f, tau = drive.position_gain, drive.feed_forward, drive.time_constant
    # z' = A z + B u, u' = constant: one exponential of the three stacked.
    stacked = np.zeros((6, 6))
    stacked[0, 1] = 1.0
    stacked[1, :4] = np.array([-kv, -1.0 - viscous * tau, kv, f]) / tau
    stacked[2:4, 4:6] = np.eye(2) / span
    step = expm(stacked * span)
    return step[:2, :2].copy(), step[:2, 2:4].copy(), step[:2, 4:6].copy()


def _mode(drive: AxisDrive, span: float) -> FloatArray:
    """Return the step of the mode's error and of its change per step, shape (2, 2)."""
    from scipy.linalg import expm

    turn = 2.0 * math.pi * drive.mode_frequency * span
    step: FloatArray = expm(np.array([[0.0, 1.0], [-(turn**2), -2.0 * drive.mode_damping * turn]]))
    return step
