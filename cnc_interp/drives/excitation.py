"""
A part program that makes the drives show how they follow: one axis after the other.

Each axis moves there and back at several speeds, which shows friction, backlash and lags. Then it
goes on in one direction while its feed alternates faster and faster (a chirp), which shows the
loops and the flexible mode without sticking. Jerk-limited reversals come last. The program is one
as any other: the planner keeps limits and travel.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cnc_interp.core.errors import MachineError
from cnc_interp.core.units import DEG, MINUTE, MM
from cnc_interp.machine_model.machine import Axis, Machine

#: Largest feed of the program, as a share of the axis' velocity, and the least one of the sweep.
FASTEST, SLOWEST = 0.2, 0.0005
SPEEDS = 7
#: Time at a constant speed [s].
HOLD = 0.3
#: Half periods of the chirp [s], their number, and the lower feed over the higher one.
LONGEST, SHORTEST, HALVES, DIP = 0.12, 0.007, 50, 0.4
#: Largest share of the travel to one side.
ROOM = 0.4


def excitation(machine: Machine) -> str:
    """
    Write the program for all axes of a machine; it begins and ends where the axes stand.

    Raises MachineError if an axis has no room to move.
    """
    lines = [f'(EXCITATION OF THE AXES OF {machine.name.upper()}: for cnc-interp identify)']
    moving = [axis for axis in machine.axes if np.ptp(axis.travel) > 1e-6]  # none that is locked
    lines += ['G21 G94 G91', 'TRAFOOF', 'G0 ' + ' '.join(f'{axis.name}0' for axis in moving)]
    for axis in moving:
        unit = MM if axis.linear else DEG
        lines.append(f'({axis.name})')
        for way, speed in _moves(axis):
            lines.append(f'G1 {axis.name}{way / unit:.5f} F{speed / unit * MINUTE:.4f}')
    return '\n'.join([*lines, 'M30', ''])


def _moves(axis: Axis) -> Iterator[tuple[float, float]]:
    """Yield way [m or rad] and speed of each move; their sum is zero."""
    v, a, j = axis.max_velocity, axis.max_acceleration, axis.max_jerk
    room = ROOM * min(abs(axis.travel[0]), abs(axis.travel[1]))
    if not room > 0.0:
        raise MachineError('stands at the end of its travel; move it to the middle', axis.name)

    def length(speed: float) -> float:
        """Return the way of a move with HOLD at the speed."""
        ramp = max(speed / a + a / j, 2.0 * np.sqrt(speed / j))
        return float(min(speed * (HOLD + ramp), room))

    fastest = min(FASTEST * v, 0.2 * a)
    for speed in (0.1 * fastest, 0.1 * fastest):  # what came before is forgotten
        yield length(speed), speed
        yield -length(speed), speed
    for speed in np.geomspace(fastest, SLOWEST * v, SPEEDS):
        yield length(speed), speed
        yield -length(speed), speed
    # Half periods t at speeds V and DIP V alternately: the mean speed stays.
    high = 0.25 * fastest
    times = np.geomspace(LONGEST, SHORTEST, HALVES)
    for sign in (1.0, -1.0):
        for k, time in enumerate(times):
            speed = high * (DIP if k % 2 else 1.0)
            yield sign * speed * time, speed
    for way in np.geomspace(length(fastest), 20e-6 if axis.linear else 2e-4, 10):
        yield way, fastest
        yield -way, fastest
