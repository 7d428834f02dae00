"""MachineTraits: properties of a machine that the smoothing needs, such as axis rates."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from cnc_interp.core import DEG, FloatArray
from cnc_interp.machine_model.five_axis import FiveAxis
from cnc_interp.machine_model.machine_entries import BlockPace
from cnc_interp.machine_model.transform_port import Transform

#: Function that returns the rates of the axes along lines, each divided by the jerk limit of the
#: axis. A line is a row of tool tip, tool axis, unit step of the tip, and turn of the tool axis
#: per metre.
AxisRates = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class MachineTraits:
    #: Rates of the axes along a line, each over its jerk limit. They determine L2/L1 of
    #: corners (``corner_curve.py``).
    axis_rates: AxisRates | None = None
    #: Tool axis at which a rotary axis is undefined; a turning tool stops there. None if
    #: there is no such direction.
    pole: tuple[float, float, float] | None = None
    pole_cone: float = 0.02 * DEG  #: Nearer to the pole than this, a turning tool stops [rad].
    #: Largest turn of the path at which a corner is rounded, with a fixed and with a turning tool
    #: axis [rad]. At sharper turns the tool stops, which is faster on average.
    sharpest_turn: float = 178.0 * DEG
    sharpest_swing: float = 176.0 * DEG
    #: Kinematics for blocks whose rotary axes run linearly; None if there are no such blocks.
    geometry: FiveAxis | None = None
    max_jerk: FloatArray | None = None  #: (5 + k,): Jerk limits of all axes.
    turns: bool = False  #: Whether the tool of a machine without a pole can turn.
    scale: float = 1.0  #: ``Machine.scale``; on a large arm, longer blocks become curves [-].
    pace: BlockPace | None = None  #: Speed of its control on short blocks.

    def keeps_tool(self, axis: FloatArray) -> bool:
        """Return whether a tool with this tool axis, (3,), must not turn along a curve."""
        if self.pole is None:
            return not self.turns
        away = float(np.linalg.norm(np.cross(axis, self.pole)))
        return bool(away < np.sin(self.pole_cone))


def traits_of(transform: Transform) -> MachineTraits:
    machine = transform.machine
    five_axis = transform.five_axis if machine.has_rotary else None
    pole = None if five_axis is None else tuple(float(x) for x in five_axis.pole)
    return MachineTraits(
        axis_rates=partial(jerk_rates, transform),
        pole=pole,  # type: ignore[arg-type]
        pole_cone=machine.singular_cone,
        geometry=five_axis,
        max_jerk=machine.max_jerk if machine.has_rotary else None,
        turns=not machine.is_linear.all(),
        scale=machine.scale,
        pace=machine.pace,
    )


def jerk_rates(
    transform: Transform, tip: FloatArray, axis: FloatArray, step: FloatArray, turn: FloatArray
) -> FloatArray:
    rates = transform.rates(tip, axis, step, turn)
    return np.asarray(rates / transform.machine.max_jerk[: rates.shape[1]])
