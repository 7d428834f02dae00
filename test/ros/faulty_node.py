"""Nodes with a fault: one divides by zero, each time a file asks for it; others do not hear."""

import os
from pathlib import Path

from cnc_interp.processes import node_processes

#: The file that asks for the fault, and that is gone when it has happened.
ASKED = 'CNC_INTERP_TEST_FAULT'
live = node_processes._live


def live_with_fault(node, arguments, environment, log):
    """What a child process runs."""
    if node == 'feedrate_node':
        from cnc_interp.nodes.planning_session import PlanningSession

        asked, step = Path(environment[ASKED]), PlanningSession.step

        def faulty(session, now, received):
            if asked.exists():
                asked.unlink()
                return now / 0.0
            return step(session, now, received)

        PlanningSession.step = faulty
    live(node, arguments, environment, log)


def live_deaf(node, arguments, environment, log):
    """What a child process runs: machine_node gets no setpoints while the file is there."""
    if node == 'machine_node':
        from cnc_interp.nodes.machine_node import MachineNode

        asked, hears = Path(environment[ASKED]), MachineNode._pass
        MachineNode._pass = lambda node, chunk: [] if asked.exists() else hears(node, chunk)
    live(node, arguments, environment, log)


def live_unaware(node, arguments, environment, log):
    """What a child process runs: feedrate_node hears no state while the file is there."""
    if node == 'feedrate_node':
        from cnc_interp.nodes.feedrate_node import FeedrateNode

        asked, sees = Path(environment[ASKED]), FeedrateNode._see_machine
        FeedrateNode._see_machine = lambda node, state: asked.exists() or sees(node, state)
    live(node, arguments, environment, log)


def put_in(monkeypatch, folder, faulty=live_with_fault):
    """Give the nodes that are started from now on the fault; returns what asks for it."""
    file = folder / 'fault'
    monkeypatch.setitem(os.environ, ASKED, str(file))
    monkeypatch.setattr(node_processes, '_live', faulty)
    return file
