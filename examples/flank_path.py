"""Write a 5-axis path given as two cubic B-splines as a part program with native splines.

    python examples/flank_path.py PATH.json > flank.mpf
    cnc-interp plan flank.mpf --out out/flank && cnc-interp check out/flank

The JSON file holds ``knots`` (clamped, shared by both curves), ``control_points_bottom`` (tool
tip) and ``control_points_top`` (second point on the tool axis), in mm: the form in which flank
milling paths are published.
"""

from __future__ import annotations

import argparse
import json
import sys
from itertools import pairwise
from pathlib import Path

DEGREE = 3


def words(tip: list[float], second: list[float]) -> str:
    """Write a control point of both curves."""
    letters = ('X', 'Y', 'Z', 'XH=', 'YH=', 'ZH=')
    pairs = zip(letters, [*tip, *second], strict=True)
    return ' '.join(f'{letter}{value:.12g}' for letter, value in pairs)


def program(path: dict[str, list[list[float]]], knots: list[float], feed: float) -> str:
    """Return the program: to the first control point by rapid, then one block for each other."""
    points = list(zip(path['control_points_bottom'], path['control_points_top'], strict=True))
    if len(knots) != len(points) + DEGREE + 1 or sorted(knots) != knots:
        raise ValueError(f'{len(points)} control points need {len(points) + 4} rising knots')
    intervals = [after - before for before, after in pairwise(knots)]
    if any(intervals[:DEGREE] + intervals[-DEGREE:]):
        raise ValueError('the knots must be clamped: four equal ones at both ends')
    lines = ['TRAORI', 'ORICURVE', f'G0 {words(*points[0])}', f'BSPLINE SD=3 F{feed:g}']
    # Block i carries the knot interval t_(i+3) - t_(i+2).
    for point, interval in zip(points[1:], intervals[DEGREE:], strict=False):
        lines.append(f'{words(*point)} PL={interval:.12g}')
    return '\n'.join([*lines, 'M30', ''])


def main() -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(description='Two cubic B-splines in JSON -> part program.')
    parser.add_argument('path', type=Path, metavar='PATH.json')
    parser.add_argument('--feed', type=float, default=3000.0, metavar='MM_PER_MIN')
    options = parser.parse_args()
    try:
        path = json.loads(options.path.read_text(encoding='utf-8'))
        print(program(path, [float(t) for t in path['knots']], options.feed), end='')
    except (OSError, KeyError, ValueError) as problem:
        print(f'{options.path}: {type(problem).__name__}: {problem}', file=sys.stderr)
        return 2
    return 0


if __name__ == '__main__':
    sys.exit(main())
