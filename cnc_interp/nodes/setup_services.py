"""Offsets and tools of the machine over ROS: services and the topic ``setup_table``."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import SetupTable as SetupMessage
from cnc_interp_msgs.srv import ReadSetup, SetOffset, SetTool, TouchOff

from cnc_interp.core import InterpError
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.nodes.node_main import answering
from cnc_interp.nodes.peers import Peers
from cnc_interp.nodes.qos import LOADED
from cnc_interp.program import setup_table as tables
from cnc_interp.program.geometry.program_coordinates import ProgramCoordinates
from cnc_interp.program.job import ROTATION, WORK_OFFSETS, JobSetup, SetupChange, Tool
from cnc_interp.wire.run_messages import setup_table

FRESH = 2.0  #: Largest age of the machine's state for a touch-off [s].
#: Tolerance of rotary axes at zero [rad].
AT_ZERO = 1e-9
RUNNING = frozenset(('active offset', 'spindle'))


class SetupServices:
    def __init__(
        self,
        node: Any,
        table: tables.SetupTable,
        transform: Transform,
        peers: Peers,
        coordinates: Callable[[JobSetup], ProgramCoordinates],
        wake: Callable[[], None],
        require_tool: Callable[[int, Tool], None] | None = None,
    ):
        self._transform, self._coordinates = transform, coordinates
        self._require_tool = require_tool  # raises InterpError if the scene cannot hold it
        self._table, self._peers, self._node = table, peers, node
        zero = transform.linear(np.zeros((1, 3)), np.zeros((1, 2)))[0].tolist()
        names = transform.machine.program_names
        self._zero = dict(zip(names, [*zero, 0.0, 0.0], strict=False))
        self._program, self._program_id, self._in_use = '', '', frozenset[str]()
        self._publisher = node.create_publisher(SetupMessage, 'setup_table', LOADED)
        node.create_service(ReadSetup, 'read_setup', self._read)
        for kind, name, changes in (
            (SetOffset, 'set_offset', self._offset),
            (SetTool, 'set_tool', self._tool),
            (TouchOff, 'touch_off', self._touch_off),
        ):
            node.create_service(kind, name, answering(partial(self._change, changes), wake))
        self._publisher.publish(self._message())

    def _message(self) -> SetupMessage:
        table, file = self._table, self._table.file
        return setup_table(
            table.setup,
            str(file) if file else '',
            self._zero,
            self._program_id,
            self._in_use,
            table.changed_by,
            table.change,
        )

    def use(self, program: str, program_id: str, in_use: frozenset[str]) -> None:
        self._program, self._program_id, self._in_use = program, program_id, in_use
        self._publisher.publish(self._message())

    def release(self) -> None:
        self.use('', '', frozenset())

    def apply(self, changes: Sequence[SetupChange], who: str) -> str:
        """Change the table and publish it; return the changes as text, or raise InterpError."""
        told = self._table.apply(changes, who)
        if told:
            self._node.get_logger().info(f'{who}: {told}')
            self._publisher.publish(self._message())
        return told

    def _read(self, _request: Any, response: ReadSetup.Response) -> Any:
        response.table = self._message()
        return response

    def _change(
        self, changes: Callable[[Any], tuple[list[SetupChange], str]], request: Any, _response: Any
    ) -> str:
        wanted, note = changes(request)
        self._require_unused(wanted)
        return (self.apply(wanted, request.client) or 'nothing changes') + note

    def _require_unused(self, changes: list[SetupChange]) -> None:
        for change in changes:
            if self._program and change.name in self._in_use | RUNNING:
                raise InterpError(
                    f'{change.name} is used by {self._program}, which is running; change it when '
                    'the program has ended'
                )

    def _offset(self, request: SetOffset.Request) -> tuple[list[SetupChange], str]:
        turned = (ROTATION,) if request.offset != 'G92' else ()
        values = tables.values_by_axis(request.axes, request.values, (*self._zero, *turned))
        return tables.offset_changes(
            self._table.setup, request.offset, values, request.clear, request.activate
        ), ''

    def _tool(self, request: SetTool.Request) -> tuple[list[SetupChange], str]:
        given = {name: getattr(request, name, 0.0) for name in request.fields}
        number, setup = request.number, self._table.setup
        changes = tables.tool_changes(setup, number, given, request.remove, request.load)
        for change in changes:
            if self._require_tool is not None and isinstance(change.value, Tool):
                self._require_tool(number, change.value)
        return changes, ''

    def _touch_off(self, request: TouchOff.Request) -> tuple[list[SetupChange], str]:
        values = tables.values_by_axis(request.axes, request.values, tuple(self._zero))
        state = self._peers.state
        if state is None or self._peers.missing(time.monotonic(), FRESH) == 'machine_node':
            raise InterpError('machine_node does not answer; start it, then touch off')
        if not self._peers.at_rest:
            raise InterpError('the axes are moving; touch off when they rest')
        setup, q = self._table.setup, np.array(state.commanded_positions)
        name = request.offset or setup.offset
        frame = self._coordinates(
            setup.changed(SetupChange('active', name)) if name in WORK_OFFSETS else setup
        )
        tip, axis = self._transform.forward(q[None])
        zero = np.array([self._zero[letter] for letter in 'XYZ'])
        q = self._transform.counted(q, tip[0])
        here = frame.of_place(q, tip[0], axis[0], zero).tolist()
        reads = dict(zip(self._zero, here, strict=False))
        turned = [
            k for k, x in zip(self._zero, q, strict=False) if k not in 'XYZ' and abs(x) > AT_ZERO
        ]
        note = ''
        if turned and set(values) & set('XYZ') and not frame.of_tip:
            note = (
                f'; {" and ".join(turned)} not at 0: this offset suits programs without TCP; '
                'for programs with TCP, touch off with the rotary axes at 0'
            )
        changes = tables.touch_off_changes(setup, request.offset, values, reads, frame, self._zero)
        return changes, note
