"""Plan thousands of short blocks as one curve instead of corner by corner."""

import numpy as np
from matplotlib import pyplot as plt

import cnc_interp

turn = np.linspace(0, 4 * np.pi, 800)
x, y = (10 + 2 * turn) * np.cos(turn), (10 + 2 * turn) * np.sin(turn)
rows = [f'X{a:.4f} Y{b:.4f}' for a, b in zip(x, y, strict=True)]
spiral = 'G1 F3000 ' + '\n'.join(rows)
for compress in (True, False):
    plan = cnc_interp.plan(spiral, compress=compress)
    print(f'{"curve" if compress else "corners"}: {plan.cycle_time:.2f} s')
    feed = np.gradient(plan.setpoints.s, 1e-3) * 60e3
    plt.plot(plan.setpoints.s * 1e3, feed, label='curve' if compress else 'corners')

plt.xlabel('path length (mm)')
plt.ylabel('feed (mm/min)')
plt.legend()
plt.show()
