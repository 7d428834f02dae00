"""LinuxCNC's interpreter (``rs274``) as the second reader of G-code, where it is installed.

rs274 prints the calls to the machine with four decimals, and runs in a process with limits.
Comments are removed first, because rs274 executes some of them as Python code.
"""

from __future__ import annotations

import os
import re
import resource
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.core import DEG, MM, FloatArray, InterpError
from cnc_interp.core.small_files import UnreadableError, parse_yaml
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.proof.plain_reader import DWELL, PLANES, TCP_OFF, TCP_ON, ReadCall, ReadMove

LAST_DIGIT = 1e-4  #: Value of the last printed digit, in the unit of the program.
LEAST_FEED = 0.1  #: Lowest feed that rs274 prints for G93 [program units/min].
#: Processor time [s], and more per MB of the text [s]; memory and length of written files [bytes].
SECONDS, SECONDS_PER_MB, MEMORY, FILES = 8, 2, 1 << 30, 1 << 26
#: Largest number of printed lines: BESIDE, plus EACH per row of the plan and per line of the text.
BESIDE, EACH = 1000, 20
#: Comments, and words of other controls that LinuxCNC rejects and that move nothing.
_COMMENT = re.compile(r'\([^()\n]*\)|;[^\n]*')
_LEFT_OUT = re.compile(r'(?<=M6 )D\d+ H\d+|^D\d+$|G04F\d+|M29S\d+', re.MULTILINE | re.IGNORECASE)
#: Switches of the tool-tip control become comments, which are printed.
_SWITCH = re.compile(r'(?<![A-Z<_])(M(?:128|129|428|429))(?!\d)', re.IGNORECASE)
_BLANK = re.compile(r'^[ \t]*/.*', re.MULTILINE)
_SLASH = re.compile(r'^[ \t]*/', re.MULTILINE)
_CALL = re.compile(r'^\s*\d+\s+N(?:\.+|\d+)\s*([A-Z]\w*)\((.*)\)\s*$')
#: The text begins after a percent sign, which must remain the first line. G98 is inserted there.
_FIRST = re.compile(r'\A(\s*%[^\n]*\n)?')
_NUMBER = re.compile(r'-?\d+\.?\d*')
#: A tool change in its line, and the label of a subprogram.
_CHANGE = re.compile(
    r'^(.*?)(?<![A-Z<_])M[ \t]*0*6(?![\d.])[ \t]*(T[ \t]*[\d#\[\]]+)?(.*)$',
    re.MULTILINE | re.IGNORECASE,
)
_INCHES = re.compile(r'G\s*20(?!\d)', re.IGNORECASE)
_PLACE = re.compile(r'#\s*(5[123]\d[123])(?!\d)')  #: Parameter of a stored X, Y or Z.
_LABEL = re.compile(r'O\s*(\d+|<[^<>]+>)\s*SUB', re.IGNORECASE)
_PLANES = {'XY': PLANES['17'], 'XZ': PLANES['18'], 'YZ': PLANES['19']}
#: Words, outside comments, that cannot be compared, and why. Each pattern begins at its letter:
#: one that begins at a line start would scan the rest of the text from every line.
_NOT_COMPARED = tuple(
    (re.compile(pattern, re.IGNORECASE), why)
    for pattern, why in (
        (
            r'(?<![A-Z<_])(?:G[ \t]*0*4[12]\.2(?!\d)|CUT3DF)',
            'LinuxCNC has no compensation along normals',
        ),
        (
            r'(?<![A-Z<_])G[ \t]*0*4[12](?!\d)',
            'LinuxCNC begins a compensated contour at another place',
        ),
        (r'(?<![A-Z<_])M[ \t]*0*61(?!\d)', "LinuxCNC's rs274 by itself loads no tool by M61"),
        (
            r'#\s*50(?:6\d|70)',
            "LinuxCNC's rs274 lets the probe answer before the end of its line",
        ),
        (
            r'#\s*5(?:1[68]|21|2[2-9]|3[0-8])[1-9](?!\d)',
            "LinuxCNC's rs274 has the places #5161 to #5389 in inches",
        ),
        (
            r'#\s*(?:4\d{3}|50[0-4]\d|508\d)(?!\d)',
            'LinuxCNC has no modal words and places of Fanuc (#4001 to #5083)',
        ),
    )
)


class LinuxCNCError(InterpError):
    """LinuxCNC is not installed, or cannot read the program to its end."""


def interpreter() -> str:
    found = os.environ.get('RS274') or shutil.which('rs274') or ''
    return found if Path(found).is_file() else ''


def read_by_linuxcnc(
    text: str,
    axis_names: tuple[str, ...],
    skip: bool,
    rows: int,
    setup: Setup | None = None,
) -> Iterator[ReadMove | ReadCall]:
    command = interpreter()
    if not command:
        raise LinuxCNCError("LinuxCNC's rs274 is not installed")
    if not set(axis_names) <= set('XYZABC'):
        raise LinuxCNCError("LinuxCNC's rs274 prints no extra axes")
    setup = setup or Setup()
    text = _prepared(text, skip, setup)
    if why := next((why for pattern, why in _NOT_COMPARED if pattern.search(text)), ''):
        raise LinuxCNCError(why)
    most = BESIDE + EACH * (rows + text.count('\n'))
    seconds = SECONDS + SECONDS_PER_MB * (len(text) >> 20)

    def bound() -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        resource.setrlimit(resource.RLIMIT_FSIZE, (FILES, FILES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))

    with tempfile.TemporaryDirectory(prefix='cnc_interp_') as name:
        folder = Path(name)
        lengths = dict.fromkeys(range(1, 100), 0.0) | dict(setup.tool_lengths)
        table = ''.join(f'T{n} P{n} Z{length / MM / 25.4:.9f}\n' for n, length in lengths.items())
        variables = ''.join(f'{n} {v:.9f}\n' for n, v in sorted(setup.parameters.items()))
        for file, content in (('tool.tbl', table), ('part.ngc', text), ('p.var', variables)):
            (folder / file).write_text(content, encoding='utf-8')
        words = [command, '-t', 'tool.tbl', '-v', 'p.var', '-g', 'part.ngc']
        # It keeps the tool table in a file of its home, which concurrent readers would share.
        with (
            (folder / 'complaints').open('w+b') as complaints,
            subprocess.Popen(
                words,
                cwd=folder,
                env=os.environ | {'HOME': name},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=complaints,
                text=True,
                errors='replace',
                preexec_fn=bound,
            ) as child,
        ):
            assert child.stdout is not None
            try:
                for each in _moves(child.stdout, axis_names, most):
                    yield each if isinstance(each, ReadCall) else _from_zero(each, setup.zero)
            finally:
                child.kill()
            child.wait()
            complaints.seek(0)
            _demand_end(complaints.read(4000).decode('utf-8', errors='replace'), child.returncode)


def _demand_end(said: str, code: int) -> None:
    lines = [line.strip() for line in said.splitlines() if line.strip() not in ('', 'executing')]
    if code < 0:
        lines = ['it takes too long' if code == -signal.SIGXCPU else f'it ended by signal {-code}']
    if lines or code:
        raise LinuxCNCError(f"LinuxCNC's rs274 cannot read it: {' '.join(lines)[:100]}")


def _from_zero(move: ReadMove, zero: FloatArray) -> ReadMove:
    """Convert a motion from machine coordinates to coordinates from the workpiece zero."""
    centre = None if move.centre is None else move.centre - zero[list(move.plane[:2])]
    return replace(move, end=move.end - zero, centre=centre)


def _prepared(text: str, skip: bool, setup: Setup) -> str:
    """Return the text for rs274; a first line moves the tool to the workpiece zero."""
    text = (_BLANK if skip else _SLASH).sub('', _COMMENT.sub(' ', text.replace('\r', '')))
    if '(' in text or ';' in text or ')' in text:
        raise LinuxCNCError("LinuxCNC's rs274 does not read a comment within a comment")
    text = _SWITCH.sub(lambda word: f'({word[1].upper()})', _LEFT_OUT.sub('', text))
    stands = 'G98\nG53 G0 X{:.9f} Y{:.9f} Z{:.9f}\nG80\n'.format(*(setup.zero / MM))
    stands += f'T{setup.tool} M6\n' if setup.tool else ''
    if setup.macro and _CHANGE.search(text):
        macro = _COMMENT.sub(' ', setup.macro.replace('\r', ''))
        if not _INCHES.search(macro):
            macro = _PLACE.sub(lambda word: _in_mm(int(word[1]), setup), macro)
        label = _LABEL.search(macro) or _LABEL.search('O<macro> SUB')
        assert label is not None
        if label[0] not in macro:
            macro = f'{label[0]}\n{macro}\nO{label[1]} ENDSUB\n'
        stands += macro + '\n'
        calls = rf'\1\2\nO{label[1]} CALL\n\3'  # the tool of the line is selected before
        text = _CHANGE.sub(calls, text)
    return _FIRST.sub(lambda first: (first[1] or '') + stands, f'{text}\nM2\n', count=1)


def _in_mm(parameter: int, setup: Setup) -> str:
    return f'[{setup.parameters.get(parameter, 0.0) * INCH:.9f}]'


def _moves(
    printed: Iterable[str], axis_names: tuple[str, ...], most: int
) -> Iterator[ReadMove | ReadCall]:
    columns = ['ABC'.index(name) for name in axis_names[3:]]
    state = _Printed()
    for number, line in enumerate(printed):
        if number == most:
            raise LinuxCNCError("LinuxCNC's rs274 prints more than a plan of this length")
        call = _CALL.match(line)
        if call is None:
            continue
        move = state.take(call[1], call[2])
        if isinstance(move, ReadCall):
            yield move
        elif move is not None:
            unused = np.delete(state.here[3:], columns)
            if unused.any():
                raise LinuxCNCError("LinuxCNC's rs274 turns an axis that is not there")
            yield replace(move, rotary=move.rotary[columns])


#: Printed calls and their words. rs274 prints every function of the words in ``KNOWN_CALLS``.
_CALLS = {
    'SET_SPINDLE_SPEED': 'S',
    'START_SPINDLE_CLOCKWISE': 'M3',
    'START_SPINDLE_COUNTERCLOCKWISE': 'M4',
    'DWELL': 'G4',
    'PROGRAM_STOP': 'M0',
    'OPTIONAL_PROGRAM_STOP': 'M1',
}
KNOWN_CALLS = ('S', 'M3', 'M4', 'G4')


class _Printed:
    """Modal state while the printed calls are followed; lengths in m, angles in rad."""

    def __init__(self) -> None:
        self.unit, self.plane, self.tcp = MM, PLANES['17'], False
        self.digit = LAST_DIGIT * MM  # of the coarsest unit so far, which offsets may still have
        self.feed, self.mode, self.spindle = float('nan'), 'G94', 0.0
        self.offsets = {name: np.zeros(6) for name in ('G5X', 'G92', 'TOOL')}
        self.turn = np.eye(6)  # of the work offset
        self.here = np.zeros(6)
        self.tolerance, self.worded, self.lengthened = float('nan'), False, False
        self.number = float('nan')  # of the tolerance, as printed

    def take(self, name: str, text: str) -> ReadMove | ReadCall | None:
        numbers = [float(word) for word in _NUMBER.findall(text)]
        if name in _CALLS:
            given: dict[str, tuple[float, ...]] = {}
            if name == 'SET_SPINDLE_SPEED':
                self.spindle = numbers[-1]
                given = {'S': (self.spindle,)}
            elif name == 'DWELL':
                given = {DWELL: tuple(numbers)}
            return ReadCall(0, _CALLS[name], given)
        if name == 'NURBS_FEED':
            raise LinuxCNCError("LinuxCNC's rs274 prints no points of splines")
        if name in ('STRAIGHT_TRAVERSE', 'STRAIGHT_FEED', 'STRAIGHT_PROBE'):
            return self.move(name == 'STRAIGHT_TRAVERSE', self.absolute(numbers[:6]))
        if name == 'ARC_FEED':
            return self.arc(numbers)
        if name == 'USE_LENGTH_UNITS':
            before, self.unit = self.unit, 25.4 * MM if 'INCHES' in text else MM
            self.digit = max(self.digit, LAST_DIGIT * self.unit)
            if self.unit != before and self.offsets['TOOL'].any():
                raise LinuxCNCError("LinuxCNC's rs274 keeps a tool length in the previous unit")
        elif name == 'SELECT_PLANE':
            self.plane = _PLANES[text[-2:]]
        elif name == 'SET_FEED_RATE':
            self.feed = numbers[0] * self.unit / 60.0
        elif name in ('START_SPEED_FEED_SYNC', 'RIGID_TAP'):
            raise LinuxCNCError("threads of LinuxCNC's rs274 are not compared")
        elif name == 'SET_FEED_MODE':
            self.mode = 'G95' if numbers[-1] else 'G94' if self.mode == 'G95' else self.mode
        elif name == 'COMMENT' and 'feed mode set to' in text:
            self.mode = 'G93' if 'inverse' in text else 'G94'
        elif name == 'COMMENT':
            self.switch(text.strip('"'))
        elif name in ('SET_G5X_OFFSET', 'SET_G92_OFFSET', 'USE_TOOL_LENGTH_OFFSET'):
            kind = name.removesuffix('_OFFSET').split('_')[-1].replace('LENGTH', 'TOOL')
            self.offsets[kind] = self.sized(numbers[name == 'SET_G5X_OFFSET' :][:6])
            self.lengthened = self.lengthened or bool(self.offsets['TOOL'].any())
        elif name == 'CHANGE_TOOL' and self.lengthened:
            raise LinuxCNCError("LinuxCNC's rs274 forgets a length at a tool change before motion")
        elif name == 'SET_MOTION_CONTROL_MODE' and numbers and numbers[0] != self.number:
            # After a cycle the same number is printed again, even if the unit has changed.
            self.number, self.tolerance = numbers[0], numbers[0] * self.unit or float('nan')
        elif name == 'SET_XY_ROTATION':
            c, s = np.cos(numbers[0] * DEG), np.sin(numbers[0] * DEG)
            self.turn[:2, :2] = (c, -s), (s, c)
        return None

    def switch(self, word: str) -> None:
        if word not in (*TCP_ON, *TCP_OFF):
            return
        if self.here[3:].any() and self.tcp is not (word in TCP_ON):
            # X Y Z change their meaning, and LinuxCNC does not know where they are then.
            raise LinuxCNCError(f"LinuxCNC's rs274 does not know {word} at a turned axis")
        self.tcp = word in TCP_ON

    def sized(self, numbers: list[float]) -> FloatArray:
        return np.asarray(np.array(numbers) * np.repeat([self.unit, DEG], 3))

    def absolute(self, numbers: list[float]) -> FloatArray:
        work, g92, tool = self.offsets.values()
        return np.asarray(self.turn @ (self.sized(numbers) + g92) + work + tool)

    def move(
        self, rapid: bool, end: FloatArray, centre: FloatArray | None = None, turns: int = 0
    ) -> ReadMove:
        before, self.here, self.lengthened = self.here, end, False
        feed, duration, unsure, digit = float('nan'), float('nan'), 0.0, self.digit
        if not rapid and self.mode == 'G94':
            feed, unsure = self.feed, digit / 60.0 / self.feed
        elif not rapid and self.mode == 'G95':
            feed, unsure = self.feed * self.spindle, digit / 60.0 / self.feed
        elif not rapid and not turns:
            # It prints length / duration: of the line of X Y Z, or of A B C in deg if that is 0.
            line = float(np.linalg.norm(end[:3] - before[:3]))
            line = line or float(np.linalg.norm(end[3:] - before[3:])) / DEG * self.unit
            if line:
                duration, unsure = line / self.feed, digit * (2.0 / line + 1.0 / 60.0 / self.feed)
            if self.feed <= LEAST_FEED * self.unit / 60.0:
                unsure = float('inf')  # the block may take longer than it prints
        sweep = (turns > 0) - (turns < 0)
        self.worded = self.worded or bool(end[3:].any())
        return ReadMove(
            0,
            rapid,
            end[:3],
            end[3:],
            None,
            np.zeros(0),
            feed,
            duration,
            self.tcp,
            self.plane,
            centre,
            sweep,
            max(abs(turns), 1),
            digit,
            unsure,
            self.tolerance,
            self.tolerance,
            turn_feed=self.feed / self.unit * DEG * (self.spindle if self.mode == 'G95' else 1.0),
            worded=self.worded,  # exact stops are not compared: canned cycles set and reset them
        )

    def arc(self, numbers: list[float]) -> ReadMove:
        a, b, across = self.plane
        end = np.zeros(6)
        end[[a, b, across]] = numbers[0], numbers[1], numbers[5]
        end[3:] = numbers[6:9]
        if across != 2 and self.turn[0, 1]:
            raise LinuxCNCError('arcs of G18 and G19 in a turned offset are not compared')
        place = end.copy()
        place[[a, b]] = numbers[2:4]
        centre = self.absolute(list(place))[[a, b]]
        return self.move(False, self.absolute(list(end)), centre, int(numbers[4]))


OFFSETS = ('G54', 'G55', 'G56', 'G57', 'G58', 'G59', 'G59.1', 'G59.2', 'G59.3')
#: First parameter number of each position, and the unit of LinuxCNC's files [mm].
G28, G30, G92_ON, ACTIVE, G54, BETWEEN, INCH = 5160, 5180, 5210, 5220, 5220, 20, 25.4
ROTATION = 10  #: Offset from the first parameter of a work offset to its rotation.


@dataclass(frozen=True)
class Setup:
    parameters: Mapping[int, float] = field(default_factory=dict)  #: By number [inch, deg].
    tool_lengths: Mapping[int, float] = field(default_factory=dict)  #: By their numbers [m].
    tool: int = 0  #: Tool in the spindle; 0 if it is empty.
    #: (3,): Machine coordinates of the workpiece zero, the origin of all motions [m].
    zero: FloatArray = field(default_factory=lambda: np.zeros(3))
    macro: str = ''  #: Text of the subprogram that the machine calls at M6.


def cutters_of(text: Any) -> dict[int, tuple[float, float, float]] | None:
    """Return radius, corner radius (NaN if unknown) and length of the tools of a setup [m].

    Return None if the setup holds more than a tool table.
    """
    if not text:
        return {}
    try:
        content = parse_yaml(str(text)) or {}
        tools = content.get('tools', {})
        if set(content) - {'tools', 'tool'}:
            return None
        found: dict[int, tuple[float, float, float]] = {}
        for number, tool in tools.items():
            corner = float(tool.get('corner_radius', 'nan')) * MM
            found[int(number)] = _worn(tool, 'radius') * MM, corner, _worn(tool, 'length') * MM
        return found
    except (UnreadableError, AttributeError, KeyError, TypeError, ValueError) as problem:
        raise InterpError(f'summary.json: its setup cannot be read: {problem}') from None


def _worn(tool: Mapping[str, Any], size: str) -> float:
    return float(tool.get(size, 0.0)) + float(tool.get(f'{size}_wear', 0.0))


def setup_of(text: Any, machine: Machine) -> Setup:
    zero = Transform.of(machine).linear(np.zeros((1, 3)), np.zeros((1, 2)))[0]
    at_zero = dict(zip('XYZ', (zero / MM).tolist(), strict=True))
    try:
        content = (parse_yaml(str(text)) if text else None) or {}
        offsets, points = content.get('work_offsets', {}), content.get('reference_points', {})
        places = {
            G54 + BETWEEN * i: at_zero | offsets.get(name, {}) for i, name in enumerate(OFFSETS)
        }
        places |= {G28: points.get('G28', {}), G30: points.get('G30', {})}
        places[G92_ON] = content.get('g92', {})
        parameters: dict[int, float] = {}
        for first, given in places.items():
            for i, letter in enumerate('XYZABC'):
                if letter in given:
                    size = INCH if letter in 'XYZ' else 1.0
                    parameters[first + 1 + i] = given[letter] / size
            if 'R' in given:
                parameters[first + ROTATION] = given['R']
        parameters[G92_ON] = float(content.get('g92_on', bool(content.get('g92'))))
        parameters[ACTIVE] = 1.0 + OFFSETS.index(content.get('active') or OFFSETS[0])
        lengths = {
            int(n): _worn(tool, 'length') * MM for n, tool in content.get('tools', {}).items()
        }
        tool, macro = int(content.get('tool', 0)), machine.tool_change_macro
        return Setup(parameters, lengths, tool, zero, macro)
    except (UnreadableError, AttributeError, KeyError, TypeError, ValueError) as problem:
        raise InterpError(f'summary.json: its setup cannot be read: {problem}') from None
