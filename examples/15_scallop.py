"""Mill a surface with passes of constant scallop height."""

import numpy as np
from matplotlib import pyplot as plt

from cnc_interp import BSplineSurface, Cutter, IsoScallopOptions, iso_scallop_paths

u, v = np.meshgrid(*2 * [np.linspace(-0.01, 0.01, 7)], indexing='ij')
bowl = BSplineSurface.through(np.stack([u, v, 8 * (u**2 + v**2)], axis=2))  # m
mill = Cutter(tool_radius=3e-3, corner_radius=1e-3)
paths = iso_scallop_paths(bowl, mill, np.array([0.0, 1.0, 0.0]), IsoScallopOptions())
poses = paths.passes[0].postures
print(f'{len(paths.passes)} passes; the first has {len(poses.tip)} poses')

plot = plt.figure().add_subplot(projection='3d')
for one in paths.passes:
    plot.plot(*one.postures.tip.T * 1e3)
plot.set(xlabel='x (mm)', ylabel='y (mm)', zlabel='z (mm)')
plt.show()
