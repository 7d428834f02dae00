"""Tool tables of other programs: LinuxCNC's tool.tbl and CSV, read and written."""

import csv
import re
from collections.abc import Iterator, Mapping
from io import StringIO
from pathlib import Path
from typing import Any

from cnc_interp.core import InterpError
from cnc_interp.core.small_files import LONGEST_YAML, UnreadableError, small_text
from cnc_interp.program.job import MOST_TOOL, TOOL_SIZES, TOOL_TEXTS, Tool

COLUMNS = ('number', 'pocket', *TOOL_SIZES, *TOOL_TEXTS)
_WORD = re.compile(r'([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))\s*', re.IGNORECASE)
#: Words of tool.tbl without effect here: offsets and angles of lathe tools, and of other axes.
_IGNORED = frozenset('XYABCUVWIJQ')


def tools_of_text(text: str, unit: float) -> dict[int, Tool]:
    """Read a tool.tbl or a CSV file; the first line shows which one it is.

    Parameters
    ----------
    text : str
        A CSV file begins with the names of its columns: ``number``, and some of ``COLUMNS``.
    unit : float
        Unit of its lengths [m].

    Returns
    -------
    dict
        The tools by their numbers.

    Raises
    ------
    InterpError
        If a line cannot be read; the message names it.

    """
    lines = text.removeprefix('\ufeff').splitlines()
    first = next((line.strip() for line in lines if line.strip() and line.strip()[0] != ';'), '')
    if not first:
        raise InterpError('no tools in this file')
    rows = _tbl_rows(lines) if _WORD.match(first) else _csv_rows(lines)
    found: dict[int, Tool] = {}
    for line, words in rows:
        try:
            number, tool = _tool(words, unit)
        except ValueError as problem:
            raise InterpError(f'line {line}: {problem}') from None
        fault = (
            tool.fault
            if 1 <= number <= MOST_TOOL
            else f'tool numbers must be from 1 to {MOST_TOOL}'
        )
        if not fault and number in found:
            fault = 'the tool is in the file twice'
        if fault:
            raise InterpError(f'line {line}: tool {number}: {fault}')
        found[number] = tool
    return found


def tools_of_file(path: Path, unit: float) -> dict[int, Tool]:
    try:
        return tools_of_text(small_text(path, LONGEST_YAML), unit)
    except OSError as problem:
        raise InterpError(f'{path}: cannot be opened: {problem.strerror}') from None
    except (InterpError, UnreadableError) as problem:
        raise InterpError(f'{path}: {problem}') from None


def _tool(words: Mapping[str, str], unit: float) -> tuple[int, Tool]:
    sizes: dict[str, Any] = {
        name: float(words[name]) * unit for name in TOOL_SIZES if words.get(name)
    }
    if 'diameter' in words:
        sizes['radius'] = 0.5 * float(words['diameter'] or 0.0) * unit
    number, pocket = (int(words.get(name) or 0) for name in ('number', 'pocket'))
    texts: dict[str, Any] = {name: words.get(name, '').strip() for name in TOOL_TEXTS}
    return number, Tool(pocket=pocket, **texts, **sizes)


def _tbl_rows(lines: list[str]) -> Iterator[tuple[int, dict[str, str]]]:
    names = {'T': 'number', 'P': 'pocket', 'Z': 'length', 'D': 'diameter'}
    for number, line in enumerate(lines, start=1):
        words, _, remark = line.partition(';')
        if not words.strip():
            continue
        found = {letter.upper(): value for letter, value in _WORD.findall(words)}
        unknown = _WORD.sub('', words).strip() or ''.join(set(found) - {*names, *_IGNORED})
        if unknown or 'T' not in found:
            raise InterpError(f'line {number}: {unknown or "T"!r} is not understood or missing')
        read = {name: found[letter] for letter, name in names.items() if letter in found}
        yield number, {**read, 'remark': remark}


def _csv_rows(lines: list[str]) -> Iterator[tuple[int, dict[str, str]]]:
    header = next(iter(lines), '')
    mark = max(',;\t', key=header.count)
    names = [name.strip().lower() for name in header.split(mark)]
    if unknown := set(names) - {*COLUMNS, 'diameter'} or {'number'} - set(names):
        told = ', '.join(sorted(unknown))
        raise InterpError(f'line 1: columns are {", ".join(COLUMNS)}, or diameter; see {told!r}')
    for number, fields in enumerate(csv.reader(lines[1:], delimiter=mark), start=2):
        row = dict(zip(names, fields, strict=False))
        if any(field.strip() for field in fields):
            point = {name: text.replace(',', '.') for name, text in row.items()}
            yield number, point | {name: row.get(name, '') for name in TOOL_TEXTS}


def tbl_text(tools: Mapping[int, Tool], unit: float) -> str:
    """Return a tool.tbl with one length and one diameter per tool, which include the wear."""
    lines = [
        f'T{number} P{tool.pocket or number} Z{tool.worn.length / unit:+.6f} '
        f'D{2.0 * tool.worn.radius / unit:+.6f} ;{tool.remark}\n'
        for number, tool in sorted(tools.items())
    ]
    return ''.join(lines)


def csv_text(tools: Mapping[int, Tool], unit: float) -> str:
    text = StringIO()
    rows = csv.writer(text, lineterminator='\n')
    rows.writerow(COLUMNS)
    for number, tool in sorted(tools.items()):
        sizes = [getattr(tool, name) for name in TOOL_SIZES]
        told = ['' if size is None else f'{size / unit:.6f}' for size in sizes]
        rows.writerow([number, tool.pocket or '', *told, tool.remark, tool.holder])
    return text.getvalue()
