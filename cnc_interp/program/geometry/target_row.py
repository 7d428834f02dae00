"""The columns of a row of targets: one number each, or a slice; all in SI units."""

from math import nan

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.machine_model.machine import Machine

#: Tool tip, or axis positions minus those of the workpiece zero [m]; tool axis [-], NaN if rotary
#: words give it; rotary positions [rad].
POINT, AXIS, ROTARY = slice(0, 3), slice(3, 6), slice(6, 8)
#: Whether rotary axes have been programmed; whether the tool axis follows a great circle.
NAMED, GREAT_CIRCLE = 8, 9
FEEDRATE, DURATION = 10, 11  #: [m/s], [s]; one of them is used.
RAPID, EXACT_STOP = 12, 13  #: Whether it is a rapid; 1 for an exact stop, or ``AT_M1``, ``AT_M0``.
CONTOUR, ORIENTATION, LINE = 14, 15, 16  #: Tolerances [m], and the line of the main program.
#: Whether POINT holds axis positions, or ``COMBINED`` if F is the speed of all axes with degrees
#: taken as millimetres; feedrate of rotary axes [rad/s].
AXES, TURN_RATE, COMBINED = 17, 18, 2.0
#: Centre [m], normal [-] and sweep [rad] of an arc, NaN for a line; positions of the extra
#: axes in their order [m or rad].
CENTRE, NORMAL, SWEEP, EXTRA = slice(19, 22), slice(22, 25), 25, slice(26, 29)
#: How often the start line of a run was reached before the target, as counted by the reader.
PASSES = 29
#: Number of setup changes and functions before the target, as counted by ``TargetColumns``.
CHANGES = 30
#: Modal state, motion code and feed, as passed to ``ModesOfBlocks.see``.
MODES, MOTION, FEED = slice(31, 34), 32, 33
#: Tool length that turns with the tool, from the programmed tip to POINT [m]; number of columns.
LENGTH, WIDTH = 34, 35
#: Values of EXACT_STOP for M1 and M0. If several stops meet, the largest value is used.
AT_M1, AT_M0 = 2.0, 3.0
NO_ARC = (nan,) * 7  #: The columns CENTRE, NORMAL and SWEEP of a line that is not an arc.


def extra_directions(machine: Machine) -> FloatArray:
    """Return the directions in M of the extra axes in the columns EXTRA, (3, 3) [-]."""
    found = np.zeros((3, 3))
    found[: len(machine.extra_direction)] = machine.extra_direction
    return found
