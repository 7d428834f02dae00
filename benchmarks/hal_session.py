"""
A session of LinuxCNC's HAL for benchmarks and tests: the bundled axes, and a witness.

The witness is a second sampler. It records all commanded and actual positions in every period, and
is read here, independently of the nodes. HAL refuses to run as root, so root starts it as user
``nobody``.
"""

from __future__ import annotations

import ctypes
import os
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cnc_interp.machine.hal_drives import (
    HAL_KEY,
    SAMPLER_KEY,
    HalSession,
    HalStream,
    shared_memories,
)
from cnc_interp.machine.hal_pins import NO_SIGNALS, columns_of, gate_lines, gates, pins_of
from cnc_interp.machine_model.signals import Signals

FOLDER = Path(__file__).resolve().parents[1] / 'config' / 'hal'
NOBODY = 65534
#: Longest wait for a command of HAL [s].
WAIT = 60.0
#: Axes of the file, and their units in HAL [m, rad].
AXES, UNITS = 'xyzac', np.array([1e-3] * 3 + [np.pi / 180.0] * 2)
#: Periods that the witness keeps until they are read.
WITNESSED = 400_000


def why_not() -> str:
    """Say why no session can be started here; empty if one can."""
    if not (shutil.which('halcmd') and shutil.which('rtapi_app')):
        return 'LinuxCNC is not installed (Debian: linuxcnc-uspace)'
    if HAL_KEY in shared_memories():
        return 'a HAL session of somebody else runs on this computer'
    return ''


class Periods(NamedTuple):
    #: (K, n_axes): Positions at the pins, in HAL's units [mm, deg].
    commanded: np.ndarray
    actual: np.ndarray
    empty: np.ndarray  #: (K,): Periods in which the FIFO was empty.
    outputs: np.ndarray  #: (K, n_outputs)
    more: np.ndarray  #: (K, m): Further numbers.


def witnessed_columns(signals: Signals, more: Sequence[str]) -> str:
    kinds = ('f' if signal.is_number else 'b' for signal in signals.wires)
    return f'{"f" * 2 * len(AXES)}b{"".join(kinds)}{"f" * len(more)}'


def witnessed_file(text: str, signals: Signals, more: Sequence[str]) -> str:
    """Return a HAL file with the signals of a machine file, and with the second sampler.

    A net of its name begins at each output, after its gate, which is added where it is missing.
    """
    count, gated = len(AXES), [each for each in gates(signals) if each[1] not in text]
    for _, gate, module in gated:
        text = re.sub(rf'(loadrt {module} names=\S+)', rf'\1,{gate}', text)
    called = ''.join(f'\naddf {gate} servo-thread' for _, gate, _ in gated)
    text = text.replace('addf power-given servo-thread', f'addf power-given servo-thread{called}')
    stream, samples = columns_of(count, signals)
    text = re.sub(r'(depth=1000 cfg=)\w+', rf'\1{stream}', text)
    for net, columns in (
        ('sent-bits streamer.0', stream),
        ('seen-bits wsum.0.sum => sampler.0', samples),
    ):
        text = text.replace(f'net {net}.pin.{2 * count}', f'net {net}.pin.{len(columns) - 1}')
    given = f'depth=4000,{WITNESSED} cfg={samples},{witnessed_columns(signals, more)}'
    text = re.sub(r'depth=4000 cfg=\w+', given, text)
    nets = [*(f'{axis}-{kind}' for kind in ('cmd', 'fb') for axis in AXES), 'empty']
    nets += [f'{name} {pin}' for name, pin in pins_of(count, signals)[0].items()]
    nets += more
    nets = [f'net {net} => sampler.1.pin.{k}' for k, net in enumerate(nets)]
    nets += gate_lines(count, signals) if gated else []
    added = '\n'.join(['addf sampler.1 servo-thread', *nets, 'start'])
    return re.sub(r'^start$', added, text, flags=re.MULTILINE)


class Session:
    """
    Starts HAL, reads what its pins had in every period, and ends it; use it in ``with``.

    Parameters
    ----------
    name : str
        A file of ``config/hal``, without its suffix; or the lines of a file.
    signals : Signals
        Those of the machine file.
    more : Sequence[str]
        Nets of further numbers for the witness.
    priority : int
        Real-time priority of HAL's threads where it is allowed, above that of the nodes; 0: none.

    """

    def __init__(
        self,
        name: str = 'simulated_axes',
        signals: Signals = NO_SIGNALS,
        more: Sequence[str] = (),
        priority: int = 20,
    ):
        self._name, self._signals, self._more = name, signals, more
        self._priority = priority

    def __enter__(self) -> Session:
        self._folder = tempfile.TemporaryDirectory(prefix='cnc_interp_hal_')
        if os.geteuid() == 0:
            os.chown(self._folder.name, NOBODY, NOBODY)
        path = Path(self._folder.name) / 'witnessed.hal'
        text, file = self._name, FOLDER / f'{self._name}.hal'
        text = text if '\n' in text else file.read_text(encoding='utf-8')
        path.write_text(witnessed_file(text, self._signals, self._more), encoding='utf-8')
        path.chmod(0o644)  # read by the other user
        try:
            self._begin(path)
        except BaseException:
            self._end()
            raise
        return self

    def _begin(self, path: Path) -> None:
        self._run('halcmd', '-f', str(path))
        self.is_preferred = self._priority > 0 and self._prefer()
        self._session = HalSession()
        columns = witnessed_columns(self._signals, self._more)
        self._is_number = np.array([s.is_number for s in self._signals.wires], dtype=bool)
        self._witness = HalStream(self._session, SAMPLER_KEY + 1, columns, 'sampler.1')
        self.forget()

    def _run(self, *command: str) -> str:
        """Run a command of LinuxCNC as an ordinary user; what it leaves running has no pipe."""
        user = {'user': NOBODY, 'group': NOBODY, 'extra_groups': []} if os.geteuid() == 0 else {}
        told = Path(self._folder.name) / 'told.txt'
        with told.open('w') as output:
            done = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                timeout=WAIT,
                env=os.environ | {'HOME': self._folder.name},
                cwd='/',
                check=False,
                **user,
            )
        text = told.read_text(errors='replace')
        assert done.returncode == 0, f'{" ".join(command)}: {text}'
        return text

    def _prefer(self) -> bool:
        """Give the threads of HAL their priority; return whether it was allowed."""
        wanted = os.sched_param(self._priority)
        for name in Path('/proc').glob('[0-9]*/comm'):
            with suppress(FileNotFoundError, ProcessLookupError):  # it ended meanwhile
                if name.read_text().startswith('rtapi_app'):
                    for thread in (name.parent / 'task').iterdir():
                        try:
                            os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, wanted)
                        except PermissionError:
                            return False
        return True

    def tell(self, *command: str) -> str:
        """Run a command of halcmd, such as ``sets SIGNAL VALUE``; return what it prints."""
        return self._run('halcmd', '-s', *command)

    def forget(self) -> None:
        """Leave out the periods so far, also those that came while nobody read."""
        reference = self._witness.reference
        self._lost = self._session.library.hal_stream_num_overruns(reference)
        self.periods()

    def periods(self) -> Periods:
        """Read the periods since the last call."""
        library, width = self._session.library, 2 * len(AXES)
        end = width + 1 + len(self._is_number)
        row, found = np.zeros(end + len(self._more)), []
        number, place = ctypes.c_uint(), row.ctypes.data_as(ctypes.c_void_p)
        while library.hal_stream_read(self._witness.reference, place, ctypes.byref(number)) == 0:
            found.append(row.copy())
        rows = np.array(found).reshape(-1, len(row))
        assert library.hal_stream_num_overruns(self._witness.reference) == self._lost
        bits = rows.view(np.int64)[:, width:] & 1
        outputs = np.where(self._is_number, rows[:, width + 1 : end], bits[:, 1 : end - width])
        place = rows[:, : len(AXES)], rows[:, len(AXES) : width]
        return Periods(*place, bits[:, 0].astype(bool), outputs, rows[:, end:])

    def __exit__(self, *_: object) -> None:
        self._witness.detach()
        self._session.end()
        self._end()

    def _end(self) -> None:
        self._run('halcmd', 'stop')
        self._run('halcmd', 'unload', 'all')
        self._run('rtapi_app', 'exit')
        deadline = time.monotonic() + WAIT
        while HAL_KEY in shared_memories() and time.monotonic() < deadline:
            time.sleep(0.05)
        self._folder.cleanup()
