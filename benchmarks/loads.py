"""
Torque limits of the drives: rows of the planner against one constant acceleration limit.

    PYTHONPATH=. python benchmarks/loads.py

Every axis gets a drive that just reaches its largest acceleration without friction. Coulomb
friction takes 10 % of the torque, viscous friction 30 % at the largest velocity. The last column
replaces the torque rows by the acceleration that is always available: the one left at the largest
velocity in both directions, 60 % of the limit.
"""

from __future__ import annotations

import sys
from statistics import median

import numpy as np
from paths import cases

from cnc_interp.core.axis_limits import DriveLoad, Limits
from cnc_interp.feedrate.planning_windows import plan_path
from cnc_interp.machine_model.machine import Machine, limits_of

COULOMB, VISCOUS = 0.1, 0.3


def loaded_limits(limits: Machine | Limits, loaded: bool, part: float) -> Limits:
    """Return the limits with a part of the acceleration, and with drives if they are loaded."""
    given = limits_of(limits)
    v, a, j = given.max_velocity, part * given.max_acceleration, given.max_jerk
    drives = np.stack([a, COULOMB * a, VISCOUS * a / v], axis=1).tolist()
    loads = {k: DriveLoad(1.0, *drive) for k, drive in enumerate(drives)} if loaded else {}
    return Limits.constant(v, a, j).having(load=loads)


def main() -> int:
    """Print one line for each path."""
    print(f'{"path":<42}{"free s":>10}{"torques":>10}{"always":>10}   windows')
    ratios = []
    for case in cases():
        ways = (False, 1.0), (True, 1.0), (False, 1.0 - COULOMB - VISCOUS)
        limits = (loaded_limits(case.limits, *way) for way in ways)
        free, own, always = (plan_path(case.path, of) for of in limits)
        times = [piece.law.end_time / free.law.end_time for piece in (own, always)]
        ratios.append(times)
        print(
            f'{case.name:<42}{free.law.end_time:>10.4f}'
            + ''.join(f'{x:>10.4f}' for x in times)
            + f'   {own.solved}',
            flush=True,
        )
    print(f'{"median":<52}' + ''.join(f'{median(x):>10.4f}' for x in zip(*ratios, strict=True)))
    return 0


if __name__ == '__main__':
    sys.exit(main())
