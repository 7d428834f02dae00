"""Files that a goal or a program names: what may be opened is decided here, and here alone.

A path counts as what it is after all links. Outside the allowed folders the answer is the same
whether or not there is such a file, and nothing of it is read. Devices and pipes are never opened:
opening one may wait for ever, or do something.
"""

import os
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

from cnc_interp.core import InterpError


def require_inside(path: Path, folders: Sequence[str]) -> Path:
    """Return the real path of one of some files, or of what is in a folder; else InterpError."""
    real = Path(os.path.realpath(path))
    if not any(real.is_relative_to(os.path.realpath(folder)) for folder in folders if folder):
        raise InterpError(
            f'{path}: no file of a folder that the node may read; start it with program_folders, '
            'or send the text of the program'
        )
    return real


def require_allowed(path: Path, folders: Sequence[str]) -> Path:
    """Return the real path of a regular file; raises as ``require_inside``, and for others."""
    real = require_inside(path, folders)
    try:
        regular = stat.S_ISREG(real.stat().st_mode)
    except OSError as problem:
        raise InterpError(f'{path}: cannot be opened: {problem.strerror}') from None
    if not regular:
        raise InterpError(f'{path}: it is not a file; name a file with a part program')
    return real


def open_named(path: Path, folders: Sequence[str] | None) -> BinaryIO:
    """Open a file for reading; raises OSError, and InterpError as ``require_allowed``.

    With None the user of this process names it: all that he may read is allowed, pipes included.
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
