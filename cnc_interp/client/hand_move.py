"""A move by hand from the command line: ask for it, wait for its end, tell where it ended."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import MachineState
from cnc_interp_msgs.srv import MoveAxes

from cnc_interp.client.operator_client import SILENCE, OperatorClient
from cnc_interp.client.session import check_place, domain_of_nodes
from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import InterpError
from cnc_interp.core.units import MM
from cnc_interp.machine_model.machine import Axis, Machine, place_text

PATIENCE = 10.0  #: Longest wait for the nodes [s].
CERTAIN = 20  #: Homing is not under way where the machine says so many times that it rests.
POSE = 'XYZIJK'  #: Letters of a pose: the tool tip in the workpiece, then the tool axis.
THERE = 1e-6  #: Nearer than this to its target, a move has arrived [m, rad].


@dataclass(frozen=True)
class HandMove:
    """What is wanted of a move."""

    values: Mapping[str, float]  #: Values of axes [mm, deg]; of a pose X Y Z [mm] and I J K [-].
    relative: bool  #: Whether they are distances.
    tool: float  #: A distance along the tool [mm].
    speed: float  #: Share of the largest velocities [-].
    pose: bool = False  #: Whether the values are a tool pose in the workpiece frame.


@dataclass(frozen=True)
class Ended:
    """Where a move has ended, and why."""

    axes: tuple[Axis, ...]
    position: FloatArray
    arrived: bool
    message: str

    def text(self) -> str:
        """Return the place in words and shop units."""
        return f'{self.message}: {place_text(self.axes, self.position)}'

    def to_json(self) -> dict[str, Any]:
        names = [axis.name for axis in self.axes]
        return {
            'arrived': self.arrived,
            'message': self.message,
            'position': dict(zip(names, self.position.tolist(), strict=True)),
        }


def pose_request(
    values: Mapping[str, float], speed: float, length: float = MM
) -> MoveAxes.Request:
    """Return the request that moves the tool to a pose; what is not named stays as it is."""
    request = MoveAxes.Request(speed=speed)
    request.tip = [values.get(name, math.nan) * length for name in POSE[:3]]
    if set(values) & set(POSE[3:]):
        request.axis = [values.get(name, 0.0) for name in POSE[3:]]
    return request


@contextmanager
def connected(
    name: str, namespace: str, domain: int | None,
    ready: Callable[[OperatorClient], bool] = lambda _: True,
) -> Iterator[tuple[OperatorClient, Machine]]:  # fmt: skip
    """Yield a client of running nodes, once what it needs is there, and their machine."""
    domain = domain_of_nodes(domain)
    check_place(namespace, domain)
    with OperatorClient(name, namespace, domain) as client:
        until = time.monotonic() + PATIENCE
        while not (ready(client) and client.machine and client.state and client.can_move):
            if time.monotonic() > until:
                raise InterpError(
                    f'the nodes do not answer in ROS domain {domain}, namespace {namespace}; '
                    'start the nodes, or name their --domain and --namespace'
                )
            client.serve()
        yield client, Machine.load(client.machine)


def move_by_hand(wanted: HandMove, namespace: str, domain: int | None) -> Ended:
    """Move axes of a running machine and wait for the end; Ctrl-C stops them.

    Raises InterpError if no machine answers, or it refuses the move.
    """
    with connected('jog', namespace, domain) as (client, machine):
        request = pose_request(wanted.values, wanted.speed) if wanted.pose else MoveAxes.Request(
            relative=wanted.relative, speed=wanted.speed, tool=wanted.tool * MM
        )  # fmt: skip
        for name, value in wanted.values.items() if not wanted.pose else ():
            if name not in machine.axis_names:
                raise InterpError(
                    f'the machine has no axis {name} ({" ".join(machine.axis_names)})'
                )
            request.axes.append(name)
            request.values.append(value * machine.axis(name).shown_size)
        with held_at_interrupt(client):
            return _followed(client, machine, request)


def home_axes(axes: Sequence[str], namespace: str, domain: int | None) -> list[str]:
    """Home axes of a running machine, all where none is named; Ctrl-C stops them.

    Raises InterpError if no machine answers, or it refuses.
    """
    with connected('home', namespace, domain) as (client, machine):
        client.granted(client.home(axes))
        wanted = set(axes or machine.homing.switches)
        with held_at_interrupt(client):
            state = _homed(client)
        known = zip(machine.axis_names, state.homed, strict=True)
        return [name for name, homed in known if name in wanted and not homed]


def _homed(client: OperatorClient) -> Any:
    begun, rests, states = False, 0, _states(client)
    while True:
        state = next(states)
        if state.state == MachineState.JOGGING:
            begun = True
            continue
        rests += 1
        if begun or rests > CERTAIN or state.state != MachineState.IDLE:
            return state


def _states(client: OperatorClient) -> Iterator[Any]:
    state, heard = client.state, time.monotonic()
    while True:
        client.serve()
        if client.state is not state:
            state, heard = client.state, time.monotonic()
            yield state
        elif time.monotonic() - heard > SILENCE:
            raise InterpError('machine_node does not answer any more')


@contextmanager
def held_at_interrupt(client: OperatorClient) -> Iterator[None]:
    """Hold the axes where Ctrl-C ends what is done here."""
    try:
        yield
    except KeyboardInterrupt:
        client.wait_for(client.trigger('feed_hold'))
        raise


def _followed(client: OperatorClient, machine: Machine, request: Any) -> Ended:
    answer = client.granted(client.move_axes(request))
    target, moved, states = np.array(answer.response.positions), False, _states(client)
    while True:
        state = next(states)
        moved = moved or state.state == MachineState.JOGGING
        position = np.array(state.commanded_positions)
        arrived = bool((np.abs(position - target) <= THERE).all())
        rests = state.resting and (moved or arrived)
        if rests or state.state in (MachineState.FAULT, MachineState.INACTIVE):
            held = state.reason == MachineState.REASON_FEED_HOLD
            short = state.message or ('feed hold' if held else 'stopped')
            return Ended(machine.axes, position, arrived, 'there' if arrived else short)
