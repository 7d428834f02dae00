"""The strategies of `cam iso-scallop`: options, functions that make passes, and figures.

Each strategy has its own module, and a row here that defines its command line, program, summary
and page.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cnc_interp.core import DEG, MM

if TYPE_CHECKING:
    from cnc_interp.cam.cutter import Cutter
    from cnc_interp.cam.spline_pass import Strips
    from cnc_interp.cam.surface import Surface
    from cnc_interp.core import FloatArray

    Show = Callable[[float], None]
    Passes = Callable[[Surface, Cutter, FloatArray, 'Wanted', Show], Strips]


@dataclass(frozen=True)
class StrategyOption:
    """A command-line option that only some strategies have."""

    name: str
    meaning: str  #: Text for the help, which adds the default.
    default: Any = None  #: Default on the command line; False for a flag.
    metavar: str | tuple[str, str] | None = None  #: A pair: two values.
    unit: float = 1.0
    kind: Any = float
    positive: bool = False
    values: tuple[str, ...] = ()

    def value(self, given: Any) -> Any:
        """Return the given value in SI."""
        if isinstance(given, (list, tuple)):
            return tuple(one * self.unit for one in given)
        return given * self.unit if isinstance(given, float) else given


@dataclass(frozen=True)
class Wanted:
    """The requested properties of passes."""

    ridge: float  #: Scallop height that they leave [m].
    overrun: float  #: Their length beyond the border [m].
    choices: Mapping[str, Any]  #: The strategy's own options by name, in SI.


@dataclass(frozen=True)
class Strategy:
    name: str
    meaning: str
    options: tuple[StrategyOption, ...]
    passes: Passes
    #: Functions: facts of passes for the summary, these facts as text, and figures for the page.
    facts: Callable[[Any], dict[str, Any]] = lambda paths: {}
    words: Callable[[dict[str, Any]], Sequence[str]] = lambda facts: ()
    figures: Callable[[Any], list[tuple[str, str, Any]]] = lambda paths: []

    def choices(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Return the options of this strategy by name, in SI."""
        names = {option: option.name.replace('-', '_') for option in self.options}
        return {name: option.value(options[name]) for option, name in names.items()}


TILT = StrategyOption(
    'tilt',
    'tilt of a first pass with constant tilt, and smallest tilt without --stepover (3 deg)',
    3.0,
    'DEG',
    DEG,
    positive=True,
)


def _planes(
    surface: Surface, cutter: Cutter, normal: FloatArray, wanted: Wanted, show: Show
) -> Strips:
    from cnc_interp.cam.iso_scallop import IsoScallopOptions, iso_scallop_paths

    chosen = dict(wanted.choices)
    stray = None if chosen.pop('no_restart') else IsoScallopOptions.stray
    options = IsoScallopOptions(
        scallop_height=wanted.ridge, stray=stray, overrun=wanted.overrun, **chosen
    )
    return iso_scallop_paths(surface, cutter, normal, options, show)


def _planes_facts(paths: Any) -> dict[str, Any]:
    from cnc_interp.cam.iso_scallop import facts_of

    return facts_of(paths)


def _planes_words(facts: dict[str, Any]) -> list[str]:
    from cnc_interp.cam.iso_scallop import facts_in_words

    return facts_in_words(facts)


def _planes_figures(paths: Any) -> list[tuple[str, str, Any]]:
    from cnc_interp.cam.program_page import tilt_figure

    return [('Tilt', 'Tilt along the passes.', tilt_figure(paths))]


_ALL = (
    Strategy(
        'planes',
        'along parallel planes with a variable tilt',
        (
            StrategyOption(
                'stepover',
                'distance of the guiding planes (for each pass the largest that --tilt allows)',
                metavar='MM',
                unit=MM,
                positive=True,
            ),
            TILT,
            StrategyOption(
                'tilt-limits',
                'smallest and largest tilt (0.5 60 deg)',
                (0.5, 60.0),
                ('LOW', 'HIGH'),
                DEG,
                positive=True,
            ),
            StrategyOption(
                'freedom',
                'the angle that sets the width of a strip (tilt)',
                'tilt',
                values=('tilt', 'yaw'),
            ),
            StrategyOption('yaw', 'yaw (0 deg)', 0.0, 'DEG', DEG),
            StrategyOption(
                'start',
                'first pass with constant width, or with constant tilt as in the paper (width)',
                'width',
                values=('width', 'tilt'),
            ),
            StrategyOption(
                'no-restart',
                'never restart; report an error where the recursion of the paper ends',
                False,
            ),
            StrategyOption(
                'points', 'scallop points along a pass (one per 0.8 mm)', metavar='N', kind=int
            ),
        ),
        _planes,
        _planes_facts,
        _planes_words,
        _planes_figures,
    ),
)
STRATEGIES = {strategy.name: strategy for strategy in _ALL}
