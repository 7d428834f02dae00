"""RotaryGeometry: the part of a machine that a program reader needs."""

from __future__ import annotations

from typing import Protocol

from cnc_interp.core.arrays import FloatArray


class RotaryGeometry(Protocol):
    """Axis names and kinematics of a machine, which give rotary words their meaning."""

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Letters of the axes, X Y Z first, extra axes last: ('X', 'Y', 'Z', 'A', 'C', 'W')."""

    @property
    def extra_names(self) -> tuple[str, ...]:
        """Letters of the extra axes (U V W), the last ones of the axes."""

    @property
    def extra_direction(self) -> FloatArray:
        """Unit vectors in M along which the extra axes move the tool, shape (k, 3)."""

    @property
    def outer(self) -> int:
        """Index of the rotary axis that is undefined at the pole: 0 primary, 1 secondary."""

    @property
    def pole(self) -> FloatArray:
        """Direction in W at which that axis is undefined, shape (3,)."""

    @property
    def rotary_travel(self) -> FloatArray:
        """Lowest and highest positions of the rotary axes, shape (2, 2) [rad]."""

    @property
    def pole_cone(self) -> float:
        """Angle around the pole in which a direction does not give rotary positions [rad]."""

    def nearest_to_pole(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Smallest angle between tool axis and pole while the rotary axes run linearly."""

    def tool_axis(self, rotary: FloatArray) -> FloatArray:
        """
        Convert rotary positions to tool axes.

        Parameters
        ----------
        rotary : ndarray, shape (n, 2)
            Positions of the rotary axes [rad].

        Returns
        -------
        ndarray, shape (n, 3)
            Unit tool axes in W [-].

        """

    def forward(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """
        Convert axis positions to poses.

        Parameters
        ----------
        q : ndarray, shape (n, 5)
            Axis positions [m, rad].

        Returns
        -------
        tip, axis : ndarray, shape (n, 3)
            Tool tips [m] and unit tool axes [-] in W.

        """

    def linear(self, tip: FloatArray, rotary: FloatArray) -> FloatArray:
        """
        Compute the positions of X Y Z for tool tips at given rotary positions.

        Parameters
        ----------
        tip : ndarray, shape (n, 3)
            Tool tips in W [m].
        rotary : ndarray, shape (n, 2)
            Positions of the rotary axes [rad].

        Returns
        -------
        ndarray, shape (n, 3)
            Positions of X, Y and Z [m].

        """

    def rotary_solutions(self, axis: FloatArray) -> list[FloatArray]:
        """
        Compute the rotary positions that give a tool axis.

        Parameters
        ----------
        axis : ndarray, shape (3,)
            Unit tool axis in W [-].

        Returns
        -------
        list of ndarray, shape (2,)
            All solutions, up to whole turns [rad].

        """
