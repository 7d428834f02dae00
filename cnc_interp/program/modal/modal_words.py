"""The modal values of a program, each declared once with its words and properties."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from math import nan
from typing import Any

from cnc_interp.core import INCH, MM
from cnc_interp.program.text.control_traits import FANUC, PLAIN, Dialect


@dataclass(frozen=True)
class Mode:
    #: Value that each word sets; of several words for a value, the first one is displayed.
    codes: Mapping[str, Any] = field(default_factory=dict)
    has_handler: bool = False  #: Whether its words also have a handler (``execution/``).
    kept: bool = True  #: Whether an MDI line inherits it from the line before.
    saved: bool = True  #: Whether M70 and M73 save it.
    recorded: bool = True  #: Whether a change makes a new modal state of blocks.
    shown: bool = True  #: Whether its word is among the active codes.
    dialects: tuple[Dialect, ...] = ()  #: Dialects that know its words; empty means all.


def _mode(start: Any, **given: Any) -> Any:
    return field(default=start, metadata={'mode': Mode(**given)})


@dataclass(eq=False)
class ModalValues:
    motion: int | None = _mode(
        None, codes={f'G{n}': n for n in range(4)}, saved=False, recorded=False
    )
    plane: str = _mode('G17', codes={code: code for code in ('G17', 'G18', 'G19')})
    unit: float = _mode(
        MM,
        codes={
            **dict.fromkeys(('G20', 'G70', 'G700'), INCH),
            **dict.fromkeys(('G21', 'G71', 'G710'), MM),
        },
    )
    incremental: bool = _mode(False, codes={'G90': False, 'G91': True})
    #: Whether I J K are absolute coordinates of the centre of an arc.
    centre_absolute: bool = _mode(False, codes={'G90.1': True, 'G91.1': False})
    feed_mode: str = _mode('G94', codes={code: code for code in ('G93', 'G94', 'G95')})
    retract_to_start: bool = _mode(True, codes={'G98': True, 'G99': False})
    stop_always: bool = _mode(
        False,
        codes={
            **dict.fromkeys(('G61', 'G60', 'G61.1'), True),
            **dict.fromkeys(('G64', 'G641', 'G642', 'G643', 'G644', 'G645'), False),
        },
    )
    stop_once: bool = _mode(
        False, codes={'G9': True}, kept=False, saved=False, recorded=False, shown=False
    )
    polar: bool = _mode(False, codes={'G16': True}, has_handler=True, dialects=(FANUC, PLAIN))
    # On linear blocks ORICURVE turns from one direction to the other like ORIVECT.
    great_circle: bool = _mode(
        True,
        codes={
            **dict.fromkeys(('ORIVECT', 'ORIPLANE', 'ORICURVE'), True),
            **dict.fromkeys(('ORIAXES', 'ORIMKS'), False),
        },
        has_handler=True,
    )
    tcp: str = _mode('')  #: Word that switched tool-tip programming on; empty if off.
    #: Whether the tool has been turned to the tilted plane in effect.
    oriented: bool = _mode(False, recorded=False)
    feedrate: float | None = _mode(None, recorded=False)  #: With G95 [m per rev/min], else [m/s].
    turn_rate: float = _mode(nan, recorded=False)  #: Feedrate of rotary axes [rad/s].
    blocks_per_minute: float | None = _mode(None, recorded=False)
    #: Whether the feed mode changed after the last F.
    feed_changed: bool = _mode(False, recorded=False)
    spindle_speed: float = _mode(0.0)  #: [rev/min].
    contour: float = _mode(0.0)  #: Tolerances [m].
    orientation: float = _mode(0.0)
    #: Whether S is a surface speed (G96), that speed [m/min], and the speed limit [rev/min].
    by_surface_speed: bool = _mode(False, recorded=False)
    surface_speed: float = _mode(0.0, recorded=False)
    surface_limit: float = _mode(0.0, recorded=False)


MODES: dict[str, Mode] = {each.name: each.metadata['mode'] for each in fields(ModalValues)}
#: G words that only set a value; any other word needs a handler. Two for the same value in one
#: block are rejected.
SETTINGS: dict[str, tuple[str, Any]] = {
    code: (name, value)
    for name, mode in MODES.items()
    if not mode.has_handler
    for code, value in mode.codes.items()
}
