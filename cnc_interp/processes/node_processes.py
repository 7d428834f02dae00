"""Start, watch and end the four nodes, which are child processes of one fork server."""

from __future__ import annotations

import contextlib
import importlib
import os
import signal
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing.context import ForkServerProcess
from pathlib import Path

from cnc_interp.core import InterpError
from cnc_interp.processes.fork_server import SERVER_LOST, begin_child, load_nodes
from cnc_interp.processes.temporary_folder import TemporaryFolder, remove_dead_folders

NODES = ('feedrate_node', 'program_node', 'lookahead_node', 'machine_node')
LOOK = 0.01  #: Time between two checks whether the nodes have ended [s].
#: A node that has not ended after this time is killed [s]; its machine may have to stop first.
LAST_WAIT = 10.0
FAULT = 1  #: Exit code of a process after an uncaught Python error.


@dataclass(frozen=True)
class Started:
    name: str
    process: ForkServerProcess
    log: Path

    @property
    def code(self) -> int | None:
        """Exit code of the node process; None while it is alive."""
        code = self.process.exitcode
        if code != SERVER_LOST:
            return code
        with contextlib.suppress(OSError):
            if Path(f'/proc/{self.process.pid}/comm').read_text().strip() == self.name:
                return None
        return -signal.SIGKILL

    @property
    def last_words(self) -> str:
        written = self.log.read_text(errors='replace') if self.log.exists() else ''
        words = written.strip().splitlines()
        last = words[-1] if words else f'exit code {self.code}'
        return last.removeprefix('cnc_interp: ')


def _live(node: str, arguments: list[str], environment: Mapping[str, str], log: Path) -> None:
    if not log.parent.is_dir():
        return  # the run was interrupted before the fork server was ready
    begin_child(node)
    os.environ.update(environment)
    with log.open('ab') as output, open(os.devnull, 'rb') as nothing:
        for stream, number in ((nothing, 0), (output, 1), (output, 2)):
            os.dup2(stream.fileno(), number)
    sys.exit(importlib.import_module(f'cnc_interp.nodes.{node}').main([node, *arguments]))


class Children:
    """The node processes of one run; ``parameters`` and ``arguments``: by node name."""

    def __init__(
        self,
        namespace: str,
        domain: int,
        parameters: dict[str, dict[str, object]],
        file: Path,
        arguments: dict[str, list[str]] | None = None,
    ):
        self._folder = TemporaryFolder()
        self._environment = os.environ | {
            'ROS_DOMAIN_ID': str(domain),
            'ROS_LOG_DIR': self._folder.name,
        }
        self._namespace, self._parameters, self._file = namespace, parameters, file
        self._arguments = arguments or {}
        self._context = load_nodes()
        self.nodes: dict[str, Started] = {}
        self.faults: dict[str, str] = {}  #: Node -> last traceback that ended it.
        try:
            for node in NODES:
                self.nodes[node] = self._start(node)
        except BaseException:
            self.end()
            raise

    def _start(self, node: str) -> Started:
        arguments = ['--ros-args', '-r', f'__ns:={self._namespace}']
        arguments += ['--params-file', str(self._file)]
        for name, value in self._parameters.get(node, {}).items():
            arguments += ['-p', f'{name}:={value}']
        arguments += self._arguments.get(node, [])
        log = Path(self._folder.name) / f'{node}.txt'
        process = self._context.Process(
            target=_live,
            args=(node, arguments, self._environment, log),
            name=node,
            daemon=True,  # a program that forgets to end the nodes can still exit
        )
        process.start()
        return Started(node, process, log)

    def check(self) -> None:
        """Raise InterpError with the last output of a node if it has ended."""
        for node in self.nodes.values():
            if node.code is not None:
                raise InterpError(f'{node.name} ended: {node.last_words}')

    def revive(self) -> dict[str, str]:
        """Restart nodes that were killed or have crashed; return node -> reason.

        Raises InterpError if a node has exited, or has crashed again with the same error.
        """
        lost = {}
        for node in tuple(self.nodes.values()):
            if (code := node.code) is None:
                continue
            words = node.last_words
            if code == FAULT and not self.faults.get(node.name, '').endswith(words):
                text = node.log.read_text(errors='replace')
                self.faults[node.name] = text[max(text.rfind('Traceback ('), 0) :].strip()
                lost[node.name] = f'ended by a fault of cnc_interp: {words}'
            elif code < 0:
                lost[node.name] = 'was killed'
            else:
                raise InterpError(f'{node.name} ended: {words}')
            self.nodes[node.name] = self._start(node.name)
        return lost

    def end(self) -> None:
        for number in (signal.SIGTERM, signal.SIGKILL):
            living = [node for node in self.nodes.values() if node.code is None]
            for node in living:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(node.process.pid or 0, number)
            deadline = time.monotonic() + LAST_WAIT
            while any(node.code is None for node in living) and time.monotonic() < deadline:
                time.sleep(LOOK)
        self._folder.cleanup()
        remove_dead_folders()

    def __enter__(self) -> Children:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()


def process_start() -> float:
    """Return when this process started, in monotonic time [s], to 0.01 s; if unknown, now."""
    try:
        told = Path('/proc/self/stat').read_text(encoding='ascii', errors='replace')
        ticks = int(told.rpartition(')')[2].split()[19])  # field 22, after the name and the state
        age = time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf('SC_CLK_TCK')
    except (OSError, AttributeError, ValueError, IndexError):
        age = 0.0
    return time.monotonic() - age
