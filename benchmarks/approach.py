"""
The approach as a straight line of the axes, compared with each axis on its own (ruckig).

``python benchmarks/approach.py [--count 1000]`` plans both between random positions of a machine,
under its limits. Each axis alone is the least time that any motion between them can take.
"""

from __future__ import annotations

import argparse

import numpy as np
import ruckig

from cnc_interp.core import FloatArray
from cnc_interp.feedrate.feed_planner import plan_path
from cnc_interp.feedrate.plan_options import PlanOptions
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform
from cnc_interp.run.start_place import approach

FLANK_HEIGHT = 0.03  # [m]


def least_time(machine: Machine, start: FloatArray, end: FloatArray) -> float:
    """Return the time of the slowest axis from rest to rest [s]."""
    wanted = ruckig.InputParameter(len(start))
    wanted.current_position, wanted.target_position = start.tolist(), end.tolist()
    wanted.max_velocity = machine.max_velocity.tolist()
    wanted.max_acceleration = machine.max_acceleration.tolist()
    wanted.max_jerk = machine.max_jerk.tolist()
    found = ruckig.Trajectory(len(start))
    ruckig.Ruckig(len(start)).calculate(wanted, found)
    return float(found.duration)


def main() -> None:
    """Print the ratio of the times."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--count', type=int, default=1000)
    parser.add_argument('--machine', default='xyzac')
    options = parser.parse_args()
    machine, random = Machine.load(options.machine), np.random.default_rng(1)
    transform = Transform.of(machine)
    low, high = np.clip(machine.travel, -np.pi, np.pi).T
    ratios, times = [], []
    for _ in range(options.count):
        start, end = random.uniform(low, high), random.uniform(low, high)
        path = approach(transform, FLANK_HEIGHT, start, end)
        line = plan_path(path, machine, PlanOptions(bound=False)).law.end_time
        alone = least_time(machine, start, end)
        ratios.append(line / alone)
        times.append(alone)
    found = np.quantile(ratios, [0.5, 0.99, 1.0])
    print(f'{options.count} approaches on {machine.name}, median {np.median(times):.2f} s')
    print('line / each axis alone: median {:.4f}, 99 % {:.4f}, most {:.4f}'.format(*found))


if __name__ == '__main__':
    main()
