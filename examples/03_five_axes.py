"""Follow a five-axis program: the tool tip moves on straight lines, the axes do not."""

from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

import cnc_interp

plan = cnc_interp.plan(Path(__file__).with_name('pyramid.apt'))
print(plan)

scale = np.where(plan.machine.is_linear, 1e-3, np.pi / 180)  # to mm and deg
for k, name in enumerate(plan.machine.axis_names):
    plt.plot(plan.setpoints.time, plan.setpoints.position[:, k] / scale[k], label=name)
plt.xlabel('time (s)')
plt.ylabel('axis position (mm, deg)')
plt.legend()
plt.show()
