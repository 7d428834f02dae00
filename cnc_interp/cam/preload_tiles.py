"""Modules that tiles of needles need, imported once by the process that forks the workers."""

import gc

import numpy as np

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.nbuffer import TileTask, cut_tile
from cnc_interp.cam.needle_cuts import TOP
from cnc_interp.cam.needles import MotionPieces, NeedleGrid
from cnc_interp.cam.shapes import Plane
from cnc_interp.core import MM

axis = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
tip = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]) * MM
sweep = MotionPieces.of(Cutter(0.0, 3.0 * MM), tip, axis)
grid = NeedleGrid.on(Plane((1.0 * MM, 1.0 * MM)), 0.5 * MM)
tile = cut_tile(TileTask(0, 0, grid.needles(slice(0, 3), slice(0, 3)), sweep))
assert tile.height.max() < TOP, tile
gc.collect()
gc.freeze()  # the collector ignores these objects from now on, so their memory stays shared
