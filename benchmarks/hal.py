"""
Programs over LinuxCNC's HAL: what its pins had against the setpoints that were executed.

    python benchmarks/hal.py PROGRAM [PROGRAM ...] [--depth N] [--fifo PRIORITY] [--file NAME]

A second sampler in HAL, read apart from the nodes, is the witness. For each program: setpoints;
those that the pins had otherwise, or not in their order; periods of HAL without a setpoint
(underruns) between the first and the last movement; periods in which HAL showed a setpoint longer
than planned, rests left out; largest following error.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
from pathlib import Path

import numpy as np
from hal_session import UNITS, Session, why_not

from cnc_interp.client.session import RunRequest, RunResult, run_session

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


def main() -> None:
    """Run the programs of the command line."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument('programs', nargs='+', type=Path)
    options.add_argument('--depth', type=int, default=8, help='setpoints in the FIFO of HAL (8)')
    options.add_argument(
        '--fifo', type=int, default=0, help="real-time priority of HAL's threads (root)"
    )
    options.add_argument('--file', default='simulated_axes', help='a HAL file of config/hal')
    given = options.parse_args()
    if reason := why_not():
        raise SystemExit(reason)
    with Session(given.file, priority=given.fifo) as session:
        for program in given.programs:
            told, result = run(program, given.depth, session)
            errors = '  '.join(f'{name} {e:.3g}' for name, e in result.following_error.items())
            print(f'{program.name}: {result.message}, {result.cycle_time:.3f} s')
            print(f'  {told}\n  largest following error [m, rad]: {errors}', flush=True)


if __name__ == '__main__':
    main()
