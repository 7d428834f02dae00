"""The user's request for a run, and the result of the run."""

from __future__ import annotations

import json
from argparse import Namespace
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from cnc_interp.core import MM, MS, UM
from cnc_interp.machine_model.machine import error_text
from cnc_interp.settings.command_line import settings_from
from cnc_interp.settings.option_kinds import Stage, choices
from cnc_interp.settings.options import DEFAULT_MACHINE, Settings

#: A simulated machine starts with its tip this high above the part, clear of all bodies [m].
START_HEIGHT = 0.1


@dataclass(frozen=True)
class RunRequest:
    program: Path  #: Program file.
    #: Further programs; each one starts after its predecessor has ended.
    then: tuple[Path, ...] = ()
    machine: str = DEFAULT_MACHINE  #: Bundled machine or YAML file.
    settings: Settings = field(default_factory=Settings)  #: Settings chosen by the user.
    out: Path | None = None  #: Folder for plan files of the executed motion.
    record: Path | None = None  #: Bag in which all messages are recorded.
    quiet: bool = False  #: Whether to hide the progress.
    #: Whether to continue without cycle start at program stops, single blocks and before a plunge;
    #: with simulated drives also at functions that wait for the operator (M6 by hand).
    pass_stops: bool = False
    #: Kind of drives and their parameters, see ``command_options.drives``. If empty, the defaults
    #: of the nodes apply.
    drives: dict[str, str] = field(default_factory=dict)

    @staticmethod
    def from_options(options: Namespace) -> RunRequest:
        """Return a request from command-line options, which are in shop units."""
        return RunRequest(
            options.program,
            tuple(options.then),
            options.machine,
            settings_from(options),
            options.out,
            options.record,
            options.json,
            options.pass_stops,
            options.drives,
        )

    @property
    def simulated(self) -> bool:
        return self.drives.get('drives', 'simulated') == 'simulated'

    @property
    def programs(self) -> tuple[Path, ...]:
        return (self.program, *self.then)

    def node_parameters(self) -> dict[str, dict[str, object]]:
        from cnc_interp.nodes.parameters import NODES

        given: dict[str, object] = {'machine': f"'{self.machine}'"}
        for choice in choices(self.settings, Stage.MOTION, Stage.PLANNING, Stage.APPROACH):
            value = choice.plain(getattr(self.settings, choice.name))
            given[choice.name] = f"'{value}'" if isinstance(value, str) else value
        if self.settings.scene is not None and not self.drives:
            given['start_height'] = START_HEIGHT  # not inside the body that carries the part
        given |= self.drives
        named = [*self.programs, *([self.settings.setup] if self.settings.setup else [])]
        given['program_folders'] = json.dumps([str(path.resolve()) for path in named])
        found = {
            node: {p.name: given[p.name] for p in declared if p.name in given}
            for node, declared in NODES.items()
        }
        if self.settings.scene and self.settings.setup:  # its tools have bodies
            for node in ('feedrate_node', 'machine_node'):
                found[node]['setup'] = f"'{self.settings.setup.resolve()}'"
        return found


@dataclass(frozen=True)
class RunResult:
    ok: bool  #: Whether the program was executed completely.
    message: str  #: What happened, in one line.
    #: Program; machine; and id of the run in all messages.
    program: str
    machine: str
    program_id: str = ''
    scene: str = ''  #: Scene file with which the path was checked.
    hits: tuple[str, ...] = ()  #: Hits in a run that only warns of them.
    stock: str = ''  #: Text about the removed stock.
    #: Motion time of the program, and of the move to its start pose [s].
    cycle_time: float = 0.0
    approach_time: float = 0.0
    #: Time from the command to the first executed setpoint [s].
    start_to_motion: float = float('nan')
    path_length: float = 0.0  #: Path executed [m].
    #: Counts. A starvation is an interruption by missing setpoints.
    blocks_sent: int = 0
    blocks_executed: int = 0
    samples: int = 0
    starvations: int = 0
    #: Least buffered motion time during the run [s].
    least_buffered_time: float = float('nan')
    contour_error: float = 0.0  #: Largest distance of the tip from the commanded path [m].
    #: Axis -> 'm' for a linear, 'rad' for a rotary axis.
    axis_units: dict[str, str] = field(default_factory=dict)
    #: Axis -> largest value: following error [m, rad], and uses of limits [-].
    following_error: dict[str, float] = field(default_factory=dict)
    velocity_use: dict[str, float] = field(default_factory=dict)
    acceleration_use: dict[str, float] = field(default_factory=dict)
    jerk_use: dict[str, float] = field(default_factory=dict)
    #: Axis -> position at the end [m, rad].
    position: dict[str, float] = field(default_factory=dict)
    notices: tuple[str, ...] = ()  #: Notices about ignored or simplified words.
    #: Tracebacks of nodes that were restarted after a fault of cnc_interp.
    faults: tuple[str, ...] = ()
    #: Tool errors by the drive model of the machine file, if they are limited: ``tip``, ``axis``
    #: (at the flank height) and their ``limit`` [m], and the flank height [m].
    tool_error: dict[str, float] | None = None
    flank_height: float = 0.0

    def to_json(self) -> dict[str, Any]:
        """Return all fields for JSON; NaN becomes None."""
        return {k: None if v != v else v for k, v in asdict(self).items()}

    def text(self) -> str:
        least = self.least_buffered_time / MS  # nan where each line ended at rest
        never = f'; buffer never below {least:.0f} ms' if least == least else ''
        lines = [
            f'program        {self.program} on {self.machine}: {self.message}',
            f'blocks         {self.blocks_sent} sent, {self.blocks_executed} executed; '
            f'path {self.path_length / MM:.1f} mm',
            f'cycle time     {self.cycle_time:.3f} s, after an approach of '
            f'{self.approach_time:.3f} s; first motion {self.start_to_motion:.1f} s after start',
            f'setpoints      {self.samples}, {underruns(self.starvations)}' + never,
            f'drives         contour error {self.contour_error / UM:.1f} um; following error '
            + '  '.join(
                f'{axis} {error_text(error, self.axis_units.get(axis, "m"))}'
                for axis, error in self.following_error.items()
            ),
        ]
        for name in ('velocity', 'acceleration', 'jerk'):
            use = getattr(self, f'{name}_use')
            values = '  '.join(f'{axis} {ratio:6.1%}' for axis, ratio in use.items())
            lines.append(f'{name:<15}{values}')
        if self.tool_error:
            from cnc_interp.run.plan_figures import tool_error_text

            lines.append(tool_error_text(self.tool_error, self.flank_height))
        if self.scene:
            clear = f'each piece of the path kept the clearances of {self.scene}'
            stock = f'; stock: {self.stock}' if self.stock else ''
            lines.append(f'collision      {"NOT clear" if self.hits else clear}{stock}')
        lines += [
            f'fault          {fault.splitlines()[-1]}: please report it; --json has the traceback'
            for fault in self.faults
        ]
        if self.excesses:
            lines.append(f'NOT proven     {"; ".join(self.excesses)}')
        elif self.ok:
            lines.append(
                'proven         every executed setpoint kept the limits, every curve '
                'the tolerances'
            )
        return '\n'.join(lines)

    @property
    def excesses(self) -> list[str]:
        """Texts about exceeded limits of executed setpoints, and about hits."""
        from cnc_interp.run.plan_figures import excesses

        uses = {k: getattr(self, f'{k}_use') for k in ('velocity', 'acceleration', 'jerk')}
        return [*excesses(uses, {}, self.tool_error), *self.hits]


def underruns(count: int) -> str:
    return f'{count or "no"} underrun{"" if count == 1 else "s"}'
