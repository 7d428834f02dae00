"""MachineTraits: the properties of a machine that the smoothing needs; rates of its axes."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from cnc_interp.core import DEG, FloatArray
from cnc_interp.core.kernels import njit
from cnc_interp.machine_model.machine_entries import BlockPace
from cnc_interp.machine_model.transform import Transform
from cnc_interp.machine_model.transform_kernels import linear_jets, rotary_jets

#: Rates of the axes along a line, each over its jerk limit, of rows of tool tip, tool axis, unit
#: step of the tip, and turn of the tool axis per metre.
AxisRates = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class MachineTraits:
    #: Rates of the axes along a line, each over its jerk limit. They determine L2/L1 of corners
    #: (``corner_curve.py``).
    axis_rates: AxisRates | None = None
    #: Tool direction at which a rotary axis is undefined; a turning tool stops there. None if
    #: there is no such direction.
    pole: tuple[float, float, float] | None = None
    pole_cone: float = 0.02 * DEG  #: Angle around it in which a turning tool stops [rad].
    #: Largest turn of the path that is rounded, with a fixed and with a turning tool axis [rad].
    #: At larger turns the tool stops, which is faster on average.
    sharpest_turn: float = 178.0 * DEG
    sharpest_swing: float = 176.0 * DEG
    #: Kinematics for blocks whose rotary axes run linearly. Without it there are none.
    geometry: Transform | None = None
    max_jerk: FloatArray | None = None  #: (5 + k,): Jerk limits of all axes.
    pace: BlockPace | None = None  #: How its control goes through short blocks.

    def keeps_tool(self, axis: FloatArray) -> bool:
        """Tell whether a tool along an axis, shape (3,), cannot turn on a curve."""
        if self.pole is None:
            return True
        away = float(np.linalg.norm(np.cross(axis, self.pole)))
        return bool(away < np.sin(self.pole_cone))


def traits_of(transform: Transform) -> MachineTraits:
    machine = transform.machine
    pole = tuple(float(x) for x in transform.pole) if machine.has_rotary else None
    return MachineTraits(
        axis_rates=partial(jerk_rates, transform),
        pole=pole,  # type: ignore[arg-type]
        pole_cone=machine.singular_cone,
        geometry=transform if machine.has_rotary else None,
        max_jerk=machine.max_jerk if machine.has_rotary else None,
        pace=machine.pace,
    )


def jerk_rates(
    transform: Transform, tip: FloatArray, axis: FloatArray, step: FloatArray, turn: FloatArray
) -> FloatArray:
    machine = transform.machine
    if not machine.has_rotary:
        return np.asarray(step / machine.max_jerk[:3])
    rows = [np.ascontiguousarray(column).view() for column in (tip, axis, step, turn)]
    for row in rows:
        row.flags.writeable = False  # one form for the kernel: no other is compiled while it moves
    return np.asarray(rates(transform.packed, transform.outer, *rows) / machine.max_jerk[:5])


@njit(cache=True, nogil=True, error_model='numpy')  # at the pole they are not finite
def rates(
    packed: FloatArray,
    outer: int,
    tip: FloatArray,
    axis: FloatArray,
    step: FloatArray,
    turn: FloatArray,
) -> FloatArray:
    """Return q_s of the branch with the positive tilt, shape (n, 5); rows as in ``jerk_rates``."""
    found = np.full((len(tip), 5), np.nan)
    for i in range(len(tip)):
        o, w = axis[i], turn[i]
        slope = (w[1] * o[2] - w[2] * o[1], w[2] * o[0] - w[0] * o[2], w[0] * o[1] - w[1] * o[0])
        tool = ((o[0], slope[0], 0.0, 0.0), (o[1], slope[1], 0.0, 0.0), (o[2], slope[2], 0.0, 0.0))
        tilt, turned, sine_squared = rotary_jets(packed, tool, 1.0, 0.0, 0.0)
        if sine_squared <= 0.0:
            continue
        first, second = (tilt, turned) if outer == 1 else (turned, tilt)
        point = (
            (tip[i, 0], step[i, 0], 0.0, 0.0),
            (tip[i, 1], step[i, 1], 0.0, 0.0),
            (tip[i, 2], step[i, 2], 0.0, 0.0),
        )
        x, y, z = linear_jets(packed, point, first, second)
        found[i, 0], found[i, 1], found[i, 2] = x[1], y[1], z[1]
        found[i, 3], found[i, 4] = first[1], second[1]
    return found
