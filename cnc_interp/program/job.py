"""JobSetup: offsets, tools and reference points that a program starts with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from pathlib import Path
from typing import Any

import yaml

from cnc_interp.core import DEG, MM, ProgramError
from cnc_interp.core.small_files import UnreadableError, parse_yaml, read_yaml
from cnc_interp.settings.options import Settings

LETTERS = 'XYZABC'
WORK_OFFSETS = ('G54', 'G55', 'G56', 'G57', 'G58', 'G59', 'G59.1', 'G59.2', 'G59.3')
#: Further work offsets: G54.1 P1 to P300 of Fanuc, which Haas writes as G154 P1.
ALL_OFFSETS = (*WORK_OFFSETS, *(f'G54.1 P{number}' for number in range(1, 301)))
REFERENCE_POINTS = ('G28', 'G30')
#: Key of the rotation about Z among the values of a work offset [rad].
ROTATION = 'R'
Position = Mapping[str, float]

#: Longest remark of a tool [characters], and largest tool number.
LONGEST_REMARK, MOST_TOOL = 80, 99_999
#: Entries of a tool in a setup file: sizes [mm], pocket, and texts.
TOOL_SIZES = ('length', 'radius', 'corner_radius', 'length_wear', 'radius_wear', 'flute')
TOOL_TEXTS = ('remark', 'holder')
_TOOL_KINDS = {
    'pocket': (int, 'a whole number'),
    'remark': (str, 'a text'),
    'holder': (str, 'the name of a holder'),
}
_TOOL_KEYS = {*TOOL_SIZES, *_TOOL_KINDS}
_DIGITS = 9  #: Digits after the point in setup files [mm, deg].


@dataclass(frozen=True)
class Tool:
    length: float = 0.0  #: Length along the tool that G43 uses [m].
    radius: float = 0.0  #: Radius of the cutter [m].
    remark: str = ''  #: Description, in one line.
    #: Corner radius [m]: ``radius`` for a ball, 0 for a flat end.
    corner_radius: float | None = None
    #: Wear that is added to length and radius [m].
    length_wear: float = 0.0
    radius_wear: float = 0.0
    pocket: int = 0  #: Its pocket in the tool changer; 0 if none.
    holder: str = ''  #: Name of its holder in a scene; empty for the default.
    flute: float = 0.0  #: Flute length [m]; 0 if all of it below the holder cuts.

    @property
    def worn(self) -> Tool:
        """The tool with its wear added to its sizes."""
        if not (self.length_wear or self.radius_wear):
            return self
        radius, corner = self.radius + self.radius_wear, self.corner_radius
        if corner is not None:
            corner = radius if corner == self.radius else min(corner, radius)
        length = self.length + self.length_wear
        return Tool(length, radius, self.remark, corner, holder=self.holder, flute=self.flute)

    @property
    def fault(self) -> str:
        if min(self.radius, self.radius + self.radius_wear) < 0.0:
            return 'the radius must not be below 0, with or without its wear'
        if not 0 <= self.pocket <= MOST_TOOL:
            return f'the pocket must be from 1 to {MOST_TOOL}, or 0 for none'
        if not 0.0 <= (self.corner_radius or 0.0) <= self.radius:
            return 'the corner radius must be from 0 to the radius'
        if self.flute and not self.flute >= 2.0 * (self.corner_radius or 0.0):
            return 'the flute must be at least twice the corner radius high, or 0'
        for name in TOOL_TEXTS:
            text = getattr(self, name)
            if len(text) > LONGEST_REMARK or not text.isprintable():
                return f'the {name} must be one line of {LONGEST_REMARK} characters'
        return ''


@dataclass(frozen=True)
class SetupChange:
    field: str  #: Name of the field of ``JobSetup``.
    value: Any  #: Its new value, or that of one entry; None removes the entry.
    #: Key of the changed entry, if the field is a mapping.
    key: str | int | None = None

    @property
    def name(self) -> str:
        names = {'active': 'active offset', 'tool': 'spindle', 'g92': 'G92', 'g92_on': 'G92'}
        if self.field == 'tools':
            return f'tool {self.key}'
        return str(names.get(self.field, self.key))


@dataclass(frozen=True)
class JobSetup:
    """Offsets, tools and reference points: those of the machine, or those of one job."""

    #: Machine coordinates of the workpiece zeros G54 to G59.3, by axis letter [m, rad]. If a zero
    #: is missing, the machine file gives the workpiece zero. ``R`` is the rotation about Z [rad].
    work_offsets: Mapping[str, Position] = field(default_factory=dict)
    tools: Mapping[int, Tool] = field(default_factory=dict)  #: The tool table, by tool number.
    #: Machine coordinates of G28 and G30 by axis letter [m, rad]; missing values are 0.
    reference_points: Mapping[str, Position] = field(default_factory=dict)
    #: Work offset with which a program begins; empty means G54.
    active: str = ''
    #: Values that G92 adds to the work offset, by axis letter [m, rad].
    g92: Position = field(default_factory=dict)
    g92_on: bool = False  #: Whether G92 is in effect; G92.2 suspends it.
    tool: int = 0  #: Number of the tool in the spindle; 0 if it is empty.

    @property
    def offset(self) -> str:
        return self.active or WORK_OFFSETS[0]

    def rotation(self, name: str) -> float:
        return self.work_offsets.get(name, {}).get(ROTATION, 0.0)

    def changed(self, change: SetupChange) -> JobSetup:
        if change.key is None:
            return replace(self, **{change.field: change.value})
        entries: dict[Any, Any] = dict(getattr(self, change.field))
        entries.pop(change.key, None)
        if change.value is not None:
            entries[change.key] = change.value
        fields: dict[str, Any] = {change.field: entries}
        return replace(self, **fields)

    def told(self, change: SetupChange) -> str:
        """Return the current values of a changed entry, in mm and deg, as ``X 40 Y -70``."""
        value = getattr(self, change.field)
        if change.field == 'active':
            return self.offset
        if change.field == 'tool':
            return f'tool {self.tool}' if self.tool else 'no tool'
        if change.field == 'g92_on':
            return 'on' if value else 'off'
        entry = value if change.key is None else value.get(change.key)
        if isinstance(entry, Tool):
            words = f'length {_shown(entry.length, MM):g} radius {_shown(entry.radius, MM):g}'
            if entry.corner_radius is not None:
                words += f' corner radius {_shown(entry.corner_radius, MM):g}'
            if entry.length_wear or entry.radius_wear:
                worn = entry.length_wear, entry.radius_wear
                words += ' wear {:g} {:g}'.format(*(_shown(size, MM) for size in worn))
            if entry.pocket:
                words += f' pocket {entry.pocket}'
            if entry.flute:
                words += f' flute {_shown(entry.flute, MM):g}'
            if entry.holder:
                words += f' holder {entry.holder}'
            return f'{words} {entry.remark}'.strip()
        shown = _position_shown(entry or {}).items()
        return ' '.join(f'{letter} {value:g}' for letter, value in shown) or 'not set'

    @staticmethod
    def of(settings: Settings) -> JobSetup:
        return JobSetup.load(settings.setup) if settings.setup else JobSetup()

    @staticmethod
    def load(path: Path) -> JobSetup:
        try:
            content = read_yaml(path)
        except OSError as problem:
            raise ProgramError(f'cannot be opened: {problem.strerror}', str(path)) from None
        except UnreadableError as problem:
            raise ProgramError(f'cannot be read as YAML: {problem}', str(path)) from None
        return _Reading(str(path)).setup(content)

    @staticmethod
    def of_text(text: str) -> JobSetup:
        return _Reading('<setup>').setup(parse_yaml(text)) if text else JobSetup()

    def text(self) -> str:
        content: dict[str, Any] = {
            'work_offsets': _positions_shown(self.work_offsets, ALL_OFFSETS),
            'active': self.active,
            'g92': _position_shown(self.g92),
            'g92_on': None if self.g92_on or not self.g92 else False,
            'tools': {number: _tool_shown(self.tools[number]) for number in sorted(self.tools)},
            'tool': self.tool,
            'reference_points': _positions_shown(self.reference_points, REFERENCE_POINTS),
        }
        filled = {k: v for k, v in content.items() if v is False or v not in ({}, '', 0, None)}
        style: dict[str, Any] = {'sort_keys': False, 'allow_unicode': True, 'width': 10_000}
        return str(yaml.safe_dump(filled, default_flow_style=None, **style))


def _shown(value: float, unit: float) -> float:
    return float(round(value / unit, _DIGITS)) + 0.0


def _position_shown(position: Position) -> dict[str, float]:
    given = [letter for letter in (*LETTERS, ROTATION) if letter in position]
    return {k: _shown(position[k], MM if k in 'XYZ' else DEG) for k in given}


def _positions_shown(
    positions: Mapping[str, Position], names: Sequence[str]
) -> dict[str, dict[str, float]]:
    return {name: _position_shown(positions[name]) for name in names if name in positions}


def _tool_shown(tool: Tool) -> dict[str, Any]:
    sizes = {name: getattr(tool, name) for name in TOOL_SIZES}
    shown = {
        name: _shown(size, MM)
        for name, size in sizes.items()
        if size or (size == 0.0 and name in ('length', 'corner_radius'))
    }
    others = {name: getattr(tool, name) for name in ('pocket', *TOOL_TEXTS)}
    return shown | {name: value for name, value in others.items() if value}


class _Reading:
    KEYS = ('work_offsets', 'active', 'g92', 'g92_on', 'tools', 'tool', 'reference_points')

    def __init__(self, source: str):
        self._source = source

    def fault(self, message: str) -> ProgramError:
        return ProgramError(message, self._source)

    def demand(self, holds: bool, message: str) -> None:
        if not holds:
            raise self.fault(message)

    def setup(self, content: Any) -> JobSetup:
        whole = self._mapping(content, 'the file')
        for key in whole:
            self.demand(key in self.KEYS, f'{key}: unknown; known: {", ".join(self.KEYS)}')
        offsets, tools, references = (
            self._mapping(whole.get(key) or {}, key)
            for key in ('work_offsets', 'tools', 'reference_points')
        )
        active, g92_on = whole.get('active', ''), whole.get('g92_on', bool(whole.get('g92')))
        self.demand(
            active in ('', *ALL_OFFSETS),
            f'active: must be one of {", ".join(WORK_OFFSETS)}, not {active!r}',
        )
        self.demand(isinstance(g92_on, bool), f'g92_on: must be true or false, not {g92_on!r}')
        return JobSetup(
            {k: self._position(offsets[k], k, ALL_OFFSETS) for k in offsets},
            {self._number_of(k, 'tools'): self._tool(tools[k], k) for k in tools},
            {k: self._position(references[k], k, REFERENCE_POINTS) for k in references},
            active,
            self._position(whole.get('g92') or {}, 'g92', ('g92',)),
            g92_on,
            self._number_of(whole.get('tool', 0), 'tool'),
        )

    def _mapping(self, content: Any, what: str) -> dict[Any, Any]:
        self.demand(isinstance(content, dict), f'{what}: must be a mapping; give keys with values')
        return content

    def _number(self, value: Any, key: str) -> float:
        self.demand(
            type(value) in (int, float) and isfinite(value),
            f'{key}: must be a number, not {value!r}',
        )
        return float(value)

    def _position(self, content: Any, name: Any, known: tuple[str, ...]) -> dict[str, float]:
        if name not in known:
            shown = ', '.join(known[: len(WORK_OFFSETS)])
            raise self.fault(f'{name}: unknown; known: {shown}')
        words = self._mapping(content, str(name))
        letters = [*LETTERS, ROTATION] if known is ALL_OFFSETS else list(LETTERS)
        for letter in words:
            self.demand(
                letter in letters, f'{name}.{letter}: unknown axis; known: {" ".join(letters)}'
            )
        return {
            letter: self._number(value, f'{name}.{letter}') * (MM if letter in 'XYZ' else DEG)
            for letter, value in words.items()
        }

    def _number_of(self, key: Any, what: str) -> int:
        self.demand(
            type(key) is int,
            f'{what}.{key}: the tool number must be a whole number',
        )
        return key

    def _tool(self, content: Any, key: Any) -> Tool:
        words = dict(self._mapping(content, f'tools.{key}'))
        self.demand(
            'length' in words and words.keys() <= _TOOL_KEYS,
            f'tools.{key}: must have a length, perhaps a radius, a corner_radius and a '
            'remark, as {length: 75.0, radius: 5.0, remark: ball}, and may have length_wear, '
            'radius_wear, flute, pocket and holder',
        )
        others = {name: words.pop(name) for name in _TOOL_KINDS if name in words}
        for name, value in others.items():
            kind, what = _TOOL_KINDS[name]
            self.demand(type(value) is kind, f'tools.{key}.{name}: must be {what}')
        found: dict[str, Any] = {
            name: self._number(words[name], f'tools.{key}.{name}') * MM for name in words
        }
        tool = Tool(**others, **found)
        self.demand(not tool.fault, f'tools.{key}: {tool.fault}')
        return tool
