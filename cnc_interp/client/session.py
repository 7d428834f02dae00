"""One session of `cnc-interp run`: start the four nodes, run programs, end the nodes."""

import os
import random
import time
import uuid
from pathlib import Path
from typing import Any

from cnc_interp.client.run_request import RunRequest, RunResult
from cnc_interp.core import InterpError, ProgramError
from cnc_interp.core.small_files import config_directory
from cnc_interp.processes.fork_server import load_nodes
from cnc_interp.processes.node_processes import Children

#: ROS domains with ports that Linux never assigns to other programs; all ROS domains.
DOMAINS = range(1, 102)
ALL_DOMAINS = range(233)


def run_session(
    request: RunRequest, companion: Any = None, started: float | None = None
) -> list[RunResult]:
    """Start the nodes, run one or more programs through them, and end the nodes.

    ``companion``: an object with ``start`` and ``finish``, such as the page, that runs beside the
    nodes; ``started``: monotonic time at which the command began, by default now [s]. Raises
    InterpError if the first program is rejected before any motion, if the machine file is invalid,
    or if a node cannot start.
    """
    started = time.monotonic() if started is None else started
    for program in request.programs:
        try:
            program.open('rb').close()
        except OSError as problem:
            reason = f'cannot be opened: {problem.strerror}'
            raise ProgramError(reason, str(program)) from None
    if request.then and request.out is not None:
        raise InterpError('--out takes the motion of one program; leave out --then, or --record')
    namespace = f'/run_{uuid.uuid4().hex[:8]}'
    domain = chosen_domain()
    load_nodes()
    # The rest is imported, and this end of ROS made, while another process loads the nodes.
    from cnc_interp.client.operator_client import OperatorClient
    from cnc_interp.client.run_console import run_recorded
    from cnc_interp.machine_model.machine import Machine

    client = OperatorClient('run', namespace, domain)
    try:
        children = Children(namespace, domain, request.node_parameters(), nodes_file())
    except BaseException:
        client.close()
        raise
    with children, client:  # the nodes end last
        machine = Machine.load(request.machine)
        if companion is not None:
            companion.start(namespace, domain)
        results = run_recorded(request, machine, client, children, started)
        if companion is not None:
            companion.finish(results[-1])
    return results


def chosen_domain() -> int:
    """Return the user's ROS domain, or a random one so that parallel runs are separate."""
    chosen = os.environ.get('ROS_DOMAIN_ID', '')
    return int(chosen) if chosen.isdigit() else random.choice(DOMAINS)


def domain_of_nodes(domain: int | None) -> int:
    """Return the ROS domain of running nodes: ``domain``, or that of the environment."""
    chosen = os.environ.get('ROS_DOMAIN_ID', '')
    return (int(chosen) if chosen.isdigit() else 0) if domain is None else domain


def check_place(namespace: str, domain: int) -> None:
    """Check a namespace and a domain against the rules of ROS 2.

    Raises InterpError if one of them is wrong; the message says what is allowed.
    """
    from rclpy.exceptions import InvalidNamespaceException
    from rclpy.validate_namespace import validate_namespace

    if domain not in ALL_DOMAINS:
        last = ALL_DOMAINS.stop - 1
        raise InterpError(f'domain {domain}: the domains of ROS 2 are 0 to {last}')
    try:
        validate_namespace(f'/{namespace.lstrip("/")}')
    except InvalidNamespaceException:
        raise InterpError(
            f'namespace {namespace!r}: may have only letters, digits and _ between slashes, '
            'and no digit first'
        ) from None


def nodes_file() -> Path:
    file = config_directory() / 'nodes.yaml'
    if not file.is_file():
        raise InterpError(f'{file} is missing; install cnc_interp again')
    return file
