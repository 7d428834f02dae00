"""Run the program of a milling machine on a six-joint arm."""

from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

import cnc_interp

plan = cnc_interp.plan(Path(__file__).with_name('pyramid.apt'), machine='ur10e')
print(plan)
print('proven:', plan.check().ok)

plt.plot(plan.setpoints.time, np.degrees(plan.setpoints.position))
plt.legend(plan.machine.axis_names)
plt.xlabel('time (s)')
plt.ylabel('joint (deg)')
plt.show()
