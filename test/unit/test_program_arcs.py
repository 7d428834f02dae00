"""Arcs: chords against the circle that the words describe, drawn here point by point."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from test_program_gcode import ThreeAxes
from test_program_subdivision import TableAC
from tiers import examples

from cnc_interp.core import ProgramError
from cnc_interp.program import read_text
from cnc_interp.settings.options import Settings

PLANES = {'G17': ('XY', 'IJ', 'Z'), 'G18': ('ZX', 'KI', 'Y'), 'G19': ('YZ', 'JK', 'X')}


def read(text, geometry=None, **options):
    return read_text(text, 'arc.ngc', geometry or ThreeAxes(), Settings(**options)).blocks


def turned(points, centre, axes):
    """Angle run through around a centre, counter-clockwise positive [rad]."""
    a, b = ('XYZ'.index(letter) for letter in axes)
    v = points - centre
    angle = np.unwrap(np.arctan2(v[:, b], v[:, a]))
    return angle[-1] - angle[0], np.hypot(v[:, a], v[:, b])


@pytest.mark.parametrize('plane', PLANES)
@pytest.mark.parametrize('code', ['G2', 'G3'])
@pytest.mark.parametrize('sweep', [1.0, 90.0, 180.0, 200.0, 359.0, 360.0])
def test_centre_arcs_and_helices(plane, code, sweep):
    """From angle 20 deg on a circle of 10 mm about (3, -4), rising by 6 mm."""
    axes, offsets, normal = PLANES[plane]
    sign = 1.0 if code == 'G3' else -1.0
    start, end = np.radians(20.0), np.radians(20.0 + sign * sweep)
    p = [10.0 * np.array([np.cos(t), np.sin(t)]) + [3.0, -4.0] for t in (start, end)]
    i, j = np.array([3.0, -4.0]) - p[0]
    a, b = axes
    text = (
        f'{plane} G0 {a}{p[0][0]:.6f} {b}{p[0][1]:.6f} {normal}1\n'
        f'{code} {a}{p[1][0]:.6f} {b}{p[1][1]:.6f} {normal}7 '
        f'{offsets[0]}{i:.6f} {offsets[1]}{j:.6f} F600'
    )
    blocks = read(text)
    tips = blocks.tip * 1e3
    centre = np.zeros(3)
    centre['XYZ'.index(a)], centre['XYZ'.index(b)] = 3.0, -4.0
    angle, radius = turned(tips, centre, axes)
    assert np.degrees(angle) == pytest.approx(sign * sweep, abs=1e-4)
    np.testing.assert_allclose(radius, 10.0, atol=1e-5)
    rise = tips[:, 'XYZ'.index(normal)]
    np.testing.assert_allclose(rise, np.linspace(1.0, 7.0, len(tips)), atol=1e-9)
    # The chord's middle lies inside the circle by no more than a tenth of 0.02 mm.
    middle = turned(0.5 * (tips[1:] + tips[:-1]), centre, axes)[1]
    assert (10.0 - middle).max() <= 2e-3 + 1e-6
    assert len(tips) - 1 <= 1.1 * np.radians(sweep) / (2 * np.arccos(1 - 2e-4)) + 4
    np.testing.assert_allclose(blocks.contour_tolerance[1:], 0.9 * 2e-5)
    np.testing.assert_allclose(blocks.feedrate[1:], 0.01)


@pytest.mark.parametrize(
    ('word', 'sweep'), [('G2 R10', -90.0), ('G2 R-10', -270.0), ('G3 R10', 90), ('G3 R-10', 270)]
)
def test_radius_arcs_take_the_short_way_unless_negative(word, sweep):
    code, radius = word.split()
    tips = read(f'G0 X10 Y0\n{code} X0 Y10 {radius} F600').tip * 1e3
    short = np.sign(sweep) * np.sign(float(radius[1:])) > 0
    centre = np.array([0.0, 0.0, 0.0] if short else [10.0, 10.0, 0.0])
    angle, found = turned(tips, centre, 'XY')
    assert np.degrees(angle) == pytest.approx(sweep)
    np.testing.assert_allclose(found, 10.0, atol=1e-9)


def test_a_half_circle_whose_radius_is_rounded_down():
    tips = read('G0 X0 Y0\nG2 X20.001 Y0 R10 F600').tip * 1e3
    assert tips[:, 1].max() == pytest.approx(10.0005, abs=2e-3)


def test_full_circles_turns_and_lines_that_only_look_like_them():
    circle = read('G0 X10\nG3 I-10 F600')
    assert np.degrees(turned(circle.tip, np.zeros(3), 'XY')[0]) == pytest.approx(360)
    thrice = read('G0 X10\nG2 I-10 Z-3 P3 F600')
    assert np.degrees(turned(thrice.tip, np.zeros(3), 'XY')[0]) == pytest.approx(-1080)
    siemens = read('G0 X10\nG2 X10 Y0 I-10 Z-3 TURN=2 F600')
    np.testing.assert_allclose(siemens.tip, thrice.tip, atol=1e-15)


def test_words_of_the_centre_absolute_by_mode_and_by_function():
    wanted = read('G0 X10 Y5\nG3 X0 Y15 I-10 J0 F600').tip
    for words in ('G90.1\nG3 X0 Y15 I0 J5', 'G3 X0 Y15 I=AC(0) J=AC(5)', 'G3 X0 Y15 CR=10'):
        np.testing.assert_allclose(read(f'G0 X10 Y5\n{words} F600').tip, wanted, atol=1e-12)


def test_arcs_that_fit_in_one_way_only_tell_what_centres_are():
    head = 'G0 X40 Y0\nG3 X30 Y10 '
    by_start = 'I-10 J0 F600\nX20 Y0 I0 J-10\nX20 Y0 I10 J0\nX30 Y-10 I10 J0\n'
    wanted = read(head + by_start).tip
    reversed_ = 'I10 J0 F600\nX20 Y0 I0 J10\nX20 Y0 I-10 J0\nX30 Y-10 I-10 J0\n'
    absolute = 'I30 J0 F600\nX20 Y0 I30 J0\nX20 Y0 I30 J0\nX30 Y-10 I30 J0\n'
    for told in (reversed_, absolute):
        program = read_text(head + told, 'arc.nc', ThreeAxes())
        np.testing.assert_allclose(program.blocks.tip, wanted, atol=1e-12)
        assert 'line 2: I J K: ' in str(program.notices)
        circle = head.replace('X30 Y10 ', 'I10 J0 F9\nX30 Y10 ')
        one = head + told[: told.index('X20')]
        two = head + told[: told.index('X30')]
        for text in (circle + told, one, two, one + 'X20 Y0 R10\n', 'G91.1\n' + head + told):
            with pytest.raises(ProgramError, match='--arc-centres'):
                read_text(text, 'arc.nc', ThreeAxes())


def test_arcs_in_inch_and_incremental():
    wanted = read('G0 X25.4\nG3 X0 Y25.4 I-25.4 F600').tip
    np.testing.assert_allclose(read('G20 G0 X1\nG3 X0 Y1 I-1 F20').tip, wanted, atol=1e-12)
    np.testing.assert_allclose(
        read('G0 X25.4\nG91 G3 X-25.4 Y25.4 I-25.4 F600').tip, wanted, atol=1e-12
    )


def test_arcs_are_modal_and_inverse_time_is_shared_out():
    blocks = read('G93 G0 X10\nG3 X0 Y10 R10 F30\nX-10 Y0 R10 F60\nM2')
    for line, seconds in ((2, 2.0), (3, 1.0)):
        pieces = blocks.line_number == line
        assert pieces.sum() > 10 and blocks.duration[pieces].sum() == pytest.approx(seconds)


def test_an_arc_with_rotary_motion_keeps_both():
    blocks = read('M428\nG0 X10 A20 C0\nG3 X-10 I-10 C120 F600', TableAC())
    u = np.arange(len(blocks)) / (len(blocks) - 1)
    np.testing.assert_allclose(blocks.tip[:, 0], 0.01 * np.cos(np.pi * u), atol=1e-12)
    np.testing.assert_allclose(np.degrees(blocks.rotary[:, 1]), 120 * u, atol=1e-9)


NUMBERS = st.integers(-50000, 50000).map(lambda n: n / 1000)


@settings(max_examples=examples(15, 300))
@given(
    start=st.tuples(NUMBERS, NUMBERS),
    end=st.tuples(NUMBERS, NUMBERS),
    stretch=st.floats(1.0, 30.0),
    long_way=st.booleans(),
    code=st.sampled_from(['G2', 'G3']),
    tolerance=st.sampled_from([1e-6, 1e-5, 1e-3]),
)
def test_any_radius_arc_is_within_its_share_of_the_tolerance(
    start, end, stretch, long_way, code, tolerance
):
    half = 0.5 * np.linalg.norm(np.subtract(start, end))
    assume(half > 0.1)
    radius = round(half * stretch + 0.001, 3)
    text = f'G0 X{start[0]} Y{start[1]}\n{code} X{end[0]} Y{end[1]} R{"-" * long_way}{radius} F600'
    tips = read(text, contour_tolerance=tolerance).tip[:, :2] * 1e3
    np.testing.assert_allclose(tips[[0, -1]], [start, end], atol=1e-9)
    # Three points of it give the circle; it bulges to the right of its chord for G3.
    middle = 0.5 * (tips[0] + tips[-1])
    along = (tips[-1] - tips[0]) / (2 * half)
    left = np.array([-along[1], along[0]])
    side = (1 if code == 'G3' else -1) * (-1 if long_way else 1)
    centre = middle + side * np.sqrt(max(radius**2 - half**2, 0.0)) * left
    np.testing.assert_allclose(np.linalg.norm(tips - centre, axis=1), radius, atol=1e-6)
    sag = radius - np.linalg.norm(0.5 * (tips[1:] + tips[:-1]) - centre, axis=1)
    assert sag.max() <= 0.1 * tolerance * 1e3 * (1 + 1e-6) + 1e-9
    angle, _ = turned(np.c_[tips, np.zeros(len(tips))], np.r_[centre, 0.0], 'XY')
    assert (abs(angle) > np.pi) == long_way or half == pytest.approx(radius, rel=1e-6)
    assert np.sign(angle) == (1 if code == 'G3' else -1)


@settings(max_examples=examples(15, 300))
@given(
    radius=st.floats(0.02, 200.0),
    angles=st.tuples(st.floats(0, 6.28), st.floats(-1.0, 1.0)),
    rise=st.floats(-3.0, 3.0),
    grown=st.floats(-1e-3, 1e-3),
    tolerance=st.sampled_from([0.001, 0.02, 0.3]),
)
def test_chords_and_smoothing_together_keep_the_tolerance_of_any_arc(
    radius, angles, rise, grown, tolerance
):
    """LHchips4, lines 8195 and 8196: an arc of one chord left the whole tolerance to smoothing."""
    first, sweep = angles
    sweep = 2.0 * np.pi * np.sign(sweep or 1.0) * abs(sweep) ** 3  # many are short
    last, outer = first + sweep, radius + grown * min(radius, 1.0)
    start, end = radius * np.exp(1j * first), outer * np.exp(1j * last)
    assume(abs(end - start) > 2e-3)
    code = 'G3' if sweep > 0 else 'G2'
    blocks = read(
        f'G64 P{tolerance}\nG0 X{start.real:.9f} Y{start.imag:.9f}\n{code} X{end.real:.9f} '
        f'Y{end.imag:.9f} Z{rise:.9f} I{-start.real:.9f} J{-start.imag:.9f} F600\nG1 X900\nM2'
    )
    rows = np.flatnonzero(blocks.line_number == 3)
    pieces = len(rows)
    for i, row in enumerate(rows):
        share = (i + np.linspace(0.0, 1.0, 33)) / pieces
        at = (radius + share * (outer - radius)) * np.exp(1j * (first + share * sweep))
        arc = np.c_[at.real, at.imag, share * rise]
        a, b = blocks.tip[row - 1] * 1e3, blocks.tip[row] * 1e3
        along = np.clip((arc - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        off = np.linalg.norm(arc - a - along[:, None] * (b - a), axis=1).max()
        assert off + blocks.contour_tolerance[row] * 1e3 <= tolerance * (1 + 1e-9) + 1e-8
    assert blocks.contour_tolerance[rows[-1] + 1] * 1e3 == pytest.approx(tolerance)


def test_chords_of_arcs_keep_the_smaller_tolerance():
    """The point at flank height moves with the tip: a tenth of its tolerance counts, too."""
    text = 'G0 X10 Y0 Z0\nG2 X-10 Y0 I-10 J0 F600'
    tips = read(text, contour_tolerance=1e-4, orientation_tolerance=5e-6).tip * 1e3
    middle = 0.5 * (tips[1:] + tips[:-1])
    assert 10.0 - np.linalg.norm(middle, axis=1).min() <= 5e-4


def test_chords_of_an_arc_with_rotary_motion_keep_the_top_point():
    """Deviations of tip and tool axis add up at flank height."""
    text = 'M428\nG0 X10 Y0 Z0 A20 C0\nG2 X-10 Y0 A45 C80 I-10 J0 F600'
    blocks = read(text, TableAC(), contour_tolerance=2e-5, orientation_tolerance=2e-5)
    u = np.linspace(0.0, 1.0, len(blocks))
    for share in (0.25, 0.5, 0.75):
        at = u[:-1] + share * np.diff(u)
        angle = -np.pi * at
        tip = 1e-2 * np.stack([np.cos(angle), np.sin(angle), 0 * at], axis=1)
        a, c = np.radians(20 + 25 * at), np.radians(80 * at)
        axis = TableAC().tool_axis(np.stack([a, c], axis=1))
        chord = blocks.tip[:-1] + share * np.diff(blocks.tip, axis=0)
        turned = blocks.axis[:-1] + share * np.diff(blocks.axis, axis=0)
        turned /= np.linalg.norm(turned, axis=1)[:, None]
        off = tip + 0.03 * axis - chord - 0.03 * turned
        assert np.linalg.norm(off, axis=1).max() <= 0.1 * 2e-5 * 1.05
