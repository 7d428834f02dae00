"""
Programs over a trajectory controller: its commands against the executed setpoints.

    PYTHONPATH=.:test/ros:test/unit python benchmarks/trajectory.py PROGRAM [--delay S]

The controller is the stand-in of the tests, a process with its own clock and period. Printed for
each program: number of commands; their largest distance from the executed setpoints, interpolated
by cubics; the share of commands between points of a message; rejected messages; the largest
following error.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import threading
from pathlib import Path

import numpy as np
from controller_stand_in import StandIn
from test_trajectories import place_of

from cnc_interp.client.run_request import RunRequest, RunResult
from cnc_interp.client.session import chosen_domain, run_session


def run(program: Path, delay: float, robot: StandIn) -> tuple[str, RunResult]:
    """Run a program; return the comparison and the result."""
    found, done = [], threading.Event()

    def watch() -> None:
        while not done.wait(0.2):
            found.append(robot.commanded())

    robot.commanded()
    witness = threading.Thread(target=watch)
    witness.start()
    with tempfile.TemporaryDirectory() as folder:
        try:
            given = robot.parameters(delay)
            request = RunRequest(program, out=Path(folder), quiet=True, drives=given)
            result = run_session(request)[0]
            done.wait(2.0 * delay)  # the controller is later
        finally:
            done.set()
            witness.join()
        found.append(robot.commanded())
        if not result.ok:
            return 'not executed to the end', result
        plan = np.load(Path(folder) / 'setpoints.npz')
        position, velocity = plan['position'], plan['velocity']
    times, between, commanded = (np.concatenate(parts) for parts in zip(*found, strict=True))
    moving = np.flatnonzero(np.diff(commanded, axis=0).any(axis=1))
    starts = np.flatnonzero((commanded == position[0]).all(axis=1))  # after the approach
    first, last = starts[0], moving[-1] + 2
    place, largest = 0.0, 0.0
    for k in range(first, last):
        low, reach = int(place), 20 + int(1e3 * (times[k] - times[k - 1]))
        low, high = max(low - 20, 0), min(low + reach, len(position))
        place, off = place_of(commanded[k], position, velocity, low, high)
        largest = max(largest, off)
    return (
        f'{len(position)} setpoints, {last - first} commands; the farthest {1e9 * largest:.1f} nm '
        f'or nrad off; {100 * between[first:last].mean():.4g} % between points; '
        f'{len(robot.refusals)} refused'
    ), result


def main() -> None:
    """Run the programs of the command line."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument('programs', nargs='+', type=Path)
    options.add_argument('--delay', type=float, default=0.2, help='delay of the controller (0.2)')
    given = options.parse_args()
    domain = int(os.environ.setdefault('ROS_DOMAIN_ID', str(chosen_domain())))
    with StandIn(domain) as robot:
        for program in given.programs:
            told, result = run(program, given.delay, robot)
            errors = '  '.join(f'{name} {e:.3g}' for name, e in result.following_error.items())
            print(f'{program.name}: {result.message}, {result.cycle_time:.3f} s')
            print(f'  {told}\n  largest following error [m, rad]: {errors}', flush=True)


if __name__ == '__main__':
    main()
