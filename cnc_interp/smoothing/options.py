"""What the user and the machine may choose about smoothing."""

from __future__ import annotations

from dataclasses import dataclass, field

from cnc_interp.core.errors import InterpError
from cnc_interp.core.units import DEG, MM
from cnc_interp.smoothing.corners.corner import Style
from cnc_interp.smoothing.corners.ratio import AxisRates
from cnc_interp.smoothing.dense.compression import Compression

#: Fixed L2/L1 that may be asked for; at 1 the curve meets its lines with a kink.
RATIOS = 1.2, 4.0
#: Ways to make a corner; the first of each is the default.
CHOICES = {'parametrization': ('exact', 'linear', 'paper'), 'top': ('in_step', 'tolerance')}


@dataclass(frozen=True)
class SmoothingOptions:
    """
    How the look-ahead smooths.

    Parameters
    ----------
    flank_height : float
        Height h over the tip at which the orientation tolerance is measured [m].
    ratio : float, optional
        L2/L1 of every corner where there is room [-]; None: chosen for each corner, see
        ``ratio.py``.
    axis_rates : callable, optional
        What the machine's axes do along a line, each over its jerk limit, to choose ratios by.
    parametrization : {'exact', 'linear', 'paper'}
        How the orientation of a corner is connected to its lines; see ``connection.py``.
    top : {'in_step', 'tolerance'}
        How the inner points of the top polygon are placed; see ``corner.py``.
    septic : bool
        Continue the third derivative of the tool axis as well (``exact`` only).
    left_over : float
        A line shorter than this share of its block goes to the corners [-].
    sharpest_turn, sharpest_swing : float
        The tool stops where its path turns by more than this while the tool axis rests, and where
        it turns [rad]: there a stop is faster on average.
    pole : tuple of float or None
        Direction at which a rotary axis is undefined; a turning tool stops there.
    pole_cone : float
        Angle around the pole within which that holds [rad].
    compression : Compression
        How runs of short blocks become curves.

    """

    flank_height: float = 30.0 * MM
    ratio: float | None = None
    axis_rates: AxisRates | None = None
    parametrization: str = 'exact'
    top: str = 'in_step'
    septic: bool = False
    left_over: float = 0.05
    sharpest_turn: float = 178.0 * DEG
    sharpest_swing: float = 176.0 * DEG
    pole: tuple[float, float, float] | None = None
    pole_cone: float = 0.02 * DEG
    compression: Compression = field(default_factory=Compression)

    def __post_init__(self) -> None:
        for name, choices in CHOICES.items():
            if getattr(self, name) not in choices:
                raise InterpError(
                    f'{name} {getattr(self, name)!r} is unknown; choose {" or ".join(choices)}'
                )
        low, high = RATIOS
        if self.ratio is not None and not low <= self.ratio <= high:
            raise InterpError(f'ratio L2/L1 {self.ratio:g} is not between {low:g} and {high:g}')

    @property
    def style(self) -> Style:
        """Return what concerns the corners alone."""
        in_step = self.top == 'in_step'
        return Style(self.flank_height, in_step, self.parametrization, self.septic)
