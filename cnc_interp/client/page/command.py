"""`cnc-interp panel` and `run --panel`: the page with nodes of its own, or beside others."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import signal
import subprocess
import sys
import time
from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cnc_interp.client.session import RunResult, check_place, chosen_domain, nodes_file
from cnc_interp.core.errors import InterpError
from cnc_interp.kinematics.machine import Machine
from cnc_interp.nodes.node_processes import Children
from cnc_interp.settings.choices import DEFAULT_MACHINE

if TYPE_CHECKING:
    from cnc_interp.client.page.server import Served

#: Environment variable with the process of the run; the page ends when that process ends.
PARENT = 'CNC_INTERP_PARENT'
LOOPBACK = ('127.0.0.1', 'localhost', '::1')
#: How long the page may take to end [s].
LAST_WAIT = 5.0


@dataclass(frozen=True)
class PanelRequest:
    """
    What shall be served, and where.

    Parameters
    ----------
    program : Path, optional
        Laid on the desk at start.
    machine : str
        Machine of the nodes that are started.
    attach : bool
        Join nodes that run already instead.
    namespace, domain
        Where the nodes are; domain None leaves the choice to ROS_DOMAIN_ID.
    host, port, token
        See ``Served``.

    """

    program: Path | None = None
    machine: str = DEFAULT_MACHINE
    attach: bool = False
    namespace: str = '/'
    domain: int | None = None
    host: str = '127.0.0.1'
    port: int = 8650
    token: str = ''

    @staticmethod
    def from_options(options: Namespace) -> PanelRequest:
        """Take the options of `panel`, or those of `run`."""
        return PanelRequest(
            program=options.program,
            machine=options.machine,
            attach=getattr(options, 'attach', False),
            namespace=getattr(options, 'namespace', '/'),
            domain=getattr(options, 'domain', None),
            host=options.host,
            port=options.port,
            token=options.token,
        )


def run_panel(request: PanelRequest) -> None:
    """
    Serve the page until Ctrl-C.

    Raises
    ------
    InterpError
        When the page's library is missing, the address is taken or the input is bad.

    """
    need_library()
    from cnc_interp.client.page.server import Served

    served = Served.prepare(request.host, request.port, request.token, request.program)
    if request.host not in LOOPBACK:
        print(
            f'cnc-interp: {request.host} is seen by others; page and token go unencrypted',
            file=sys.stderr,
        )
    domain = request.domain
    if domain is None and request.attach:
        unset = os.environ.get('ROS_DOMAIN_ID', '')
        domain = int(unset) if unset.isdigit() else 0
    elif domain is None:
        domain = chosen_domain()
    check_place(request.namespace, domain)
    if request.attach:
        until_asked(served, request.namespace, domain)
        return
    Machine.load(request.machine)  # a wrong name is told before anything starts
    parameters: dict[str, dict[str, object]] = {
        name: {'machine': f"'{request.machine}'"}
        for name in ('program_node', 'lookahead_node', 'feedrate_node', 'machine_node')
    }
    with Children(request.namespace, domain, parameters, nodes_file()):
        until_asked(served, request.namespace, domain)


def until_asked(served: Served, namespace: str, domain: int) -> None:
    """Serve; Ctrl-C is the way to end it and no fault."""
    from cnc_interp.client.page.server import serve

    with contextlib.suppress(KeyboardInterrupt):
        serve(served, namespace, domain)


def need_library() -> None:
    """Refuse to start without the library that makes the page."""
    if importlib.util.find_spec('nicegui') is None:
        raise InterpError(
            'the operator page needs NiceGUI: start it with ./cnc, which installs it, or '
            'pip install -r requirements/panel.txt'
        )


class PanelBeside:
    """The page as a process of its own beside a run; it talks to the nodes over ROS 2 only."""

    def __init__(self, request: PanelRequest):
        need_library()
        self._request = request
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, namespace: str, domain: int) -> None:
        """Start the page."""
        request = self._request
        command = [sys.executable, '-m', 'cnc_interp', 'panel', '--attach']
        command += ['--namespace', namespace, '--domain', str(domain), '--host', request.host]
        command += ['--port', str(request.port), '--token', request.token]
        self._process = subprocess.Popen(
            command,
            env=os.environ | {PARENT: str(os.getpid())},
            stdout=sys.stderr,  # standard output is for the result of the run
            start_new_session=True,  # Ctrl-C is for the run, which ends the page
        )

    def finish(self, result: RunResult) -> None:
        """Keep the page and the nodes until Ctrl-C."""
        process = self._process
        if process is None:
            return
        print(f'{result.message}; the page stays open, Ctrl-C ends it', file=sys.stderr)
        try:
            while process.poll() is None:
                time.sleep(0.2)
        except KeyboardInterrupt:
            process.send_signal(signal.SIGTERM)
            process.wait(LAST_WAIT)
