"""MachineTraits: the properties of a machine that the smoothing needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.units import DEG
from cnc_interp.program.blocks import Blocks
from cnc_interp.smoothing.axis_geometry import AxisGeometry
from cnc_interp.smoothing.corners.ratio import AxisRates
from cnc_interp.smoothing.orientation import angles_between


@dataclass(frozen=True)
class MachineTraits:
    """The properties of a machine that the smoothing needs."""

    #: Rates of the axes along a line, each over its jerk limit. They determine L2/L1 of corners
    #: (``ratio.py``).
    axis_rates: AxisRates | None = None
    #: Tool direction at which a rotary axis is undefined; a turning tool stops there. None if
    #: there is no such direction.
    pole: tuple[float, float, float] | None = None
    #: Angle around the pole within which a turning tool stops [rad].
    pole_cone: float = 0.02 * DEG
    #: Largest turn of the path that is rounded, with a fixed and with a turning tool axis [rad].
    #: At larger turns the tool stops, which is faster on average.
    sharpest_turn: float = 178.0 * DEG
    sharpest_swing: float = 176.0 * DEG
    #: Kinematics for blocks whose rotary axes run linearly. Without it there are none.
    geometry: AxisGeometry | None = None
    #: (5 + k,): Jerk limits of X Y Z, of the rotary axes and of the extra axes.
    max_jerk: FloatArray | None = None
    #: Time of the motion along a few blocks from rest to rest [s], as curves or corner by corner
    #: (second argument); infinite where the machine cannot execute them. Without it nothing is
    #: tried.
    motion_time: Callable[[Blocks, bool], float] | None = None

    def keeps_tool(self, axis: FloatArray) -> bool:
        """Tell whether a tool along an axis, shape (3,), cannot turn on a curve."""
        if self.pole is None:
            return True
        angle = float(angles_between(axis, np.asarray(self.pole)))
        return min(angle, np.pi - angle) < self.pole_cone
