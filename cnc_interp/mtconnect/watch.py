"""Subscribe to the nodes and store their state."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from cnc_interp_msgs.msg import LoadedProgram, MachineState, ModalState, SetupTable
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import GetParameters

from cnc_interp.client.question import Question
from cnc_interp.client.served_node import ServedNode
from cnc_interp.core import MM
from cnc_interp.machine_model.machine import Machine
from cnc_interp.mtconnect.device import CONDITION_OF, OTHER_CONDITION, in_units
from cnc_interp.mtconnect.documents import asset_id
from cnc_interp.mtconnect.store import FAULT, NORMAL, WARNING, Store
from cnc_interp.nodes.peers import watch_machine
from cnc_interp.nodes.qos import DIAGNOSTICS, LOADED
from cnc_interp.program import JobSetup
from cnc_interp.program.job import Tool

SILENCE = 2.0  #: If the machine is silent for this time, it is unavailable [s].
STEP = 0.1  #: Time between two updates of the store [s].
S = MachineState
#: Machine state -> MTConnect execution; and for HELD: reason -> execution.
EXECUTION = {
    S.IDLE: 'READY',
    S.RUNNING: 'ACTIVE',
    S.HOLDING: 'FEED_HOLD',
    S.HELD: 'INTERRUPTED',
    S.STARVED: 'WAIT',
    S.STOPPING: 'STOPPED',
    S.FAULT: 'STOPPED',
    S.INACTIVE: 'STOPPED',
    S.JOGGING: 'READY',
}
HELD_BY = {
    S.REASON_FEED_HOLD: 'FEED_HOLD',
    S.REASON_PROGRAM_STOP: 'PROGRAM_STOPPED',
    S.REASON_OPTIONAL_STOP: 'OPTIONAL_STOP',
    S.REASON_FUNCTION: 'WAIT',
}
LEVELS = {DiagnosticStatus.WARN: WARNING, DiagnosticStatus.ERROR: FAULT}
ITEM_OF = {'LOGIC_PROGRAM': 'logic', 'SYSTEM': 'system', OTHER_CONDITION: 'motion'}
SILENT, STATE = 'silent', 'state'  #: Codes of conditions that no diagnostics report.


class MachineWatch(ServedNode):
    """A ROS node that only subscribes, and updates the store of the agent."""

    def __init__(self, namespace: str, domain: int | None):
        super().__init__('mtconnect_agent', namespace, domain)
        self.machine: Machine | None = None
        self.tools: dict[int, Tool] = {}
        self._assets: dict[str, int] = {}  # the tool that was changed, and removed, last
        self._store: Store | None = None
        self._program = LoadedProgram()
        self._lines: list[str] = []
        self._modes = ModalState()
        self._setup = JobSetup()
        self._state: MachineState | None = None
        self._heard = self._told = -SILENCE
        self._parts, self._counted = 0, ''  # programs executed, and the last of them
        self._diagnostics: dict[str, DiagnosticStatus] = {}
        self._was_stopped = False
        self._reset: dict[str, str] = {}  # reports of parts of nodes when the machine was reset
        node = self.node
        watch_machine(node, self._see_state)
        take: tuple[tuple[Any, str, Callable[[Any], None]], ...] = (
            (LoadedProgram, 'loaded_program', self._see_program),
            (ModalState, 'active_modes', self._see_modes),
            (SetupTable, 'setup_table', self._see_setup),
        )
        for kind, topic, see in take:
            node.create_subscription(kind, topic, see, LOADED)
        node.create_subscription(DiagnosticArray, '/diagnostics', self._see_parts, DIAGNOSTICS)
        asked = node.create_client(GetParameters, 'machine_node/get_parameters')
        self._name = Question(asked, GetParameters.Request(names=['machine']))

    def knows_machine(self) -> bool:
        """Request the machine's name; return whether it is known. MachineError: no such file."""
        answer = self._name.answer()
        if answer is not None and answer.values:
            self.machine = Machine.load(answer.values[0].string_value)
        return self.machine is not None

    def tell(self, store: Store) -> None:
        """Set the store that ``step`` updates."""
        self._store = store

    # Receiving ----------------------------------------------------------------------------------

    def _see_state(self, state: MachineState) -> None:
        self._state, self._heard = state, time.monotonic()

    def _see_program(self, program: LoadedProgram) -> None:
        self._program, self._lines = program, program.text.splitlines()

    def _see_modes(self, modes: ModalState) -> None:
        self._modes = modes

    def _see_setup(self, table: SetupTable) -> None:
        self._setup, before = JobSetup.of_text(table.text), self.tools
        self.tools = dict(self._setup.tools)
        for number in sorted(before.keys() | self.tools.keys()):
            if before.get(number) != self.tools.get(number):
                kind = 'asset_changed' if number in self.tools else 'asset_removed'
                self._assets[kind] = number

    def _see_parts(self, array: DiagnosticArray) -> None:
        for status in array.status:
            if status.hardware_id == self.namespace:
                self._diagnostics[status.name] = status

    # Reporting ----------------------------------------------------------------------------------

    def step(self) -> None:
        """Serve the node for a short time, and update the store with the machine's state."""
        self.serve(STEP)
        now = time.monotonic()
        store, state, machine = self._store, self._state, self.machine
        if store is None or machine is None or now - self._told < STEP:
            return
        self._told = now
        if state is None or now - self._heard > SILENCE:
            store.lose()
            return
        store.observe(self._values(machine, state))
        stopped = state.state in (S.FAULT, S.STOPPING)
        if self._was_stopped and not stopped:
            self._reset = {one.name: one.message for one in self._diagnostics.values()}
        self._was_stopped = stopped
        for status in self._diagnostics.values():
            item = ITEM_OF[CONDITION_OF.get(status.name.partition(':')[0], OTHER_CONDITION)]
            old = self._reset.get(status.name) == status.message
            level = NORMAL if old else LEVELS.get(status.level, NORMAL)
            store.condition(item, level, status.name, status.message)
        for item in (*ITEM_OF.values(), 'communications'):
            store.condition(item, NORMAL)
        store.condition('system', FAULT if stopped else NORMAL, STATE, state.message)

    def _values(self, machine: Machine, state: MachineState) -> dict[str, str]:
        program, modes = self._program, self._modes
        mine = program.program_id == state.program_id
        if state.completed and not program.mdi and mine and state.program_id != self._counted:
            self._parts, self._counted = self._parts + 1, state.program_id
        line = state.line_number if mine else 0
        tool = self._setup.tool
        wanted = 0.0 if modes.program_id != state.program_id else modes.spindle_speed
        values = {
            'availability': 'AVAILABLE',
            'execution': self._execution(state),
            'mode': self._mode(state),
            'emergency_stop': 'TRIGGERED' if _stopped(state) else 'ARMED',
            'program': program.name,
            'line': str(line),
            'block': self._lines[line - 1].strip() if 0 < line <= len(self._lines) else '',
            'feed': f'{state.feedrate / MM:.3f}',
            'feed_override': f'{100.0 * state.feed_override:g}',
            'rapid_override': f'{100.0 * state.rapid_override:g}',
            'spindle_override': f'{100.0 * state.spindle_override:g}',
            'spindle_speed': f'{state.spindle_speed:.1f}',
            'spindle_wanted': f'{wanted:.1f}',
            'tip': ' '.join(f'{value / MM:.4f}' for value in state.tip),
            'tool': str(tool),
            'tool_asset': asset_id(machine.name, tool) if tool in self.tools else '',
            'parts': str(self._parts),
            **{kind: asset_id(machine.name, number) for kind, number in self._assets.items()},
        }
        for number, name in enumerate(machine.axis_names):
            for what, q in (('actual', state.positions), ('commanded', state.commanded_positions)):
                values[f'{name}_{what}'] = f'{in_units(machine, number, q[number]):.4f}'
        return values

    def _execution(self, state: MachineState) -> str:
        if state.state == S.HELD:
            return HELD_BY.get(state.reason, EXECUTION[S.HELD])
        if state.state == S.IDLE and state.completed and not self._program.mdi:
            return 'PROGRAM_COMPLETED'
        return EXECUTION[state.state]

    def _mode(self, state: MachineState) -> str:
        if state.state == S.JOGGING:
            return 'MANUAL'
        if self._program.mdi and state.program_id == self._program.program_id:
            return 'MANUAL_DATA_INPUT'
        return 'SEMI_AUTOMATIC' if state.single_block else 'AUTOMATIC'


def _stopped(state: MachineState) -> bool:
    return state.reason == S.REASON_EMERGENCY_STOP and state.state in (S.STOPPING, S.FAULT)
