"""The folder of programs that pages list, open and save, and the recently opened programs."""

import time
from dataclasses import dataclass
from pathlib import Path

from cnc_interp.core import InterpError
from cnc_interp.core.small_files import state_folder, write_whole

SUFFIXES = frozenset(
    {
        *('.ngc', '.nc', '.tap', '.cnc', '.gcode', '.g', '.eia', '.ptp', '.min', '.txt'),
        *('.mpf', '.spf', '.h', '.i', '.cls', '.apt'),
    }
)
MOST_LISTED, MOST_RECENT = 500, 10
LONGEST_PROGRAM = 64 << 20  #: Largest program accepted from a browser [bytes].
LONGEST_EDITED = 500_000  #: Longest program that can be edited on a page [characters].


@dataclass(frozen=True)
class Listed:
    name: str  #: Its path below the folder.
    size: int  #: [bytes]
    changed: float  #: Time of its last change, in seconds since the epoch.

    def text(self) -> str:
        size = f'{self.size} B' if self.size < 2000 else f'{self.size / 1e3:.0f} kB'
        return f'{size}, {time.strftime("%Y-%m-%d %H:%M", time.localtime(self.changed))}'


def program_text(path: Path, name: str) -> str:
    """Read a program; errors (InterpError) refer to it by ``name``."""
    try:
        with path.open('rb') as file:
            content = file.read(LONGEST_PROGRAM + 1)
    except OSError as problem:
        raise InterpError(f'{name}: cannot be opened: {problem.strerror}') from None
    if len(content) > LONGEST_PROGRAM:
        raise InterpError(f'{name}: longer than {LONGEST_PROGRAM >> 20} MB; use cnc-interp run')
    return content.decode('utf-8-sig', errors='replace')


class ProgramFolder:
    """Programs below one folder; a page cannot access files outside it."""

    def __init__(self, folder: Path):
        self.folder = folder.resolve()
        self._kept = state_folder() / 'recent_programs'

    def listed(self) -> list[Listed]:
        """Return the programs of the folder and its subfolders, the latest change first."""
        found = []
        for path in self.folder.rglob('*'):
            hidden = any(part.startswith('.') for part in path.relative_to(self.folder).parts)
            if path.suffix.lower() in SUFFIXES and not hidden and path.is_file():
                status = path.stat()
                name = path.relative_to(self.folder).as_posix()
                found.append(Listed(name, status.st_size, status.st_mtime))
        return sorted(found, key=lambda one: -one.changed)[:MOST_LISTED]

    def recent(self) -> list[str]:
        """Return the names of recently opened programs that still exist, the latest first."""
        try:
            lines = self._kept.read_text(encoding='utf-8').splitlines()
        except (OSError, UnicodeDecodeError):
            return []
        inside = (Path(line) for line in lines if line.startswith(f'{self.folder}/'))
        return [path.relative_to(self.folder).as_posix() for path in inside if path.is_file()]

    def opened(self, name: str) -> None:
        path = str(self._path(name))
        try:
            lines = self._kept.read_text(encoding='utf-8').splitlines()
        except (OSError, UnicodeDecodeError):
            lines = []
        lines = [path, *(line for line in lines if line != path)][:MOST_RECENT]
        try:
            self._kept.parent.mkdir(parents=True, exist_ok=True)
            write_whole(self._kept, '\n'.join(lines) + '\n')
        except OSError:
            return  # a list for comfort; the program is open all the same

    def read(self, name: str) -> str:
        return program_text(self._path(name), name)

    def save(self, name: str, text: str) -> None:
        path = self._path(name)
        if path.suffix.lower() not in SUFFIXES:
            raise InterpError(f'{name}: end the name of a program with one of .ngc, .nc, .mpf, .h')
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, text)
        except OSError as problem:
            raise InterpError(f'{name}: cannot be written: {problem.strerror}') from None

    def _path(self, name: str) -> Path:
        path = (self.folder / name).resolve()
        if not name.strip() or not path.is_relative_to(self.folder) or path == self.folder:
            raise InterpError(f'{name or "no name"}: give a name below {self.folder}')
        return path
