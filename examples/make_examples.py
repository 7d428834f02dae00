"""Write the part programs of this folder, and one surface: ``python examples/make_examples.py``.

Both parts are flank milled: the tool axis stays in the plane of a wall and turns along it, so
that every wall is flat. Between two given axes the great circle lies in their common plane, hence
the programs need points at the corners only.
"""

from __future__ import annotations

import json
from math import atan2, cos, degrees, exp, hypot, pi, radians, sin, sqrt, tan
from pathlib import Path

Vector = tuple[float, float, float]

HERE = Path(__file__).resolve().parent
FEED_MM_PER_MIN = 3000


def unit(v: Vector) -> Vector:
    """Scale a vector to length one."""
    length = sqrt(sum(component**2 for component in v))
    return v[0] / length, v[1] / length, v[2] / length


def pyramid() -> list[tuple[Vector, Vector]]:
    """Tip [mm] and tool axis at the corners of a square, walls tilted outward by 15 deg.

    At a corner the axis runs along the pyramid's edge, where both neighbouring walls meet.
    """
    slope = tan(radians(15.0))
    corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)]
    return [((30.0 * x, 30.0 * y, 0.0), unit((slope * x, slope * y, 1.0))) for x, y in corners]


def s_path() -> list[tuple[Vector, Vector]]:
    """Tip [mm] and tool axis along an S-shaped wall that is milled by the flank.

    It resembles the S-shaped test part of ISO 10791-7: the wall bends to both sides and
    its tilt changes sign on the way, so that all five axes turn back. For t from 0 to 1,

        tip = (140 t - 70, 35 sin(2 pi t), 4 sin(2 pi t)),

    and the axis is tilted by 12 + 8 cos(3 pi t) deg across the path, 6 sin(4 pi t) deg along it.
    """
    found, count = [], 240
    for number in range(count + 1):
        t = number / count
        way = unit((140.0, 70.0 * pi * cos(2 * pi * t), 0.0))
        across = -way[1], way[0]
        side = tan(radians(12.0 + 8.0 * cos(3 * pi * t)))
        lead = tan(radians(6.0 * sin(4 * pi * t)))
        tip = 140.0 * t - 70.0, 35.0 * sin(2 * pi * t), 4.0 * sin(2 * pi * t)
        slope = [side * a + lead * w for a, w in zip(across, way[:2], strict=True)]
        found.append((tip, unit((slope[0], slope[1], 1.0))))
    return found


def pocket_corner() -> list[tuple[Vector, Vector]]:
    """Tip [mm] and tool axis along two walls of a pocket, tilted outward by 15 and 12 deg.

    At the free ends the axis is square to the path; at the corner it is the line in which both
    walls meet.
    """
    first, second = radians(15.0), radians(12.0)
    return [
        ((-60.0, 0.0, 0.0), (0.0, -sin(first), cos(first))),
        ((0.0, 0.0, 0.0), unit((tan(second), -tan(first), 1.0))),
        ((0.0, 60.0, 0.0), (sin(second), 0.0, cos(second))),
    ]


def cl_data(name: str, points: list[tuple[Vector, Vector]]) -> str:
    """Write points as CL data."""
    lines = [f'PARTNO {name}', 'UNITS/MM', 'MULTAX/ON']
    for number, (tip, axis) in enumerate(points):
        words = [f'{value:.4f}' for value in tip] + [f'{value:.9f}' for value in axis]
        lines.append('GOTO/' + ','.join(words))
        if number == 0:
            lines.append(f'FEDRAT/{FEED_MM_PER_MIN},MMPM')
    return '\n'.join([*lines, 'FINI', ''])


def gcode(name: str, points: list[tuple[Vector, Vector]]) -> str:
    """Write points as G-code for the table-tilting machine xyzac, C never jumping by a turn."""
    lines = ['%', f'({name}: tool tip programming, tool axis on great circles)']
    lines += ['G21 G90 G94', 'G64 P0.02', 'TRAORI', 'ORIVECT']
    c = 0.0
    for number, (tip, (i, j, k)) in enumerate(points):
        a = degrees(atan2(hypot(i, j), k))
        c += (degrees(atan2(i, j)) - c + 180.0) % 360.0 - 180.0
        words = [f'{letter}{value:.4f}' for letter, value in zip('XYZ', tip, strict=True)]
        words += [f'A{a:.9f}', f'C{c:.9f}']
        feed = f' F{FEED_MM_PER_MIN}' if number == 1 else ''
        lines.append(f'G{min(number, 1)} {" ".join(words)}{feed}')
    return '\n'.join([*lines, 'TRAFOOF', 'M30', '%', ''])


def hollow() -> dict[str, object]:
    """Surface of a shallow trough, 83 mm in radius, with a swelling in the middle.

    It is hollow across the feed, so that strips of 5 mm fit a mill of 13 mm; turned by 25 deg, so
    that the tool axis keeps off the pole of the machine.
    """

    def height(x: float, y: float) -> float:
        return 0.006 * y**2 + 0.3 * exp(-(x**2 + y**2) / 288.0)

    points = [
        [[x, y, round(height(x, y), 6)] for y in range(-20, 21, 2)] for x in range(-25, 26, 2)
    ]
    return {
        'comment': 'A trough of varying curvature, the kind of surface of [TL2008], Fig. 5',
        'kind': 'grid',
        'placement': {'rotation_deg': [25, 0, 0]},
        'points_mm': points,
    }


def saddle() -> dict[str, object]:
    """Surface of a saddle of 120 mm radius; flat on the table, its passes come near the pole."""
    points = [
        [[x, y, round((x**2 - y**2) / 240.0, 6)] for y in range(-20, 21, 4)]
        for x in range(-25, 26, 5)
    ]
    comment = 'A saddle, 50 x 40 mm; see docs/batch.md for how it should be turned'
    return {'comment': comment, 'kind': 'grid', 'points_mm': points}


def main() -> None:
    """Write all files beside this script."""
    (HERE / 'pyramid.apt').write_text(cl_data('PYRAMID', pyramid()), encoding='ascii')
    (HERE / 'pyramid.ngc').write_text(gcode('PYRAMID', pyramid()), encoding='ascii')
    corner = cl_data('POCKET CORNER', pocket_corner())
    (HERE / 'pocket_corner.apt').write_text(corner, encoding='ascii')
    (HERE / 's_path.apt').write_text(cl_data('S PATH', s_path()), encoding='ascii')
    (HERE / 'hollow.json').write_text(json.dumps(hollow()) + '\n', encoding='ascii')
    (HERE / 'saddle.json').write_text(json.dumps(saddle()) + '\n', encoding='ascii')


if __name__ == '__main__':
    main()
