"""Turn two cubic B-splines, of tool tip and tool axis, into a program with native splines.

Flank milling paths are published in this form: knots, and control points of the tool tip and of a
second point on the tool axis, in mm.
"""

from matplotlib import pyplot as plt

import cnc_interp

bottom = [(0, 0, 0), (6, 1, 0), (14, 6, 0), (22, 6, 1), (30, 0, 2), (38, -4, 2), (44, -2, 1)]
top = [(x + 2, y + 8 - x / 10, z + 28) for x, y, z in bottom]
knots = [0, 0, 0, 0, 0.25, 0.5, 0.75, 1, 1, 1, 1]

letters = 'X', 'Y', 'Z', 'XH=', 'YH=', 'ZH='
lines = ['TRAORI', 'ORICURVE']
for number, values in enumerate(zip(bottom, top, strict=True)):
    words = zip(letters, [*values[0], *values[1]], strict=True)
    point = ' '.join(f'{letter}{value:g}' for letter, value in words)
    # Block i carries the knot interval t_(i+3) - t_(i+2).
    interval = knots[number + 3] - knots[number + 2]
    lines.append(f'{point} PL={interval:g}' if number else f'G0 {point}\nBSPLINE SD=3 F3000')
plan = cnc_interp.plan('\n'.join(lines))
print(plan)
print('proven:', plan.check().ok)

position = plan.setpoints.position
plt.plot(plan.setpoints.time, position[:, 3:] * 57.2958)
plt.legend(plan.machine.axis_names[3:])
plt.xlabel('time (s)')
plt.ylabel('rotary axes (deg)')
plt.show()
