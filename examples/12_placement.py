"""Find the fastest placement of a part: the same program, turned about Z on the table."""

from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

from cnc_interp import Blocks, Machine, Program, Transform, plan_program, read_program

machine = Machine.load('xyzac')
blocks = read_program(Path(__file__).with_name('pyramid.apt'), Transform.of(machine)).blocks
angles, times = np.arange(0, 91, 15), []
for angle in np.radians(angles):
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
    turned = Blocks.of_poses(blocks.tip @ turn, blocks.axis @ turn, feedrate=0.05)
    times.append(plan_program(Program(turned), machine).cycle_time)
best = int(np.argmin(times))
print(f'{times[0]:.2f} s as it lies, {times[best]:.2f} s turned by {angles[best]} deg')

plt.plot(angles, times, 'o-')
plt.xlabel('turn of the part about Z (deg)')
plt.ylabel('cycle time (s)')
plt.show()
