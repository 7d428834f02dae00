"""What the user may choose about curves through dense blocks."""

from __future__ import annotations

from dataclasses import dataclass

from cnc_interp.core.errors import InterpError
from cnc_interp.core.units import DEG, MM


@dataclass(frozen=True)
class Compression:
    """
    How dense programs become curves.

    Parameters
    ----------
    enabled : bool
        Whether they do.
    longest_block : float
        Longer blocks stay lines [m].
    corner_angle : float
        Where the path turns by more it keeps its corner [rad].
    tolerance_share : float
        Share of the tolerances that curves may use [-].

    """

    enabled: bool = True
    longest_block: float = 5.0 * MM
    corner_angle: float = 35.0 * DEG
    tolerance_share: float = 0.98

    def __post_init__(self) -> None:
        if not self.longest_block > 0.0:
            raise InterpError(f'longest_block {self.longest_block:g} m is not positive')
        if not 0.0 < self.corner_angle <= 180.0 * DEG:
            raise InterpError(f'corner_angle {self.corner_angle:g} rad is not within 0 to pi')
        if not 0.0 < self.tolerance_share <= 1.0:
            raise InterpError(f'tolerance_share {self.tolerance_share:g} is not within 0 to 1')
