"""The setup file of the machine with its log, and changes requested by operators."""

import fcntl
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from math import isfinite
from pathlib import Path
from typing import TextIO

from cnc_interp.core import MM, InterpError
from cnc_interp.core.small_files import LONGEST_YAML, write_whole
from cnc_interp.program.geometry.program_coordinates import ProgramCoordinates
from cnc_interp.program.job import (
    MOST_TOOL,
    TOOL_SIZES,
    TOOL_TEXTS,
    WORK_OFFSETS,
    JobSetup,
    Position,
    SetupChange,
    Tool,
)

LARGEST = 1e5 * MM  #: Larger values suggest a wrong unit [m, rad].
#: Entries of a tool that can be changed.
TOOL_FIELDS = (*TOOL_SIZES, 'pocket', *TOOL_TEXTS)
_NAMES = f'{WORK_OFFSETS[0]} to {WORK_OFFSETS[-1]}'


class SetupTable:
    """Offsets and tools of the machine; each change is written to the log, then to the file.

    While it is open, no other table can use the same file, which need not exist yet. Without a
    file, changes are lost with this object.
    """

    def __init__(self, file: Path | None):
        self.file = file
        self.changed_by = self.change = ''  #: Author and description of the last change.
        self._log: TextIO | None = None
        self.setup = JobSetup()
        if file is None:
            return
        try:
            log = file.resolve()
            log.parent.mkdir(parents=True, exist_ok=True)
            self._log = log.with_name(f'{log.name}.log').open('a', encoding='utf-8')
            fcntl.flock(self._log, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InterpError(f'{file}: another program_node keeps its offsets there') from None
        except OSError as problem:
            raise InterpError(f'{file}: its log cannot be written: {problem.strerror}') from None
        if file.exists():
            self.setup = JobSetup.load(file)

    def apply(self, changes: Sequence[SetupChange], who: str) -> str:
        """Make all changes, or raise InterpError; return a description, '' if nothing changed."""
        after = self.setup
        for change in changes:
            after = after.changed(change)
        text = after.text()
        after = JobSetup.of_text(text)  # exactly what a restart will read
        names = {(change.field, change.key): change for change in changes}.values()
        told = '; '.join(
            f'{change.name}: {self.setup.told(change)} -> {after.told(change)}'
            for change in names
            if self.setup.told(change) != after.told(change)
        )
        if after == self.setup:
            return ''
        if len(text.encode()) > LONGEST_YAML:
            raise InterpError(f'the tool table is full ({LONGEST_YAML >> 10} kB); remove tools')
        who = ' '.join(who.split()) or 'unknown'
        try:
            self._write_log(f'{who}\t{told}')
            if self.file is not None:
                write_whole(self.file, text)
        except OSError as problem:
            self._write_log(f'{who}\tnot changed: {problem.strerror}')
            raise InterpError(f'{self.file}: cannot be written: {problem.strerror}') from None
        self.setup, self.changed_by, self.change = after, who, told
        return told

    def _write_log(self, words: str) -> None:
        if self._log is None:
            return
        self._log.write(f'{datetime.now().astimezone().isoformat()}\t{words}\n')
        self._log.flush()
        os.fsync(self._log.fileno())

    def close(self) -> None:
        if self._log is not None:
            self._log.close()


def values_by_axis(
    letters: Sequence[str], values: Sequence[float], axes: Sequence[str]
) -> dict[str, float]:
    """Return offsets by axis letter [m, rad]; raise InterpError if one is not possible."""
    if len(letters) != len(values) or len(set(letters)) != len(letters):
        raise InterpError('name each axis once, with one value for each')
    for letter, value in zip(letters, values, strict=True):
        if letter not in axes:
            raise InterpError(f'{letter} has no offset here; the axes are {" ".join(axes)}')
        if not isfinite(value) or abs(value) > LARGEST:
            raise InterpError(f'{letter}: an offset beyond 100,000 mm; correct it or its unit')
    return dict(zip(letters, values, strict=True))


def offset_changes(
    setup: JobSetup, name: str, values: Position, clear: bool, activate: bool
) -> list[SetupChange]:
    """Return the changes of a work offset or G92 [m, rad], or raise InterpError."""
    name = name or setup.offset
    if not values and not clear and not activate:
        raise InterpError(f'{name}: nothing to change; give an axis and its value, such as X 10')
    if name == 'G92':
        if activate:
            raise InterpError('G92 cannot be the active work offset; it is added to that')
        amounts = {**({} if clear else setup.g92), **values}
        return [SetupChange('g92', amounts), SetupChange('g92_on', bool(amounts))]
    if name not in WORK_OFFSETS:
        raise InterpError(f'{name}: no such offset; there are {_NAMES}, and G92')
    changes = []
    if values or clear:
        before = {} if clear else setup.work_offsets.get(name, {})
        changes.append(SetupChange('work_offsets', {**before, **values} or None, name))
    if activate:
        changes.append(SetupChange('active', name))
    return changes


def tool_changes(
    setup: JobSetup, number: int, given: Mapping[str, float | str], remove: bool, load: bool
) -> list[SetupChange]:
    """Return the changes of a tool, or raise InterpError; ``load``: it is now in the spindle."""
    if not 1 <= number <= MOST_TOOL and not (load and number == 0 and not given and not remove):
        raise InterpError(f'tool {number}: tools have numbers from 1 to {MOST_TOOL}')
    changes = []
    if remove and (given or load):
        raise InterpError(f'tool {number}: remove it, or change it; not both')
    if remove:
        if number not in setup.tools:
            raise InterpError(f'tool {number} is not in the table')
        changes.append(SetupChange('tools', None, number))
    elif given:
        changes.append(SetupChange('tools', _tool(setup, number, given), number))
    if load:
        changes.append(SetupChange('tool', number))
    if not changes:
        raise InterpError(f'tool {number}: nothing to change; give a length, radius or remark')
    return changes


def _tool(setup: JobSetup, number: int, given: Mapping[str, float | str]) -> Tool:
    unknown = set(given) - set(TOOL_FIELDS)
    if unknown:
        raise InterpError(f'tool {number} has no {unknown.pop()}; it has {", ".join(TOOL_FIELDS)}')
    tool = replace(setup.tools.get(number, Tool()), **given)  # type: ignore[arg-type]
    for name in TOOL_SIZES:
        value = getattr(tool, name) or 0.0
        if not isfinite(value) or abs(value) > LARGEST:
            raise InterpError(f'tool {number}: a {name} beyond 100,000 mm; correct it or its unit')
    if tool.fault:
        raise InterpError(f'tool {number}: {tool.fault}')
    return tool


def touch_off_changes(
    setup: JobSetup,
    name: str,
    values: Position,
    reads: Position,
    frame: ProgramCoordinates,
    zero: Position,
) -> list[SetupChange]:
    """Return the change of a work offset after which the coordinates here read ``values``.

    ``values``: the new readings; ``reads``: the current readings in ``frame``, all in the order of
    its axes; ``zero``: workpiece zero of the machine file [m, rad]. On a turned plane, one
    coordinate may change several zeros.
    """
    if name == 'G92':
        raise InterpError('touch-off sets a work offset; name G54 to G59.3, or none')
    letters = list(reads)
    less = {letters.index(k): reads[k] - value for k, value in values.items()}
    moved = dict(zip(letters, frame.change_of_zero(less).tolist(), strict=False))
    before = setup.work_offsets.get(name or setup.offset, {})
    origin = {
        letter: before.get(letter, zero[letter]) + value
        for letter, value in moved.items()
        if value or letter in values
    }
    return offset_changes(setup, name, origin, clear=False, activate=False)
