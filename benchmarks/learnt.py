"""
Errors at the tool in runs that learn from the previous run; rows of docs/measured/drives.md.

    PYTHONPATH=.:benchmarks python benchmarks/learnt.py
    PYTHONPATH=.:benchmarks python benchmarks/learnt.py --cutoff 25 0.75 --runs 7 --only s_path

Programs are planned on ``xyzac_tired`` and executed by its simulated drives, with compensation by
models that are 20 % wrong. The largest error is compared with that of the first run, and with that
of the uncompensated drives. The impeller is cut after 400 lines. ``--cutoff`` tries another low
pass: its largest cutoff frequency [Hz], and the cutoff as a share of the mode frequency.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from compensation import EXAMPLES, MACHINE, SHARED, quietly, wrong

from cnc_interp.core import DEG, UM, FloatArray
from cnc_interp.drives import learning
from cnc_interp.drives.compensation import Compensation, compensate_all
from cnc_interp.drives.drive_model import follow_all, words_of
from cnc_interp.drives.tool_error import tool_error
from cnc_interp.machine_model.machine import Machine

PROGRAMS = {
    's_path': EXAMPLES / 's_path.apt',
    'pyramid': EXAMPLES / 'pyramid.ngc',
    'impeller': SHARED / 'programs' / 'linuxcnc-impeller-xyzac',
}
#: Lines of the impeller.
LINES = 400


def setpoints_of(name: str, folder: Path) -> tuple[FloatArray, FloatArray, float] | None:
    """Plan a program; return positions, velocities and period, or None where it is not there."""
    file = PROGRAMS[name]
    if name == 'impeller':
        found = next(file.glob('*.ngc'), None)
        if found is None:
            return None
        file = folder / 'impeller.ngc'
        lines = found.read_text(encoding='utf-8').splitlines()[:LINES]
        file.write_text('\n'.join([*lines, 'M2', '']), encoding='utf-8')
    quietly('plan', str(file), '--machine', MACHINE, '--out', str(folder / name))
    rows = np.load(folder / name / 'setpoints.npz')
    return rows['position'], rows['velocity'], float(rows['time'][1] - rows['time'][0])


def runs(
    machine: Machine, model: Machine, q: FloatArray, period: float, count: int
) -> list[FloatArray]:
    """Return the errors at the tool in some runs, each learning from those before."""
    setpoint = learning.with_hold(q, period)
    program = len(q) - learning.start_of(q)
    rate, errors = np.zeros_like(setpoint), []
    for _ in range(count):
        compensation = Compensation(model, period, setpoint[0])
        sent, rates = compensate_all(compensation.words, compensation.known, setpoint)
        x, _ = follow_all(words_of(machine, period, setpoint[0]), sent, rates + rate)
        lead = compensation.lead
        errors.append(learning.measured_error(machine, period, lead, setpoint, x))
        # As in a bag, feedback ends with the program.
        rate = learning.learnt_rates(model, period, lead, setpoint, x[:program], rate)
    return errors


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--cutoff', nargs=2, type=float, metavar=('HZ', 'SHARE'))
    parser.add_argument('--runs', type=int, default=3)
    parser.add_argument('--only', choices=PROGRAMS)
    options = parser.parse_args()
    if options.cutoff:
        learning.CUTOFF, learning.SHARE = options.cutoff
    machine = Machine.load(MACHINE)
    models = {
        '20 % too large': wrong(machine, False),
        '20 % off, up and down': wrong(machine, True),
    }
    with tempfile.TemporaryDirectory() as folder:
        for name in [options.only] if options.only else PROGRAMS:
            found = setpoints_of(name, Path(folder))
            if not found:
                continue
            q, velocity, period = found
            before = tool_error(machine, period, q, velocity).tip.max() / UM
            print(f'| {name} | as they are | - | {before:.1f} | | | | |', flush=True)
            for what, model in models.items():
                errors = runs(machine, model, q, period, options.runs)
                for number, error in enumerate(errors):
                    tip, axis = error[:, 0] / UM, error[:, 1] / DEG * 1e3
                    less, of_all = (
                        (tip.max() / other - 1.0) * 100
                        for other in (errors[0][:, 0].max() / UM, before)
                    )
                    print(
                        f'| {name} | {what} | {number} | {tip.max():.1f} | {less:+.0f} % | '
                        f'{of_all:+.0f} % | {tip.mean():.2f} | {axis.max():.1f} | '
                        f'{axis.mean():.2f} |',
                        flush=True,
                    )


if __name__ == '__main__':
    main()
