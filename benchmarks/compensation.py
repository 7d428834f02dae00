"""
Errors at the tool, and ridges on surfaces, that remain with compensation.

    PYTHONPATH=. python benchmarks/compensation.py --model identified.yaml

Programs are planned on ``xyzac_tired`` and executed by its simulated drives: without compensation,
with compensation by the model, and by models whose values are all wrong by 20 %. ``--model`` is a
file written by ``cnc-interp identify``; without it the true model is used.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import fields, replace
from io import StringIO
from pathlib import Path

import numpy as np

from cnc_interp.commands.cli import main as command
from cnc_interp.core import DEG, UM
from cnc_interp.drives.tool_error import tool_error
from cnc_interp.machine.simulated_drives import simulate
from cnc_interp.machine_model.axis_drives import AxisDrive
from cnc_interp.machine_model.machine import Machine

MACHINE = 'xyzac_tired'
EXAMPLES = Path(__file__).parents[1] / 'examples'
SHARED = Path(__file__).parents[2] / 'shared'
PROGRAMS = (
    EXAMPLES / 's_path.apt',
    EXAMPLES / 'pyramid.ngc',
    SHARED / 'programs' / 'linuxcnc-impeller-xyzac',
)
SURFACES = (
    ('bumps', EXAMPLES / 'bumps.json', ['--stepover', '2']),
    ('hollow', EXAMPLES / 'hollow.json', ['--stepover', '3']),
    ('saddle', EXAMPLES / 'saddle.json', ['--stepover', '3']),
)
#: What a wrong model does not change: the step of the encoder, and what is no value.
RIGHT = ('resolution', 'feed_forward')
#: Time of a difference of the executed motion, so that modes and steps of encoders are left out.
SPAN = 8e-3


def wrong(machine: Machine, in_turn: bool, share: float = 0.2) -> Machine:
    """Return a model whose values are too large by a share, or up and down in turn."""
    loads, drives = {}, {}

    def by(number: int) -> float:
        """Return the factor of a value."""
        return 1.0 - share if in_turn and number % 2 else 1.0 + share

    for j, load in machine.limits.loads.items():
        loads[j] = replace(load, coulomb=load.coulomb * by(j), viscous=load.viscous * by(j + 1))
    for j, drive in machine.drives.items():
        names = [field.name for field in fields(AxisDrive) if field.name not in RIGHT]
        values = {name: getattr(drive, name) * by(j + k) for k, name in enumerate(names)}
        drives[j] = replace(drive, **values)
    return replace(machine, drives=drives).having(load=loads)


def quietly(*words: str) -> str:
    """Run a command and return what it prints."""
    with redirect_stdout(StringIO()) as printed:
        if command(list(words)):
            raise SystemExit(f'{" ".join(words)} failed')
    return printed.getvalue()


def planned(folder: Path) -> Iterator[tuple[str, Path]]:
    """Plan all programs; yield name and folder of each plan."""
    for program in PROGRAMS:
        file = program if program.is_file() else next(program.glob('*.ngc'), program)
        if file.is_file():
            out = folder / program.stem
            quietly('plan', str(file), '--machine', MACHINE, '--out', str(out))
            yield program.stem, out


def errors(name: str, plan: Path, machine: Machine, models: dict[str, Machine | None]) -> None:
    """Print rows of errors at the tool."""
    rows = np.load(plan / 'setpoints.npz')
    period = float(rows['time'][1] - rows['time'][0])
    first = None
    for what, model in models.items():
        found = tool_error(machine, period, rows['position'], rows['velocity'], model)
        tip, axis = found.tip / UM, found.axis / DEG * 1e3
        first = first or (tip.max(), tip.mean(), axis.max())
        less = [
            f'{(now / then - 1.0) * 100:+.0f} %'
            for now, then in zip((tip.max(), tip.mean(), axis.max()), first, strict=True)
        ]
        print(
            f'| {name} | {what} | {tip.max():.1f} ({less[0]}) | {tip.mean():.2f} ({less[1]}) | '
            f'{axis.max():.1f} ({less[2]}) | {axis.mean():.2f} | '
            f'{executed_use(machine, period, rows, model)} |',
            flush=True,
        )


def executed_use(machine: Machine, period: float, rows: dict, model: Machine | None) -> str:
    """Return the largest velocity and acceleration of the tables over their limits."""
    drives = {j: replace(drive, resolution=0.0) for j, drive in machine.drives.items()}
    smooth = replace(machine, drives=drives)
    found = simulate(smooth, period, rows['position'], rows['velocity'], model).position
    every = max(round(SPAN / period), 1)
    uses = [
        np.abs(np.diff(found[::every], order, axis=0)).max(axis=0)
        / (every * period) ** order
        / machine.limits.by_order[order - 1]
        for order in (1, 2)
    ]
    return ' / '.join(f'{use.max() * 100:.0f} %' for use in uses)


def ridges(folder: Path) -> None:
    """Print rows of ridges: on the ideal machine and on the tired one."""
    for name, surface, options in SURFACES:
        if not surface.is_file():
            continue
        for machine in ('xyzac', MACHINE):
            out = folder / f'{name}_{machine}'
            quietly(
                'cam',
                'iso-scallop',
                str(surface),
                *options,
                '--run',
                '--machine',
                machine,
                '--out',
                str(out),
                '--json',
            )
            made = json.loads((out / 'summary.json').read_text(encoding='utf-8'))
            again = quietly(
                'cam',
                'simulate',
                str(out / 'plan'),
                '--surface',
                str(surface),
                '--executed',
                '--machine',
                machine,
                '--compensate',
                machine,
                '--json',
            )
            parts = made['programmed'], made['executed'], json.loads(again)['executed']
            cells = [
                f'{part["ridge_highest"] / UM:.2f} / {part["highest"] / UM:.2f}' for part in parts
            ]
            print(f'| {name} | {machine} | {" | ".join(cells)} |', flush=True)


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--model', help='machine file that identify wrote')
    parser.add_argument('--only', choices=('errors', 'ridges'))
    options = parser.parse_args()
    machine = Machine.load(MACHINE)
    model = Machine.load(options.model) if options.model else machine
    models = {
        'as they are': None,
        'compensated': model,
        'model 20 % too large': wrong(machine, False),
        'model 20 % off, up and down': wrong(machine, True),
    }
    with tempfile.TemporaryDirectory() as name:
        if options.only != 'ridges':
            for program, plan in planned(Path(name)):
                errors(program, plan, machine, models)
        if options.only != 'errors':
            ridges(Path(name))


if __name__ == '__main__':
    main()
