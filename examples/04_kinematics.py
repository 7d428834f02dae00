"""Convert axis positions into poses; near the pole, a small change of the pose turns C far."""

import numpy as np
from matplotlib import pyplot as plt

from cnc_interp import Machine, Transform

machine = Machine.load('xyzac')
tilt, swing = np.radians([0.1, 1.0, 5.0]), np.linspace(-1, 1, 201)
for beside in tilt:
    q = np.zeros((len(swing), 5))
    q[:, 3] = np.hypot(beside, 0.2 * swing)  # A, while the tool leans from side to side
    q[:, 4] = np.arctan2(0.2 * swing, beside)  # C
    tip, axis = Transform.of(machine).forward(q)
    plt.plot(np.degrees(np.arcsin(axis[:, 0])), np.degrees(q[:, 4]))
print(f'C turns {np.degrees(np.ptp(q[:, 4])):.0f} deg when the tool passes the pole at 5 deg')

plt.legend([f'{angle:g} deg beside the pole' for angle in np.degrees(tilt)])
plt.xlabel('lean of the tool (deg)')
plt.ylabel('C (deg)')
plt.show()
