"""Drives in LinuxCNC's HAL (``docs/linuxcnc_machine.md``): setpoints pass through a FIFO."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from cnc_interp.core import DEG, MM, FloatArray
from cnc_interp.core.native import publish
from cnc_interp.machine import hal_step
from cnc_interp.machine.drives import DriveFaultError, HomedDrives
from cnc_interp.machine.hal_pins import SAMPLER, STREAMER, columns_of
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import home_input, index_signals

LIBRARY = 'liblinuxcnchal.so.0'
#: Shared memory keys: of HAL itself, of its first ``streamer`` and of its first ``sampler``.
HAL_KEY, STREAMER_KEY, SAMPLER_KEY = 0x48414C32, 0x48535430, 0x48534130
TYPES = {1: 'b', 2: 'f', 3: 's', 4: 'u'}  #: Column letter of each HAL data type.
PATIENCE = 10.0  #: Longest wait for ``halcmd`` [s].


class _Stream(ctypes.Structure):
    """HAL's C struct of an open stream: component, id and address of the shared memory."""

    _fields_ = [('component', ctypes.c_int), ('memory', ctypes.c_int), ('fifo', ctypes.c_void_p)]


class HalStream:
    """The FIFO of a HAL ``streamer`` or ``sampler``, in shared memory."""

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
        return ctypes.byref(self._stream)

    @property
    def address(self) -> int:
        return ctypes.addressof(self._stream)

    @property
    def capacity(self) -> int:
        return int(self._library.hal_stream_maxdepth(self.reference)) - 1

    @property
    def depth(self) -> int:
        return int(self._library.hal_stream_depth(self.reference))

    def detach(self) -> None:
        self._library.hal_stream_detach(self.reference)


class HalSession:
    """The running HAL session, joined as a component without pins."""

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
        address = ctypes.cast(getattr(self.library, function), ctypes.c_void_p).value
        assert address is not None
        return address

    def end(self) -> None:
        self.library.hal_exit(self.component)


def shared_memories() -> dict[int, int]:
    """Return the shared memories in use: key -> user id of the owner."""
    rows = Path('/proc/sysvipc/shm').read_text(encoding='ascii').splitlines()
    names, *values = (row.split() for row in rows)
    found = [dict(zip(names, map(int, row), strict=True)) for row in values]
    return {row['key'] & 0xFFFFFFFF: row['uid'] for row in found if row['nattch']}


def thread_period(functions: tuple[str, ...]) -> float:
    """Return the period of the HAL thread that calls all of ``functions`` [s]."""
    halcmd = shutil.which('halcmd')
    if halcmd is None:
        raise DriveFaultError('halcmd is not found; install LinuxCNC (Debian: linuxcnc-uspace)')
    try:
        told = subprocess.run(
            [halcmd, '-s', 'show', 'thread'],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=PATIENCE,
            check=True,
        ).stdout
    except (OSError, subprocess.SubprocessError) as problem:
        raise DriveFaultError(f'halcmd show thread: {problem}') from None
    # period [ns], uses floating point, name, time, largest time, functions in their order
    for row in (line.split() for line in told.splitlines()):
        if len(row) > 5 and set(functions) <= set(row[5:]):
            return int(row[0]) * 1e-9
    raise DriveFaultError(
        f'no thread of HAL calls {" and ".join(functions)}; add both to one thread by addf'
    )


#: Largest relative difference between HAL's period and the interpolation period [-].
PERIOD_SLACK = 0.01
POWER_UP = 5.0  #: Longest wait for HAL and for the power of the drives [s].

CAUSES = {
    hal_step.SWITCHED_OFF: 'the drives have no power; is an emergency stop pressed?',
    hal_step.EMPTY: (
        "HAL's thread found no setpoint in time (underrun); raise hal_depth, or see the lateness "
        'of the clock on /diagnostics'
    ),
    hal_step.CHANGED: 'HAL does not play the setpoints that it was sent; does another program '
    'write into its streamer, or is a pin of the sampler wired to another signal?',
    hal_step.UNSEEN: 'samples of HAL were lost, because they were not read in time',
    hal_step.FULL: 'HAL takes no more setpoints; its thread is too slow or has stopped',
    hal_step.STOPPED: "HAL's thread has stopped; start it again: halcmd start",
}


class HalDrives(HomedDrives):
    """Drives that are moved by a running HAL session; see ``drives.CycleDrives``.

    ``depth``: number of setpoints that wait in HAL's FIFO; ``limits``: largest following error of
    each axis; ``known``: its kept position, or NaN [m, rad]. Raises DriveFaultError if no session
    runs, if the wiring is wrong, or if HAL's thread has stopped or has another period.
    """

    wired = True
    lag = 0.02  #: Typical time by which drives lag behind their setpoints [s].

    def __init__(
        self,
        machine: Machine,
        period: float,
        depth: int,
        limits: FloatArray,
        known: FloatArray | None = None,
    ):
        self._names, self.ahead = machine.axis_names, (depth + hal_step.LATER) * period
        n = len(self._names)
        self._session = HalSession()
        self._streams: list[HalStream] = []
        try:
            found = thread_period((STREAMER, SAMPLER))
            if abs(found - period) > PERIOD_SLACK * period:
                raise DriveFaultError(
                    f"HAL's thread has a period of {found * 1e3:g} ms, the interpolation period "
                    f'is {period * 1e3:g} ms; make them equal'
                )
            columns = columns_of(n, machine.signals)
            stream = self._attach(STREAMER_KEY, columns[0], 'streamer')
            samples = self._attach(SAMPLER_KEY, columns[1], 'sampler')
            self._check_depth(depth, stream, samples)
            counts = machine.signals.wired, len(machine.signals.inputs)
            self.memory = np.zeros(hal_step.block_size(n, *counts))
            turns = machine.signals.spindle.angle
            words = [hal_step.OUTPUTS, hal_step.INPUTS, hal_step.TURNS]
            self.memory.view(np.int64)[words] = *counts, turns
            self._block = hal_step.block_at(self.memory.ctypes.data, n)
            self.outputs, self.inputs = self._block.outputs, self._block.inputs
            signals = *machine.signals.wires, *machine.signals.inputs
            self._block.is_number[:] = [signal.is_number for signal in signals]
            inputs = [signal.name for signal in machine.signals.inputs]
            self._block.home[:] = [
                inputs.index(home_input(name)) if name in machine.homing.switches else -1
                for name in self._names
            ]
            offsets = [index_signals(name)[2] for name in self._names]
            self._indexed = np.isin(offsets, inputs)
            self._offsets = [inputs.index(each) if each in inputs else -1 for each in offsets]
            self._fill(machine, period, depth, limits, stream, samples)
            self.step = int(hal_step.step_hal.address)
            self._step_alone = ctypes.CFUNCTYPE(ctypes.c_int64, *[ctypes.c_int64] * 4)(self.step)
            self._await_answer()
            self._assume_inside(machine, np.full(n, np.nan) if known is None else known)
        except BaseException:
            self._leave()
            raise

    def _attach(self, key: int, columns: str, name: str) -> HalStream:
        stream = HalStream(self._session, key, columns, name)
        self._streams.append(stream)
        return stream

    def _check_depth(self, depth: int, stream: HalStream, samples: HalStream) -> None:
        if stream.capacity < 2 * depth:
            raise DriveFaultError(
                f'the FIFO of {STREAMER} holds {stream.capacity} rows, it needs {2 * depth} '
                'or more'
            )
        if stream.capacity + samples.capacity >= hal_step.KEPT:
            raise DriveFaultError(
                f'the FIFOs of {STREAMER} and {SAMPLER} must not hold more than '
                f'{hal_step.KEPT - 1} rows together'
            )

    def _fill(
        self,
        machine: Machine,
        period: float,
        depth: int,
        limits: FloatArray,
        stream: HalStream,
        samples: HalStream,
    ) -> None:
        block, words, session = self._block, self._block.words, self._session
        block.units[:] = np.where(machine.is_linear, MM, DEG)
        block.limits[:] = limits
        for word, function in (
            (hal_step.WRITE, 'hal_stream_write'),
            (hal_step.READ, 'hal_stream_read'),
            (hal_step.DEPTH, 'hal_stream_depth'),
            (hal_step.OVERRUNS, 'hal_stream_num_overruns'),
        ):
            words[word] = session.address_of(function)
        words[hal_step.STREAM], words[hal_step.SAMPLES] = stream.address, samples.address
        words[hal_step.WANTED] = words[hal_step.LEAST] = depth
        words[hal_step.PERIOD] = round(period * 1e9)

    def _await_answer(self) -> None:
        """Run periods until HAL has answered; the machine's clock is not running yet."""
        self._step_until(hal_step.COUNTED, 1)
        if not self._block.words[hal_step.COUNTED]:
            raise DriveFaultError("HAL's thread does not run; start it: halcmd start")

    def _assume_inside(self, machine: Machine, known: FloatArray) -> None:
        """Set axes with a reference switch to their known position, or to one in their travel."""
        block, inside = self._block, np.clip(self._block.actual[1], *machine.travel.T)
        inside = np.where(np.isfinite(known), known, inside)
        block.shift[:] = np.where(block.home >= 0, inside - block.actual[1], 0.0)
        hal_step.shift_axes(block)

    @property
    def released(self) -> FloatArray:
        block = self._block
        by_index = self._indexed & np.isfinite(block.released)
        place = block.offset - np.append(self.inputs, 0.0)[self._offsets] * block.units
        return np.where(by_index, place, block.released)

    def watch(self, axis: int, number: int) -> None:
        self._block.released[axis], self._block.home[axis] = np.nan, number

    def shift(self, by: FloatArray) -> None:
        words = self._block.words
        self._block.shift[:] = by
        publish(words, hal_step.SHIFT_ASKED, 1)
        self._wait(lambda: not words[hal_step.SHIFT_ASKED])
        if words[hal_step.SHIFT_ASKED]:
            raise DriveFaultError(CAUSES[hal_step.STOPPED])

    def _step_until(self, word: int, value: int) -> None:
        """Run periods without the clock until memory word number ``word`` is ``value``."""
        n, memory = len(self._names), self.memory.ctypes.data
        setpoint, feedback = np.zeros((2, n)), np.zeros((4, n))

        def reached() -> bool:
            self._step_alone(memory, setpoint.ctypes.data, feedback.ctypes.data, n)
            return bool(self._block.words[word] == value)

        self._wait(reached)

    @property
    def position(self) -> FloatArray:
        held = self._block.words[hal_step.POWER] == hal_step.HOLD
        return (self._block.held if held else self._block.actual[1]).copy()

    def switch_on(self) -> None:
        """Switch the power on and wait until the drives confirm it; needs the running clock."""
        words = self._block.words
        self._wait(lambda: bool(words[hal_step.POWER_BEFORE] == hal_step.OFF))
        publish(words, hal_step.POWER, hal_step.HOLD)
        self._wait(lambda: bool(words[hal_step.POWERED]))
        alarm = int(words[hal_step.ALARM])
        if alarm or not words[hal_step.POWERED]:
            self.switch_off()
            raise DriveFaultError(self.fault(alarm or hal_step.SWITCHED_OFF))

    def _wait(self, done: Callable[[], bool]) -> None:
        deadline = time.monotonic() + POWER_UP
        while not done() and time.monotonic() < deadline:
            time.sleep(1e-9 * self._block.words[hal_step.PERIOD])

    def switch_off(self) -> None:
        """Request that HAL switch the power off after the last setpoint."""
        publish(self._block.words, hal_step.POWER, hal_step.OFF)

    def close(self) -> None:
        self.switch_off()
        self._step_until(hal_step.POWER_BEFORE, hal_step.OFF)
        self._leave()

    def _leave(self) -> None:
        for stream in self._streams:
            stream.detach()
        self._session.end()

    def fault(self, number: int) -> str:
        """Return a text for a fault or alarm number: the cause, and what to do."""
        if number >= hal_step.AMPLIFIER:
            return f'{self._names[number - hal_step.AMPLIFIER]}: the amplifier reports a fault'
        if number >= hal_step.BEHIND:
            k = number - hal_step.BEHIND
            limit = self._block.limits[k] / self._block.units[k]
            unit = 'deg' if self._block.units[k] == DEG else 'mm'
            return f'{self._names[k]}: following error over {limit:g} {unit}'
        return CAUSES[number]
