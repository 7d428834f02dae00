"""Plan a program, prove it, and draw the feed along its path."""

from matplotlib import pyplot as plt

import cnc_interp

plan = cnc_interp.plan('G1 X0 Y0 F3000\nX40\nY20', machine='xyzac')
print(plan)
print('proven:', plan.check().ok)

seconds, s = plan.setpoints.time, plan.setpoints.s
plt.plot(seconds[1:], (s[1:] - s[:-1]) / 1e-3 * 60e3)  # m/s to mm/min
plt.xlabel('time (s)')
plt.ylabel('feed (mm/min)')
plt.show()
