"""The part of a machine that readers of programs need."""

from __future__ import annotations

from typing import Protocol

from cnc_interp.core.arrays import FloatArray


class RotaryGeometry(Protocol):
    """The part of a machine that gives rotary words their meaning."""

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Letters of the axes, linear ones first: ('X', 'Y', 'Z', 'A', 'C')."""

    def tool_axis(self, rotary: FloatArray) -> FloatArray:
        """Turn rotary positions, shape (n, 2) [rad], into unit tool axes in W, shape (n, 3)."""

    def forward(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Turn axis positions, shape (n, 5) [m, rad], into tool tips in W [m] and tool axes."""

    def linear(self, tip: FloatArray, rotary: FloatArray) -> FloatArray:
        """Give X Y Z [m], shape (n, 3), of tool tips [m] at rotary positions, shape (n, 2)."""

    def rotary_solutions(self, axis: FloatArray) -> list[FloatArray]:
        """Give the rotary positions, shape (2,) [rad], that reach a tool axis, shape (3,)."""
