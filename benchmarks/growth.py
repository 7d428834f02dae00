"""How planning time (blocks -> setpoints) grows with program length, for us and for copp-py."""

from __future__ import annotations

import resource
import time

import numpy as np
from figures import Figures
from rivals import topp3
from whole_plans import Kept

from cnc_interp.core import DEG, MM, MM_PER_MIN
from cnc_interp.machine_model.machine import Machine
from cnc_interp.problems.paths import of_blocks
from cnc_interp.program import Blocks
from cnc_interp.run.path_chain import BATCH
from cnc_interp.run.planning_chain import Chain
from cnc_interp.settings.options import Settings

ROW = 100


def raster(count: int, first: int = 0) -> Blocks:
    """Make 1 mm blocks, zigzag in rows of ROW over a dome, the tool normal to it and tilted."""
    n = first + np.arange(count)
    row, along = np.divmod(n, ROW)
    along = np.where(row % 2 == 0, along, ROW - 1 - along)
    # rows go up and down between y = 0 and 40 mm
    side = np.abs((row + 40) % 80 - 40)
    x, y = (along - ROW / 2) * 1.0 * MM, side * 1.0 * MM
    z = -(x**2 + y**2) / (2 * 200 * MM)
    tilt = np.column_stack([x / (200 * MM), y / (200 * MM) - np.tan(20 * DEG), np.ones(count)])
    axis = tilt / np.linalg.norm(tilt, axis=1, keepdims=True)
    return Blocks.of_poses(np.column_stack([x, y, z]), axis, 3000 * MM_PER_MIN)


def chain_cost(count: int) -> Figures:
    """
    Send a raster through the chain, dropping what comes out.

    Returns motion and CPU seconds by room, and the most memory that this process ever held [MB].
    """
    kept = Kept()
    chain = Chain(Machine.load('xyzac'), Settings(), kept, time.process_time)
    motion = 0.0
    for first in range(0, count, BATCH):
        chain.push(raster(min(BATCH, count - first), first))
        motion = kept.pieces[-1].law.end_time if kept.pieces else motion
        for held in (kept.parts, kept.pieces, kept.samples):
            held.clear()
    chain.finish()
    motion = kept.pieces[-1].law.end_time if kept.pieces else motion
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {**chain.seconds, 'motion': motion, 'memory': memory}


def topp3_cost(count: int) -> Figures:
    """Plan the same raster with copp-py, one round."""
    machine = Machine.load('xyzac')
    answer = topp3(of_blocks('raster', raster(count), machine).path, machine, 0, rounds=1)
    return {'computing': answer.computing, 'motion': answer.time}
