"""What a reader needs to know besides the text: machine geometry and the user's choices."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import Literal, Protocol

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import ProgramError
from cnc_interp.core.units import MM
from cnc_interp.program.job import JobSetup

Interpolation = Literal['auto', 'vector', 'axes']
RotarySense = Literal['programmed', 'shortest']


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
    rotary_sense : {'programmed', 'shortest'}
        How an absolute rotary word is taken: as the position it says, or as the nearest position
        that differs from it by whole turns.
    skip_blocks : bool
        Leave out the lines that begin with a slash (block delete).
    setup : JobSetup
        Work offsets, tool lengths and reference points.
    most_jumps : int
        Backward jumps (loops, calls) after which a program counts as endless.

    """

    contour_tolerance: float = 0.02 * MM
    orientation_tolerance: float = 0.02 * MM
    force_tolerances: bool = False
    flank_height: float = 30.0 * MM
    feedrate: float | None = None
    interpolation: Interpolation = 'auto'
    rotary_sense: RotarySense = 'programmed'
    skip_blocks: bool = False
    setup: JobSetup = JobSetup()  # noqa: RUF009 (frozen)
    most_jumps: int = 1_000_000

    def __post_init__(self) -> None:
        for name in ('contour_tolerance', 'orientation_tolerance', 'flank_height', 'feedrate'):
            value = getattr(self, name)
            if value is not None and not (isfinite(value) and value > 0.0):
                raise ProgramError(f'{name} is {value:g}; it must be greater than zero')
        if self.interpolation not in ('auto', 'vector', 'axes'):
            raise ProgramError(
                f"interpolation is {self.interpolation!r}; choose 'auto', 'vector' or 'axes'"
            )
        if self.rotary_sense not in ('programmed', 'shortest'):
            raise ProgramError(
                f"rotary_sense is {self.rotary_sense!r}; choose 'programmed' or 'shortest'"
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
