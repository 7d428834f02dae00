"""The choices of the user for iso-scallop passes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from cnc_interp.cam.next_posture import Freedom
from cnc_interp.core.errors import InterpError
from cnc_interp.core.units import DEG, MM, UM


@dataclass(frozen=True)
class IsoScallopOptions:
    """The user's choices."""

    scallop_height: float = 10.0 * UM  #: S_h [m].
    #: Distance d of the guiding planes [m]. By default every pass has the largest distance that
    #: its tilts allow.
    stepover: float | None = None
    #: Tilt of a first pass with constant tilt. Without a stepover, the tilt that determines the
    #: distance of the planes [rad].
    tilt: float = 5.0 * DEG
    tilt_limits: tuple[float, float] = (0.5 * DEG, 60.0 * DEG)  #: Smallest and largest tilt [rad].
    yaw: float = 0.0  #: Yaw of all passes; the first guess if the yaw is the free angle [rad].
    freedom: Freedom = 'tilt'  #: The angle that determines the width.
    #: The first pass has the constant half width d/2, or the constant tilt, as in the paper.
    start: Literal['width', 'tilt'] = 'width'
    points: int | None = None  #: Number of scallop points along a pass.
    #: A pass starts afresh if the half width differs from d/2 by more than this share [-]. None is
    #: the recursion of the paper: a pass that cannot be found is then an error.
    stray: float | None = 0.25
    #: Largest depth at which the bottom of the mill may enter the surface [m].
    gouge: float = 1.0 * UM
    #: Length that is milled beyond the border at both ends of a pass [m].
    overrun: float = 0.5 * MM

    def __post_init__(self) -> None:
        low, high = self.tilt_limits
        if not 0.0 < low <= self.tilt <= high <= 0.5 * np.pi:
            raise InterpError(
                f'tilts of {low / DEG:g} <= {self.tilt / DEG:g} <= {high / DEG:g} deg do not make '
                'sense; they must rise and lie between 0 and 90 deg'
            )
        if not self.scallop_height > 0.0 or (self.stepover is not None and self.stepover <= 0.0):
            raise InterpError('scallop height and plane distance must be positive')
        if self.points is not None and self.points < 8:
            raise InterpError(f'{self.points} points along a pass are too few; give at least 8')
