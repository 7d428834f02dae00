"""Temporary folders that are removed after their process has ended, even if it was killed."""

import contextlib
import fcntl
import os
import shutil
import tempfile
from pathlib import Path

PREFIX = 'cnc_run_'  #: Short, because the path of a socket has at most 107 characters.


class TemporaryFolder(tempfile.TemporaryDirectory[str]):
    """A temporary folder that is locked as long as its process is alive."""

    def __init__(self) -> None:
        super().__init__(prefix=PREFIX)
        self._lock = os.open(self.name, os.O_RDONLY | os.O_DIRECTORY)
        fcntl.flock(self._lock, fcntl.LOCK_EX)

    def cleanup(self) -> None:
        super().cleanup()
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1


def remove_dead_folders() -> None:
    for folder in Path(tempfile.gettempdir()).glob(f'{PREFIX}*'):
        with contextlib.suppress(OSError):
            if folder.stat().st_uid == os.getuid() and is_unlocked(folder):
                shutil.rmtree(folder)


def is_unlocked(path: Path) -> bool:
    """Return whether no process holds a lock on a file or folder."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    finally:
        os.close(descriptor)
    return True
