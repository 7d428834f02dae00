"""
Identify the drives of the machine ``xyzac_tired`` from a bag, and compare with the true values.

    PYTHONPATH=. python benchmarks/identified.py

The excitation runs over ROS on ``xyzac_tired``, whose encoders have a finite resolution.
``--noise`` adds normally distributed noise to the feedback in the bag, in multiples of this
resolution.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from cnc_interp.client.bag import Bag
from cnc_interp.client.recorded_feedback import recorded_feedback
from cnc_interp.client.run_request import RunRequest
from cnc_interp.client.session import run_session
from cnc_interp.drives.identification import excitation, identify_axis
from cnc_interp.machine_model.machine import Machine
from cnc_interp.report.identified import values_of

MACHINE = 'xyzac_tired'


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--noise', type=float, default=2.0, help='in resolutions (2)')
    parser.add_argument('--bag', type=Path, help='bag of the excitation, instead of a run')
    options = parser.parse_args()
    machine = Machine.load(MACHINE)
    with tempfile.TemporaryDirectory() as folder:
        bag = options.bag or Path(folder, 'bag')
        if options.bag is None:
            program = Path(folder, 'excite.ngc')
            program.write_text(excitation(machine), encoding='utf-8')
            run_session(RunRequest(program, machine=MACHINE, record=bag, quiet=True))
        with Bag(bag) as opened:
            run, _ = recorded_feedback(opened, MACHINE)
    steps = np.array([machine.drives[j].resolution for j in range(len(machine.axis_names))])
    noise = np.random.default_rng(1).normal(size=run.feedback.shape) * steps * options.noise
    # Inertia and viscous friction are given, the rest of the file is not.
    known = {j: replace(load, coulomb=0.0) for j, load in machine.limits.loads.items()}
    blind = replace(machine, drives={}).having(load=known)
    print('| axis | value | truth | identified | off | 95 % interval |\n|---|---|---|---|---|---|')
    inside = count = 0
    for j, letter in enumerate(machine.axis_names):
        found = identify_axis(blind, j, run.period, run.setpoint, run.rate, run.feedback + noise)
        assert found is not None
        truth = replace(found, drive=machine.drives[j], load=machine.limits.axes[j].load)
        for (key, value, width), (_, true, _) in zip(
            values_of(machine, found), values_of(machine, truth), strict=True
        ):
            if width is None:
                continue
            count, inside = count + 1, inside + (abs(value - true) <= width)
            off, part = (value / true - 1.0) * 100, width / true * 100
            print(f'| {letter} | {key} | {true:.4g} | {value:.4g} | {off:+.2f} % | {part:.2f} % |')
    print(f'\n{inside} of {count} intervals hold the truth.')


if __name__ == '__main__':
    main()
