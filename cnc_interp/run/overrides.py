"""The operator's settings: overrides with their ranges, and single block."""

from dataclasses import dataclass
from typing import NamedTuple

from cnc_interp.core import StreamError

#: Override -> smallest and largest value [-].
OVERRIDES = {
    'feed_override': (0.0, 1.5),
    'rapid_override': (0.01, 1.0),
    'spindle_override': (0.5, 1.2),
}
LEAST_FEED = 1e-3  #: A smaller feed override counts as 0 [-].


@dataclass(frozen=True)
class OperatorSettings:
    #: Factor on the programmed feed: 0, or 0.001 to 1.5 [-]. At 0 the motion stops and waits.
    override: float = 1.0
    single_block: bool = False  #: Whether the machine waits for cycle_start after each line.
    rapid: float = 1.0  #: Factor on the speed of rapids, up to 1 [-].
    #: Factor on the spindle speed, 0.5 to 1.2 [-]; it also scales a feed per revolution (G95).
    spindle: float = 1.0


class OverrideStep(NamedTuple):
    """Overrides in effect, and the number of the first setpoint with them."""

    sample: int
    feed: float
    spindle: float


NOMINAL = (OverrideStep(0, 1.0, 1.0),)  #: No overrides in a run or a plan.


def sound_override(name: str, value: float) -> float:
    """Return the effective value of an override; StreamError if it is NaN or out of range."""
    least, most = OVERRIDES[name]
    if not least <= value <= most:
        text = f'{name} is {value:g}; it must lie between {least:g} and {most:g}'
        raise StreamError(text)
    return 0.0 if name == 'feed_override' and value < LEAST_FEED else value
