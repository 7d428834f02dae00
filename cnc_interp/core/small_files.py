"""User files: check which may be opened, read them within limits, and write them atomically."""

import json
import os
import resource
import shutil
import stat
import sys
from collections.abc import Sequence
from io import BufferedReader
from math import isfinite
from pathlib import Path
from typing import Any

import yaml

from cnc_interp.core import InterpError


def require_inside(path: Path, folders: Sequence[str]) -> Path:
    """Return the real path of a file that is allowed or in an allowed folder; else InterpError.

    Links are resolved first. Outside the folders the error does not reveal whether the file
    exists, and nothing of it is read.
    """
    real = Path(os.path.realpath(path))
    if not any(real.is_relative_to(os.path.realpath(folder)) for folder in folders if folder):
        raise InterpError(
            f'{path}: no file of a folder that the node may read; start it with program_folders, '
            'or send the text of the program'
        )
    return real


def require_allowed(path: Path, folders: Sequence[str]) -> Path:
    """Return the real path of an allowed regular file; raises as ``require_inside`` does.

    Devices and pipes are rejected, because opening one may block forever or have side effects.
    """
    real = require_inside(path, folders)
    try:
        regular = stat.S_ISREG(real.stat().st_mode)
    except OSError as problem:
        raise InterpError(f'{path}: cannot be opened: {problem.strerror}') from None
    if not regular:
        raise InterpError(f'{path}: it is not a file; name a file with a part program')
    return real


def open_named(path: Path, folders: Sequence[str] | None) -> BufferedReader:
    """Open a file for reading; raises OSError, and InterpError as ``require_allowed`` does.

    None means that the user of this process named the file: anything readable is allowed then,
    pipes included.
    """
    if folders is None:
        return path.open('rb')
    real = require_allowed(path, folders)
    # Whoever swaps the file for a link or a pipe in between meets the same decision again.
    descriptor = os.open(real, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        require_allowed(Path(f'/proc/self/fd/{descriptor}').readlink(), folders)
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise InterpError(f'{path}: it is not a file; name a file with a part program')
        return os.fdopen(descriptor, 'rb')
    except BaseException:
        os.close(descriptor)
        raise


#: Longest YAML and JSON file [bytes], and how deep its values may be nested.
LONGEST_YAML, LONGEST_JSON, DEEPEST = 1 << 17, 1 << 24, 20
#: Largest whole number.
LARGEST = 1 << 63
_LOADER = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)


class UnreadableError(ValueError):
    """A file cannot be read; the message says why in a few words."""


def small_text(path: Path, longest: int) -> str:
    """Return the text of a file below the size limit; raises OSError or UnreadableError."""
    path.stat()
    if not path.is_file():
        raise UnreadableError('it is not a file')
    with path.open('rb') as file:
        content = file.read(longest + 1)
    if len(content) > longest:
        raise UnreadableError(f'it is longer than {longest >> 10} kB')
    try:
        return content.decode('utf-8')
    except UnicodeDecodeError as problem:
        raise UnreadableError(f'it is not UTF-8 text: {problem.reason}') from None


def _checked(content: Any) -> Any:
    """Return the content of a file; reject numbers that no float can hold."""
    waiting = [content]
    while waiting:
        value = waiting.pop()
        if isinstance(value, int) and abs(value) > LARGEST:
            raise UnreadableError('a whole number is too large')
        if isinstance(value, dict):
            waiting += [*value.keys(), *value.values()]
        elif isinstance(value, list):
            waiting += value
    return content


def read_yaml(path: Path) -> Any:
    """Return a small YAML file, without references (``*x``); raises OSError, UnreadableError."""
    return parse_yaml(small_text(path, LONGEST_YAML))


def parse_yaml(text: str) -> Any:
    """Return the content of a short YAML text; raises as ``read_yaml``."""
    depth = 0
    try:
        for event in yaml.parse(text, Loader=_LOADER):
            if isinstance(event, yaml.AliasEvent):
                raise UnreadableError(f'*{event.anchor}: write the value out')
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > DEEPEST:
                raise UnreadableError(f'values are nested more than {DEEPEST} deep')
        return _checked(yaml.load(text, Loader=_LOADER))
    except (yaml.YAMLError, ValueError) as problem:
        raise UnreadableError(' '.join(str(problem).split())[:200]) from None


def is_number(value: Any) -> bool:
    """Return whether a value of such a file is a finite number; booleans are not numbers."""
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)


def read_json(path: Path) -> Any:
    """Return the content of a small JSON file; raises as ``read_yaml``."""
    text = small_text(path, LONGEST_JSON)
    try:
        return _checked(json.loads(text))
    except RecursionError:
        raise UnreadableError('values are nested too deep') from None
    except ValueError as problem:
        raise UnreadableError(f'it is not JSON: {problem}'[:200]) from None


def write_whole(path: Path, text: str) -> None:
    """Replace a small file atomically; if OSError is raised, the old file remains."""
    path = path.resolve()  # a link stays one
    beside = path.with_name(f'.{path.name}.new')
    with beside.open('w', encoding='utf-8') as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    if path.exists():
        shutil.copymode(path, beside)
    beside.replace(path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)  # the new name is on the disk, too
    finally:
        os.close(folder)


#: Memory allowed to a reader: ROOM [bytes] plus TIMES the length of its files.
ROOM, TIMES = 1 << 30, 30
_KINDS = (resource.RLIMIT_DATA, resource.RLIMIT_FSIZE)


class BoundedMemory:
    """Limits memory and written files of this process until ``lift``; ``room``: extra [bytes]."""

    def __init__(self, *files: Path, room: int = ROOM):
        room += TIMES * sum(file.stat().st_size for file in files)
        pages = Path('/proc/self/statm').read_text(encoding='ascii').split()
        used = int(pages[5]) * resource.getpagesize()
        self._before = [resource.getrlimit(kind) for kind in _KINDS]
        for kind, limits, most in zip(_KINDS, self._before, (used + room, room), strict=True):
            known = [limit for limit in limits if limit != resource.RLIM_INFINITY]
            resource.setrlimit(kind, (min([most, *known]), limits[1]))

    def lift(self) -> None:
        for kind, limits in zip(_KINDS, self._before, strict=True):
            resource.setrlimit(kind, limits)


def share_directory(package: str) -> Path:
    """Return the data folder of a package, installed by pip or ROS; LookupError if missing."""
    beside_python = Path(sys.prefix, 'share', package)  # installed by pip, also without ROS
    if 'AMENT_PREFIX_PATH' not in os.environ and beside_python.is_dir():
        return beside_python
    from ament_index_python.packages import get_package_share_directory

    os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
    return Path(get_package_share_directory(package))


def state_folder() -> Path:
    """Return the folder in which the programs of this package keep what a user did with them."""
    state = os.environ.get('XDG_STATE_HOME') or Path.home() / '.local' / 'state'
    return Path(state) / 'cnc_interp'


def config_directory() -> Path:
    """Return the folder ``config``: beside the package, or in the ROS share."""
    source = Path(__file__).resolve().parents[2] / 'config'
    return source if source.is_dir() else share_directory('cnc_interp') / 'config'
