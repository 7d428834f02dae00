"""Trade contour tolerance for time: a wider corner needs less braking."""

import numpy as np
from matplotlib import pyplot as plt

import cnc_interp

zigzag = 'G1 X0 Y0 F6000\n' + '\n'.join(f'X{5 * k} Y{5 * (k % 2)}' for k in range(1, 9))
tolerances = np.array([2e-6, 5e-6, 1e-5, 2e-5, 5e-5, 1e-4, 2e-4, 5e-4])  # m
times = []
for tolerance in tolerances:
    both = {'contour_tolerance': tolerance, 'orientation_tolerance': tolerance}
    times.append(cnc_interp.plan(zigzag, machine='xyz', **both).cycle_time)
print(f'{times[0]:.2f} s within 2 um, {times[-1]:.2f} s within 500 um')

plt.semilogx(tolerances * 1e6, times, 'o-')
plt.xlabel('contour tolerance (um)')
plt.ylabel('cycle time (s)')
plt.show()
