"""Chooses who carries out a batch, and loads what only that needs."""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType

from cnc_interp.batch.processes import PRELOADED, Processes, total_memory
from cnc_interp.batch.run import Workers
from cnc_interp.core.errors import InterpError


def dask_workers() -> ModuleType:
    """
    Return the module of clusters.

    Raises
    ------
    InterpError
        If Dask is not installed.

    """
    try:
        from cnc_interp.batch import dask_workers
    except ModuleNotFoundError as problem:
        raise InterpError(
            f'a cluster needs Dask ({problem.name} is missing): pip install distributed bokeh'
        ) from None
    return dask_workers


def workers_of(
    scheduler: str | None,
    workers: int,
    memory: float | None,
    longest: float,
    preloaded: Sequence[str] = PRELOADED,
) -> Workers:
    """
    Return who carries out a batch.

    Parameters
    ----------
    scheduler : str, optional
        Address of a cluster; without it, processes of this computer.
    workers : int
        How many of these.
    memory : float, optional
        Most memory of a task [bytes]; None for a share of the computer.
    longest : float
        Longest time of a task [s].
    preloaded : sequence of str
        Modules that processes of this computer load once.

    """
    if scheduler is not None:
        found: Workers = dask_workers().DaskWorkers(scheduler, memory, longest)
        return found
    share = memory or total_memory() / workers
    return Processes(workers, share, longest, preloaded=preloaded)
