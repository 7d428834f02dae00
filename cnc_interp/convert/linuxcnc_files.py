"""The files of a LinuxCNC configuration: an INI file with its includes, and its HAL files."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np

from cnc_interp.core import DEG, INCH, MM, FloatArray, InterpError, MachineError
from cnc_interp.machine_model.demands import demand

HAL_LIBRARY = Path('/usr/share/linuxcnc/hallib')  #: HAL files of LinuxCNC itself.
DEEPEST = 8  #: Largest depth of files that include each other.
#: Names of units in ``[TRAJ]`` [m, rad].
UNITS = {
    'mm': MM,
    'metric': MM,
    'inch': INCH,
    'in': INCH,
    'imperial': INCH,
    'deg': DEG,
    'degree': DEG,
    'rad': 1.0,
    'radian': 1.0,
    'grad': 0.9 * DEG,
    'gon': 0.9 * DEG,
}
Sections = dict[str, list[tuple[str, str]]]


@dataclass(frozen=True)
class Ini:
    path: Path
    sections: Sections  #: Keys and values; keys may repeat.

    def all(self, section: str, key: str) -> list[str]:
        return [value for name, value in self.sections.get(section, ()) if name == key]

    def get(self, section: str, key: str, usual: str = '') -> str:
        """Return a value without its comment; as in LinuxCNC the first of repeated keys counts."""
        text = next(iter(self.all(section, key)), usual)
        return text.partition('#')[0].partition(';')[0].strip()

    @property
    def kinematics(self) -> list[str]:
        """The kinematics module and its parameters."""
        text = self.get('KINS', 'KINEMATICS')
        demand(text, 'no KINEMATICS in [KINS]; give the INI file of LinuxCNC 2.8 or later')
        return text.split()

    @property
    def joints(self) -> str:
        """The axis letters of the joints, in order."""
        words = self.kinematics[1:]
        given = next((w.partition('=')[2] for w in words if w.startswith('coordinates=')), '')
        return (given or self.get('TRAJ', 'COORDINATES')).replace(' ', '').upper()

    def unit(self, key: str, usual: str) -> float:
        text = self.get('TRAJ', key, usual)
        if text.lower() in UNITS:
            return UNITS[text.lower()]
        with suppress(ValueError):  # a number counts the units in a millimetre or degree
            if float(text) > 0.0:
                return UNITS[usual] / float(text)
        raise MachineError(f'{text!r} is no unit; known: {", ".join(UNITS)}', f'[TRAJ]{key}')


def number(text: str, letter: str, key: str) -> float:
    try:
        value = float(text.split('#')[0].split(';')[0])
    except ValueError:
        value = float('nan')
    demand(isfinite(value), f'must be a number, not {text!r}', f'{key} of {letter}')
    return value


def comp_file(path: Path) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the columns of a COMP_FILE: nominal, forward and reverse. Raises MachineError."""
    rows = [line.split() for line in map(str.strip, _text(path).splitlines()) if line]
    rows = [row[:3] for row in rows if row[0][0] in '+-.0123456789']
    demand(len(rows) > 1 and all(len(row) == 3 for row in rows), f'{path.name} has no such rows')
    table = np.array([[number(text, path.name, 'a row') for text in row] for row in rows])
    return table[:, 0], table[:, 1], table[:, 2]


def read_ini(path: Path) -> Ini:
    """Read an INI file; comments are lines of their own. Raises MachineError."""
    found: Sections = {}
    section = ''
    for line in _lines(path, path.parent, DEEPEST):
        if line[:1] == '[':
            section = line[1:].partition(']')[0].strip().upper()
        elif line[:1] not in ('', '#', ';') and '=' in line:
            key, _, value = line.partition('=')
            found.setdefault(section, []).append((key.strip().upper(), value.strip()))
    return Ini(path, found)


def _lines(path: Path, folder: Path, deepest: int) -> Iterator[str]:
    for line in map(str.strip, _text(path).splitlines()):
        if line.startswith('#INCLUDE') and deepest:
            name = line.removeprefix('#INCLUDE').strip()
            yield from _lines(folder / Path(name).expanduser(), folder, deepest - 1)
        else:
            yield line


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding='utf-8', errors='replace')
    except OSError as problem:
        raise MachineError(f'{path}: cannot be opened: {problem.strerror}') from None


def hal_lines(files: Sequence[Path], ini: Ini | None) -> list[str]:
    """Return the lines of HAL files, and of the HAL files named by an INI file in ``files``.

    Continued lines are joined, and ``source`` lines included. Raises InterpError for files in Tcl.
    """
    lines: list[str] = []
    for file in files:
        if ini is None or file != ini.path:
            lines += _hal(Path(file.name), file.parent, DEEPEST)
            continue
        for name in filter(None, ini.all('HAL', 'HALFILE')):
            lines += _hal(Path(name.split()[0]), file.parent, DEEPEST)
        lines += ini.all('HAL', 'HALCMD')
    return lines


def _hal(file: Path, folder: Path, deepest: int) -> Iterator[str]:
    if file.suffix == '.tcl':
        raise InterpError(f'{file}: is Tcl, which is not read; give HAL files that do the same')
    path, own = folder / file.expanduser(), HAL_LIBRARY / file.name.removeprefix('LIB:')
    path = own if own.is_file() and not path.exists() else path
    for line in _text(path).replace('\\\n', ' ').splitlines():
        words = line.partition('#')[0].split()
        if words[:1] == ['source'] and len(words) > 1 and deepest:
            yield from _hal(Path(words[1]), folder, deepest - 1)
        else:
            yield line
