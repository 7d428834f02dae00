"""
Paths of poses past the pole: their times at a distance from it, and the effect of the tolerance.

    python benchmarks/pole.py [--machine xyzac]

The tool tilts from -20 to +20 deg along 56 mm at F 3000 and passes the pole at a distance. The
table compares each motion with the motion straight through the pole, and checks it with the proof.
``dense`` is the same path in blocks of 0.5 mm, ``vertex`` has a vertex in its middle.
"""

from __future__ import annotations

import argparse

import numpy as np
from rotary_words import files_of
from whole_plans import plan_program

from cnc_interp.core import DEG, MM, FloatArray, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.proof.verify import verify
from cnc_interp.settings.options import Settings

#: Distance from the pole [deg], orientation tolerance [mm].
CASES = (
    (0.0, 0.02),
    (0.005, 0.02),
    (0.01, 0.02),
    (0.03, 0.02),
    (0.1, 0.02),
    (0.1, 0.1),
    (1.0, 0.02),
    (1.0, 0.6),
)
TILT, LENGTH, FEED = 20.0, 56.0, 3000.0
#: Time through the pole [s]; docs/measured/README.md says how it was found.
THROUGH = 1.402


def program(tools: FloatArray) -> str:
    """Write CL data that move the tip evenly along X while the tool takes these axes."""
    lines = []
    for x, (i, j, k) in zip(np.linspace(0.0, LENGTH, len(tools)), tools, strict=True):
        lines.append(f'GOTO/{x:.9f},0,0,{i:.12f},{j:.12f},{k:.12f}')
        if len(lines) == 1:
            lines.append(f'FEDRAT/{FEED:g}')
    return '\n'.join(lines)


def pole_of(transform: Transform) -> FloatArray:
    """Return the direction of the pole beside the tool axis at rest, shape (3,)."""
    upright = transform.tool_axis(np.zeros((1, 2)))[0]
    return np.asarray(transform.pole * (1.0 if upright @ transform.pole > 0.0 else -1.0))


def tools_of(distance: float, transform: Transform, count: int) -> FloatArray:
    """Return tool axes on a great circle at a distance from the pole [deg], shape (count, 3)."""
    pole = pole_of(transform)
    inner = transform.machine.rotary_direction[1 - transform.outer]
    side = np.cross(inner, pole)
    side /= np.linalg.norm(side)
    nearest = np.cos(distance * DEG) * pole + np.sin(distance * DEG) * np.cross(pole, side)
    angle = np.linspace(-TILT, TILT, count)[:, None] * DEG
    return np.asarray(np.cos(angle) * nearest + np.sin(angle) * side)


def row(machine: Machine, distance: float, tolerance: float, count: int) -> str:
    """Plan and check one case; return its row of the table."""
    transform = Transform.of(machine)
    settings = Settings(orientation_tolerance=tolerance * MM)
    text = program(tools_of(distance, transform, count))
    try:
        plan = plan_program(read_text(text, 'pole.apt', transform, settings), machine, settings)
    except InterpError as problem:
        return f'refused: {problem}'
    proof = verify(files_of(plan), machine)
    time = float(plan.setpoints.time[-1])
    stops = sum(int(piece.path.stop[1:].sum()) for piece in plan.pieces) - 1
    found = proof.largest('orientation deviation').value / MM
    told = plan.segments.deviation[:, 1].max() / MM
    verdict = 'yes' if proof.ok else f'NO: {proof.failures[0]}'
    return f'{time:.3f} | {time / THROUGH:.3f} | {stops} | {found:.4f} | {told:.4f} | {verdict}'


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--machine', default='xyzac')
    machine = Machine.load(parser.parse_args().machine)
    print(
        '| blocks | beside the pole, deg | tolerance, mm | time, s | of 1.402 s | stops '
        '| largest deviation, mm | told, mm | proven |'
    )
    print('|---' * 9 + '|')
    for name, count in (('one', 2), ('vertex', 3), ('dense', 113)):
        for distance, tolerance in CASES:
            found = row(machine, distance, tolerance, count)
            print(f'| {name} | {distance:g} | {tolerance:g} | {found} |', flush=True)


if __name__ == '__main__':
    main()
