"""`cnc-interp cluster`: computers that plan batches together."""

from __future__ import annotations

import argparse
import os
from typing import Any

from cnc_interp.command_options import FINE, command


def add_cluster_command(commands: Any) -> None:
    """Declare `cluster`."""
    cluster = command(
        commands, 'cluster', cluster_command,
        'plan batches on several computers: a scheduler and workers, or further workers',
        'cnc-interp cluster --host 192.168.1.10, and elsewhere cnc-interp cluster --join '
        'tcp://192.168.1.10:8786',
    )  # fmt: skip
    cluster.add_argument(
        '--join', metavar='ADDRESS', help='work for the scheduler there, start none here'
    )
    cluster.add_argument(
        '--workers', type=int, default=len(os.sched_getaffinity(0)), metavar='N',
        help='programs that are planned here at the same time, 0: a scheduler only (one for '
        'each processor)',
    )  # fmt: skip
    cluster.add_argument(
        '--host', default='127.0.0.1',
        help='address of the scheduler; whoever reaches it can run any code here (127.0.0.1)',
    )  # fmt: skip
    cluster.add_argument('--port', type=int, default=8786, help='its port, 0 for any (8786)')
    cluster.add_argument(
        '--dashboard', type=int, default=8787, metavar='PORT', help='port of its page (8787)'
    )


def cluster_command(options: argparse.Namespace) -> int:
    """Be a part of a cluster until the process is interrupted."""
    from cnc_interp.batch.workers import dask_workers
    from cnc_interp.core.errors import InterpError

    if options.workers < (1 if options.join else 0):
        raise InterpError('--workers must be 1 or more')
    cluster = dask_workers()

    def say(text: str) -> None:
        print(text, flush=True)

    if options.join:
        cluster.join(options.join, options.workers, say)
    else:
        cluster.serve(options.host, options.port, options.dashboard, options.workers, say)
    return FINE
