"""A start inside the loaded program: the chosen line, and the approach to it."""

from dataclasses import dataclass, replace

import numpy as np
from cnc_interp_msgs.msg import LoadedProgram

from cnc_interp.client.operator_client import MachineState
from cnc_interp.core import FloatArray
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.run.start_place import way_inside
from cnc_interp.settings.options import Settings
from cnc_interp.wire.run_messages import settings_from

#: Number of points drawn on a leg with turning rotary axes, where the tip moves on a curve.
POINTS = 25
#: Legs of the approach, and the index of the corner of ``way_inside`` at which each leg ends.
LEGS = (('1 retract', 1), ('2 position', 3), ('3 plunge', 4))
#: Reasons why a machine waits before the approach.
WAITS = (MachineState.REASON_APPROACH, MachineState.REASON_AWAY)
AWAY = 'the axes were moved away by hand'
BACK = 'cycle start moves the tool back and continues: retract, position, plunge; reset gives up'
MOVES = 'cycle start moves the tool: retract, position, plunge; reset gives up'


@dataclass(frozen=True)
class StartChoice:
    line: int = 0  #: Line of the program; 0 for its top.
    which: int = 0  #: Number of the execution of that line, from 1; 0 if there is only one.
    refused: str = ''  #: Why the start at this line was rejected; empty if it was not.

    @property
    def text(self) -> str:
        if not self.line or self.refused:
            return self.refused
        which = f', pass {self.which}' if self.which else ''
        return (
            f'the next run starts at line {self.line}{which}; '
            'cycle start shows the approach, nothing moves yet'
        )


@dataclass(frozen=True)
class WayThere:
    #: Name of each leg, and tool tips along it in W, shape (k, 3) [m].
    legs: tuple[tuple[str, FloatArray], ...]
    text: str  #: Note for the operator before the motion; empty once it moves.


class WayAhead:
    def __init__(self, transform: Transform):
        self._transform = transform
        self._known: tuple[str, list[float], list[float]] | None = None
        self._way: WayThere | None = None

    def at(self, state: MachineState, program: LoadedProgram | None) -> WayThere | None:
        if program is None or program.program_id != state.program_id:
            return None
        if state.reason not in WAITS:
            is_on_it = self._known is not None and self._known[0] == state.program_id
            if not is_on_it or self._way is None or state.sequence:
                return None
            if self._way.text:  # it has begun
                self._way = replace(self._way, text='')
            return self._way
        before = state.path_position <= 0.0
        ends = [*(program.start_positions if before else state.resume_positions)]
        if not ends or not state.resting:
            return None
        known = state.program_id, [*state.commanded_positions], ends
        if self._known != known or self._way is None or not self._way.text:
            self._known = known
            retract = settings_from(program.settings, Settings()).retract
            stands = np.array(state.commanded_positions)
            corners = way_inside(self._transform, stands, np.array(ends), retract)
            self._way = WayThere(self._legs(corners), told(program, before))
        return self._way

    def _legs(self, corners: FloatArray) -> tuple[tuple[str, FloatArray], ...]:
        """Return the tool tips on the approach, leg by leg; legs without length are left out."""
        legs, first = [], 0
        for name, last in LEGS:
            part = corners[first : last + 1]
            knots = np.arange(len(part))
            at = np.linspace(0, len(part) - 1, (len(part) - 1) * (POINTS - 1) + 1)
            q = np.column_stack([np.interp(at, knots, column) for column in part.T])
            tips = self._transform.forward(q)[0]
            if np.abs(np.diff(tips, axis=0)).max() > 0.0:
                legs.append((name, tips))
            first = last
        return tuple(legs)


def told(program: LoadedProgram, before: bool) -> str:
    return '\n'.join((*program.start_notes, MOVES) if before else (AWAY, BACK))
