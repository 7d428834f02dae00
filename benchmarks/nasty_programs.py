"""
Random difficult programs: convergence of the planner, comparison with exact stops, and proof.

    PYTHONPATH=. python benchmarks/nasty_programs.py [--count 2000] [--first 0] [--unproven]

Each program is CL data of 4 to 9 blocks for the reference machine, made from its seed: ordinary
blocks, blocks of micrometres, rotations of the tool axis while the tip moves micrometres or not at
all, sharp turns, reversals, tool axes near or through the pole, changes of feed, and tolerances of
2 um to 0.2 mm. Each program is planned twice: as it is, and with an exact stop after each block.
The script prints each program that is slower than with stops, not converged, rejected or not
proven, and a summary at the end.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from dataclasses import replace

import numpy as np
from active import share_active
from rotary_words import files_of
from whole_plans import Plan, plan_program

from cnc_interp.core import DEG, MM, InterpError
from cnc_interp.feedrate.planning_windows import PlannedPiece
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import Program, read_text
from cnc_interp.proof.verify import verify
from cnc_interp.settings.options import Settings

#: A program is slower than its stops from this part of the time on [-].
SLOWER = 1e-4
#: A motion is far from every limit below this share of it [-], and a program with much of that.
FAR, MUCH = 0.9, 0.3

KINDS = 'ordinary', 'micro', 'swivel', 'rotation', 'sharp', 'reversal', 'pole'
ODDS = 0.30, 0.18, 0.16, 0.04, 0.14, 0.06, 0.12


def spread(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number between two, evenly over the logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def nasty_program(seed: int) -> str:
    """Return the CL data of a seed, in mm and mm/min."""
    rng = np.random.default_rng(seed)
    point = np.zeros(3)
    way = rng.normal(size=3)
    tilt, heading = rng.uniform(2.0, 35.0) * DEG, rng.uniform(-np.pi, np.pi)
    feeds = [100.0, 600.0, 3000.0, 10000.0, 30000.0]
    mixed = rng.random() < 0.5
    lines = [f'FEDRAT/{rng.choice(feeds):g}']

    def add() -> None:
        tool = np.sin(tilt) * np.sin(heading), np.sin(tilt) * np.cos(heading), np.cos(tilt)
        lines.append('GOTO/' + ','.join(f'{x:.9f}' for x in (*point, *tool)))

    add()
    for kind in rng.choice(KINDS, int(rng.integers(4, 10)), p=ODDS):
        if mixed and rng.random() < 0.5:
            lines.append(f'FEDRAT/{rng.choice(feeds):g}')
        length, swing = spread(rng, 0.5, 20.0), spread(rng, 0.05, 5.0)
        side = np.cross(way, rng.normal(size=3))
        turn = rng.uniform(0.0, 140.0)
        if kind == 'micro':
            length, swing = spread(rng, 1e-4, 0.05), rng.choice([0.0, spread(rng, 1e-3, 0.1)])
        elif kind == 'swivel':
            length, swing = spread(rng, 3e-4, 0.02), spread(rng, 1.0, 50.0)
        elif kind == 'rotation':
            length, swing = 0.0, spread(rng, 0.1, 50.0)
        elif kind == 'sharp':
            turn = rng.uniform(140.0, 179.9)
        elif kind == 'reversal':
            turn = 180.0
        way = way / np.linalg.norm(way)
        way = np.cos(turn * DEG) * way + np.sin(turn * DEG) * side / np.linalg.norm(side)
        point = point + length * way
        if rng.random() < 0.7:
            tilt = abs(tilt + swing * DEG * rng.uniform(-1.0, 1.0))
            heading += swing * DEG * rng.uniform(-2.0, 2.0)
        if kind == 'pole':
            tilt = rng.choice([0.0, 1e-3, 0.03, 0.3, 2.0]) * DEG
        elif tilt > 60.0 * DEG:
            tilt = 30.0 * DEG
        add()
    return '\n'.join(lines)


def settings_of(seed: int) -> Settings:
    """Return the tolerances of a seed."""
    rng = np.random.default_rng([seed, 1])
    return Settings(
        contour_tolerance=spread(rng, 0.002, 0.2) * MM,
        orientation_tolerance=spread(rng, 0.002, 0.2) * MM,
    )


def with_stops(program: Program) -> Program:
    """Return a program with an exact stop at the end of each block."""
    stops = np.ones(len(program.blocks), dtype=bool)
    return replace(program, blocks=replace(program.blocks, exact_stop=stops))


def planned(program: Program, machine: Machine, settings: Settings) -> tuple[Plan, PlannedPiece]:
    """Plan a program; return the plan, and its motion in one piece."""
    plan = plan_program(program, machine, settings)
    return plan, PlannedPiece.join(plan.pieces)


def main() -> None:
    """Run the programs and print what is wrong, and a summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--count', type=int, default=2000)
    parser.add_argument('--first', type=int, default=0)
    parser.add_argument('--unproven', action='store_true', help='leave the proof out')
    options = parser.parse_args()
    machine = Machine.load('xyzac')
    transform = Transform.of(machine)
    counts: Counter[str] = Counter()
    ratios, bounds = [], []
    for seed in range(options.first, options.first + options.count):
        settings = settings_of(seed)
        try:
            program = read_text(nasty_program(seed), f'{seed}.apt', transform, settings)
            stopping = planned(with_stops(program), machine, settings)[1].law.end_time
            plan, piece = planned(program, machine, settings)
        except InterpError as problem:
            counts['refused'] += 1
            print(f'{seed} refused: {problem}', flush=True)
            continue
        time = piece.law.end_time
        ratios.append(time / stopping)
        bounds.append(time / piece.least_time)
        for part in plan.pieces:
            counts[f'windows {part.solved}'] += 1
        if ratios[-1] > 1.0 + SLOWER:
            counts['slower'] += 1
            print(f'{seed} slower: {time:.4f} s, with stops {stopping:.4f} s', flush=True)
        if piece.solved not in ('converged', 'divided'):
            print(f'{seed} {piece.solved}', flush=True)
        if 1.0 - share_active(piece, machine, FAR) > MUCH:
            counts['far from every limit'] += 1
        if not options.unproven and not (proof := verify(files_of(plan), machine)).ok:
            counts['not proven'] += 1
            print(f'{seed} not proven: {proof.failures[0]}', flush=True)
    ratio, bound = np.array(ratios), np.array(bounds)
    print(
        json.dumps(
            {
                'programs': options.count,
                **counts,
                'time / with stops': {
                    'mean': round(float(ratio.mean()), 4),
                    'median': round(float(np.median(ratio)), 4),
                    'largest': round(float(ratio.max()), 6),
                },
                'time / least time, median': round(float(np.median(bound)), 3),
            }
        )
    )


if __name__ == '__main__':
    main()
