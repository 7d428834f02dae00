"""Splines of LinuxCNC in the plane (G5, G5.1), recomputed from their control points."""

from itertools import pairwise

import numpy as np
import pytest

from cnc_interp.core import MM, ProgramError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.settings.options import Settings

XYZ = Transform.of(Machine.load('xyz'))
HEAD = 'G21 G90 G17 F600\nG0 X0 Y0 Z0\n'
TOLERANCE = 0.01


def points_of(text, name='part.ngc'):
    blocks = read_text(HEAD + text, name, XYZ, Settings(contour_tolerance=TOLERANCE * MM)).blocks
    return blocks.tip / MM, blocks


def bezier(points, count=4001):
    """De Casteljau's construction."""
    points = [np.array(point, dtype=float) for point in points]
    u = np.linspace(0.0, 1.0, count)[:, None]
    while len(points) > 1:
        points = [(1 - u) * a + u * b for a, b in pairwise(points)]
    return points[0]


def gap(chords, curve):
    """Largest distance of a dense curve from a row of chords."""
    a, b = chords[:-1, None], chords[1:, None]
    way = b - a
    share = ((curve - a) * way).sum(-1) / np.maximum((way**2).sum(-1), 1e-30)
    foot = a + np.clip(share, 0.0, 1.0)[..., None] * way
    return np.linalg.norm(curve - foot, axis=-1).min(axis=0).max()


def test_a_cubic_spline_and_one_that_goes_on():
    tip, blocks = points_of('G5 I0 J30 P0 Q-30 X20 Y20\nG5 P5 Q-20 X50 Y10\nG1 X60\n')
    first = bezier([[0, 0], [0, 30], [20, -10], [20, 20]])
    second = bezier([[20, 20], [20, 50], [55, -10], [50, 10]])
    for line, curve in ((3, first), (4, second)):
        chords = np.vstack([curve[:1], tip[blocks.line_number == line][:, :2]])
        assert 5 < len(chords) < 400
        assert 0.02 * TOLERANCE < gap(chords, curve) < 0.11 * TOLERANCE
        np.testing.assert_allclose(chords[-1], curve[-1], atol=1e-9)
    assert (blocks.contour_tolerance[blocks.line_number == 4] <= 0.9 * TOLERANCE * MM).all()
    assert blocks.contour_tolerance[-1] == TOLERANCE * MM


def test_a_quadratic_spline_in_a_frame_and_in_g91():
    tip, _ = points_of('G92 X100 Y50\nG91\nG5.1 X40 Y0 I20 J-80\n')
    curve = bezier([[0, 0], [20, -80], [40, 0]])
    assert gap(tip[:, :2], curve) < 0.11 * TOLERANCE
    np.testing.assert_allclose(tip[-1], [40, 0, 0], atol=1e-9)


def test_an_exact_stop_holds_at_the_end_only():
    _, blocks = points_of('G61\nG5 I0 J30 P0 Q-30 X20 Y20\nG1 X30\n')
    on_spline = blocks.exact_stop[blocks.line_number == 4]
    assert on_spline[-1] and not on_spline[:-1].any()


@pytest.mark.parametrize(
    ('text', 'part'),
    [
        ('G5 X9 Y9 P1 Q1', 'needs I and J, because it follows no spline'),
        ('G5 X9 I1 J1', 'needs P and Q'),
        ('G5 X9 I1 P1 Q1', 'give both I and J'),
        ('G5.1 X9 Y9', 'needs I and J'),
        ('G18 G5 X9 I1 J1 P1 Q1', 'lies in the plane of X and Y'),
        ('G5 I0 J30 P0 Q-30 X20 Y20\nG0 X9\nG5 P5 Q-20 X50 Y10', 'needs I and J, because'),
        ('G5 I0 J3 P0 Q-3 X2 Y2\nX9', 'axis words before G0 or G1'),
    ],
)
def test_what_is_no_spline_of_linuxcnc_is_refused(text, part):
    with pytest.raises(ProgramError, match=part):
        points_of(text)


def test_on_fanuc_they_are_switches():
    with pytest.raises(ProgramError, match='spline moves are not supported'):
        points_of('G54.1 P1\nG5 I0 J3 P0 Q-3 X2 Y2', 'part.nc')
    tip, _ = points_of('G5.1 Q1\nG5 P10000\nG1 X9\nG5 P0\n', 'part.nc')
    assert tip[-1, 0] == 9.0
