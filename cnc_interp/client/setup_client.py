"""Offsets and tools of the machine as users see them: the table that is told, its services."""

from __future__ import annotations

import os
from concurrent.futures import Future
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import SetupTable
from cnc_interp_msgs.srv import SetOffset, SetTool, TouchOff

from cnc_interp.client.operator_client import Answer, OperatorClient
from cnc_interp.core.arrays import FloatArray
from cnc_interp.nodes.qos import LOADED
from cnc_interp.program import JobSetup
from cnc_interp.program.frames import rotation
from cnc_interp.program.job import ROTATION
from cnc_interp.program.setup_requests import work_coordinates as coordinates_of

#: Services that change the table.
SERVICES: dict[str, Any] = {'set_offset': SetOffset, 'set_tool': SetTool, 'touch_off': TouchOff}


class SetupClient:
    """Hears the table of offsets and tools, and asks for changes.

    ``nodes``: the ROS node; not yet served by a thread; ``who``: name of this client in the log of
    changes.
    """

    def __init__(self, nodes: OperatorClient, who: str):
        self._nodes, self._who = nodes, f'{who} of {os.environ.get("USER") or os.getuid()}'
        self.table: SetupTable | None = None  #: The table as it was told last; None before.
        self.setup = JobSetup()
        nodes.node.create_subscription(SetupTable, 'setup_table', self._see, LOADED)
        self._clients = {
            name: nodes.node.create_client(kind, name) for name, kind in SERVICES.items()
        }

    def _see(self, table: SetupTable) -> None:
        self.table, self.setup = table, JobSetup.of_text(table.text)

    @property
    def is_ready(self) -> bool:
        """Tell whether the table is known and can be changed."""
        ready = all(client.service_is_ready() for client in self._clients.values())
        return self.table is not None and ready

    def ask(self, service: str, **request: Any) -> Future[Answer]:
        """Call one of ``SERVICES``, with the fields of its request in SI."""
        message = SERVICES[service].Request(client=self._who, **request)
        return self._nodes.ask(self._clients[service], message, service)


def of_axes(values: dict[str, float]) -> dict[str, Any]:
    """Return values by axis letter [m, rad] as fields of a request."""
    return {'axes': list(values), 'values': list(values.values())}


def offset_row(table: SetupTable, setup: JobSetup, name: str) -> dict[str, float]:
    """Return a work offset with its rotation R [m, rad].

    Where it has no value, it has the zero of the machine file.
    """
    zero = dict(zip(table.axes, table.zero, strict=True))
    return zero | {ROTATION: 0.0} | dict(setup.work_offsets.get(name, {}))


def work_coordinates(
    table: SetupTable, setup: JobSetup, positions: Any, name: str = '', tip: Any = None
) -> dict[str, float]:
    """Return what the coordinates read with a work offset, G92 and the tool in the spindle.

    ``positions``: positions of the axes of the machine [m, rad]; ``name``: the work offset; empty
    for the active one; ``tip``: the tool tip in W [m]: X Y Z are its coordinates, as with tool-tip
    programming. Returns coordinate by axis letter [m, rad].
    """
    machine = dict(zip(table.axes, positions, strict=False))
    zero = dict(zip(table.axes, table.zero, strict=True))
    if tip is not None:
        machine |= {letter: zero[letter] + x for letter, x in zip('XYZ', tip, strict=True)}
    return coordinates_of(setup, name, machine, zero)


def zero_here(
    table: SetupTable, setup: JobSetup, name: str, reads: dict[str, float], letter: str
) -> dict[str, float]:
    """Return the values of a work offset with which one coordinate reads 0 [m, rad]."""
    row = offset_row(table, setup, name)
    change = {letter: reads[letter]}
    if letter in 'XY' and row[ROTATION]:
        x, y = rotation(2, row[ROTATION])[:2, 'XY'.index(letter)] * reads[letter]
        change = {'X': float(x), 'Y': float(y)}
    return {each: row[each] + value for each, value in change.items()}


def work_zero(table: SetupTable, setup: JobSetup, name: str) -> tuple[FloatArray, float]:
    """Return where X0 Y0 Z0 of a work offset with G92 lies in W [m], and its rotation [rad]."""
    row = offset_row(table, setup, name)
    zero = dict(zip(table.axes, table.zero, strict=True))
    added = [setup.g92.get(letter, 0.0) if setup.g92_on else 0.0 for letter in 'XYZ']
    place = np.array([row[letter] - zero[letter] for letter in 'XYZ'])
    return place + rotation(2, row[ROTATION]) @ added, row[ROTATION]
