"""The overrides of the operator: their ranges, and which value counts."""

from cnc_interp.core import StreamError

#: Smallest and largest value of each override [-].
OVERRIDES = {
    'feed_override': (0.0, 1.5),
    'rapid_override': (0.01, 1.0),
    'spindle_override': (0.5, 1.2),
}
LEAST_FEED = 1e-3  #: A feed override below this counts as 0 [-].


def sound_override(name: str, value: float) -> float:
    """Return the override that counts for a value; StreamError if it is out of range or NaN."""
    least, most = OVERRIDES[name]
    if not least <= value <= most:
        text = f'{name} is {value:g}; it must lie between {least:g} and {most:g}'
        raise StreamError(text)
    return 0.0 if name == 'feed_override' and value < LEAST_FEED else value
