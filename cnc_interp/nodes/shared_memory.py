"""
What DDS keeps in shared memory, removed after processes that could not do so.

A process that ends in order leaves nothing. One that was killed leaves its segment of half a
megabyte, and the ports that it had open last.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator
from pathlib import Path

from cnc_interp.core.temporary_folder import is_unlocked

FOLDER = Path('/dev/shm')
SEGMENT = re.compile(r'(fastrtps_[0-9a-f]{16})_el')
PORT = re.compile(r'(?:sem\.)?fastrtps_port([0-9]+)(?:_el|_sl|_mutex)?')
#: Ports below this number belong to no domain: all processes use them again, so they are few.
FIRST_OF_DOMAINS = 7400


def remove_dead_segments() -> None:
    """Remove the segments of processes that were killed, and ports that no process has open."""
    dead: list[Path] = []
    ports: dict[str, list[Path]] = {}
    for file in own_files():
        with contextlib.suppress(OSError):
            if (found := SEGMENT.fullmatch(file.name)) and is_unlocked(file):
                dead += [file.with_name(found[1]), file]
        if (found := PORT.fullmatch(file.name)) and int(found[1]) >= FIRST_OF_DOMAINS:
            ports.setdefault(found[1], []).append(file)
    if ports:
        living = open_ports()
        dead += [file for port, files in ports.items() if port not in living for file in files]
    for file in dead:
        with contextlib.suppress(OSError):
            file.unlink()


def own_files() -> Iterator[Path]:
    """Yield the files of this user in shared memory."""
    with contextlib.suppress(OSError):
        for entry in os.scandir(FOLDER):
            with contextlib.suppress(OSError):
                if entry.stat().st_uid == os.getuid():
                    yield Path(entry.path)


def open_ports() -> set[str]:
    """Return the numbers of the ports that a process has open."""
    found: set[str] = set()
    for maps in Path('/proc').glob('[0-9]*/maps'):
        with contextlib.suppress(OSError):
            found.update(re.findall(r'fastrtps_port([0-9]+)', maps.read_text(errors='replace')))
    return found
