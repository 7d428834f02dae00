"""Mirroring and scaling: G51, G51.1 of Fanuc, MIRROR and SCALE of Siemens."""

import numpy as np
import pytest

from cnc_interp.core import MM, ProgramError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import JobSetup, Tool, read_text
from cnc_interp.settings.options import Settings

XYZ = Transform.of(Machine.load('xyz'))
SETUP = JobSetup(tools={1: Tool(0.0, 2.0 * MM)})
PART = """G0 X5 Y6 Z3
G1 X20 F600
G3 X30 Y16 I0 J10
G2 X40 Y26 R10
G91 G1 X4 Y-7
G90 Y6
G18 G2 X34 Z13 I-10 K0
G17 G1 Y1
"""
CONTOUR = 'G0 X0 Y0 Z0\nG41 D1\nG1 X10 Y0 F600\nX30\nG3 X40 Y10 J10\nG1 Y30\nX10\nG40 G1 X0 Y40\n'


def tips(text, head='', name='part.nc', dialect='fanuc'):
    settings = Settings(dialect=dialect)
    blocks = read_text(
        f'G21 G90 G17\nG0 X0 Y0 Z0\n{head}\n{text}', name, XYZ, settings, SETUP
    ).blocks
    return blocks.tip[blocks.line_number > 3] / MM, blocks


@pytest.mark.parametrize(
    ('head', 'factor', 'moved'),
    [
        ('G51.1 X50', [-1, 1, 1], [100, 0, 0]),
        ('G51.1 X50 Y2', [-1, -1, 1], [100, 4, 0]),
        ('G51.1 Z0', [1, 1, -1], [0, 0, 0]),
        ('G51 X0 Y0 Z0 P2.', [2, 2, 2], [0, 0, 0]),
        ('G51 X10 Y5 Z0 P500', [0.5, 0.5, 0.5], [5, 2.5, 0]),
        ('G51 X0 Y0 Z0 I-1. J1. K1.', [-1, 1, 1], [0, 0, 0]),
        ('MIRROR X0', [-1, 1, 1], [0, 0, 0]),
        ('SCALE X2 Y2 Z2', [2, 2, 2], [0, 0, 0]),
        ('G51 X0 Y0 Z0 P3.\nG50', [1, 1, 1], [0, 0, 0]),
        ('G51.1 X7 Y0\nG50.1 X0', [1, -1, 1], [0, 0, 0]),
    ],
)
def test_places_and_arcs_are_those_of_the_part_mirrored_or_scaled(head, factor, moved):
    head = head if '\n' in head else f'{head}\n'
    dialect = 'siemens' if 'R' in head[:7] and 'G' not in head[:3] else 'fanuc'
    _, before = tips(PART, '\n', dialect=dialect)
    _, blocks = tips(PART, head, dialect=dialect)
    ends = np.flatnonzero(np.diff(blocks.line_number, append=0))
    wanted = np.flatnonzero(np.diff(before.line_number, append=0))
    np.testing.assert_allclose(
        blocks.tip[ends][1:] / MM, before.tip[wanted][1:] / MM * factor + moved, atol=1e-9
    )
    # Each point of the arcs lies on the mirrored arc: about its centre, on the same side.
    on_arc = blocks.tip[blocks.line_number == 7] / MM
    centre = np.array([20, 16, 3]) * factor + moved
    radius = 10.0 * abs(factor[0])
    np.testing.assert_allclose(np.linalg.norm(on_arc - centre, axis=1), radius, atol=1e-9)
    assert (((on_arc - centre) * factor)[:, 1] < 1e-9).all()
    np.testing.assert_allclose(blocks.feedrate[blocks.line_number == 7] * 60 / MM, 600)


@pytest.mark.parametrize('head', ['G51.1 X0', 'G51.1 Y0', 'G51.1 X0 Y0'])
def test_the_side_of_the_compensation_is_mirrored_too(head):
    factor = np.array([-1.0 if letter in head else 1.0 for letter in 'XYZ'])
    plain, mirrored = tips(CONTOUR, '')[0], tips(CONTOUR, head)[0]
    np.testing.assert_allclose(mirrored[1:], plain[1:] * factor, atol=1e-9)


def test_the_radius_of_the_cutter_is_not_scaled():
    found = tips('G0 X0 Y0\nG41 D1\nG1 X10 Y0 F600\nX30\nX40', 'G51 X0 Y0 Z0 P2.')[0]
    np.testing.assert_allclose(found[-1], [80, 2, 0], atol=1e-9)


@pytest.mark.parametrize(
    ('text', 'part'),
    [
        ('G51 X0 Y0 P2', 'P2: is 2 on some controls, 0.002 on others'),
        ('G51 X0 Y0', 'G51: give the scale as P'),
        ('G51.1', r'G51\.1: give the axis'),
        (
            'G51 X0 Y0 Z0 I2. J1. K1.\nG1 X9 F9\nG2 X0 I-4.5',
            'different scales',
        ),
        ('G51.1 X0\nG68 X0 Y0 R30', 'G68: axes are mirrored or scaled'),
        ('G51.1 Z0\nG81 X1 Z-1 R2 F9', 'G81: axes are mirrored or scaled'),
        ('G51.1 X0\nG92 X5', 'G92: axes are mirrored'),
        ('G50 X100', 'presets coordinates on lathes'),
        ('MIRROR X0\nATRANS X5', 'ATRANS: comes after MIRROR'),
    ],
)
def test_what_controls_mirror_in_different_ways_is_refused(text, part):
    with pytest.raises(ProgramError, match=part):
        tips(text)


@pytest.mark.parametrize(
    ('corner', 'ends'),
    [
        (',R3', [[17, 0], [20, 3]]),
        (',C2', [[18, 0], [20, 2]]),
        (', R#1', [[16, 0], [20, 4]]),
        (',C[#1/2]', [[18, 0], [20, 2]]),
    ],
)
def test_corner_words_of_fanuc(corner, ends):
    found = tips(f'#1=4\nG1 X20 Y0 {corner} F600\nY30\n')[0]
    np.testing.assert_allclose([found[0, :2], found[-2, :2]], ends, atol=1e-9)
    np.testing.assert_allclose(found[-1, :2], [20, 30], atol=1e-9)
    np.testing.assert_allclose(tips('G1 X10 ,A45 F600\n')[0][-1], [10, 10, 0], atol=1e-9)


@pytest.mark.parametrize(
    ('corner', 'ends'), [(',R3', [[34, 0], [40, 6]]), (',C2', [[36, 0], [40, 4]])]
)
def test_corners_are_scaled_with_the_path(corner, ends):
    found = tips(f'G1 X20 Y0 {corner} F600\nY30\n', 'G51 X0 Y0 Z0 P2.')[0]
    np.testing.assert_allclose([found[0, :2], found[-2, :2]], ends, atol=1e-9)
    with pytest.raises(ProgramError, match='different scales'):
        tips(f'G1 X20 Y0 {corner} F600\nY30\n', 'G51 X0 Y0 Z0 I2. J1. K1.')
