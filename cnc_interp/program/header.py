"""The head of a G-code program: text before its beginning (%), and its name."""

from __future__ import annotations

import re

from cnc_interp.program.source import Source

#: Lines in which the beginning of a program is sought.
_HEAD_LINES = 200
_WORD = re.compile(r'\s*(?:/\s*)?(?:[GMXYZNTSF]\s*[-+.\d#\[=]|[:O]\s*\d|[(;]|$)', re.IGNORECASE)
_NAME = re.compile(
    r'<[^<>]+>'  # Fanuc: a name instead of a number
    r'|O\s*<[^<>]+>'
    r'|O(?!RI|TOL|FFN)\s*[A-Z_][\w-]*'  # Okuma; not the words of Siemens
    r'|O\s*\d+(?:\s*[-_]\s*|\s+)[A-Z_][A-Z_][\w .-]*'  # a number and a title
    r'|O\s*\d+\s*[-_]\s*\w[\w .-]*'
)


def leader_lines(source: Source) -> int:
    """
    Return the number of lines before the line with % that begins a program.

    ISO 6983-1 calls this text the leader; controls skip it. Files that begin without % have none.
    """
    head = source.lines(source.start).decode('utf-8', 'replace').splitlines()[:_HEAD_LINES]
    for number, line in enumerate(head):
        if line.lstrip().startswith('%'):
            return number
        if line.strip() and _WORD.match(line):
            return 0
    return 0


def is_name(line: str) -> bool:
    """Tell whether a line, in upper case and without comments, is only the name of a program."""
    return _NAME.fullmatch(line) is not None
