"""Dialects: the form of a text, and the meaning of words that differ between controls."""

import re
from dataclasses import dataclass, replace
from pathlib import Path

from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.text.expressions import (
    READ_BY_FANUC,
    READ_BY_LINUXCNC,
    READ_BY_SIEMENS,
    USUAL,
    USUAL_OF_BITS,
    Reading,
)
from cnc_interp.program.text.source import CL_SUFFIXES, Source
from cnc_interp.settings.options import Settings


@dataclass(frozen=True)
class Dialect:
    name: str
    title: str
    starts_with: int | None = None  #: Motion code after a reset (0 to 3), or None.
    #: Whether the line of G41 or G42 ends beside its own end, not beside the start of the next.
    own_entry: bool = False
    #: Whether an incremental word after a new frame also includes its shift (SD42440).
    runs_shifts: bool = False
    feeds_first: bool = False  #: Whether F has the unit in effect before G20 or G21 of its block.
    turns_in_cycles: bool = True  #: Whether rotary words are allowed in a canned cycle.
    machine_axes: bool = False  #: Whether G53 means axis positions with tool-tip programming on.
    is_sure: bool = True  #: Whether ambiguous words have the meaning of this control.
    #: Readings of operators without brackets; the line is rejected if they differ in value.
    readings: tuple[Reading, ...] = (USUAL,)


LINUXCNC = Dialect(
    'linuxcnc',
    'LinuxCNC',
    own_entry=True,
    feeds_first=True,
    turns_in_cycles=False,
    readings=(READ_BY_LINUXCNC,),
)
FANUC = Dialect(
    'fanuc',
    'Fanuc and its kin',
    machine_axes=True,
    starts_with=0,
    readings=(READ_BY_FANUC, USUAL_OF_BITS),
)
SIEMENS = Dialect(
    'siemens',
    'Siemens 840D',
    starts_with=1,
    runs_shifts=True,
    readings=(READ_BY_SIEMENS, USUAL),
)
PLAIN = Dialect(
    'plain',
    'no control in particular',
    is_sure=False,
    readings=LINUXCNC.readings + FANUC.readings + SIEMENS.readings,
)
HEIDENHAIN = Dialect('heidenhain', 'Heidenhain', machine_axes=True)
PROFILES = {dialect.name: dialect for dialect in (PLAIN, LINUXCNC, FANUC, SIEMENS)}
_SUFFIXES = {
    '.ngc': LINUXCNC,
    '.mpf': SIEMENS,
    '.spf': SIEMENS,
    '.min': FANUC,
    '.eia': FANUC,
}

_WORDS = (
    (
        LINUXCNC,
        r'^\s*O\s*(?:\d+|<[^<>]+>|\[[^\]]+\]|#\S+)\s*(?:SUB|ENDSUB|CALL|IF|WHILE|DO|REPEAT)'
        r'\b|#<\w|\(\s*(?:DEBUG|PRINT|PROBEOPEN|LOGOPEN)\s*,|^\s*;\s*PY\s*,',
    ),
    (
        FANUC,
        r'^\s*[O:]\s*\d{4,8}\s*(?:\(|$)|\bG\s*54\.1\s*P|\bG0?5\.1\s*Q|\bG65\s*P|'
        r'^\s*(?:N\d+\s*)?WHILE\s*\[.*\]\s*DO\s*\d|\bGOTO\s*\d|\bIF\s*\[.*\]\s*(?:GOTO|THEN)|'
        r'#300[06]\s*=|\bG(?:154\s*P|187\b|43\.[45]\b|234\b|0?5\s*P\d+\b(?!\s*[QXYZIJ.])|0?8\s*P[01]\b)',
    ),
    (
        SIEMENS,
        r'\b(?:CYCLE\d+|MCALL|TRAORI|TRAFOOF|MSG|HOLES\d|POCKET\d|SLOT\d)\b\s*(?:\(|$)|'
        r'^\s*(?:N\d+\s*)?(?:DEF\s+(?:REAL|INT|BOOL|STRING|AXIS|CHAR)|PROC\s|A?TRANS\b|A?ROT\b|'
        r'EXTERN\s|FFWON|SUPA\b|G500\b|DIAMOF|STOPRE|ENDFOR|ENDWHILE|ENDIF|ENDLOOP|UNTIL\b)|'
        r'\bGOTO[FBC]\b|=\s*(?:A|I|D)C\s*\(|\bR\d+\s*=|^%_N_|;\s*\$PATH|\bD\d+\s+M0?6\b.*"',
    ),
)
_SIGNS = tuple((dialect, re.compile(words, re.I | re.M)) for dialect, words in _WORDS)
_COMMENT = re.compile(
    r'\((?!\s*(?:DEBUG|PRINT|PROBEOPEN|LOGOPEN)\s*,)[^()\n]*[a-z ][^()\n]*\)|'
    r';(?!\s*(?:PY|\$PATH))[^\n]*',
    re.I,
)

#: Lines with only words that all controls share; a mark replaces each to keep line numbers.
_COMMON = re.compile(
    r'^[ \t]*(?:(?:G\d\d?(?![\d.])|[A-FH-NR-Z][ \t]*[-+]?[\d.]+)[ \t\r]*)+$', re.M
)
_HEAD_LINES = 2000
#: Start of the first line with words, in each form.
_FORMS = {
    'heidenhain': re.compile(r'\s*(?:\d+\s+)?BEGIN\s+PGM\b', re.I),
    'cl': re.compile(
        r'\s*(?:(?:GOTO|FROM)\s*/?\s*[-+.\d]|(?:FEDRAT|LOADTL|MULTAX|PPWORD|SPINDL|'
        r'UNITS?|TOOL PATH)\s*/|(?:PARTNO|FINI)\b)',
        re.I,
    ),
    'poses': re.compile(r'\s*(?:(?=.*\bqw\b).*\bqx\b|(?:header|poses):\s*$)', re.I),
    'gcode': re.compile(r'\s*(?:/\s*)?(?:%|(?:N\s*\d+\s*)?[GMXYZ]\s*[-+]?\.?\d|:\d|O\d)', re.I),
}


def _head(source: Source) -> str:
    return source.lines(source.start).decode('utf-8', 'replace')


def _told_form(source: Source) -> str:
    for line in _head(source).splitlines()[:_HEAD_LINES]:
        if form := next((form for form, begins in _FORMS.items() if begins.match(line)), ''):
            return form
    return ''


def is_program(source: Source) -> bool:
    """Return whether a line begins like a program line, or has words of only one control."""
    text = _head(source)
    return bool(_told_form(source)) or any(sign.search(text) for _, sign in _SIGNS)


def form_of(source: Source) -> str:
    if form := _told_form(source):
        return form
    return 'cl' if Path(source.name).suffix.lower() in CL_SUFFIXES else 'gcode'


def as_on(geometry: Transform, settings: Settings) -> Settings:
    control = geometry.machine.control
    return replace(
        settings, **{k: v for k, v in control.items() if getattr(settings, k) == 'auto'}
    )


def dialect_of(source: Source, chosen: str) -> tuple[Dialect, str]:
    """Return the dialect of a G-code text, and the reason: the choice, its words or suffix."""
    if chosen != 'auto':
        return PROFILES[chosen], 'as chosen'
    text = _COMMON.sub('-', _COMMENT.sub(' ', _head(source)))
    found = [(dialect, sign.search(text)) for dialect, sign in _SIGNS]
    told = {
        dialect: f'{" ".join(match[0].split())} in line {1 + text.count(chr(10), 0, match.end())}'
        for dialect, match in found
        if match
    }
    if len(told) == 1:
        return next(iter(told.items()))
    if told:
        return PLAIN, f'it has words of several controls: {", ".join(told.values())}'
    suffix = Path(source.name).suffix.lower()
    if suffix in _SUFFIXES:
        return _SUFFIXES[suffix], f'by its suffix {suffix}'
    return PLAIN, 'no control is known; choose one by --dialect'
