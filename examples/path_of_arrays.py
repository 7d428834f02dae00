"""Plan the motion along axis positions that are given as arrays."""

import numpy as np

from cnc_interp.feedrate.feed_planner import plan_path
from cnc_interp.feedrate.limit_use import limits_at
from cnc_interp.kinematics.path_from_arrays import axis_path_from
from cnc_interp.machine_model.machine import Machine
from cnc_interp.run.setpoints import Interpolator, Setpoints

PERIOD = 1e-3  # [s]
machine = Machine.load('xyzac')
s = np.linspace(0.0, 0.2, 81)  # [m]
turn = 2.0 * np.pi * s / s[-1]
# X, Y, Z [m], A, C [rad]
q = np.stack([0.03 * np.sin(turn), 0.03 * np.cos(turn), 0.01 * turn, 0.2 * np.sin(turn), turn], 1)

path = axis_path_from(q, s, machine, feedrate=3.0 / 60.0)
piece = plan_path(path, limits_at(machine, PERIOD))
interpolator = Interpolator(PERIOD)
setpoints = Setpoints.concatenate([interpolator.push(piece), interpolator.finish()])
jerk = np.diff(setpoints.position, 3, axis=0) / PERIOD**3
print(f'{piece.law.end_time:.3f} s, {len(setpoints)} setpoints')
use = np.abs(jerk).max(axis=0) / machine.max_jerk
for name, share in zip(machine.axis_names, use, strict=True):
    print(f'{name}: jerk {share:.1%} of its limit')
