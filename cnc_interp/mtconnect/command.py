"""`cnc-interp mtconnect`: run the agent as a separate process beside the nodes."""

from __future__ import annotations

import contextlib
import socket
import sys
import threading
import time
from argparse import Namespace

from cnc_interp.client import session
from cnc_interp.core import InterpError
from cnc_interp.mtconnect.device import device_of, items_of
from cnc_interp.mtconnect.documents import Agent
from cnc_interp.mtconnect.server import AgentServer, Requests
from cnc_interp.mtconnect.store import Store
from cnc_interp.mtconnect.watch import MachineWatch

PATIENCE = 10.0  #: Longest wait for the name of the machine [s].


def run_agent(options: Namespace) -> None:
    """Serve until Ctrl-C; raise InterpError if no node answers or the port is in use."""
    domain = session.domain_of_nodes(options.domain)
    session.check_place(options.namespace, domain)
    with MachineWatch(options.namespace, domain) as watch:
        until = time.monotonic() + PATIENCE
        while not watch.knows_machine():
            watch.serve()
            if time.monotonic() > until:
                raise InterpError(
                    f'no machine_node answers in domain {domain}; start the nodes, or name '
                    'their --domain'
                )
        assert watch.machine is not None
        host = socket.gethostname()
        device = device_of(watch.machine, host)
        store = Store(items_of(device))
        watch.tell(store)
        agent = Agent(device, store, host, int(time.time()))
        with AgentServer(
            options.host, options.port, Requests(agent, lambda: watch.tools)
        ) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            print(
                f'MTConnect      http://{options.host}:{server.server_port}/probe, device '
                f'{device.name}; Ctrl-C ends it',
                file=sys.stdout,
                flush=True,
            )
            with contextlib.suppress(KeyboardInterrupt):
                while True:
                    watch.step()
            server.shutdown()
