"""
Random programs of poses near the pole: rejections, unprogrammed stops, and the proof.

    python benchmarks/pole_programs.py [--count 1000] [--machines xyzac ...]

Each program is CL data with 3 to 12 points. The tool axes lie on the pole, within the tolerance
of it, or up to 25 deg away; in every third program the path between the points is divided into
short blocks. The tip never turns back, so no stop is necessary. A program counts as off its words
if the motion does not end at its last pose.
"""

from __future__ import annotations

import argparse
import json

import numpy as np
from pole import pole_of
from rotary_words import files_of, rotary_machines
from whole_plans import plan_program

from cnc_interp.core import DEG, MM, FloatArray, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.program.geometry.subdivide import great_circle
from cnc_interp.proof.verify import verify
from cnc_interp.settings.options import Settings


def random_tools(rng: np.random.Generator, count: int, pole: FloatArray) -> FloatArray:
    """Return tool axes near the pole, shape (count, 3)."""
    reach = rng.choice(
        [0.0, 1e-3, 0.03, 0.1, 1.0, 25.0], count, p=[0.2, 0.1, 0.15, 0.1, 0.1, 0.35]
    )
    tilt = reach * rng.uniform(0.0, 1.0, count) * DEG
    turn = rng.uniform(0.0, 2.0 * np.pi, count)
    turn[1:] = np.where(
        rng.random(count - 1) < 0.4, turn[0] + np.pi * (rng.random() < 0.5), turn[1:]
    )
    first = np.cross(pole, [0.6, 0.0, 0.8] if abs(pole[0]) > 0.9 else [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(pole, first)
    across = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    return np.asarray(np.cos(tilt)[:, None] * pole + np.sin(tilt)[:, None] * across)


def random_program(rng: np.random.Generator, transform: Transform) -> str:
    """Return CL data of 3 to 12 points, divided into short blocks in every third program."""
    count = int(rng.integers(3, 13))
    steps = rng.uniform(-1.0, 1.0, (count, 3)) * [0.2, 1.0, 0.4] + [1.0, 0.0, 0.0]
    tip = np.cumsum(steps * rng.choice([0.5, 3.0, 15.0], (count, 1)), axis=0)
    tip -= 0.5 * (tip[0] + tip[-1])
    tool = random_tools(rng, count, pole_of(transform))
    if rng.random() < 1.0 / 3.0:
        pieces = int(rng.integers(5, 40))
        share = np.tile(np.arange(1, pieces + 1) / pieces, count - 1)
        row = np.repeat(np.arange(count - 1), pieces)
        tip = np.vstack([tip[:1], tip[row] + share[:, None] * (tip[row + 1] - tip[row])])
        tool = np.vstack([tool[:1], great_circle(tool[row], tool[row + 1], share)])
    digits = int(rng.choice([5, 7, 9]))
    lines = [f'FEDRAT/{rng.choice([600, 3000, 10000])}']
    for p, o in zip(tip, tool, strict=True):
        lines.append('GOTO/' + ','.join(f'{x:.{digits}f}' for x in (*p, *o)))
    return '\n'.join(lines)


def main() -> None:
    """Run the programs and print one line for each machine."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--count', type=int, default=1000)
    parser.add_argument('--first', type=int, default=0)
    parser.add_argument('--machines', nargs='*', default=rotary_machines())
    options = parser.parse_args()
    for name in options.machines:
        machine = Machine.load(name)
        transform, settings = Transform.of(machine), Settings()
        if name == 'xyza':  # its tool cannot reach the pole
            continue
        refused = travel = stops = unproven = off = 0
        time = 0.0
        for i in range(options.first, options.first + options.count):
            text = random_program(np.random.default_rng(i), transform)
            try:
                plan = plan_program(read_text(text, f'{i}.apt', transform, settings), machine)
            except InterpError as problem:
                if 'travel' in str(problem):
                    travel += 1
                    continue
                refused += 1
                print(f'{name} {i} refused: {problem}')
                continue
            found = sum(int(piece.path.stop[1:].sum()) for piece in plan.pieces) - 1
            stops += found
            if found:
                print(f'{name} {i} stops: {found}')
            proof = verify(files_of(plan), machine)
            if not proof.ok:
                unproven += 1
                print(f'{name} {i} not proven: {proof.failures[0]}')
            tip, axis = transform.forward(plan.setpoints.position[-1:])
            blocks = plan.program.blocks
            gap = (
                np.abs(tip[0] - blocks.tip[-1]).max() + 0.03 * np.abs(axis - blocks.axis[-1]).max()
            )
            off += bool(gap > 1e-6 * MM)
            time += float(plan.setpoints.time[-1])
        print(
            json.dumps(
                {
                    'machine': name,
                    'programs': options.count,
                    'refused': refused,
                    'travel': travel,
                    'stops': stops,
                    'not proven': unproven,
                    'off their words': off,
                    'time [s]': round(time, 3),
                }
            ),
            flush=True,
        )


if __name__ == '__main__':
    main()
