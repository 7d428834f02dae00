"""Lines by hand (MDI) in the program node: when they may start, and their modal state."""

from collections.abc import Callable
from typing import Any

from cnc_interp_msgs.msg import MachineState, ModalState

from cnc_interp.machine_model.transform import Transform
from cnc_interp.nodes.peers import Peers
from cnc_interp.nodes.program_check import Prepared, prepare_line
from cnc_interp.nodes.program_run import ProgramRun, why_not
from cnc_interp.nodes.qos import LOADED
from cnc_interp.program.job import JobSetup
from cnc_interp.program.reading import MDI, MdiReader
from cnc_interp.run.run_phase import Code, Outcome
from cnc_interp.settings.options import Settings
from cnc_interp.wire.run_messages import modal_state


class Mdi:
    def __init__(
        self, node: Any, transform: Transform, settings: Settings,
        of_machine: Callable[[], JobSetup],
    ):  # fmt: skip
        self._transform, self._settings, self._of_machine = transform, settings, of_machine
        self._reader = MdiReader(transform, settings)
        self._publisher = node.create_publisher(ModalState, 'modal_state', LOADED)
        self._told: JobSetup | None = None

    def tell(self) -> None:
        """Publish the modal state if the offsets or tools of the machine have changed."""
        if (setup := self._of_machine()) is not self._told:
            self._told = setup
            self._publisher.publish(modal_state(self._reader.modes(setup)))

    def refusal(self, run: ProgramRun, peers: Peers, missing: str, busy: bool) -> Outcome | None:
        """Return why a line cannot start now; else store in its run where the machine stands."""
        if busy:
            return Outcome(Code.BUSY, 'a program is running; give the line when it has ended')
        machine = peers.machine
        run.name, run.stands = MDI, None if machine is None else machine.stands
        return why_not(missing, machine)

    def prepare(self, run: ProgramRun, goal: Any) -> Prepared:
        assert run.stands is not None
        return prepare_line(
            goal, self._reader, self._of_machine(), run.stands, self._transform, self._settings,
            run.preparation.has_checked,
        )  # fmt: skip

    def keep(self, prepared: Prepared | None) -> None:
        if prepared is not None and prepared.line is not None:
            self._reader.keep(prepared.line)
            self._told = None
            self.tell()


class ActiveModesTopic:
    def __init__(self, node: Any):
        self._publisher = node.create_publisher(ModalState, 'active_modes', LOADED)
        self._told = ('', -1)

    def tell(self, program: Prepared, state: MachineState) -> None:
        change = program.modes.change_before(state.sequence)
        told = (str(state.program_id), change)
        if told == self._told:
            return
        self._told = told
        if (modes := program.modes.after(change)) is None:
            self._publisher.publish(ModalState(program_id=state.program_id))
        else:
            self._publisher.publish(modal_state(modes, state.program_id))
