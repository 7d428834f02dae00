"""Units in which positions and feeds are shown: millimetres, or inches on the page."""

from dataclasses import dataclass

from cnc_interp.core import DEG, INCH, MINUTE, MM

LINEAR = 'XYZUVW'  #: Letters of linear axes; all others are rotary.


@dataclass(frozen=True)
class LengthUnit:
    """A unit of length; angles are always in degrees."""

    name: str
    size: float  #: Length of the unit [m].
    #: Number of decimals of a position, and of a feed.
    digits: int
    feed_digits: int
    #: Jog speeds in this unit or degrees per minute, from slow to fast.
    speeds: tuple[str, ...]
    steps: tuple[str, ...]  #: Jog steps in this unit or degrees.

    def of(self, letter: str) -> float:
        return self.size if letter in LINEAR else DEG

    def shown(self, letter: str, value: float) -> str:
        digits = self.digits if letter in LINEAR else 4
        return f'{value / self.of(letter):z.{digits}f}'

    def suffix(self, letter: str) -> str:
        return self.name if letter in LINEAR else '°' if letter in 'ABCR' else ''

    def length(self, value: float) -> str:
        return self.shown('X', value)

    def per_minute(self, speed: float) -> float:
        return speed * MINUTE / self.size

    def feed(self, speed: float) -> str:
        return f'{self.per_minute(speed):.{self.feed_digits}f}'

    def named(self, text: str) -> str:
        """Return a text in which mm is replaced by this unit."""
        return text.replace('mm', self.name)


STEPS = ('0.01', '0.1', '1', '10')
MILLIMETRES = LengthUnit('mm', MM, 3, 0, ('100', '300', '1000', '3000', '10000'), STEPS)
INCHES = LengthUnit(
    'in', INCH, 4, 1, ('4', '12', '40', '120', '400'), ('0.0001', '0.001', '0.01', '0.1')
)
