"""Simulate how drives execute a motion, and the error of the tool tip."""

import numpy as np
from matplotlib import pyplot as plt

from cnc_interp import Blocks, Machine, Program, plan_program, simulate

tip = 0.02 * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [2, 1, 0]])  # m
lean = np.radians([10, 15, 20, 15])
axis = np.stack([0 * lean, np.sin(lean), np.cos(lean)], axis=1)
machine = Machine.load('xyzac')
motion = plan_program(Program(Blocks.of_poses(tip, axis, feedrate=0.05)), machine).setpoints
recorded = simulate(machine, 1e-3, motion.position, motion.velocity)
print(f'contour error {recorded.contour_error.max() * 1e6:.1f} um')

plt.plot(motion.time, recorded.contour_error * 1e6)
plt.xlabel('time (s)')
plt.ylabel('contour error (um)')
plt.show()
