"""The four nodes as child processes: started together, watched, and ended together."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from cnc_interp.errors import InterpError

NODES = ('feedrate_node', 'program_node', 'lookahead_node', 'machine_node')
#: Set for the nodes: the process whose end is also theirs.
PARENT = 'CNC_INTERP_PARENT'
#: A node that has not ended by itself after this is killed [s].
LAST_WAIT = 5.0


@dataclass(frozen=True)
class Started:
    """One node that runs."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path


class Children:
    """
    The nodes of one run.

    Parameters
    ----------
    namespace : str
        ROS namespace of the run.
    domain : int
        ROS domain.
    parameters : dict
        Values for the nodes, by node name, on top of the parameter file.
    file : Path
        Parameter file.
    arguments : dict, optional
        Further ROS arguments, by node name: remappings.

    """

    def __init__(
        self,
        namespace: str,
        domain: int,
        parameters: dict[str, dict[str, object]],
        file: Path,
        arguments: dict[str, list[str]] | None = None,
    ):
        self._folder = tempfile.TemporaryDirectory(prefix='cnc_interp_')
        self._environment = os.environ | {
            'ROS_DOMAIN_ID': str(domain),
            'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
            'ROS_LOG_DIR': self._folder.name,
            PARENT: str(os.getpid()),
        }
        self._namespace, self._parameters, self._file = namespace, parameters, file
        self._arguments = arguments or {}
        self._nodes = {node: self._start(node) for node in NODES}

    def _start(self, node: str) -> Started:
        """Start one node; what it prints goes to a file."""
        command = [sys.executable, '-m', f'cnc_interp.nodes.{node}', '--ros-args']
        command += ['-r', f'__ns:={self._namespace}', '--params-file', str(self._file)]
        for name, value in self._parameters.get(node, {}).items():
            command += ['-p', f'{name}:={value}']
        command += self._arguments.get(node, [])
        log = Path(self._folder.name) / f'{node}.txt'
        with log.open('wb') as output:
            process = subprocess.Popen(
                command,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C is for the run, which ends the nodes in order
            )
        return Started(node, process, log)

    def check(self) -> None:
        """
        Make sure that all nodes run.

        Raises
        ------
        InterpError
            With the last words of the node that ended.

        """
        for node in self._nodes.values():
            if node.process.poll() is not None:
                words = node.log.read_text(errors='replace').strip().splitlines()
                last = words[-1] if words else f'exit code {node.process.returncode}'
                raise InterpError(f'{node.name} ended: {last.removeprefix("cnc_interp: ")}')

    def revive(self) -> list[str]:
        """Start nodes again that were killed by a signal; returns their names."""
        dead = [n.name for n in self._nodes.values() if (n.process.poll() or 0) < 0]
        for name in dead:
            self._nodes[name] = self._start(name)
        return dead

    @property
    def process_ids(self) -> dict[str, int]:
        """Process of each node."""
        return {node.name: node.process.pid for node in self._nodes.values()}

    @property
    def exit_codes(self) -> dict[str, int | None]:
        """Exit code of each node; None while it runs."""
        return {node.name: node.process.poll() for node in self._nodes.values()}

    def end(self) -> None:
        """Ask all nodes to end, wait, and kill only what does not."""
        for node in self._nodes.values():
            if node.process.poll() is None:
                node.process.send_signal(signal.SIGTERM)
        deadline = time.monotonic() + LAST_WAIT
        for node in self._nodes.values():
            try:
                node.process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                node.process.kill()
                node.process.wait()
        self._folder.cleanup()

    def __enter__(self) -> Children:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.end()
