"""Axis: what the machine says about one of its axes, and the units in which people read it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from cnc_interp.core.units import DEG, MM, UM


@dataclass(frozen=True)
class Axis:
    """One axis of a machine."""

    name: str  #: Its letter.
    linear: bool  #: True for a linear axis, False for a rotary one.
    #: Limits [m/s or rad/s, per s, per s2].
    max_velocity: float
    max_acceleration: float
    max_jerk: float
    #: Lowest and highest position, infinite for an endless axis [m or rad].
    travel: tuple[float, float]

    @property
    def endless(self) -> bool:
        """True where at least one end of the travel is open."""
        return not np.isfinite(self.travel).all()

    @property
    def unit(self) -> str:
        """Unit of positions inside and on the wire."""
        return 'm' if self.linear else 'rad'

    @property
    def shown_unit(self) -> str:
        """Unit in which people read positions of the axis."""
        return 'mm' if self.linear else 'deg'

    @property
    def shown_size(self) -> float:
        """Size of that unit [m or rad]."""
        return MM if self.linear else DEG

    def position_text(self, position: float) -> str:
        """Return a position [m or rad] as text for a display, in mm or deg without the unit."""
        return f'{position / MM:z.3f}' if self.linear else f'{position / DEG:z.4f}'


def place_text(axes: Sequence[Axis], position: Iterable[float]) -> str:
    """Return the positions of all axes [m or rad] as text with names and units."""
    return '  '.join(
        f'{axis.name} {axis.position_text(q)} {axis.shown_unit}'
        for axis, q in zip(axes, position, strict=True)
    )


def error_text(error: float, unit: str) -> str:
    """Return a small difference of positions [m or rad] as text with its unit."""
    return f'{error / UM:.1f} um' if unit == 'm' else f'{error / DEG:.4f} deg'
