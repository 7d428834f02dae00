"""The time of a program by tool and operation: motion, and times at rest."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, IntArray
from cnc_interp.feedrate.planning_windows import PlannedPiece
from cnc_interp.machine_model.machine import Machine
from cnc_interp.program.blocks import STOP, Blocks
from cnc_interp.program.blocks.functions import Functions

#: A program line that is only a comment: it names an operation.
_NAME = re.compile(r'\s*(?:N\d+\s*)?(?:\(([^()]*)\)|;(.*)|\$\$(.*)|PPRINT\s*/(.*))\s*', re.I)
CHANGE, DWELL = 'M6', 'G4'


@dataclass(frozen=True)
class Times:
    """Time of a program or a section, by what it is spent on [s]."""

    cutting: float = 0.0
    rapid: float = 0.0
    dwell: float = 0.0
    spindle: float = 0.0  #: Starting and stopping the spindle.

    @property
    def total(self) -> float:
        return self.cutting + self.rapid + self.dwell + self.spindle

    def to_json(self) -> dict[str, float]:
        return {'time_s': self.total} | {f'{k}_s': float(v) for k, v in asdict(self).items()}


@dataclass(frozen=True)
class Operation:
    line: int  #: First line of the operation.
    name: str  #: Comment before this line.
    motion: float  #: Time of its motion [s].


@dataclass(frozen=True)
class ToolSection:
    """A section of a program, from one tool change to the next."""

    line: int  #: First line of the section.
    tool: int  #: Tool number; 0: the tool is already in the spindle.
    times: Times
    change: float  #: Time of the tool change before it [s].
    operations: tuple[Operation, ...]

    def to_json(self) -> dict[str, Any]:
        operations = [
            {'line': one.line, 'name': one.name, 'motion_s': one.motion} for one in self.operations
        ]
        told = {'line': self.line, 'tool': self.tool, **self.times.to_json()}
        return {**told, 'change_s': self.change, 'operations': operations}


#: Columns of the printed table: heading, key in the JSON, and width.
_COLUMNS = (
    ('total', 'time_s', 11),
    ('cutting', 'cutting_s', 11),
    ('rapids', 'rapid_s', 9),
    ('dwells', 'dwell_s', 9),
    ('spindle', 'spindle_s', 9),
    ('change', 'change_s', 9),
)


def times_table(tools: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the lines of a table with the times of each tool and of its operations.

    ``tools``: the sections in JSON form, as in `estimate --json` and summary.json.
    """
    if not tools:
        return []
    lines = ['    line   tool' + ''.join(f'{head:>{width}}' for head, _, width in _COLUMNS)]
    for one in tools:
        times = ''.join(f'{one[key]:{width}.2f}' for _, key, width in _COLUMNS)
        lines.append(f'{one["line"]:8d} {one["tool"]:6d}{times}')
        operations = one.get('operations', ())
        lines += [
            f'{each["line"]:8d}{each["motion_s"]:18.2f}  {each["name"]}'
            for each in operations
            if len(operations) > 1
        ]
    return lines


def operation_names(source: str) -> list[tuple[int, str]]:
    """Return line and text of each comment line; [] if the file cannot be read as a program."""
    try:
        lines = Path(source).read_text(encoding='utf-8', errors='replace').splitlines()
    except OSError:
        return []
    found = ((number, _NAME.fullmatch(line)) for number, line in enumerate(lines, 1))
    told = ((number, next(filter(None, one.groups()), '').strip()) for number, one in found if one)
    return [(number, name) for number, name in told if name]


class ProgramTimes:
    """Adds up the time of each row of a program while it is planned."""

    def __init__(self) -> None:
        self._lines: list[IntArray] = []
        self._rapid: list[BoolArray] = []
        self._parts: list[tuple[IntArray, FloatArray]] = []  # rows, and the time spent in each
        self.stops = 0  #: Number of rows after which M0 waits for the operator.

    def blocks(self, blocks: Blocks) -> None:
        self._lines.append(blocks.line_number)
        self._rapid.append(blocks.rapid)
        self.stops += int(np.count_nonzero(blocks.program_stop == STOP))

    def piece(self, piece: PlannedPiece) -> None:
        self.spent(piece.path.cell_block[piece.law.cell], piece.law.duration)

    def spent(self, row: IntArray, time: FloatArray) -> None:
        """Add times to rows: ``row`` (n,), ``time`` (n,) [s]."""
        first = np.flatnonzero(np.diff(row, prepend=row[0] - 1))
        self._parts.append((row[first], np.add.reduceat(time, first)))

    def sections(
        self, functions: Functions, machine: Machine, source: str = ''
    ) -> list[ToolSection]:
        """Return a section for each tool in order; ``source``: file with names of operations."""
        if not self._lines:
            return []
        line, rapid = np.concatenate(self._lines), np.concatenate(self._rapid)
        motion = np.zeros(len(line))
        for row, spent in self._parts:
            known = (row >= 0) & (row < len(line))  # blocks of a record may be missing
            np.add.at(motion, row[known], spent[known])
        names = list(_operations(line, operation_names(source)))
        signals = machine.signals
        first = {words.start: word for word, words in signals.words.items()}
        words = np.array([first.get(step, '') for step in functions.step.tolist()], dtype=object)
        rests = functions.standstill(signals, machine.standstill)
        dwells = np.where(words == DWELL, rests, 0.0)
        changes = np.flatnonzero(words == CHANGE).tolist()
        steps = [-1, *changes, len(functions)]
        rows = [0, *functions.block[changes].tolist(), len(line)]
        found = []
        for (at, after), (begin, end) in zip(pairwise(steps), pairwise(rows), strict=True):
            here, within = slice(begin, end), slice(at + 1, after)
            fast = float(motion[here][rapid[here]].sum())
            dwell = float(dwells[within].sum())
            times = Times(
                cutting=float(motion[here].sum()) - fast,
                rapid=fast,
                dwell=dwell,
                spindle=float(rests[within].sum()) - dwell,
            )
            if at < 0:
                if times.total > 0.0:
                    found.append(ToolSection(int(line[0]), 0, times, 0.0, ()))
                continue
            inside = [(row, name) for row, name in names if begin <= row < end]
            operations = tuple(
                Operation(int(line[row]), name, float(motion[row:to].sum()))
                for (row, name), (to, _) in pairwise([*inside, (end, '')])
            )
            number, change = _tool(functions, machine, at), float(rests[at])
            begins = int(functions.line_number[at])
            found.append(ToolSection(begins, number, times, change, operations))
        return found


def _tool(functions: Functions, machine: Machine, change: int) -> int:
    """Return the tool number of the tool change at function ``change``."""
    steps = machine.signals.steps
    last = change + len(machine.signals.words[CHANGE])
    told = [
        value
        for step, value in zip(functions.step[:last], functions.value[:last], strict=True)
        if steps[step].value == 'T'
    ]
    return int(told[-1]) if told else 0


def _operations(line: IntArray, names: Sequence[tuple[int, str]]) -> Iterator[tuple[int, str]]:
    """Yield first row and name of each operation; of several comments the last is its name."""
    passed = np.maximum.accumulate(line)  # a repeated line counts where it was executed first
    by_row = {int(np.searchsorted(passed, number)): name for number, name in names}
    yield from ((row, name) for row, name in by_row.items() if row < len(line))
