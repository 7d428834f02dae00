"""Show and change offsets and tools of the machine, for the page and the command line."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import starmap
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import SetupTable

from cnc_interp.client.hand_move import connected
from cnc_interp.client.length_unit import MILLIMETRES, LengthUnit
from cnc_interp.client.operator_client import Answer, MachineState, OperatorClient
from cnc_interp.core import FloatArray
from cnc_interp.machine_model.machine import Machine
from cnc_interp.nodes.qos import LOADED
from cnc_interp.program import JobSetup
from cnc_interp.program.geometry.frames import rotation
from cnc_interp.program.job import ROTATION, TOOL_SIZES, TOOL_TEXTS, Tool


@dataclass(frozen=True)
class OffsetChange:
    """A change of an offset [m, rad]: explicit values before it; all values before and after."""

    name: str
    had: dict[str, float]
    counted: dict[str, float]
    counts: dict[str, float]

    def text(self, unit: LengthUnit) -> str:
        """Return a text with the changed values, such as ``G54 X -5.000 → 32.500 mm``."""
        shown = {
            letter: (unit.shown(letter, self.counted.get(letter, 0.0)), unit.shown(letter, value))
            for letter, value in self.counts.items()
        }
        words = [
            f'{letter} {was} → {now} {unit.suffix(letter)}'
            for letter, (was, now) in shown.items()
            if was != now
        ]
        return f'{self.name} {", ".join(words) or "changed by less than the last digit shown"}'


@dataclass(frozen=True)
class Proposal:
    """Changes that a probing cycle proposes and that are not set yet."""

    offsets: tuple[OffsetChange, ...]  #: Proposed changes of offsets.
    tools: dict[int, Tool]  #: Changed tools by number.
    after: JobSetup  #: All offsets and tools after the change.

    def texts(self, before: JobSetup, unit: LengthUnit) -> list[str]:
        told = [one.text(unit) for one in self.offsets]
        for number, tool in self.tools.items():
            had = before.tools.get(number)
            was = unit.length(had.worn.length) if had is not None else 'not known'
            told.append(
                f'tool {number}: length {was} → {unit.length(tool.worn.length)} {unit.name}'
            )
        return told


def offset_changes(
    table: SetupTable, before: JobSetup, after: JobSetup
) -> tuple[OffsetChange, ...]:
    return tuple(
        OffsetChange(
            name,
            dict(position_of(before, name)),
            offset_row(table, before, name),
            offset_row(table, after, name),
        )
        for name in sorted({'G92', *before.work_offsets, *after.work_offsets})
        if position_of(before, name) != position_of(after, name)
    )


class SetupClient:
    """Listens to the table of offsets and tools, and changes it under the name ``who``."""

    def __init__(self, nodes: OperatorClient, who: str):
        self._nodes, self._who = nodes, f'{who} of {os.environ.get("USER") or os.getuid()}'
        self.table: SetupTable | None = None  #: Table received last; None if none.
        self.setup = JobSetup()
        #: Last change of offsets, by any client; empty if there was none.
        self.changes: tuple[OffsetChange, ...] = ()
        nodes.node.create_subscription(SetupTable, 'setup_table', self._see, LOADED)

    def _see(self, table: SetupTable) -> None:
        before, self.setup = self.setup, JobSetup.of_text(table.text)
        known, self.table = self.table is not None, table
        if known and (changes := offset_changes(table, before, self.setup)):
            self.changes = changes

    def proposal(self, text: str) -> Proposal:
        """Return the changes that an MDI line proposes; ``text``: `proposed` of its result."""
        assert self.table is not None
        after = JobSetup.of_text(text) if text else self.setup
        tools = {n: tool for n, tool in after.tools.items() if tool != self.setup.tools.get(n)}
        return Proposal(offset_changes(self.table, self.setup, after), tools, after)

    async def take(self, proposal: Proposal) -> Answer:
        after = proposal.after
        wanted = [whole_offset(one.name, position_of(after, one.name)) for one in proposal.offsets]
        return await self.ask_each([*wanted, *starmap(whole_tool, proposal.tools.items())])

    async def undo(self, changes: tuple[OffsetChange, ...]) -> Answer:
        """Restore the offsets before ``changes``; reject this if they are not the last changes."""
        if changes != self.changes:
            return Answer(False, 'the offsets were changed again: check the last change')
        return await self.ask_each(whole_offset(one.name, one.had) for one in changes)

    async def ask_each(self, requests: Iterable[tuple[str, dict[str, Any]]]) -> Answer:
        """Send requests in order, up to the first that is rejected; return the last answer."""
        answer = Answer(True, 'nothing to set')
        for service, request in requests:
            answer = await asyncio.wrap_future(self.ask(service, **request))
            if not answer.ok:
                break
        return answer

    def ask(self, service: str, **request: Any) -> Future[Answer]:
        return self._nodes.ask(service, client=self._who, **request)


def whole_offset(name: str, values: Mapping[str, float]) -> tuple[str, dict[str, Any]]:
    """Return the service and the request that give an offset exactly these values."""
    return 'set_offset', {'offset': name, 'clear': True, **of_axes(values)}


def whole_tool(number: int, tool: Tool) -> tuple[str, dict[str, Any]]:
    """Return the service and the request that store exactly this tool in the table."""
    sizes = {name: getattr(tool, name) for name in TOOL_SIZES}
    given = {name: size for name, size in sizes.items() if size is not None}
    given |= {name: getattr(tool, name) for name in ('pocket', *TOOL_TEXTS)}
    return 'set_tool', {'number': number, 'fields': list(given), **given}


def of_axes(values: Mapping[str, float]) -> dict[str, Any]:
    return {'axes': list(values), 'values': list(values.values())}


def position_of(setup: JobSetup, name: str) -> Mapping[str, float]:
    """Return the explicitly set values of a work offset or of G92 [m, rad]."""
    return setup.g92 if name == 'G92' else setup.work_offsets.get(name, {})


def offset_row(table: SetupTable, setup: JobSetup, name: str) -> dict[str, float]:
    """Return all values of a work offset (with its rotation R) or of G92 [m, rad].

    Values that are not set are those of the machine file in a work offset, and 0 in G92.
    """
    if name == 'G92':
        return dict.fromkeys(table.axes, 0.0) | dict(setup.g92)
    zero = dict(zip(table.axes, table.zero, strict=True))
    return zero | {ROTATION: 0.0} | dict(setup.work_offsets.get(name, {}))


def work_zero(table: SetupTable, setup: JobSetup, name: str) -> tuple[FloatArray, float]:
    """Return the position in W [m] and rotation [rad] of a work offset's zero, G92 included."""
    row = offset_row(table, setup, name)
    zero = dict(zip(table.axes, table.zero, strict=True))
    added = [setup.g92.get(letter, 0.0) if setup.g92_on else 0.0 for letter in 'XYZ']
    place = np.array([row[letter] - zero[letter] for letter in 'XYZ'])
    return place + rotation(2, row[ROTATION]) @ added, row[ROTATION]


@contextmanager
def connected_setup(
    name: str, namespace: str, domain: int | None
) -> Iterator[tuple[OperatorClient, SetupClient, Machine]]:
    found: list[SetupClient] = []

    def ready(client: OperatorClient) -> bool:
        if not found:
            found.append(SetupClient(client, 'cnc-interp'))
        offers = client.offers('set_offset', 'set_tool', 'touch_off')
        return found[0].table is not None and offers and not client.silent

    with connected(name, namespace, domain, ready) as (client, machine):
        yield client, found[0], machine


@contextmanager
def setup_console(namespace: str, domain: int | None) -> Iterator[SetupConsole]:
    with connected_setup('setup', namespace, domain) as (client, setup, _):
        yield SetupConsole(client, setup)


class SetupConsole:
    def __init__(self, client: OperatorClient, setup: SetupClient):
        self._client, self._setup = client, setup

    @property
    def _now(self) -> tuple[SetupTable, JobSetup, MachineState]:
        table, state = self._setup.table, self._client.state
        assert table is not None
        assert state is not None
        return table, self._setup.setup, state

    @property
    def tools(self) -> Mapping[int, Tool]:
        return self._setup.setup.tools

    def values(self, words: dict[str, float]) -> dict[str, Any]:
        return of_axes({letter: x * MILLIMETRES.of(letter) for letter, x in words.items()})

    def ask(self, service: str, **request: Any) -> str:
        return self._client.granted(self._setup.ask(service, **request)).message

    def offsets_text(self) -> str:
        table, setup, _ = self._now
        rows = [('machine', self._machine()), (f'work {setup.offset}', self._work())]
        rows += [
            (f'{name}{" *" if name == setup.offset else ""}', offset_row(table, setup, name))
            for name in sorted({setup.offset, *setup.work_offsets})
        ]
        if setup.g92:
            rows.append(('G92' if setup.g92_on else 'G92 off', offset_row(table, setup, 'G92')))
        letters = [*table.axes]
        if any(setup.rotation(name) for name in setup.work_offsets):
            letters.append(ROTATION)
        lines = [' ' * 10 + ''.join(f'{letter:>12}' for letter in letters)]
        for name, position in (row for row in rows if row[1]):
            texts = {k: MILLIMETRES.shown(k, value) for k, value in position.items()}
            values = ''.join(f'{texts.get(k, ""):>12}' for k in letters)
            lines.append(f'{name:<10}{values}'.rstrip())
        counts = f'program: {self._now[2].coordinates}'
        return '\n'.join([*lines, counts, self._file_text()])

    def tools_text(self) -> str:
        setup = self._setup.setup
        lines = [
            f'{"tool":<8}{"length":>12}{"radius":>12}{"corner":>12}{"wear Z":>10}{"wear R":>10}'
            f'{"flute":>10}{"pocket":>8}  {"holder":<8}  remark'
        ]
        for number in sorted({*setup.tools} | ({setup.tool} if setup.tool else set())):
            star = ' *' if number == setup.tool else ''
            tool = setup.tools.get(number)
            values = 'not in the table'
            if tool is not None:
                sizes = ''.join(
                    f'{"" if v is None else MILLIMETRES.length(v):>12}'
                    for v in (tool.length, tool.radius, tool.corner_radius)
                )
                more = ''.join(
                    f'{MILLIMETRES.length(v) if v else "":>10}'
                    for v in (tool.length_wear, tool.radius_wear, tool.flute)
                )
                values = f'{sizes}{more}{tool.pocket or "":>8}  {tool.holder:<8}  {tool.remark}'
            lines.append(f'{number}{star:<{8 - len(str(number))}}{values}'.rstrip())
        return '\n'.join([*lines, self._file_text()])

    def to_json(self) -> dict[str, Any]:
        table, setup, _ = self._now
        return {
            'file': table.file,
            'machine': self._machine(),
            'work': self._work(),
            'active': setup.offset,
            'work_offsets': {k: dict(v) for k, v in setup.work_offsets.items()},
            'g92': dict(setup.g92),
            'g92_on': setup.g92_on,
            'tools': {str(number): vars(tool) for number, tool in setup.tools.items()},
            'tool': setup.tool,
            'in_use': list(table.in_use),
        }

    def _machine(self) -> dict[str, float]:
        """Return axis -> position, for the axes in the table; joints of an arm are not in it."""
        table, _, state = self._now
        has_them = len(state.positions) == len(state.program_positions)
        return dict(zip(table.axes, state.positions, strict=False)) if has_them else {}

    def _work(self) -> dict[str, float]:
        table, _, state = self._now
        return dict(zip(table.axes, state.program_positions, strict=False))

    def _file_text(self) -> str:
        return f'kept in {self._now[0].file or "program_node only, until it ends"}'
