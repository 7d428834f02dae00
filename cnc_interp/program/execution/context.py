"""The objects on which words act: motion, planes, cycles, tools, outputs and program flow."""

from __future__ import annotations

from copy import deepcopy

from cnc_interp.core import FloatArray
from cnc_interp.machine_model import signals
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.blocks.block_modes import NONE, ActiveModes
from cnc_interp.program.blocks.functions import Acting, acting
from cnc_interp.program.blocks.targets import TargetColumns
from cnc_interp.program.geometry.arcs import PLANES
from cnc_interp.program.job import JobSetup
from cnc_interp.program.modal.state import words_of_state
from cnc_interp.program.modal.system_variables import named, numbered
from cnc_interp.program.motion import probing
from cnc_interp.program.motion.block_motion import Mover
from cnc_interp.program.motion.cycles import CannedCycle, SiemensCycle, dwell_of
from cnc_interp.program.motion.probing import Probe
from cnc_interp.program.motion.splines import Splines
from cnc_interp.program.motion.tilted_plane import TiltedPlane
from cnc_interp.program.notices import Notices
from cnc_interp.program.text.control_traits import LINUXCNC, Dialect
from cnc_interp.program.text.expressions import ProgramVariables
from cnc_interp.program.text.flow import Flow
from cnc_interp.program.text.source import Source
from cnc_interp.settings.options import Settings

#: State saved by M70: modal values and outputs; M6 saves it without outputs.
State = tuple[dict[str, object], dict[str, str] | None]


class Execution:
    def __init__(
        self,
        geometry: Transform,
        settings: Settings,
        setup: JobSetup,
        source: Source,
        notices: Notices,
        dialect: Dialect,
    ):
        self.settings = settings
        self.variables = ProgramVariables(
            lambda: numbered(self.mover, self.tool, self.cycle.code if self.cycle else ''),
            lambda: named(self.mover, self.mover.setup.tool, self.chosen_tool, self.outputs),
            dialect.readings,
        )
        self.flow = Flow(source, self.variables, settings.most_jumps)
        self.mover = Mover(geometry, settings, setup, self.flow, notices)
        self.mover.dialect = dialect
        self.mover.motion = dialect.starts_with
        self.mover.centres_open &= dialect is not LINUXCNC
        self.fault, self.demand = self.flow.fault, self.flow.demand
        self.refuse_if = self.flow.refuse_if
        self.notice = self.mover.notice
        self.splines = Splines(self.mover)
        self.plane = TiltedPlane(self.mover)
        self.signals = geometry.machine.signals
        self.tool_change_macro = geometry.machine.tool_change_macro
        self.cycle: CannedCycle | None = None
        self.called: SiemensCycle | None = None  # by MCALL
        self.tool = self.chosen_tool = setup.tool
        self.has_tool = False  # whether the last M6 names the tool in the spindle
        self.outputs: dict[str, str] = {}  # the last M code of each output
        #: Values that functions set last: G94 or G95, and with G96 those named by ``SURFACE``.
        self.states: tuple[str, tuple[float, ...]] = 'G94', ()
        self.times: dict[str, float] = {}  # letters of the dwell of this block
        self.set_here: dict[str, str] = {}  # by modal value, the code of this block
        self.whole = True  # whether more lines can follow, so that it can look ahead
        self.finished = False  # whether M2 or M30 was read
        #: Whether a machine executes the program while it is read. Reading then continues after
        #: each probe, and tool lengths must be known.
        self.is_live = False
        self.probe: Probe | None = None  # that is waited for

    @property
    def targets(self) -> TargetColumns:
        return self.mover.targets

    def follow(self, before: Execution) -> None:
        self.mover.follow(before.mover)
        self.variables.follow(before.variables)
        self.chosen_tool = before.chosen_tool or self.tool
        self.cycle = deepcopy(before.cycle)
        self.outputs = dict(before.outputs)

    def stand_at(self, q: FloatArray) -> None:
        self.mover.stand_at(q)
        if self.cycle is not None:
            self.cycle.start = self.level()

    def level(self) -> float:
        return float(self.mover.here()[PLANES[self.mover.plane][2]])

    def active_modes(self, offset: str, tool: int) -> ActiveModes:
        code = '' if self.cycle is None else self.cycle.code
        return self.mover.active_modes(code, offset, tool, self.outputs)

    def state(self) -> tuple[float, float, float]:
        """Return the number of the current modal state, the motion code and the feed."""
        mover, tool = self.mover, self.tool
        code = '' if self.cycle is None else self.cycle.code
        motion = NONE if code or mover.motion is None else float(mover.motion)
        number = mover.targets.modes.number(
            (code, tool, *self.outputs.values(), *mover.recorded_values()),
            lambda: self.active_modes(mover.setup.offset, tool),
        )
        return number, motion, mover.feed_word

    def state_words(self) -> tuple[str, ...]:
        words = words_of_state(self.mover)
        if self.tool:
            words.insert(0, f'T{self.tool}')
        if self.mover.spindle_speed:
            words.append(f'S{self.mover.spindle_speed:g}')
        return (*words, *(code for code in self.outputs.values() if code))

    def act(self, steps: list[Acting]) -> None:
        for number, value in steps:
            if self.signals.steps[number].rests:
                self.mover.end_corner()
                if not self.targets.stands or self.splines.open:
                    self.splines.stop_here()
            self.targets.change((number, value), self.flow.main_line)

    def rest_for(self, code: str, time: float, text: str = '.') -> None:
        seconds = dwell_of(self.mover, code, time, text)
        self.act(acting(self.signals, ['G4'], {signals.DWELL: seconds}, self.fault)[0])

    @property
    def by_surface(self) -> bool:
        return self.mover.by_surface_speed and 'G96' in self.signals.words

    def go_on(self, stands: FloatArray, at: FloatArray | None) -> None:
        """Continue after a probe; the arguments are those of ``ProgramStream.go_on``."""
        self.probe = None
        self._begin_at(stands if at is None else at)
        self.mover.probed = probing.answer(self.mover, at is not None)
        self._begin_at(stands)

    def _begin_at(self, stands: FloatArray) -> None:
        self.mover.begin_targets()
        self.stand_at(stands)
