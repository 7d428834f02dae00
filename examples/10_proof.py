"""Manipulate a plan, and let the check find it from the setpoints alone."""

from dataclasses import replace

import numpy as np
from matplotlib import pyplot as plt

import cnc_interp

plan = cnc_interp.plan('G1 X0 Y0 F3000\nX40\nY20')
position = plan.setpoints.position.copy()
position[700, 0] += 2e-8  # 20 nm, at one setpoint
proof = cnc_interp.check(replace(plan, setpoints=replace(plan.setpoints, position=position)))
print('proven:', proof.ok)
print(proof.failures[0])

jerk = np.diff(position[:, 0], 3, axis=0) / 1e-9
plt.plot(plan.setpoints.time[3:], jerk / plan.machine.max_jerk[0])
plt.xlabel('time (s)')
plt.ylabel('jerk of X / limit')
plt.show()
