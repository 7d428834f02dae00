"""`cnc-interp panel` and `run --panel`: the page with its own nodes, or beside running ones."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import signal
import subprocess
import sys
import time
from argparse import Namespace
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING

from cnc_interp.client import session
from cnc_interp.client.run_request import START_HEIGHT, RunResult
from cnc_interp.core import InterpError
from cnc_interp.core.small_files import UnreadableError, small_text
from cnc_interp.machine_model.machine import without_topic
from cnc_interp.page.origin import PARENT, Revive
from cnc_interp.processes.node_processes import NODES, Children
from cnc_interp.processes.temporary_folder import TemporaryFolder

if TYPE_CHECKING:
    from cnc_interp.page.server import Served

#: Shortest token in a file. It cannot be guessed, so no lock-out is needed [bytes].
SHORTEST_TOKEN = 16
LONGEST_TOKEN = 1000  #: Longest token [bytes].
LAST_WAIT = 5.0  #: Longest wait for the page to end [s].


def run_panel(options: Namespace) -> None:
    need_library()
    from cnc_interp.page.server import Served

    token = token_of(options.token_file)
    served = Served.prepare(options.host, options.port, token, options.program, options.programs)
    if not is_loopback(options.host):
        print(
            f'cnc-interp: others can reach {options.host}; page and token are not encrypted',
            file=sys.stderr,
        )
    domain = options.domain
    if options.attach:
        domain = session.domain_of_nodes(domain)
    elif domain is None:
        domain = session.chosen_domain()
    session.check_place(options.namespace, domain)
    if options.attach:
        until_asked(served, options.namespace, domain, dict)
        return
    folder = TemporaryFolder()
    # A wrong name is reported before anything starts.
    name = without_topic(options.machine, Path(folder.name) / 'machine.yaml')
    machine = f"'{name}'"
    parameters: dict[str, dict[str, object]] = {name: {'machine': machine} for name in NODES}
    if options.drives.get('drives', 'simulated') == 'simulated':
        parameters['machine_node']['start_height'] = START_HEIGHT
    parameters['machine_node'] |= options.drives
    if options.scene is not None:
        from cnc_interp.collision.scene_file import find_scene_file

        scene = f"'{find_scene_file(options.scene).resolve()}'"
        for name in ('program_node', 'feedrate_node', 'machine_node'):
            parameters[name]['scene'] = scene
    if options.setup is not None:
        for name in ('program_node', 'feedrate_node', 'machine_node'):
            parameters[name]['setup'] = f"'{options.setup.resolve()}'"
    nodes = Children(options.namespace, domain, parameters, session.nodes_file())
    with folder, nodes as children:
        print(
            f'ROS domain     {domain}: give it to commands: cnc-interp mdi --domain {domain}',
            flush=True,
        )
        until_asked(served, options.namespace, domain, children.revive)


def token_of(file: Path | None) -> str:
    if file is None:
        return ''
    try:
        token = small_text(file, LONGEST_TOKEN).strip()
    except OSError as problem:
        raise InterpError(f'{file}: cannot be opened: {problem.strerror}') from None
    except UnreadableError as problem:
        raise InterpError(f'{file}: {problem}') from None
    if len(token) < SHORTEST_TOKEN:
        raise InterpError(f'{file}: a token has at least {SHORTEST_TOKEN} characters')
    return token


def is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == 'localhost'


def until_asked(served: Served, namespace: str, domain: int, revive: Revive) -> None:
    """Serve until Ctrl-C, which is the normal way to end."""
    from cnc_interp.page.server import serve

    with contextlib.suppress(KeyboardInterrupt):
        serve(served, namespace, domain, revive)


def need_library() -> None:
    if importlib.util.find_spec('nicegui') is None:
        raise InterpError(
            'the operator page needs NiceGUI: start it with ./cnc, which installs it, or '
            'pip install -r requirements/panel.txt'
        )


class PanelBeside:
    """The page as a process of its own beside a run; it talks to the nodes over ROS 2 only."""

    def __init__(self, options: Namespace):
        need_library()
        token_of(options.token_file)  # a wrong one is reported before anything starts
        self._options = options
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, namespace: str, domain: int) -> None:
        options = self._options
        command = [sys.executable, '-m', 'cnc_interp', 'panel', '--attach']
        command += ['--namespace', namespace, '--domain', str(domain), '--host', options.host]
        command += ['--port', str(options.port)]
        if options.token_file is not None:
            command += ['--token-file', str(options.token_file)]
        self._process = subprocess.Popen(
            command,
            env=os.environ | {PARENT: str(os.getpid())},
            stdout=sys.stderr,  # standard output is for the result of the run
            start_new_session=True,  # Ctrl-C is for the run, which ends the page
        )

    def finish(self, result: RunResult) -> None:
        process = self._process
        if process is None:
            return
        print(f'{result.message}; the page stays open, Ctrl-C ends it', file=sys.stderr)
        try:
            while process.poll() is None:
                time.sleep(0.2)
        except KeyboardInterrupt:
            process.send_signal(signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):  # it sees the end of this one
                process.wait(LAST_WAIT)
