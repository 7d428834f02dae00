"""AxisGeometry: the kinematics that lines and corners in machine axes need."""

from __future__ import annotations

from typing import Protocol

from cnc_interp.core.arrays import FloatArray


class AxisGeometry(Protocol):
    """Positions of axes for poses, and how far a rotary axis moves the tool."""

    @property
    def extra_direction(self) -> FloatArray:
        """Unit vectors in M along which the extra axes move the tool, shape (k, 3)."""

    def tool_axis(self, rotary: FloatArray) -> FloatArray:
        """Return unit tool axes in W, shape (n, 3), of rotary positions, shape (n, 2) [rad]."""

    def linear(self, tip: FloatArray, rotary: FloatArray) -> FloatArray:
        """Return X Y Z plus extra axes, shape (n, 3) [m], of tips at rotary positions [rad]."""

    def levers(self, stands: FloatArray, rotary: FloatArray, height: float) -> FloatArray:
        """Return how far a point above the tip moves per radian of each axis, shape (n, 2) [m]."""
