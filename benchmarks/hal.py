"""
Programs over LinuxCNC's HAL: values of the pins against the executed setpoints.

    python benchmarks/hal.py PROGRAM [PROGRAM ...] [--depth N] [--fifo PRIORITY] [--file NAME]
    PYTHONPATH=.:test/ros:test/unit python benchmarks/hal.py --stops [--depth N] [--fifo PRIORITY]

A second sampler in HAL, read independently of the nodes, is the witness. Printed for each program:
setpoints; setpoints whose values or order differed at the pins; HAL periods without a setpoint
(underruns) between the first and the last movement; HAL periods in which a setpoint stayed longer
than planned, except at rest; the largest following error.

``--stops`` measures how long after an emergency stop, a fault, a reset or the loss of a node each
output is off at HAL's pins, when the axes are at rest, and whether an axis became faster after the
cause. The test ``test/ros/test_hal_stops.py`` reads the same periods.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from hal_session import AXES, FOLDER, UNITS, Session, why_not

from cnc_interp.client.run_request import RunRequest, RunResult
from cnc_interp.client.session import run_session
from cnc_interp.machine.hal_pins import pins_of
from cnc_interp.machine_model.machine import find_machine_file
from cnc_interp.machine_model.signals import signals

#: A setpoint moves an axis by less than this where the machine begins to move [mm, deg].
FIRST_STEP = 1e-4


def changes(rows: np.ndarray) -> np.ndarray:
    """Return the rows that differ from the row before."""
    return np.flatnonzero(np.diff(rows, axis=0).any(axis=1)) + 1


def compare(wanted: np.ndarray, seen: np.ndarray, empty: np.ndarray) -> str:
    """Compare setpoints with the rows that HAL had; both in HAL's units."""
    moved, at = changes(wanted), changes(seen)
    at = at[len(at) - len(moved) :] if len(at) > len(moved) else at
    count = min(len(at), len(moved))
    other = int(np.any(seen[at[:count]] != wanted[moved[:count]], axis=1).sum())
    other += len(moved) - count
    underruns = int(empty[at[0] : at[-1]].sum()) if count else 0
    longer = np.diff(at[:count]) - np.diff(moved[:count])
    rests = np.abs(seen[at[1:count]] - seen[at[1:count] - 1]).max(axis=1) < FIRST_STEP
    return (
        f'{len(wanted)} setpoints, {len(moved)} in motion; {other} otherwise at the pins; '
        f'{underruns} underruns; {int(longer[~rests].sum())} periods missed'
    )


def run(program: Path, depth: int, session: Session) -> tuple[str, RunResult]:
    """Run a program; return the comparison and the result."""
    found, done = [], threading.Event()

    def watch() -> None:
        while not done.wait(0.2):
            found.append(session.periods())

    session.forget()
    witness = threading.Thread(target=watch)
    witness.start()
    with tempfile.TemporaryDirectory() as folder:
        try:
            given = {'drives': 'hal', 'hal_depth': str(depth)}
            request = RunRequest(program, out=Path(folder), quiet=True, drives=given)
            result = run_session(request)[0]
        finally:
            done.set()
            witness.join()
        found.append(session.periods())
        if not result.ok:
            return 'not executed to the end', result
        setpoints = np.load(Path(folder) / 'setpoints.npz')['position'] / UNITS
    seen, _, empty, _ = (np.concatenate(parts) for parts in zip(*found, strict=True))
    last = np.flatnonzero((seen == setpoints[-1]).all(axis=1))
    end = last[-1] + 1 if len(last) else len(seen)  # without power the command follows the axes
    return compare(setpoints, seen[:end], empty[:end]), result


SIGNALS = signals({'signals': 'milling'})
NAMES = [signal.name for signal in SIGNALS.wires]
#: What the witness sees as numbers, too: whether something in HAL has caused a stop; the power.
SEEN = """loadrt conv_bit_float names=fault,released,powered
loadrt sum2 names=cause
net a-fault fault.in
net estop-released released.in
net cnc-power powered.in
net fault-seen fault.out cause.in0
net released-seen released.out cause.in1
setp cause.gain1 -1
setp cause.offset 1
net event cause.out
net seen-power powered.out
addf fault servo-thread
addf released servo-thread
addf powered servo-thread
addf cause servo-thread
"""
#: Long lines, so that a stop comes while the axes speed up; and a tool change.
MOTION = 'G21 G90 G94\nG0 X0 Y0 Z0\nS1000 M3\nM7\nM8\nG1 X-200 Y-150 F20000\nX200 Y150\nM30\n'
CHANGE = 'G21 G90 G94\nG0 X0 Y0 Z0\nM8\nT2 M6\nG1 X20 F3000\nM30\n'


class Stop(NamedTuple):
    """What HAL's pins had in each period around a stop."""

    at: int  #: The first period that the cause may have changed.
    power: np.ndarray  #: (K,): Whether the axes had power.
    outputs: np.ndarray  #: (K, n_outputs)
    actual: np.ndarray  #: (K, n_axes) [mm, deg].
    state: str  #: What the machine said then.

    def off(self, on: np.ndarray) -> int | None:
        """Return for how many periods more (K,) was on; None if it was off before, or stays on."""
        on = on[self.at - 1 :] != 0.0
        return int(np.flatnonzero(on)[-1]) if on[0] and not on[-1] else None

    @property
    def stands(self) -> int:
        """For how many periods more an axis moved by more than 1 um, or 1e-3 deg."""
        moved = np.abs(np.diff(self.actual[self.at - 1 :], axis=0)).max(axis=1) > 1e-3
        return int(np.flatnonzero(moved)[-1]) + 1 if moved.any() else 0

    @property
    def speeds(self) -> tuple[float, float]:
        """The speed of the fastest axis X Y Z before the cause, and the largest one after it."""
        speed = 1e3 * np.abs(np.diff(self.actual[:, :3], axis=0)).max(axis=1)
        return float(speed[self.at - 2]), float(speed[self.at - 1 :].max())


def stops_session(priority: int) -> Session:
    text = (FOLDER / 'simulated_axes.hal').read_text(encoding='utf-8')
    at_speed = pins_of(len(AXES), SIGNALS)[1]['spindle_at_speed']
    text = text.replace('\nstart', f'\n{SEEN}setp {at_speed} 1\nstart')
    return Session(text, SIGNALS, ['event', 'seen-power'], priority)


@contextmanager
def stops_bench(depth: int) -> Iterator[Any]:
    """Start the nodes on the machine xyzac with the outputs of a milling machine."""
    from operated import Bench

    from cnc_interp.processes.node_processes import NODES

    with tempfile.TemporaryDirectory() as folder:
        file, own = (
            Path(folder) / 'm.yaml',
            {'machine_node': {'drives': 'hal', 'hal_depth': depth}},
        )
        file.write_text(find_machine_file('xyzac').read_text() + '\nsignals: milling\n')
        bench = Bench({node: {'machine': f"'{file}'", **own.get(node, {})} for node in NODES})
        try:
            yield bench
        finally:
            bench.watching = False
            bench.close()


def witnessed_stop(hal: Session, bench: Any, kind: str, seconds: float = 1.5) -> Stop:
    """Cause a stop of this kind in a run; return what HAL's pins had until some time later."""
    parts, state = [], bench.state

    def read() -> int:
        parts.append(hal.periods())
        return sum(len(part.empty) for part in parts)

    def wait(done: Callable[[], bool]) -> None:
        bench.spin_until(lambda: bool(read()) and done())

    def on(name: str) -> bool:
        return bool(parts and len(parts[-1].empty) and parts[-1].outputs[-1, NAMES.index(name)])

    change = 'M6' in kind
    hal.forget()
    handle = bench.begin(CHANGE if change else MOTION)
    wait(lambda: on('tool_change') if change else on('coolant_flood'))
    if not change:
        wait(lambda: parts[-1].commanded[0, 0] < -3.0 if len(parts[-1].empty) else False)
    at = read()
    ways = {
        'kill -9 of machine_node': lambda: bench.kill('machine_node'),
        'kill -9 of feedrate_node': lambda: bench.kill('feedrate_node'),
        'emergency_stop of the page': lambda: bench.press('emergency_stop'),
        'contact of the emergency stop': lambda: hal.tell('sets', 'estop-released', '0'),
        'fault of an amplifier': lambda: hal.tell('sets', 'a-fault', '1'),
    }
    if change:
        assert bench.press('feed_hold').success
        at = read()
        assert bench.press('reset').success
    else:
        ways[kind]()
    end = at + round(1e3 * seconds)
    wait(lambda: read() > end)
    state = bench.state.message if bench.state else ''
    del handle
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    _, actual, _, outputs, more = columns
    if 'contact' in kind or 'amplifier' in kind:  # halcmd took some time
        at = int(np.flatnonzero(more[at:, 0] > 0.5)[0]) + at
    return Stop(at, more[:, 1] > 0.5, outputs, actual, state)


KINDS = {
    'emergency_stop of the page': 1.5,
    'contact of the emergency stop': 1.5,
    'fault of an amplifier': 1.5,
    'reset while M6 waits': 1.0,
    'kill -9 of feedrate_node': 4.5,
    'kill -9 of machine_node': 1.5,
}


def print_stops(depth: int, priority: int) -> None:
    """Print a row for each kind of stop, in periods of 1 ms."""
    shown = 'spindle_forward', 'spindle_speed', 'coolant_flood', 'coolant_mist', 'tool_change'
    print(
        '| stop | power | '
        + ' | '.join(shown)
        + ' | axes at rest | speed at the cause, after it |'
    )
    print('|---' * (len(shown) + 4) + '|')
    with stops_session(priority) as hal, stops_bench(depth) as bench:
        for kind, seconds in KINDS.items():
            recover(hal, bench)
            found = witnessed_stop(hal, bench, kind, seconds)
            columns = [found.outputs[:, NAMES.index(name)] for name in shown]
            periods = [found.off(column) for column in (found.power, *columns)]
            told = ['' if k is None else str(k) for k in periods]
            told += [str(found.stands), ', '.join(f'{speed:.1f}' for speed in found.speeds)]
            print(f'| {kind} | {" | ".join(told)} |', flush=True)


def recover(hal: Session, bench: Any) -> None:
    """Make ready after a stop: mend its cause, reset, and start again what was killed."""
    hal.tell('sets', 'estop-released', '1')
    hal.tell('sets', 'a-fault', '0')
    bench.tidy()


def main() -> None:
    """Run the programs of the command line."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument('programs', nargs='*', type=Path)
    options.add_argument('--stops', action='store_true', help='times of stops at the pins')
    options.add_argument('--depth', type=int, default=8, help='setpoints in the FIFO of HAL (8)')
    options.add_argument(
        '--fifo', type=int, default=0, help="real-time priority of HAL's threads (root)"
    )
    options.add_argument('--file', default='simulated_axes', help='a HAL file of config/hal')
    given = options.parse_args()
    if reason := why_not():
        raise SystemExit(reason)
    if given.stops:
        print_stops(given.depth, given.fifo)
        return
    with Session(given.file, priority=given.fifo) as session:
        for program in given.programs:
            told, result = run(program, given.depth, session)
            errors = '  '.join(f'{name} {e:.3g}' for name, e in result.following_error.items())
            print(f'{program.name}: {result.message}, {result.cycle_time:.3f} s')
            print(f'  {told}\n  largest following error [m, rad]: {errors}', flush=True)


if __name__ == '__main__':
    main()
