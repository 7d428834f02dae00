"""
Short runs of blocks that are slower as a curve than block by block.

A curve needs room: a few spans, and a part of the lines beside it. On a run of a few tolerances
the lines and their corners may be shorter and straighter. Near the pole a curve may use the whole
orientation tolerance, and the outer rotary axis follows each of its waves. So the motion along
such a run is planned as a curve and as lines, and the faster one is taken. The lines are either
all rounded or all stops. Only runs of few blocks are tried, once they are known as a whole.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cnc_interp.machine_model.machine_traits import MachineTraits
from cnc_interp.smoothing.corners.stop_trials import WORTH, turns_fast
from cnc_interp.smoothing.corners.vertices import Legs
from cnc_interp.smoothing.dense.skeleton import Skeleton

#: Most blocks of a run that is tried.
MOST_BLOCKS = 8
#: A run shorter than this is tried [tolerances].
TINY = 15.0


def is_tried(
    skeleton: Skeleton, start: int, last: int, height: float, machine: MachineTraits
) -> bool:
    """Tell whether a run may be slower as a curve."""
    if last - start > MOST_BLOCKS:
        return False
    least = float(skeleton.tolerance[start + 1 : last + 1].min())
    if skeleton.u[last] - skeleton.u[start] < TINY * least:
        return True
    blocks = skeleton.blocks[start : last + 1]
    return bool(turns_fast(blocks, Legs.of(blocks, machine, height), height, machine).any())


def lines_are_faster(skeleton: Skeleton, start: int, last: int, machine: MachineTraits) -> bool:
    """Plan a run and the lines beside it as a curve and as lines; tell if lines are faster."""
    assert machine.motion_time is not None
    first = start if skeleton.stop[start] else start - 1
    end = last if skeleton.stop[last] else last + 1
    blocks = skeleton.blocks[first : end + 1]
    stops = replace(blocks, exact_stop=np.ones(len(blocks), dtype=np.bool_))
    lines = min(machine.motion_time(blocks, False), machine.motion_time(stops, False))
    return lines < (1.0 - WORTH) * machine.motion_time(blocks, True)
