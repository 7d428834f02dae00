"""Remove the shared memory of DDS that killed processes have left behind.

Fast DDS's own lock is held meanwhile. Otherwise a process that opens a port just when its file is
removed would use another file than later processes, and receive no messages.
"""

import contextlib
import ctypes
import os
import re
from collections.abc import Iterator
from pathlib import Path

from cnc_interp.processes.temporary_folder import is_unlocked

FOLDER = Path('/dev/shm')
SEGMENT = re.compile(r'(fastrtps_[0-9a-f]{16})_el')
PORT = re.compile(r'(?:sem\.)?(fastrtps_port([0-9]+))(?:_el|_sl|_mutex)?')
MAPPED = re.compile(r' ([0-9]+) +/dev/shm/(fastrtps|sem)[_.]')
#: Ports below this number belong to no domain; they are reused by all processes, so they are few.
FIRST_OF_DOMAINS = 7400


def remove_dead_segments() -> None:
    """Remove the segments of processes that were killed, and ports that no process has open."""
    segments: list[Path] = []  # their locks
    ports: dict[str, list[Path]] = {}
    for file in own_files():
        if SEGMENT.fullmatch(file.name) and _is_dead(file):
            segments.append(file)
        if (found := PORT.fullmatch(file.name)) and int(found[2]) >= FIRST_OF_DOMAINS:
            ports.setdefault(found[1], [semaphore_of(found[1])]).append(file)
    if segments or ports:
        _remove_segments(segments)
        _remove_ports(ports)


def _remove_segments(locks: list[Path]) -> None:
    living = files_in_use()
    for lock in locks:
        segment = lock.with_name(lock.name.removesuffix('_el'))
        # A process that has just begun makes the file of the lock before it holds it.
        if not living & {*_numbers(segment)} and _is_dead(lock):
            segment.unlink(missing_ok=True)
            lock.unlink(missing_ok=True)


def _remove_ports(files: dict[str, list[Path]]) -> None:
    def dead() -> list[str]:
        living = files_in_use()
        return [
            port
            for port in files
            if not living & {*_numbers(FOLDER / port), *_numbers(semaphore_of(port))}
        ]

    with contextlib.ExitStack() as locks:
        files = {port: files[port] for port in dead()}  # nobody waits for a port that lives
        for port in files:
            locks.enter_context(opening_locked(port))
        for port in dead():  # from now on, who opens one of them waits
            for file in files[port]:
                file.unlink(missing_ok=True)


def _is_dead(lock: Path) -> bool:
    with contextlib.suppress(OSError):
        return is_unlocked(lock)
    return False


def _numbers(file: Path) -> Iterator[int]:
    """Yield the inode of a file, if it exists."""
    with contextlib.suppress(OSError):
        yield file.stat().st_ino


def semaphore_of(port: str) -> Path:
    """Return the file of the semaphore with which Fast DDS opens or creates a port."""
    return FOLDER / f'sem.{port}_mutex'


@contextlib.contextmanager
def opening_locked(port: str) -> Iterator[None]:
    """Hold the semaphore with which Fast DDS opens or creates a port, unless it is taken."""
    library = ctypes.CDLL(None)
    library.sem_open.restype = ctypes.c_void_p
    name = f'/{port}_mutex'.encode()
    semaphore = ctypes.c_void_p(library.sem_open(name, os.O_CREAT, 0o644, 1))
    held = bool(semaphore.value) and library.sem_trywait(semaphore) == 0
    try:
        yield
    finally:
        if held:
            library.sem_post(semaphore)
        if semaphore.value:
            library.sem_close(semaphore)


def own_files() -> Iterator[Path]:
    with contextlib.suppress(OSError):
        for entry in os.scandir(FOLDER):
            with contextlib.suppress(OSError):
                if entry.stat().st_uid == os.getuid():
                    yield Path(entry.path)


def files_in_use() -> set[int]:
    """Return the inodes open in shared memory, except semaphores of this process."""
    found: set[int] = set()
    for maps in Path('/proc').glob('[0-9]*/maps'):
        with contextlib.suppress(OSError):
            own = maps.parent.name == str(os.getpid())
            opened = MAPPED.findall(maps.read_text(errors='replace'))
            found |= {int(inode) for inode, name in opened if not (own and name == 'sem')}
    return found
