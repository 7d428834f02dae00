"""
The functions of LinuxCNC's HAL that the drives need, from ``liblinuxcnchal``.

The library is that of the installed LinuxCNC. It is loaded when the drives are made, and belongs
to no other part of the program. ``docs/linuxcnc_machine.md`` says what its licence is.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
from pathlib import Path

from cnc_interp.machine.drives import DriveFaultError

LIBRARY = 'liblinuxcnchal.so.0'
#: Keys of the shared memory of HAL itself, of the first streamer and of the first sampler.
HAL_KEY, STREAMER_KEY, SAMPLER_KEY = 0x48414C32, 0x48535430, 0x48534130
#: Letters of a stream's columns by HAL's numbers of the types.
TYPES = {1: 'b', 2: 'f', 3: 's', 4: 'u'}
#: Longest wait for ``halcmd`` [s].
PATIENCE = 10.0


class _Stream(ctypes.Structure):
    """A stream as one of its users knows it: component, id of the shared memory, its address."""

    _fields_ = [
        ('component', ctypes.c_int), ('memory', ctypes.c_int), ('fifo', ctypes.c_void_p)
    ]  # fmt: skip


class HalStream:
    """A FIFO of HAL in shared memory, of a ``streamer`` or a ``sampler``."""

    def __init__(self, session: HalSession, key: int, columns: str, name: str):
        self._library, self._stream = session.library, _Stream()
        remedy = f'it needs: loadrt {name} cfg={columns}'
        if key not in shared_memories():
            raise DriveFaultError(f'HAL has no {name}; {remedy}')
        if self._library.hal_stream_attach(self.reference, session.component, key, None) < 0:
            raise DriveFaultError(f'the FIFO of {name} cannot be opened; see the message above')
        count = self._library.hal_stream_element_count(self.reference)
        found = ''.join(
            TYPES.get(self._library.hal_stream_element_type(self.reference, k), '?')
            for k in range(count)
        )
        if found != columns:
            self.detach()
            raise DriveFaultError(f'{name} of HAL has columns {found}; {remedy}')

    @property
    def reference(self) -> ctypes._CArgObject:
        """The stream as an argument of the library."""
        return ctypes.byref(self._stream)

    @property
    def address(self) -> int:
        """Address of the stream, for compiled code."""
        return ctypes.addressof(self._stream)

    @property
    def capacity(self) -> int:
        """Most rows that the FIFO holds."""
        return int(self._library.hal_stream_maxdepth(self.reference)) - 1

    @property
    def depth(self) -> int:
        """Rows in the FIFO."""
        return int(self._library.hal_stream_depth(self.reference))

    def detach(self) -> None:
        """Let the FIFO go."""
        self._library.hal_stream_detach(self.reference)


class HalSession:
    """The running session of HAL, as a component of it that has no pins."""

    def __init__(self) -> None:
        try:
            self.library = ctypes.CDLL(LIBRARY)
        except OSError:
            raise DriveFaultError(
                f'{LIBRARY} is not found; install LinuxCNC (Debian: linuxcnc-uspace)'
            ) from None
        owner = shared_memories().get(HAL_KEY)
        if owner is None:
            raise DriveFaultError('no HAL session runs here; start one: halrun -I -f FILE.hal')
        if os.geteuid() not in (0, owner):
            raise DriveFaultError(
                f'the HAL session belongs to another user (uid {owner}); start the nodes as that '
                'user'
            )
        self.component = int(self.library.hal_init(f'cnc-interp-{os.getpid()}'.encode()))
        if self.component < 0:
            raise DriveFaultError(f'HAL refuses: {os.strerror(-self.component)}')
        self.library.hal_ready(self.component)

    def address_of(self, function: str) -> int:
        """Return the address of a function of the library."""
        address = ctypes.cast(getattr(self.library, function), ctypes.c_void_p).value
        assert address is not None
        return address

    def end(self) -> None:
        """Leave the session."""
        self.library.hal_exit(self.component)


def shared_memories() -> dict[int, int]:
    """Return the shared memories that a process has open: user by key."""
    rows = Path('/proc/sysvipc/shm').read_text(encoding='ascii').splitlines()
    names, *values = (row.split() for row in rows)
    found = [dict(zip(names, map(int, row), strict=True)) for row in values]
    return {row['key'] & 0xFFFFFFFF: row['uid'] for row in found if row['nattch']}


def thread_period(functions: tuple[str, ...]) -> float:
    """Return the period of the thread of HAL that calls all these functions [s]."""
    halcmd = shutil.which('halcmd')
    if halcmd is None:
        raise DriveFaultError('halcmd is not found; install LinuxCNC (Debian: linuxcnc-uspace)')
    try:
        told = subprocess.run(
            [halcmd, '-s', 'show', 'thread'], stdin=subprocess.DEVNULL, capture_output=True,
            text=True, timeout=PATIENCE, check=True,
        ).stdout  # fmt: skip
    except (OSError, subprocess.SubprocessError) as problem:
        raise DriveFaultError(f'halcmd show thread: {problem}') from None
    # period [ns], uses floating point, name, time, largest time, functions in their order
    for row in (line.split() for line in told.splitlines()):
        if len(row) > 5 and set(functions) <= set(row[5:]):
            return int(row[0]) * 1e-9
    raise DriveFaultError(
        f'no thread of HAL calls {" and ".join(functions)}; add both to one thread by addf'
    )
