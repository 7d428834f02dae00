"""Readers of other people's formats, kept from taking all memory or disk for a hostile file."""

from __future__ import annotations

import resource
from pathlib import Path

#: What a reader may take beside so many times the length of its file [bytes].
ROOM, TIMES = 1 << 30, 30
_KINDS = (resource.RLIMIT_DATA, resource.RLIMIT_FSIZE)


class BoundedMemory:
    """
    Limits the memory of this process, and the files it writes, until ``lift``.

    Lengths that a hostile file tells, and what it unpacks to, then end in ``MemoryError`` or
    ``OSError``.

    ``room``: what it may take beside [bytes].
    """

    def __init__(self, *files: Path, room: int = ROOM):
        room += TIMES * sum(file.stat().st_size for file in files)
        pages = Path('/proc/self/statm').read_text(encoding='ascii').split()
        used = int(pages[5]) * resource.getpagesize()
        self._before = [resource.getrlimit(kind) for kind in _KINDS]
        for kind, limits, most in zip(_KINDS, self._before, (used + room, room), strict=True):
            known = [limit for limit in limits if limit != resource.RLIM_INFINITY]
            resource.setrlimit(kind, (min([most, *known]), limits[1]))

    def lift(self) -> None:
        """Set the limits back."""
        for kind, limits in zip(_KINDS, self._before, strict=True):
            resource.setrlimit(kind, limits)
