"""Use Python's fork server: it loads libraries and kernels once, and its children share them."""

import contextlib
import multiprocessing
import os
import signal
from collections.abc import Sequence
from multiprocessing import forkserver, resource_tracker, util
from multiprocessing.context import ForkServerContext
from pathlib import Path
from typing import Any

from cnc_interp.processes.stop_signals import STOPS
from cnc_interp.processes.temporary_folder import TemporaryFolder

COMMAND = 'cnc_interp.commands.cli'  #: Module that multiprocessing imports in every child.
#: Exit code of a child in multiprocessing if the fork server has died.
SERVER_LOST = 255
AFTER_CHILDREN = -50  #: Exit priority: end the fork server after all children.
_sockets: TemporaryFolder | None = None  #: Folder of the sockets of multiprocessing.


def begin_loading(modules: Sequence[str]) -> ForkServerContext:
    """Start the fork server, which then loads ``modules`` for seconds; it blocks ``STOPS``."""
    global _sockets
    multiprocessing.set_forkserver_preload([*modules, COMMAND])
    if _sockets is None:
        # The end of the next run removes this folder if this one is killed.
        _sockets = TemporaryFolder()
        multiprocessing.current_process()._config['tempdir'] = _sockets.name  # type: ignore[attr-defined]
        util.Finalize(None, _end, exitpriority=AFTER_CHILDREN)
    resource_tracker.ensure_running()  # which changes the mask itself
    # The server and its children inherit the mask. Blocked signals wait; ignored ones are lost.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOPS)
    try:
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return multiprocessing.get_context('forkserver')


def load_nodes() -> ForkServerContext:
    """Start the fork server, which loads the modules of the nodes."""
    return begin_loading(['cnc_interp.nodes.preload_nodes'])


def begin_child(name: str) -> None:
    """Set the name of a child in ps. Of ``STOPS``, it obeys only SIGTERM, even if sent before."""
    os.setsid()
    for number in set(STOPS) - {signal.SIGTERM}:
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPS)
    with contextlib.suppress(OSError):
        Path('/proc/self/comm').write_text(name, encoding='ascii')


def _end() -> None:
    """End the fork server and the resource tracker, and wait until they have ended."""
    server: Any = forkserver._forkserver
    helper: Any = resource_tracker._resource_tracker
    with contextlib.suppress(OSError):
        if server._forkserver_pid is not None:
            os.kill(server._forkserver_pid, signal.SIGKILL)  # it may still be loading
        server._stop()
    with contextlib.suppress(OSError):
        helper._stop()
