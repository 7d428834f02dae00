"""The recorder of a run, in its own process so that the terminal cannot delay it.

The recorder reports over a pipe that every node knows it, and at the end that the bag is complete.
The run requests the end. A closed pipe means that the process at its other end has died.
"""

from __future__ import annotations

import contextlib
import errno
import multiprocessing
import signal
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING

from cnc_interp.core import InterpError
from cnc_interp.nodes.node_main import come_first
from cnc_interp.processes.fork_server import begin_child, load_nodes
from cnc_interp.processes.this_host import stay_on_this_host

if TYPE_CHECKING:
    from cnc_interp.client.recorder import Recorder
    from cnc_interp.client.served_node import ServedNode

NAME = 'recorder'  #: Name of the process.
NICENESS = -5  #: Lower priority than the nodes, but above others: unread messages are lost.
SPIN = 0.05  #: Longest wait for a message before the pipe is checked [s].
READY, WHOLE = 'ready', 'whole'  #: Messages of the recorder, unless it sends an error.
#: Longest wait until the bag is complete, for last messages and a slow disk [s].
LAST_WAIT = 60.0


def _live(path: Path, namespace: str, domain: int, kept: bool, run: Connection) -> None:
    begin_child(NAME)
    # After a signal to all processes the machine comes to rest, which is recorded.
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    come_first(NICENESS)
    stay_on_this_host()
    # Imported now, while this process has priority: importing bags takes a second.
    from cnc_interp.client.bag import TOPICS
    from cnc_interp.client.recorder import NEEDED, Recorder
    from cnc_interp.client.served_node import ServedNode

    topics = TOPICS if kept else NEEDED
    try:
        with ServedNode('record', namespace, domain) as node:
            _keep(Recorder(node.node, path, topics), node, run)
    except (InterpError, OSError) as fault:
        _say(run, fault)


def _keep(recorder: Recorder, node: ServedNode, run: Connection) -> None:
    """Record until the run requests the end or has died; then complete the bag."""
    ready = False
    while recorder.fault is None and not run.poll():
        node.serve(SPIN)
        if not ready and recorder.ready():
            ready = True
            _say(run, READY)
    recorder.finish(node)
    _say(run, WHOLE)


def _say(run: Connection, word: object) -> None:
    with contextlib.suppress(OSError):  # the run has ended
        run.send(word)


class RecorderProcess:
    """The recorder process as the run sees it; it writes the bag ``path``.

    ``kept``: whether the user keeps the bag. If not, it has only the topics for plan files.
    """

    def __init__(self, path: Path, kept: bool, namespace: str, domain: int):
        from cnc_interp.client.bag import refuse_existing

        refuse_existing(path)
        self._path = path
        self.fault: Exception | None = None  #: Error that ended the recording early.
        self._said: set[str] = set()
        self._pipe, recorder = multiprocessing.Pipe()
        self._process = load_nodes().Process(
            target=_live,
            args=(path, namespace, domain, kept, recorder),
            name=NAME,
            daemon=True,  # a program that forgets to end it can still exit
        )
        self._process.start()
        recorder.close()

    def look(self, timeout: float = 0.0) -> None:
        """Read the reports of the recorder, and check that it is alive."""
        while self.fault is None and WHOLE not in self._said and self._pipe.poll(timeout):
            try:
                word = self._pipe.recv()
            except (EOFError, OSError):
                reason = f'its recorder was killed; cnc-interp repair {self._path} --out NEW'
                word = OSError(errno.EPIPE, f'{reason} saves what it wrote', str(self._path))
            if isinstance(word, Exception):
                self.fault = word
            else:
                self._said.add(word)

    def ready(self) -> bool:
        """Return whether the recorder is known to all nodes; raise its error if it has ended."""
        self.look()
        if self.fault is not None:
            raise self.fault
        return READY in self._said

    def finish(self) -> None:
        """End the recorder and wait until the bag is complete; raise its error if it is not."""
        try:
            with contextlib.suppress(OSError):  # it has ended
                self._pipe.send(WHOLE)
            until = time.monotonic() + LAST_WAIT
            while self.fault is None and WHOLE not in self._said and time.monotonic() < until:
                self.look(SPIN)
            self._process.join(max(until - time.monotonic(), 0.0))
        finally:
            self._process.kill()
            self._process.join()
            self._pipe.close()
        if self.fault is None and WHOLE not in self._said:
            self.fault = OSError(errno.ETIMEDOUT, 'its recorder does not stop', str(self._path))
        if self.fault is not None:
            raise self.fault
