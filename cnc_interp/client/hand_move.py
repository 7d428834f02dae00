"""Motion by hand from the command line: moves, homing and MDI lines, and their results."""

import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import MachineState
from cnc_interp_msgs.srv import MoveAxes

from cnc_interp.client.operator_client import SILENCE, STOPS, Answer, OperatorClient
from cnc_interp.client.session import check_place, domain_of_nodes
from cnc_interp.core import MM, MM_PER_MIN, FloatArray, InterpError
from cnc_interp.machine_model.machine import Axis, Machine, place_text

PATIENCE = 10.0  #: Longest wait for the nodes [s].
CERTAIN = 20  #: Homing has ended after this many reports of a resting machine.
POSE = 'XYZIJK'  #: Letters of a pose: tool tip in the workpiece, then tool axis.
THERE = 1e-6  #: A move nearer to its target than this has arrived [m, rad].


@dataclass(frozen=True)
class Ended:
    axes: tuple[Axis, ...]
    position: FloatArray
    arrived: bool
    message: str

    def text(self) -> str:
        return f'{self.message}: {place_text(self.axes, self.position)}'

    def to_json(self) -> dict[str, Any]:
        names = [axis.name for axis in self.axes]
        position = dict(zip(names, self.position.tolist(), strict=True))
        return {'arrived': self.arrived, 'message': self.message, 'position': position}


def pose_request(values: dict[str, float], speed: float, length: float = MM) -> MoveAxes.Request:
    """Return the request that moves the tool to a pose; letters without a value stay."""
    request = MoveAxes.Request(speed=speed)
    request.tip = [values.get(name, math.nan) * length for name in POSE[:3]]
    if set(values) & set(POSE[3:]):
        request.axis = [values.get(name, 0.0) for name in POSE[3:]]
    return request


@contextmanager
def connected(
    name: str,
    namespace: str,
    domain: int | None,
    ready: Callable[[OperatorClient], bool] = lambda client: client.offers('move_axes'),
) -> Iterator[tuple[OperatorClient, Machine]]:
    domain = domain_of_nodes(domain)
    check_place(namespace, domain)
    with OperatorClient(name, namespace, domain) as client:
        until = time.monotonic() + PATIENCE
        while not all((client.machine, client.state, client.offers(*STOPS), ready(client))):
            if time.monotonic() > until:
                raise InterpError(
                    f'the nodes do not answer in ROS domain {domain}, namespace {namespace}; '
                    'start the nodes, or name their --domain and --namespace'
                )
            client.serve()
        yield client, Machine.load(client.machine)


def move_by_hand(
    namespace: str, domain: int | None, values: dict[str, float], pose: bool, **fields: Any
) -> Ended:
    """Move axes [mm, deg], or to a pose, and wait. Ctrl-C stops them; InterpError if rejected."""
    request = pose_request(values, fields['speed']) if pose else MoveAxes.Request(**fields)
    with connected('jog', namespace, domain) as (client, machine):
        for name, value in values.items() if not pose else ():
            if name not in machine.axis_names:
                known = ' '.join(machine.axis_names)
                raise InterpError(f'the machine has no axis {name} ({known})')
            request.axes.append(name)
            request.values.append(value * machine.axis(name).shown_size)
        with held_at_interrupt(client):
            return _followed(client, machine, request)


def home_axes(axes: Sequence[str], namespace: str, domain: int | None) -> list[str]:
    """Home axes, by default all; return the axes that are not homed. InterpError if rejected."""
    with connected('home', namespace, domain, lambda one: one.offers('home')) as (client, machine):
        client.granted(client.ask('home', axes=list(axes)))
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
    try:
        yield
    except KeyboardInterrupt:
        client.wait_for(client.ask('feed_hold'))
        raise


def _followed(client: OperatorClient, machine: Machine, request: Any) -> Ended:
    answer = client.granted(client.ask('move_axes', request))
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


PER_TURN = 1e-3  #: Unit in which a feed per revolution (G95) is shown [m].
MOST = 100  #: Number of lines in the history.


class LineHistory:
    """The MDI lines entered so far, latest first; all pages share them."""

    def __init__(self) -> None:
        self._lines: deque[str] = deque(maxlen=MOST)

    def add(self, line: str) -> None:
        if not self._lines or self._lines[0] != line:
            self._lines.appendleft(line)

    def at(self, age: int) -> tuple[int, str]:
        """Return an age limited to the history, and its line; 0: the latest, -1: an empty line."""
        age = max(-1, min(age, len(self._lines) - 1))
        return age, self._lines[age] if age >= 0 else ''


def modes_text(modes: Any) -> str:
    words = list(modes.codes)
    if 'G93' in words:
        words += [] if modes.duration != modes.duration else [f'F{60.0 / modes.duration:g}']
    elif modes.feedrate == modes.feedrate:
        unit = PER_TURN if 'G95' in words else MM_PER_MIN
        words.append(f'F{modes.feedrate / unit:.10g}')
    words += [f'S{modes.spindle_speed:g}'] if modes.spindle_speed else []
    words += [f'T{modes.tool}'] if modes.tool else []
    return ' '.join(words)


@dataclass(frozen=True)
class LineEnd:
    line: str
    answer: Answer
    modes: str
    place: str
    position: dict[str, float]

    @property
    def notices(self) -> list[str]:
        run = self.answer.response
        return list(run.notices) if run is not None else []

    def text(self) -> str:
        return f'{self.line}: {self.answer.message}: {self.place}' if self.line else self.place

    def to_json(self) -> dict[str, Any]:
        told = {'line': self.line, 'ok': self.answer.ok, 'message': self.answer.message}
        return told | {'modes': self.modes, 'position': self.position}


def give_lines(lines: Sequence[str], namespace: str, domain: int | None) -> Iterator[LineEnd]:
    """Execute MDI lines until one is rejected, and yield the result of each.

    Without lines, yield one result with the modal state.
    """
    with connected('mdi', namespace, domain, lambda one: not one.silent and bool(one.modes)) as (
        client,
        machine,
    ):
        if not lines:
            yield _end(client, machine, '', Answer(True, 'the modal state'))
        for line in lines:
            asked = client.give_line(line)
            try:
                answer = client.wait_for(asked)
            except KeyboardInterrupt:
                client.cancel_lines()
                client.wait_for(asked)
                raise
            run = answer.response
            while run is not None and run.samples and not _rests(client.state, run.program_id):
                client.serve()
            yield _end(client, machine, line, answer)
            if not answer.ok:
                return


def _rests(state: Any, program_id: str) -> bool:
    return bool(state.program_id == program_id and state.resting)


def _end(client: OperatorClient, machine: Machine, line: str, answer: Answer) -> LineEnd:
    assert client.state is not None
    position = client.state.commanded_positions
    place = place_text(machine.axes, position)
    at = dict(zip(machine.axis_names, map(float, position), strict=True))
    return LineEnd(line, answer, modes_text(client.modes), place, at)
