"""Offsets and tools of a running machine from the command line: show them, change them."""

from __future__ import annotations

import time
from typing import Any

from cnc_interp.client.length_unit import MILLIMETRES
from cnc_interp.client.operator_client import OperatorClient
from cnc_interp.client.session import check_place, domain_of_nodes
from cnc_interp.client.setup_client import SetupClient, of_axes, offset_row, work_coordinates
from cnc_interp.core.errors import InterpError
from cnc_interp.program.job import ROTATION

PATIENCE = 10.0  #: Longest wait for the nodes [s].


class SetupConsole:
    """A connection to the table of running nodes.

    ``domain``: their ROS domain; None takes that of the environment. Raises InterpError if no
    program_node answers there.
    """

    def __init__(self, namespace: str, domain: int | None):
        domain = domain_of_nodes(domain)
        check_place(namespace, domain)
        self._client = OperatorClient('setup', namespace, domain)
        self._setup = SetupClient(self._client, 'cnc-interp')
        until = time.monotonic() + PATIENCE
        while not self._setup.is_ready or self._client.state is None:
            if time.monotonic() > until:
                self._client.close()
                raise InterpError(
                    f'no nodes answer in ROS domain {domain}, namespace {namespace}; start them, '
                    'or name their --domain and --namespace'
                )
            self._client.serve()

    def values(self, words: dict[str, float]) -> dict[str, Any]:
        """Return values by axis letter [mm, deg] as the fields of a request [m, rad]."""
        return of_axes({letter: x * MILLIMETRES.of(letter) for letter, x in words.items()})

    def ask(self, service: str, **request: Any) -> str:
        """Change something; returns what was changed.

        Raises InterpError if it is refused.
        """
        answer = self._client.granted(self._setup.ask(service, **request))
        return answer.message.partition(': ')[2]

    def offsets_text(self) -> str:
        """Return positions and offsets as a table in mm and deg; a star marks the active one."""
        table, setup, state = self._setup.table, self._setup.setup, self._client.state
        assert table is not None
        assert state is not None
        machine = dict(zip(table.axes, state.positions, strict=False))
        rows = [('machine', machine), (f'work {setup.offset}', self._work())]
        rows += [
            (f'{name}{" *" if name == setup.offset else ""}', offset_row(table, setup, name))
            for name in sorted({setup.offset, *setup.work_offsets})
        ]
        if setup.g92:
            amounts = dict.fromkeys(table.axes, 0.0) | dict(setup.g92)
            rows.append(('G92' if setup.g92_on else 'G92 off', amounts))
        letters = [*table.axes]
        if any(setup.rotation(name) for name in setup.work_offsets):
            letters.append(ROTATION)
        lines = [' ' * 10 + ''.join(f'{letter:>12}' for letter in letters)]
        for name, position in rows:
            texts = {k: MILLIMETRES.shown(k, value) for k, value in position.items()}
            values = ''.join(f'{texts.get(k, ""):>12}' for k in letters)
            lines.append(f'{name:<10}{values}'.rstrip())
        return '\n'.join([*lines, self._file_text()])

    def tools_text(self) -> str:
        """Return the tool table in mm; a star marks the tool in the spindle."""
        setup = self._setup.setup
        lines = [f'{"tool":<8}{"length":>12}{"radius":>12}{"corner":>12}  remark']
        for number in sorted({*setup.tools} | ({setup.tool} if setup.tool else set())):
            star = ' *' if number == setup.tool else ''
            tool = setup.tools.get(number)
            values = 'not in the table'
            if tool is not None:
                sizes = ''.join(
                    f'{"" if v is None else MILLIMETRES.length(v):>12}'
                    for v in (tool.length, tool.radius, tool.corner_radius)
                )
                values = f'{sizes}  {tool.remark}'
            lines.append(f'{number}{star:<{8 - len(str(number))}}{values}'.rstrip())
        return '\n'.join([*lines, self._file_text()])

    def to_json(self) -> dict[str, Any]:
        """Return everything for machines to read, in SI."""
        setup, table, state = self._setup.setup, self._setup.table, self._client.state
        assert table is not None
        assert state is not None
        return {
            'file': table.file,
            'machine': dict(zip(table.axes, state.positions, strict=False)),
            'work': self._work(),
            'active': setup.offset,
            'work_offsets': {k: dict(v) for k, v in setup.work_offsets.items()},
            'g92': dict(setup.g92),
            'g92_on': setup.g92_on,
            'tools': {str(number): vars(tool) for number, tool in setup.tools.items()},
            'tool': setup.tool,
            'in_use': list(table.in_use),
        }

    def _work(self) -> dict[str, float]:
        """Return the work coordinates [m, rad]."""
        table, state = self._setup.table, self._client.state
        assert table is not None
        assert state is not None
        return work_coordinates(table, self._setup.setup, state.positions)

    def _file_text(self) -> str:
        assert self._setup.table is not None
        return f'kept in {self._setup.table.file or "program_node only, until it ends"}'

    def __enter__(self) -> SetupConsole:
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close()
