"""What a reader needs to know besides the text: machine geometry and the user's choices."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Literal, Protocol

from cnc_interp.errors import ProgramError
from cnc_interp.program.blocks import FloatArray
from cnc_interp.units import MM

Interpolation = Literal['auto', 'vector', 'axes']


class RotaryGeometry(Protocol):
    """The part of a machine that gives rotary words their meaning."""

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Letters of the axes, linear ones first: ('X', 'Y', 'Z', 'A', 'C')."""

    def tool_axis(self, rotary: FloatArray) -> FloatArray:
        """Turn rotary positions, shape (n, 2) [rad], into unit tool axes in W, shape (n, 3)."""


@dataclass(frozen=True)
class ReadOptions:
    """
    The user's choices for reading a program.

    Parameters
    ----------
    contour_tolerance, orientation_tolerance : float
        Tolerances where the program gives none [m].
    force_tolerances : bool
        Keep these tolerances even where the program gives others (G64 P).
    flank_height : float
        Height of the point on the tool axis at which orientation is measured [m].
    feedrate : float, optional
        Feedrate of programs that give no F [m/s].
    interpolation : {'auto', 'vector', 'axes'}
        Orientation between blocks: on the great circle, or with rotary axes running linearly.
        'auto' takes 'axes' for rotary words and 'vector' for direction vectors, and follows the
        program's ORIVECT and ORIAXES.

    """

    contour_tolerance: float = 0.02 * MM
    orientation_tolerance: float = 0.02 * MM
    force_tolerances: bool = False
    flank_height: float = 30.0 * MM
    feedrate: float | None = None
    interpolation: Interpolation = 'auto'

    def __post_init__(self) -> None:
        for name in ('contour_tolerance', 'orientation_tolerance', 'flank_height', 'feedrate'):
            value = getattr(self, name)
            if value is not None and not (isfinite(value) and value > 0.0):
                raise ProgramError(f'{name} is {value:g}; it must be greater than zero')
        if self.interpolation not in ('auto', 'vector', 'axes'):
            raise ProgramError(
                f"interpolation is {self.interpolation!r}; choose 'auto', 'vector' or 'axes'"
            )


class Notices:
    """Harmless things worth telling, each told once with the line where it first stood."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}

    def once(self, key: str, line_number: int, text: str) -> None:
        """Note ``text`` unless something was noted under ``key`` before."""
        if key not in self._texts:
            self._texts[key] = f'line {line_number}: {text}'

    def texts(self) -> tuple[str, ...]:
        """All notices in the order of the program."""
        return tuple(self._texts.values())
