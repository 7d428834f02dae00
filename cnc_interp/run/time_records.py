"""Read records of controls and shops: start times of lines, path feeds, and cycle times.

A record is a CSV file, a document of MTConnect streams, or a trace of a Sinumerik. Error messages
name the line of the record that cannot be read.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from math import isfinite
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from cnc_interp.core import FloatArray, IntArray, InterpError

LINES, NUMBERS, FEEDS = 'time_s,block', 'time_s,number', 'time_s,feed_mm_per_s'
BY_PROGRAM, BY_TOOL = 'program,time_s', 'program,tool,time_s'
_NUMBER = re.compile(r'\s*(?:/\d?\s*)?N(\d+)', re.I)
#: MTConnect observations: line number in the file; N word of the line; path feed.
_LINE_ITEMS, _LABEL, _FEED = ('LineNumber', 'Line'), 'LineLabel', 'PathFeedrate'
#: Signals of a Sinumerik: the line of the program, and the path feed [mm/min].
_LINE_SIGNAL, _FEED_SIGNAL = 'linenumber', 'feedrateipo'
_NOTHING = 9.2e18  #: A larger value of a Sinumerik means: no value.
Rows = list[tuple[int, float, float]]  #: Rows: line of the record, time [s], value.


@dataclass(frozen=True)
class Trace:
    """Values that a control has recorded while it executed a program."""

    name: str
    #: (k,): Times at which lines began [s], and these source lines.
    time: FloatArray
    line: IntArray
    feed: FloatArray  #: (m, 2): Time [s] and path feed [m/s]; m = 0 if not recorded.

    def line_at(self, time: FloatArray) -> tuple[IntArray, FloatArray]:
        """Return the line executed at each time [s], and the time since its start [s]."""
        at = np.maximum(np.searchsorted(self.time, time, side='right') - 1, 0)
        return self.line[at], time - self.time[at]


@dataclass(frozen=True)
class CycleTime:
    """A row of a table of cycle times."""

    row: int  #: Line of the table.
    program: str
    tool: int | None  #: Tool number; None for the whole program.
    time: float  #: Cycle time [s].


def cycle_times(path: Path) -> list[CycleTime]:
    """Read a table ``program,time_s`` or ``program,tool,time_s``; [] for other records."""
    if path.suffix.lower() == '.xml':
        return []
    head, *lines = _lines_of(path)
    if head not in (BY_PROGRAM, BY_TOOL):
        return []
    found = []
    for number, line in enumerate(lines, 2):
        name, *values = (word.strip() for word in line.rsplit(',', head.count(',')))
        if not line.strip():
            continue
        numbers = _numbers(path, number, values, head)
        tool = int(numbers[0]) if head == BY_TOOL else None
        found.append(CycleTime(number, Path(name).name, tool, numbers[-1]))
    return found


def load_traces(path: Path, program: Path) -> list[Trace]:
    """Read the runs of a program in a record. A run begins where line numbers fall.

    For a record X_blocks.csv, the feeds are read from X_feed.csv beside it.
    """
    labelled = False
    feed = np.zeros((0, 2))
    if path.suffix.lower() == '.xml':
        rows, feeds, labelled = _of_xml(path, program)
        feed = np.array([(time, value) for _, time, value in feeds]).reshape(-1, 2)
    else:
        head, rows = _table(path, LINES, NUMBERS)
        labelled = head == NUMBERS
        beside = path.with_name(path.name.replace('_blocks', '_feed'))
        if beside != path and beside.is_file():
            feed = np.array([row[1:] for row in _table(beside, FEEDS)[1]]) * [1.0, 1e-3]
    if labelled:
        rows = _by_number(path, rows, program)
    if len(rows) < 2:
        raise InterpError(f'{path}: must hold at least two rows of {program.name}')
    table = np.array([row[1:] for row in rows])
    if (back := np.diff(table[:, 0]) < 0.0).any():
        at = rows[int(np.argmax(back)) + 1][0]
        raise InterpError(f'{path}:{at}: times must increase')
    again = np.flatnonzero(np.diff(table[:, 1]) < 0.0) + 1
    parts = [part for part in np.split(table, again) if len(part) > 1]
    return [
        Trace(path.name, part[:, 0], part[:, 1].astype(np.int64), _between(feed, part, last))
        for part, last in zip(parts, [False] * (len(parts) - 1) + [True], strict=True)
    ]


def _between(feed: FloatArray, part: FloatArray, last: bool) -> FloatArray:
    until = np.inf if last else part[-1, 0]
    return feed[(feed[:, 0] >= part[0, 0]) & (feed[:, 0] <= until)]


def _lines_of(path: Path) -> list[str]:
    try:
        lines = path.read_text(encoding='utf-8-sig').splitlines()
    except (OSError, UnicodeDecodeError) as problem:
        raise InterpError(f'{path}: cannot be read: {problem}') from None
    return [','.join(word.strip() for word in (lines or [''])[0].split(',')), *lines[1:]]


def _table(path: Path, *heads: str) -> tuple[str, Rows]:
    head, *lines = _lines_of(path)
    if head not in heads:
        raise InterpError(f'{path}:1: must begin with the line {" or ".join(heads)}')
    rows = []
    for number, line in enumerate(lines, 2):
        if line.strip():
            time, value = _numbers(path, number, line.split(','), head)
            rows.append((number, time, value))
    return head, rows


def _numbers(path: Path, row: int, words: Sequence[str], head: str) -> tuple[float, ...]:
    try:
        values = tuple(map(float, words))
    except ValueError:
        values = ()
    wanted = head.count(',') + (not head.startswith('program'))
    if len(values) != wanted or not all(map(isfinite, values)):
        raise InterpError(f'{path}:{row}: {",".join(words)}: must hold numbers for {head}')
    return values


def _by_number(path: Path, rows: Rows, program: Path) -> Rows:
    """Return the rows with N words replaced by lines of the program; N words may repeat."""
    places = defaultdict(list)
    for line, text in enumerate(_lines_of(program), 1):
        if match := _NUMBER.match(text):
            places[int(match[1])].append(line)
    found, at = [], 0
    for row, time, number in rows:
        if number <= 0.0:  # before the first block
            continue
        if not (known := places.get(int(number))):
            raise InterpError(f'{path}:{row}: {program.name} has no line N{number:g}')
        following = bisect_right(known, at - 1)
        at = known[following if following < len(known) else 0]
        found.append((row, time, float(at)))
    return found


def _of_xml(path: Path, program: Path) -> tuple[Rows, Rows, bool]:
    """Return rows of lines, rows of feeds, and whether the lines are N words."""
    try:
        text = path.read_bytes()
        roots = [ElementTree.fromstring(part) for part in _documents(text)]
    except OSError as problem:
        raise InterpError(f'{path}: cannot be read: {problem.strerror}') from None
    except ElementTree.ParseError as problem:
        raise InterpError(f'{path}:{problem.position[0]}: no XML: {problem}') from None
    if roots and roots[0].find('traceData') is not None:
        return *_of_sinumerik(path, roots[0]), False
    if not roots or not all(root.tag.endswith('}MTConnectStreams') for root in roots):
        raise InterpError(f'{path}: neither MTConnectStreams nor a trace of a Sinumerik')
    return _of_streams(roots, program)


def _documents(text: bytes) -> list[bytes]:
    """Return the XML documents in a file; a recorded stream has many, with HTTP heads between."""
    parts = [b'<?xml' + part for part in text.split(b'<?xml')[1:]] or [text]
    return [part[: part.rindex(b'>') + 1] if b'>' in part else part for part in parts]


def _of_streams(roots: Sequence[ElementTree.Element], program: Path) -> tuple[Rows, Rows, bool]:
    told: dict[str, dict[int, tuple[float, str]]] = defaultdict(dict)
    for one in (one for root in roots for one in root.iter() if one.get('timestamp')):
        usable = (
            one.text and one.text != 'UNAVAILABLE' and one.get('subType', 'ACTUAL') != 'COMMANDED'
        )
        if usable:
            time = datetime.fromisoformat(one.get('timestamp', '')).timestamp()
            name = one.tag.rpartition('}')[2]
            told[name][int(one.get('sequence', '0'))] = time, (one.text or '').strip()
    kind = next((name for name in (*_LINE_ITEMS, _LABEL) if told[name]), _LABEL)
    names = [told['Program'][key] for key in sorted(told['Program'])]
    begins = [time for time, _ in names]
    start = min((time for items in told.values() for time, _ in items.values()), default=0.0)

    def rows(items: dict[int, tuple[float, str]], unit: float) -> Rows:
        found = []
        for key in sorted(items):
            time, text = items[key]
            runs = names[max(0, bisect_right(begins, time) - 1)][1] if names else program.name
            if Path(runs).stem == program.stem:
                found.append((key, time - start, float(text.lstrip('Nn:')) * unit))
        return found

    return rows(told[kind], 1.0), rows(told[_FEED], 1e-3), kind == _LABEL


def _of_sinumerik(path: Path, root: ElementTree.Element) -> tuple[Rows, Rows]:
    frame = root.find('traceData/dataFrame')
    signals = [] if frame is None else frame.findall('dataSignal')
    names = {f'f{k}': one.get('name', '').lower() for k, one in enumerate(signals, 1)}
    if frame is None or not any(_LINE_SIGNAL in name for name in names.values()):
        raise InterpError(f'{path}: no signal actLineNumber; add it to the trace')
    lines: Rows = []
    feeds: Rows = []
    for row, record in enumerate(frame.findall('rec'), 1):
        time = float(record.get('time', 'nan'))
        for key, name in names.items():
            value = float(record.get(key, 'nan'))
            if not abs(value) < _NOTHING:
                continue
            if _LINE_SIGNAL in name:
                if not lines or lines[-1][2] != value:
                    lines.append((row, time, value))
            elif _FEED_SIGNAL in name:
                feeds.append((row, time, value * 1e-3 / 60.0))
    return lines, feeds
