"""
Planes in all directions on every bundled 5-axis machine: are they reached, how exactly?

``PYTHONPATH=. python benchmarks/tilted_planes.py`` prints the figures of
``docs/how_it_works/tilted_planes.md``.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from scipy.spatial.transform import Rotation

from cnc_interp.core import ProgramError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.settings.options import Settings

MACHINES = (
    'xyzac',
    'xyzbc',
    'bc_trunnion',
    'head_head',
    'head_table',
    'xyzac_trt',
    'xyzbc_trt',
    'xyzacw',
)
PLANES = [(i, j) for i in range(0, 360, 5) for j in range(0, 360, 5)]
ORIGIN, POINT = np.array([10.0, 20.0, 30.0]), np.array([1.0, 2.0, 3.0])
HEAD = 'G21 G90\nG0 X0 Y0 Z50\n'


def text_of(number: int) -> str:
    """Return the blocks of one plane; its point is higher than that of the one before."""
    i, j = PLANES[number]
    return f'G69\nG68.2 X10 Y20 Z30 I{i} J{j} K10\nG53.1\nG0 X1 Y2 Z{3 + number % 2}\n'


def errors(geometry: Transform) -> tuple[float, float]:
    """Return the largest errors of the tool axis [-] and of a point [mm] over all planes."""
    text = HEAD + ''.join(text_of(number) for number in range(len(PLANES)))
    blocks = read_text(text, 'planes.ngc', geometry, Settings()).blocks
    row = {int(line): k for k, line in enumerate(blocks.line_number)}
    rows = [row[6 + 4 * number] for number in range(len(PLANES))]
    turn = Rotation.from_euler('ZXZ', [[i, j, 10] for i, j in PLANES], degrees=True).as_matrix()
    points = POINT + np.outer(np.arange(len(PLANES)) % 2, [0.0, 0.0, 1.0])
    tips = ORIGIN + np.einsum('nij,nj->ni', turn, points)
    axes = geometry.tool_axis(blocks.rotary[rows])
    return (
        float(np.abs(axes - turn[:, :, 2]).max()),
        float(np.abs(blocks.tip[rows] * 1e3 - tips).max()),
    )


def reached(geometry: Transform) -> int:
    """Return how many of the planes are within the travel of a machine."""
    count = 0
    for number in range(len(PLANES)):
        try:
            read_text(HEAD + text_of(number), 'plane.ngc', geometry, Settings())
            count += 1
        except ProgramError:
            pass
    return count


def main() -> None:
    """Print the table."""
    print(
        '| machine | planes without error | error of the axis | of a point, mm | s | within the '
        'travel |'
    )
    print('|---|--:|--:|--:|--:|--:|')
    for name in sys.argv[1:] or MACHINES:
        machine = Machine.load(name)
        travel = np.tile([-np.inf, np.inf], (len(machine.axis_names), 1))
        begun = time.process_time()
        axis, point = errors(Transform.of(machine.having(travel=travel)))
        took = time.process_time() - begun
        within = reached(Transform.of(machine))
        print(f'| {name} | {len(PLANES):,} | {axis:.1e} | {point:.1e} | {took:.1f} | {within:,} |')


if __name__ == '__main__':
    main()
