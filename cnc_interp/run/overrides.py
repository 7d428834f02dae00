"""The operator's settings: ranges of the overrides, and the effective values."""

from dataclasses import dataclass
from typing import NamedTuple

from cnc_interp.core import StreamError

#: Smallest and largest value of each override [-].
OVERRIDES = {
    'feed_override': (0.0, 1.5),
    'rapid_override': (0.01, 1.0),
    'spindle_override': (0.5, 1.2),
}
LEAST_FEED = 1e-3  #: A feed override below this counts as 0 [-].


@dataclass(frozen=True)
class OperatorSettings:
    #: Factor on the programmed feed, 0 or 0.001 to 1.5 [-]; with 0 the motion stops and waits.
    override: float = 1.0
    single_block: bool = False  #: Rest at the end of each source line until cycle_start.
    rapid: float = 1.0  #: Factor on the speed of rapids, up to 1 [-].
    #: Factor on the spindle speed, 0.5 to 1.2, and so on the feed per revolution (G95) [-].
    spindle: float = 1.0


class OverrideStep(NamedTuple):
    """The overrides in effect from a setpoint of a run on."""

    sample: int
    feed: float
    spindle: float


NOMINAL = (OverrideStep(0, 1.0, 1.0),)  #: A run or a plan without overrides.


def sound_override(name: str, value: float) -> float:
    """Return the effective override for a value; StreamError if it is out of range or NaN."""
    least, most = OVERRIDES[name]
    if not least <= value <= most:
        text = f'{name} is {value:g}; it must lie between {least:g} and {most:g}'
        raise StreamError(text)
    return 0.0 if name == 'feed_override' and value < LEAST_FEED else value
