"""The declaration of a setting: its value, range, unit and description.

``Settings`` holds the settings. The command line, ROS parameters, goals, bags, plan files and the
operator page are made from the declarations: they iterate over ``choices(Settings)``.
"""

import enum
import math
from collections.abc import Mapping
from dataclasses import Field, dataclass, field, fields
from decimal import Decimal
from pathlib import Path
from typing import Any

from cnc_interp.core import DEG, MM, MM_PER_MIN, MS, SettingsError

DECLARED = 'choice'  #: Key of a declaration in the metadata of a dataclass field.
DIGITS = 17  #: Most digits that a number needs to be read back bit for bit.

Value = float | int | bool | str | Path | None


class Stage(enum.Enum):
    """The processing stage that uses a setting."""

    READING = 'reading'
    SMOOTHING = 'smoothing'
    MOTION = 'motion'
    PLANNING = 'planning'  # the motion law, found by the feed planner
    START = 'start'  # where one run begins; never a default of the nodes or of the page
    APPROACH = 'approach'  # the approach from the machine's current position
    OFFLINE = 'offline'  # motion that is planned without the nodes


@dataclass(frozen=True)
class Unit:
    """The unit in which users enter a number."""

    name: str  #: Unit of the shop floor; empty for a plain number.
    size: float  #: One unit in SI.
    si: str  #: Name of the SI unit.


PLAIN = Unit('', 1.0, '-')
LENGTH = Unit('mm', MM, 'm')
ANGLE = Unit('deg', DEG, 'rad')
FEED = Unit('mm/min', MM_PER_MIN, 'm/s')
TIME = Unit('ms', MS, 's')


@dataclass(frozen=True)
class Choice:
    name: str  #: Name of the field, of the ROS parameter and of the key in a goal.
    kind: type  #: float, int, bool, str or Path.
    default: Value  #: Default value [SI].
    stage: Stage  #: Processing stage that uses it.
    sentence: str  #: Description, one plain sentence without a full stop.
    option: str  #: Name on the command line, without the dashes.
    unit: Unit = PLAIN  #: Unit on the shop floor.
    #: Range of a number, ends included [SI].
    low: float = -math.inf
    high: float = math.inf
    values: tuple[str, ...] = ()  #: The words to choose from; empty for other kinds.
    optional: bool = False  #: Whether None is allowed.
    nothing: str = ''  #: Word for None; empty if the option is simply left out.
    metavar: str = ''  #: Placeholder for the value in the help.
    for_comparison: bool = False  #: Whether it only serves to compare methods, not operation.

    def check(self, value: Any) -> None:
        """Reject a value of the wrong type or outside the range; SettingsError names it."""
        if value is None and self.optional:
            return
        if self.kind in (float, int):
            whole = isinstance(value, int) and not isinstance(value, bool)
            if not (whole or (self.kind is float and isinstance(value, float))):
                raise SettingsError(self.name, f'{value!r} is not a number')
            if not self.low <= value <= self.high:  # NaN neither
                raise SettingsError(self.name, f'{self.shown(value)} is not {self.range}')
        elif not isinstance(value, self.kind):
            raise SettingsError(self.name, f'{value!r} is not a {self.kind.__name__}')
        elif self.values and value not in self.values:
            known = ' or '.join(self.values)
            raise SettingsError(self.name, f'{value!r} is unknown; choose {known}')

    @property
    def range(self) -> str:
        """The range of a number in words of the shop floor."""
        low, high = (f'{bound / self.unit.size:.6g}' for bound in (self.low, self.high))
        return f'between {low} and {high} {self.unit.name}'.rstrip()

    def shown(self, value: Value) -> str:
        """Return a value in words of the shop floor, with its unit."""
        if value is None:
            return self.nothing or 'not given'
        if isinstance(value, bool):
            return 'on' if value else 'off'
        if isinstance(value, float):
            return f'{value / self.unit.size:g} {self.unit.name}'.rstrip()
        return str(value)

    def shop_text(self, value: Value) -> str:
        """Return a value as text in the shop's unit, without the unit."""
        if isinstance(value, float):
            return shortest(value, self.unit.size)
        return self.text(value)

    def from_shop(self, text: str) -> Any:
        """Read a value from text; without a unit, it is in the shop's unit."""
        return self._read(text, self.unit.size)

    def text(self, value: Value) -> str:
        """Return a value as exact text in SI; None becomes the word in ``nothing``."""
        if value is None:
            return self.nothing
        if isinstance(value, bool):
            return 'true' if value else 'false'
        if isinstance(value, Path):
            bundled = not value.suffix and not value.exists()  # a name
            return str(value if bundled else value.resolve())
        return repr(float(value)) if self.kind is float else str(value)

    def from_text(self, text: str, need_unit: bool = False) -> Any:
        """Read a value from text; without a unit, it is in SI. Texts of users must have a unit."""
        text = text.strip()
        if need_unit and self.unit.name and is_number(text):
            raise SettingsError(
                self.name,
                f'{text!r} has no unit; write {text} {self.unit.name} or {text} {self.unit.si}',
            )
        return self._read(text, 1.0)

    def text_with_unit(self, value: Value) -> str:
        """Return a value as exact text, a number with its SI unit."""
        unit = self.unit.si if self.unit.name and value is not None else ''
        return f'{self.text(value)} {unit}'.rstrip()

    def plain(self, value: Value) -> float | int | bool | str:
        """Return a value as a ROS parameter; None becomes 0 or an empty text."""
        if value is None:
            return 0.0 if self.kind is float else ''
        return self.text(value) if isinstance(value, Path) else value

    def from_plain(self, value: float | int | bool | str) -> Any:
        """Read the value of a ROS parameter; 0 or empty may mean None; raises SettingsError."""
        found: Value = None if self.optional and not value else value
        if self.kind is Path and isinstance(found, str):
            found = Path(found)
        self.check(found)
        return found

    def _read(self, text: str, unit: float) -> Value:
        text = text.strip()
        value: Value = text
        if self.optional and text in ('', self.nothing):
            value = None
        elif self.kind is bool:
            words = {'true': True, 'false': False}
            if text.lower() not in words:
                raise SettingsError(self.name, f'{text!r} is unknown; choose true or false')
            value = words[text.lower()]
        elif self.kind in (float, int):
            number = text
            for name, size in ((self.unit.name, self.unit.size), (self.unit.si, 1.0)):
                if self.unit.name and is_number(text.removesuffix(name)) and text.endswith(name):
                    number, unit = text.removesuffix(name), size
                    break
            try:
                value = float(number) * unit if self.kind is float else int(number)
            except ValueError:
                other = f" or '{self.nothing}'" if self.nothing else ''
                units = f' in {self.unit.name} or {self.unit.si}' if self.unit.name else ''
                raise SettingsError(self.name, f'{text!r} is not a number{units}{other}') from None
        elif self.kind is Path:
            value = Path(text)
        self.check(value)
        return value


def number(
    default: float | None,
    unit: Unit,
    bounds: tuple[float, float],
    stage: Stage,
    sentence: str,
    **more: Any,
) -> Any:
    low, high = bounds
    metavar = unit.name.upper().replace('/', '_PER_')
    declared = {'unit': unit, 'low': low, 'high': high, 'metavar': metavar}
    return _declare(float, default, stage, sentence, optional=default is None, **declared | more)


def whole_number(
    default: int, bounds: tuple[int, int], stage: Stage, sentence: str, **more: Any
) -> Any:
    declared = {'low': bounds[0], 'high': bounds[1], 'metavar': 'N'}
    return _declare(int, default, stage, sentence, **declared | more)


def switch(default: bool, stage: Stage, sentence: str, **more: Any) -> Any:
    return _declare(bool, default, stage, sentence, **more)


def one_of(values: tuple[str, ...], stage: Stage, sentence: str, **more: Any) -> Any:
    return _declare(str, values[0], stage, sentence, values=values, **more)


def name(stage: Stage, sentence: str, **more: Any) -> Any:
    return _declare(str, None, stage, sentence, optional=True, **more)


def file(stage: Stage, sentence: str, **more: Any) -> Any:
    return _declare(Path, None, stage, sentence, optional=True, metavar='FILE', **more)


def _declare(kind: type, default: Value, stage: Stage, sentence: str, **more: Any) -> Any:
    told = {'kind': kind, 'default': default, 'stage': stage, 'sentence': sentence}
    return field(default=default, metadata={DECLARED: told | more})


def choices(settings: Any, *stages: Stage) -> tuple[Choice, ...]:
    """Return the declared settings of a settings class or object, in their order."""
    found = (_choice(field) for field in fields(settings))
    return tuple(choice for choice in found if not stages or choice.stage in stages)


def _choice(declared: Field[Any]) -> Choice:
    told: Mapping[str, Any] = declared.metadata[DECLARED]
    option = declared.name.replace('_', '-')
    return Choice(**{'name': declared.name, 'option': option} | dict(told))


def is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def shortest(value: float, unit: float) -> str:
    """Return the shortest number that is ``value`` again when it is multiplied by ``unit``."""
    for digits in range(1, DIGITS + 1):
        text = format(Decimal(f'{value / unit:.{digits}g}'), 'f')  # no exponent
        if float(text) * unit == value:
            break
    return text
