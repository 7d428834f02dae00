"""All settings of the user, each declared in one place, and their conversion to texts."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from math import pi
from pathlib import Path
from typing import Any

from cnc_interp.core import DEG, MM, MM_PER_MIN, MS, SettingsError
from cnc_interp.settings import option_kinds as kinds

READING, SMOOTHING, MOTION = kinds.Stage.READING, kinds.Stage.SMOOTHING, kinds.Stage.MOTION
PLANNING = kinds.Stage.PLANNING
START, APPROACH = kinds.Stage.START, kinds.Stage.APPROACH
DEFAULT_MACHINE = 'xyzac'  #: Machine if none is named.
LENGTHS = (1e-6 * MM, 1e4 * MM)  #: Range of the block length and the flank height [m].
#: Range of every tolerance; larger values suggest a wrong unit [m].
TOLERANCES = (1e-6 * MM, 5.0 * MM)
FEEDS = (1e-3 * MM_PER_MIN, 1e6 * MM_PER_MIN)  #: 0.001 mm/min to 1000 m/min [m/s].


@dataclass(frozen=True)
class Settings:
    """The user's settings for one run [SI]; raises SettingsError, which names the setting."""

    contour_tolerance: float = kinds.number(
        0.02 * MM, kinds.LENGTH, TOLERANCES, READING, 'largest deviation of the tool tip'
    )
    orientation_tolerance: float = kinds.number(
        0.02 * MM, kinds.LENGTH, TOLERANCES, READING, 'largest deviation at flank height'
    )
    flank_height: float = kinds.number(
        30.0 * MM, kinds.LENGTH, LENGTHS, READING, 'height at which orientation is measured'
    )
    force_tolerances: bool = kinds.switch(False, READING, 'ignore the tolerances of the program')
    feedrate: float | None = kinds.number(
        None,
        kinds.FEED,
        FEEDS,
        READING,
        'feedrate where the program has no F',
        option='feed',
    )
    setup: Path | None = kinds.file(  # noqa: RUF009 (a field)
        READING, 'YAML file with work offsets, tools and reference points'
    )
    interpolation: str = kinds.one_of(
        ('auto', 'vector', 'axes'),
        READING,
        'tool axis between blocks: vector (great circle), axes (linear), auto (as programmed)',
    )
    rotary_sense: str = kinds.one_of(
        ('programmed', 'shortest'),
        READING,
        'rotary words as programmed, or the shortest turn',
    )
    dialect: str = kinds.one_of(
        ('auto', 'plain', 'linuxcnc', 'fanuc', 'siemens'),
        READING,
        'control for which the program is written; auto: that of the machine file, or the one '
        'whose words it has',
    )
    arc_centres: str = kinds.one_of(
        ('auto', 'start', 'absolute', 'reversed'),
        READING,
        'I J K of arcs: vector from start to centre, position of the centre, or vector from '
        'centre to start; auto: that of the machine, else the one that fits all arcs',
    )
    units: str = kinds.one_of(
        ('auto', 'mm', 'inch'),
        READING,
        'unit of a program without G20 or G21; auto: that of the machine, else mm',
    )
    numbers: str = kinds.one_of(
        ('auto', 'units', 'increments'),
        READING,
        'what lengths and angles without a decimal point mean: units, or increments (X10 is '
        '0.010 mm or 0.0010 inch); auto: that of the machine, else units',
    )
    skip_blocks: bool = kinds.switch(False, READING, 'leave out lines that begin with a slash')
    most_jumps: int = kinds.whole_number(
        1_000_000,
        (1, 10**12),
        READING,
        'loops and calls after which a program counts as endless',
    )
    corner_ratio: float | None = kinds.number(
        None,
        kinds.PLAIN,
        (1.2, 4.0),
        SMOOTHING,
        'shape of the corners, 1.2 to 4, or auto: chosen for each',
        option='ratio',
        nothing='auto',
        metavar='L2/L1',
    )
    corner: str = kinds.one_of(
        ('default', 'paper'),
        SMOOTHING,
        'how corners are made; paper: those of Beudaert et al. (2013), word for word',
        for_comparison=True,
    )
    parametrization: str = kinds.one_of(
        ('auto', 'exact', 'linear', 'paper'),
        SMOOTHING,
        'how the orientation of a corner joins its lines; auto: paper for paper corners, '
        'else exact',
        for_comparison=True,
    )
    top: str = kinds.one_of(
        ('in_step', 'tolerance'),
        SMOOTHING,
        'how the curve of the tool axis is placed at a corner',
        for_comparison=True,
    )
    septic: bool = kinds.switch(
        False,
        SMOOTHING,
        'make the third derivative of the tool axis continuous, too',
        for_comparison=True,
    )
    compress: bool = kinds.switch(
        True, SMOOTHING, 'make curves of dense blocks, instead of rounding every corner'
    )
    longest_block: float = kinds.number(
        5.0 * MM,
        kinds.LENGTH,
        LENGTHS,
        SMOOTHING,
        'longer blocks stay straight lines; for an arm, this length times its reach in metres',
    )
    corner_angle: float = kinds.number(
        35.0 * DEG,
        kinds.ANGLE,
        (0.01 * DEG, pi),
        SMOOTHING,
        'a sharper turn of dense blocks is a corner',
    )
    tolerance_share: float = kinds.number(
        0.98,
        kinds.PLAIN,
        (0.01, 1.0),
        SMOOTHING,
        'part of the tolerances that curves through dense blocks may use',
        metavar='SHARE',
    )
    interpolation_period: float = kinds.number(
        1.0 * MS,
        kinds.TIME,
        (0.01 * MS, 100.0 * MS),
        MOTION,
        'interpolation period',
        option='period',
    )
    compensation: str | None = kinds.name(
        MOTION,
        'machine file whose drive models are compensated, as identify writes it',
        option='compensate',
        metavar='M',
    )
    learnt: Path | None = kinds.file(  # noqa: RUF009 (a field)
        MOTION, 'correction learnt from earlier runs, added to the compensation; `learn` writes it'
    )
    tool_error: float | None = kinds.number(
        None,
        kinds.LENGTH,
        TOLERANCES,
        PLANNING,
        'largest error that the drives may leave at the tool tip and at flank height',
        nothing='none',
    )
    scene: Path | None = kinds.file(  # noqa: RUF009 (a field)
        PLANNING, 'YAML file of bodies that must not touch: machine, fixtures, stock and tools'
    )
    collision: str = kinds.one_of(
        ('refuse', 'warn'), PLANNING, 'what happens to a program that hits a body of the scene'
    )
    from_line: int = kinds.whole_number(
        0, (0, 10**12), START, 'line of the program at which the run starts, 0: at its top'
    )
    line_pass: int = kinds.whole_number(
        0,
        (0, 10**12),
        START,
        'which execution of that line, if loops or calls repeat it, 0: the only one',
        option='pass',
    )
    retract: float = kinds.number(
        25.0 * MM,
        kinds.LENGTH,
        (0.0, 1e3 * MM),
        APPROACH,
        'length of the retract and of the plunge along the tool',
    )
    plunge_feed: float = kinds.number(
        500.0 * MM_PER_MIN,
        kinds.FEED,
        FEEDS,
        APPROACH,
        'feedrate of the plunge to a place inside the program',
    )
    spin: str = kinds.one_of(
        ('fixed', 'auto', 'best'),
        kinds.Stage.OFFLINE,
        "turn of an arm's tool about its axis; auto: the fastest constant one for each cut; "
        'best: a curve for each cut, which takes longer to find',
    )

    def __post_init__(self) -> None:
        for choice in kinds.choices(self):
            choice.check(getattr(self, choice.name))

    @property
    def compares_corners(self) -> bool:
        """Return whether a method for comparison only is selected for the corners."""
        exact = self.parametrization in ('auto', 'exact')
        return (self.corner, exact, self.top, self.septic) != ('default', True, 'in_step', False)


def texts_of(settings: Settings) -> dict[str, str]:
    return {c.name: c.text(getattr(settings, c.name)) for c in kinds.choices(settings)}


def changed(settings: Settings) -> list[str]:
    return [c.name for c in kinds.choices(settings) if getattr(settings, c.name) != c.default]


def values_of(settings: Settings) -> dict[str, kinds.Value]:
    """Return every setting as a JSON value; a path becomes text."""
    found = {choice.name: getattr(settings, choice.name) for choice in kinds.choices(settings)}
    return {k: str(v.resolve()) if hasattr(v, 'resolve') else v for k, v in found.items()}


#: Settings that only older records contain, each with the one value that is still supported.
GONE = (('law', 'optimal'),)


def with_texts(
    settings: Settings, texts: Iterable[tuple[str, str]], need_units: bool = False
) -> Settings:
    """Return settings with some values replaced by texts; a number without a unit is in SI.

    ``need_units``: reject numbers without a unit, because a user wrote them. Raises SettingsError.
    """
    known = {choice.name: choice for choice in kinds.choices(settings)}
    given: dict[str, Any] = {}
    for key, text in texts:
        if (key, text) in GONE:
            continue
        if key not in known:
            raise SettingsError(key, f'this choice is unknown; known: {", ".join(known)}')
        if key in given:
            raise SettingsError(key, 'this choice is given twice; give it once')
        given[key] = known[key].from_text(text, need_units)
    return replace(settings, **given)


def offered() -> tuple[kinds.Choice, ...]:
    """Return the settings on the page: those of reading and smoothing, without the period."""
    found = kinds.choices(Settings, kinds.Stage.READING, kinds.Stage.SMOOTHING)
    return tuple(choice for choice in found if not choice.for_comparison)


def filled_in(settings: Settings) -> dict[str, str]:
    """Return the contents of the page's fields for settings, in shop units."""
    return {choice.name: choice.shop_text(getattr(settings, choice.name)) for choice in offered()}


def settings_filled_in(settings: Settings, texts: Mapping[str, str]) -> Settings:
    """Return settings with the texts of the page's fields, in shop units; raises SettingsError."""
    return replace(settings, **{c.name: c.from_shop(texts[c.name]) for c in offered()})
