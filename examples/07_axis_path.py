"""Plan along axis positions of your own, without a program."""

import numpy as np
from matplotlib import pyplot as plt

from cnc_interp import Machine, axis_motion, axis_path_from, plan_path

machine = Machine.load('xyzac')
s = np.linspace(0.0, 0.2, 81)  # m
turn = 2.0 * np.pi * s / s[-1]
x, y, z = 0.03 * np.sin(turn), 0.03 * np.cos(turn), 0.01 * turn
q = np.stack([x, y, z, 0.2 * np.sin(turn), turn], axis=1)  # X Y Z in m, A C in rad
planned = plan_path(axis_path_from(q, s, machine, feedrate=0.05), machine)
time = np.arange(0.0, planned.law.end_time + 1e-3, 1e-3)
position, velocity, acceleration, jerk, *_ = axis_motion(planned.path, planned.law, time)
print(f'{planned.law.end_time:.2f} s; jerk {(abs(jerk) / machine.max_jerk).max():.1%}')

plt.plot(time, jerk / machine.max_jerk)
plt.legend(machine.axis_names)
plt.xlabel('time (s)')
plt.ylabel('jerk / limit')
plt.show()
