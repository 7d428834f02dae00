"""`cnc-interp estimate`: how long a program takes, by tool and operation."""

from __future__ import annotations

import argparse
import json
import sys
from typing import TYPE_CHECKING, Any

from cnc_interp.commands import parser
from cnc_interp.commands.parser import option
from cnc_interp.settings.command_line import settings_from

if TYPE_CHECKING:
    from cnc_interp.run.estimate import Estimate


def add_estimate_command(commands: Any) -> None:
    overrides = (
        option(name, f'{what} override (100)', parser.positive, 'PERCENT', default=100.0)
        for name, what in (('--feed-override', 'feed'), ('--rapid-override', 'rapid'))
    )
    parser.command(
        commands,
        estimate_command,
        'estimate examples/first_part.ngc --feed-override 90',
        *parser.program_options(),
        *overrides,
        parser.workers_option(
            'processes that share the planning of a long program, divided at its exact stops'
        ),
    )


def estimate_command(options: argparse.Namespace) -> int:
    """Report how long a program takes on a machine, by tool and operation; write no plan files."""
    from cnc_interp.core.progress_bar import ProgressBar
    from cnc_interp.machine_model.machine import Machine
    from cnc_interp.machine_model.transform_port import Transform
    from cnc_interp.program import open_program
    from cnc_interp.program.notices import tell
    from cnc_interp.run.estimate import estimate
    from cnc_interp.run.overrides import sound_override

    names = 'feed_override', 'rapid_override'
    feed, rapid = (sound_override(name, getattr(options, name) / 100.0) for name in names)
    machine, settings = Machine.load(options.machine), settings_from(options)
    stream = open_program(options.program, Transform.of(machine), settings)
    with ProgressBar(None if options.json else sys.stderr) as bar:
        told = bar.of('planning')
        found = estimate(stream, machine, settings, options.workers, told, (feed, rapid))
    tell((*stream.read_as, *stream.notices, *filter(None, [machine.guessed])))
    if found.other_speeds:
        speeds = ', '.join(f'{speed:g}' for speed in found.other_speeds)
        measured = machine.standstill.speed
        tell(
            [f'start and stop times of the spindle are for {measured:g} rev/min, not at {speeds}']
        )
    print(json.dumps(found.to_json(), indent=2) if options.json else describe(found))
    return parser.FINE


def describe(found: Estimate) -> str:
    """Return the times as a table: a row for each tool, followed by rows for its operations."""
    from cnc_interp.run.program_times import times_table

    within = f' +- {found.half_width:.2g} s (95 %)' if found.half_width else ''
    often = f'{found.stops} wait{"s" * (found.stops > 1)}'
    waits = f', and {often} for the operator' if found.stops else ''
    return '\n'.join(
        [
            f'program        {found.program} on {found.machine}',
            *times_table([one.to_json() for one in found.sections]),
            f'total time     {found.total:.2f} s{within}{waits}',
        ]
    )
