"""
Cycle times for a given error at the tool: planned by error, and by a lower feed override.

    PYTHONPATH=. python benchmarks/tool_error.py

Programs are planned on ``xyzac_tired``: by their feed alone, with a limit on the error at the
tool, and with the largest override of feeds and rapids that keeps the same error. Errors are those
of the simulated drives, without compensation or compensated by a model whose values are
alternately 20 % too large and too small.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from compensation import MACHINE, PROGRAMS, wrong
from whole_plans import Kept

from cnc_interp.core import MM, UM
from cnc_interp.drives.tool_error import tool_error
from cnc_interp.feedrate.limit_use import limits_at
from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import FeedPlanner, PlannedPiece
from cnc_interp.feedrate.tool_limit import ToolLimit
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import open_program
from cnc_interp.run.path_chain import batches
from cnc_interp.run.planning_chain import Chain
from cnc_interp.run.setpoints import Setpoints
from cnc_interp.settings.options import Settings

PERIOD, HEIGHT = 1e-3, 30 * MM
#: Rounds of bisection of the override.
ROUNDS = 7
#: Limits without compensation and with a wrong model [m].
LIMITS = {'as they are': (150 * UM, 100 * UM), 'model 20 % off': (80 * UM, 50 * UM, 40 * UM)}


class SlowPlanner(FeedPlanner):
    """A feed planner with an override of feeds and rapids."""

    def __init__(self, machine: Machine, override: float, tool: ToolLimit | None):
        super().__init__(limits_at(machine, PERIOD), PlanOptions(bound=False), tool=tool)
        self._velocity, self._override = machine.max_velocity, override

    def push(self, path: AxisPath) -> list[PlannedPiece]:
        """Add the next part of the path with lower feeds."""
        feed = np.array(path.cell_feed)
        use = np.abs(np.stack([path.cell_left[1], path.cell_right[1]])).max(axis=0)
        fastest = 1.0 / (use / self._velocity).max(axis=1)
        feed = np.where(np.isinf(feed), fastest, feed)
        return super().push(replace(path, cell_feed=self._override * feed))


def planned(
    program: Path,
    machine: Machine,
    model: Machine | None,
    override: float = 1.0,
    largest: float | None = None,
) -> tuple[float, float, float]:
    """Plan a program; return cycle time [s], largest error [m] and processor time [s]."""
    kept = Kept()
    chain: Any = Chain(machine, Settings(), kept)
    tool = None if largest is None else ToolLimit.of(machine, PERIOD, largest, HEIGHT, model)
    chain._planner = SlowPlanner(machine, override, tool)
    begun = time.process_time()
    for part in open_program(program, Transform.of(machine), Settings()):
        for batch in batches(part):
            chain.push(batch)
    chain.finish()
    spent = time.process_time() - begun
    found = Setpoints.concatenate(kept.samples)
    error = tool_error(machine, PERIOD, found.position, found.velocity, model)
    return kept.pieces[-1].law.end_time, max(error.tip.max(), error.axis.max() * HEIGHT), spent


def slowest_override(
    program: Path, machine: Machine, model: Machine | None, largest: float
) -> tuple[float, float]:
    """Return the largest override that keeps an error, and the cycle time with it [s]."""
    low, high, held = 0.02, 1.0, float('nan')
    for _ in range(ROUNDS):
        override = (low * high) ** 0.5
        cycle, error, _ = planned(program, machine, model, override)
        if error <= largest:
            low, held = override, cycle
        else:
            high = override
    return low, held


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('programs', type=Path, nargs='*')
    options = parser.parse_args()
    machine = Machine.load(MACHINE)
    models = {'as they are': None, 'model 20 % off': wrong(machine, True)}
    for given in options.programs or PROGRAMS:
        program = given if given.is_file() else next(given.glob('*.ngc'), given)
        if not program.is_file():
            continue
        for drives, model in models.items():
            cycle, error, cpu = planned(program, machine, model)
            print(f'| {given.stem} | {drives} | - | {error / UM:.1f} | {cycle:.3f} | {cpu:.1f} |')
            for largest in LIMITS[drives]:
                if largest > error:
                    continue
                cycle, error_now, cpu = planned(program, machine, model, 1.0, largest)
                override, plain = slowest_override(program, machine, model, largest)
                print(
                    f'| {given.stem} | {drives} | {largest / UM:.0f} | {error_now / UM:.1f} | '
                    f'{cycle:.3f} | {cpu:.1f} | {override:.0%} | {plain:.3f} | '
                    f'{cycle / plain - 1.0:+.0%} |',
                    flush=True,
                )


if __name__ == '__main__':
    main()
