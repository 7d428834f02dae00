"""Who cuts the tiles of `cnc-interp cam simulate --tiles`: the pools of a batch."""

from __future__ import annotations

from typing import Any

from cnc_interp.core.units import HOUR

#: Longest time of a tile [s].
LONGEST = 24.0 * HOUR


def tile_workers(scheduler: str | None, workers: int) -> Any:
    """
    Return a pool of workers that have the kernel in memory.

    Parameters
    ----------
    scheduler : str, optional
        Address of a cluster; without it, processes of this computer.
    workers : int
        How many of these.

    """
    from cnc_interp.batch.processes import TILES_PRELOADED
    from cnc_interp.batch.workers import workers_of

    return workers_of(scheduler, workers, None, LONGEST, TILES_PRELOADED)
