"""
Stops along the path: how many moments of a law have one, how long they are, what they cost.

    PYTHONPATH=. python benchmarks/stops.py [PROGRAM ...]

In the first 32 s of each law, a stop is requested every 20 ms. At a moment without a stop, the
motion continues as planned to the next moment that has one. "Longer" is the time to rest minus
ruckig's time for a stop from the same speed and acceleration on a straight line along the tangent.
"Cost" compares the cycle time with that of a law without reserve for braking.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import ruckig
from paths import cases
from whole_plans import path_of

from cnc_interp.core.axis_limits import Limits
from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import plan_path
from cnc_interp.feedrate.stop_law import stop_law
from cnc_interp.kinematics.axis_path import AxisPath, evaluate
from cnc_interp.machine_model.machine import Machine, limits_of
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.problems import Problem
from cnc_interp.program import read_program
from cnc_interp.settings.options import Settings

#: Time between the moments asked, and the longest part of a law that is asked [s].
EVERY, MOST = 0.02, 32.0


def straight_stop(path: AxisPath, s: float, v: float, a: float, limits: Machine | Limits) -> float:
    """Time of ruckig's stop on a straight line along the tangent [s]."""
    q_s = np.abs(evaluate(path, np.array([s]))[1][0])
    with np.errstate(divide='ignore'):
        acceleration = float((limits.max_acceleration / q_s).min())
        jerk = float((limits.max_jerk / q_s).min())
    wanted, found = ruckig.InputParameter(1), ruckig.Trajectory(1)
    wanted.control_interface = ruckig.ControlInterface.Velocity
    wanted.current_velocity, wanted.current_acceleration = [v], [a]
    wanted.max_acceleration, wanted.max_jerk = [max(acceleration, abs(a))], [jerk]
    ruckig.Ruckig(1).calculate(wanted, found)
    return float(found.duration)


def row_of(case: Problem) -> str:
    """Plan one path and ask for stops all along it; return the row of the table."""
    piece, without = (
        plan_path(case.path, case.limits, PlanOptions(reserve=reserve))
        for reserve in (PlanOptions().reserve, 0.0)
    )
    law, table = piece.law, limits_of(case.limits).table
    times = np.arange(law.time[0], min(law.end_time, law.time[0] + MOST), EVERY)
    states = np.array(law.evaluate(times)[:3]).T.tolist()
    stops, seconds = [], 0.0
    for s, v, a in states:
        before = time.process_time()
        stops.append(stop_law(piece.path, (s, v, a), table, 0.0))
        seconds += time.process_time() - before
    rest, longer = law.end_time, []
    for now, (s, v, a), stop in list(zip(times, states, stops, strict=True))[::-1]:
        rest = rest if stop is None else now + stop.law.end_time
        if v > 0.0:
            longer.append(rest - now - straight_stop(piece.path, s, v, a, case.limits))
    share = sum(stop is not None for stop in stops) / len(stops)
    late = np.array(longer)
    cost = law.end_time / without.law.end_time - 1
    return (
        f'| {case.name} | {law.end_time:.3f} | {100 * cost:.2f} | '
        f'{100 * share:.0f} | {1e3 * seconds / len(stops):.2f} | {np.median(late):.3f} | '
        f'{late.max():.3f} | {int((late > 0.4).sum())} of {len(late)} |'
    )


def of_programs(names: list[str]) -> Iterator[Problem]:
    """Read programs for the reference machine."""
    machine = Machine.load('xyzac')
    transform = Transform.of(machine)
    for name in names:
        blocks = read_program(Path(name), transform, Settings()).blocks
        yield Problem(Path(name).stem, path_of(blocks, transform, Settings()), machine, blocks)


def main() -> None:
    """Print the table of the programs named, or of the benchmark paths."""
    print(
        '| path | s | cost % | moments with a stop % | ms | longer, median | largest | > 0.4 s |'
    )
    print('|---|---|---|---|---|---|---|---|')
    for case in of_programs(sys.argv[1:]) if len(sys.argv) > 1 else cases():
        print(row_of(case), flush=True)


if __name__ == '__main__':
    main()
