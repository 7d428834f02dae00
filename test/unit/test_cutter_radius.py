"""Cutter radius compensation: the distance of the path from the contour, corners, refusals."""

from contextlib import suppress
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tiers import few_of

from cnc_interp.core import DEG, MM, ProgramError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import JobSetup, Tool, read_text
from cnc_interp.proof import linuxcnc_reader
from cnc_interp.settings.options import Settings

XYZ, AC = Transform.of(Machine.load('xyz')), Transform.of(Machine.load('xyzac'))
SETUP = JobSetup(tools={1: Tool(0.0, 5.0 * MM), 2: Tool(0.0, 2.0 * MM)})
#: Chords leave an arc by a tenth of this tolerance [mm].
FINE = Settings(contour_tolerance=1e-3 * MM)
CHORD = 2e-4
PART = """G1 X0 Y20 F1000
Z-1
G1 Y40
G2 X10 Y50 I10
G1 X30
Y40
G3 X40 Y30 I10
G1 X60
X50 Y10
X60 Y0
X0
Y20
"""


def read(text, geometry=XYZ, name='part.nc'):
    return read_text(text, name, geometry, FINE, SETUP)


def path(text, lines=None, head='G21 G90 G17\nG0 X-20 Y-20 Z5\n'):
    """Points of the tool centre [mm], shape (n, 3); of some lines only, if they are given."""
    blocks = read(head + text).blocks
    wanted = np.isin(blocks.line_number, lines) if lines else np.ones(len(blocks), dtype=bool)
    return blocks.tip[wanted] / MM


def dense(points):
    """Points on the chords between points, shape (m, 3)."""
    share = np.linspace(0.0, 1.0, 20)[:, None]
    return np.concatenate([a + share * (b - a) for a, b in pairwise(points)])


def distances(points, contour):
    """Distance of each point from the chords of a contour [mm], in X and Y."""
    a, b = contour[:-1, None, :2], contour[1:, None, :2]
    along = b - a
    share = ((points[None, :, :2] - a) * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-12)
    foot = a + np.clip(share, 0.0, 1.0)[..., None] * along
    return np.linalg.norm(points[None, :, :2] - foot, axis=-1).min(axis=0)


@pytest.mark.parametrize(
    ('code', 'radius', 'side'),
    [
        ('G41 D1', 5.0, 1.0),
        ('G42.1 D5', 2.5, -1.0),
        pytest.param('G42 D2', 2.0, -1.0, marks=pytest.mark.thorough),
        pytest.param('G41.1 D-4', 2.0, -1, marks=pytest.mark.thorough),
    ],
)
def test_the_tool_keeps_its_radius_from_the_contour(code, radius, side):
    contour = path(PART)[1:]
    blocks = read(f'G21 G90 G17\nG0 X-20 Y-20 Z5\n{code}\n{PART}G40 G1 X-20\n').blocks
    points = blocks.tip[(blocks.line_number >= 6) & (blocks.line_number <= 15)] / MM
    away = distances(dense(points), contour)
    assert away.min() > radius - CHORD and away.max() < radius + CHORD
    # On the left of a clockwise contour the tool is outside of it.
    assert (points[:, 1].max() > 50.0) == (side > 0)
    np.testing.assert_allclose(blocks.tip[-1] / MM, [-20, 20, -1], atol=1e-9)


@pytest.mark.skipif(not linuxcnc_reader.interpreter(), reason="needs LinuxCNC's rs274")
@pytest.mark.parametrize(
    ('code', 'entry'),
    few_of(
        5,
        ['G41.1 D10', 'G42.1 D4', 'G41.1 D1', 'G42.1 D9'],
        ['G1 X0 Y0 F1000', 'G1 X-14 Y40 F1000', 'G2 X0 Y40 I20 J0 F900', 'G3 X0 Y40 J20 F900'],
    ),
)
def test_linuxcnc_goes_through_the_same_points(code, entry, monkeypatch):
    monkeypatch.setattr(linuxcnc_reader, '_NOT_COMPARED', ())
    text = f'G21 G90 G17 F900\nG0 X-20 Y20 Z5\n{code}\n{entry}\nG1 X0 Y60\nX30\nY66\nX60\n'
    text += 'Y30\nG2 X50 Y20 I-10\nG1 X20 Y20\nG40\nZ9\nX-20\nM2\n'
    # The first motion goes to where the tool stands before the program.
    _, *moves = linuxcnc_reader.read_by_linuxcnc(text, ('X', 'Y', 'Z'), False, 1000)
    theirs = np.array([move.end[:3] for move in moves]) / MM
    ours = read(text, name='part.ngc').blocks.tip / MM
    assert len(theirs) >= 10
    for point in theirs:
        assert np.abs(ours - point).max(axis=1).min() < 1e-4


def test_an_outer_corner_is_an_arc_and_an_inner_one_a_point():
    outer = path('G41 D1\nG1 X0 Y0 F900\nX40\nY-40\nG40 G1 X60', [5, 6])
    about = np.hypot(outer[:, 0] - 40.0, outer[:, 1])
    rolls = (outer[:, 0] >= 40.0) & (outer[:, 1] >= 0.0)
    assert rolls.sum() > 10
    np.testing.assert_allclose(about[rolls], 5.0, atol=CHORD)
    inner = path('G41 D1\nG1 X0 Y0 F900\nX40\nY40\nG40 G1 X60', [4, 5, 6])
    np.testing.assert_allclose(inner[:, :2], [[0, 5], [35, 5], [35, 40]], atol=1e-9)


def test_a_line_back_from_an_arc_meets_it_where_the_tool_stands_between_them():
    text = 'G42.1 D4\nG1 X20 Y0 F900\nG3 X-20 Y0 I-20\nG1 X-20 Y30\nG40 G1 X-10 Y40'
    between = path(text, [5, 6, 7], 'G21\nG0 X20 Y-10 Z0\n')
    wanted = [[-18, np.sqrt(22**2 - 18**2)], [-18, 30]]
    np.testing.assert_allclose(between[[-3, -2], :2], wanted, atol=CHORD)
    outside = path(text.replace('G42', 'G41'), [5, 6, 7], 'G21\nG0 X20 Y-10 Z0\n')
    assert outside[:, 1].min() < -1.99


def test_inverse_time_gives_a_contour_its_speed_and_its_corners_that_of_the_next_line():
    head = 'G21\nG0 X-10 Y0 Z0\nG42.1 D2\nG1 X0 Y0 F600\n'
    blocks = read(f'{head}G93 G1 X10 F30\nG1 Y10 F15\nG94 G40 G1 X20 Y20 F600').blocks
    feed, line = blocks.feedrate * 60 / MM, blocks.line_number
    np.testing.assert_allclose(feed[line == 5][0], 300)
    np.testing.assert_allclose(feed[line == 5][1:], 150)  # about the corner
    np.testing.assert_allclose(feed[line == 6], 150)


def test_a_helix_rises_as_programmed_and_a_plunge_stays_in_place():
    text = 'G41 D2\nG1 X10 Y0 F900\nZ0\nG3 X-10 Y0 Z4 I-10\nG3 X10 Y0 Z8 I10\nG40 G1 X0\n'
    points = path(text, [4, 5, 6, 7])
    np.testing.assert_allclose(points[0], [8, 0, 5], atol=1e-9)
    np.testing.assert_allclose(points[1], [8, 0, 0], atol=1e-9)
    np.testing.assert_allclose(np.hypot(*points[:, :2].T), 8.0, atol=CHORD)
    turned = np.unwrap(np.arctan2(points[1:, 1], points[1:, 0]))
    np.testing.assert_allclose(points[1:, 2], 4.0 * turned / np.pi, atol=1e-9)


def test_the_other_planes_and_tilted_planes_have_their_own_left():
    flat = path('G41 D2\nG1 X0 Y0 F900\nX10\nY-10\nX0\nG40 G1 X-20', head='G0 X-20 Y-20 Z0\n')
    for plane, to in (('G18', 'ZXY'), ('G19', 'YZX')):
        words = str.maketrans('XYZ', to)
        text = 'G0 X-20 Y-20 Z0\nG41 D2\nG1 X0 Y0 F900\nX10\nY-10\nX0\nG40 G1 X-20'
        turned = path(text.translate(words), head=f'{plane}\n')
        order = ['XYZ'.index(letter) for letter in to]
        np.testing.assert_allclose(turned[:, order], flat, atol=1e-9)
    plane = 'G0 X0 Y0 Z50\nG68.2 X10 Y20 Z30 I30 J20\nG53.1\n'
    text = 'G0 X-20 Y-20 Z0\nG41 D2\nG1 X0 Y0 F900\nX10\nY-10\nX0\nG40 G1 X-20'
    blocks = read(plane + text, AC).blocks
    c, s = np.cos([30 * DEG, 20 * DEG]), np.sin([30 * DEG, 20 * DEG])
    turn = np.array(
        [[c[0], -s[0] * c[1], s[0] * s[1]], [s[0], c[0] * c[1], -c[0] * s[1]], [0.0, s[1], c[1]]]
    )
    there = (blocks.tip[blocks.line_number >= 4] / MM - [10, 20, 30]) @ turn
    np.testing.assert_allclose(there, flat, atol=1e-9)


def test_stops_are_kept_and_nobody_waits_on_the_arc_about_a_vertex():
    text = 'G41 D1\nG1 X0 Y0 F900\nX40\nM0\nY-40\nG40 G1 X60'
    blocks = read(f'G0 X-20 Y-20\n{text}').blocks
    waits = np.flatnonzero(blocks.program_stop)
    assert len(waits) == 1
    np.testing.assert_allclose(blocks.tip[waits[0], :2] / MM, [40, 5], atol=1e-9)


def test_a_program_that_ends_without_g40_ends_beside_its_contour():
    points = path('G41 D1\nG1 X0 Y0 F900\nX40\nM30')
    np.testing.assert_allclose(points[-1], [40, 5, 5], atol=1e-9)


def test_after_g40_the_tool_is_where_it_is():
    points = path('G41 D1\nG1 X0 Y0 F900\nX40\nG40\nZ9\nG91 G0 X1')
    np.testing.assert_allclose(points[-2:], [[40, 5, 9], [41, 0, 9]], atol=1e-9)


@settings(max_examples=60)
@given(
    st.lists(st.floats(12.0, 40.0), min_size=5, max_size=12),
    st.floats(0.5, 3.0),
    st.booleans(),
    st.floats(0.0, 360.0),
)
def test_random_contours_are_followed_at_the_radius_or_refused(radii, radius, left, start):
    angles = np.linspace(0.0, 2.0 * np.pi, len(radii) + 1)[:-1] + start * DEG
    corners = np.array(radii)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    middle = 0.5 * (corners[0] + corners[-1])
    contour = np.vstack([middle, corners, middle]).round(4)
    code = 'G41.1' if left else 'G42.1'
    text = f'G0 X90 Y90 Z0\n{code} D{2 * radius:.4f}\nG1 F900\n'
    text += ''.join(f'G1 X{x:.4f} Y{y:.4f}\n' for x, y in contour) + 'G40 G0 Z20\n'
    try:
        blocks = read(text).blocks
    except ProgramError as problem:
        assert 'does not fit' in str(problem)
        return
    points = blocks.tip[(blocks.line_number >= 4) & (blocks.line_number < 5 + len(radii))] / MM
    away = distances(dense(points), np.c_[contour, np.zeros(len(contour))])
    assert away.min() > radius - CHORD - 1e-3  # the tolerance of the path
    assert away.max() < radius / np.sin(0.04) + CHORD


@pytest.mark.parametrize(
    ('text', 'part'),
    [
        ('G41 D7\nG1 X0', r'D7: the setup has no radius'),
        ('G41 D1\nG42 D1', 'G42: G41 is on; write G40'),
        ('G41.1\nG1 X0', r'G41\.1: give the diameter'),
        ('G41 D1\nG3 X-16 I2', 'does not fit'),
        ('G41 D1\nG1 X0 Y0\nX40\nG40\nG2 X50 I5', 'after G40 must be a line'),
        ('G41 D1\nG1 X0 Y0\nG92 X0', 'G92: G41 is on; write G40'),
        ('G41 D1\nG1 X0 Y0\nG18', 'G18: another plane while G41 is on'),
        ('G41 D1\nG1 X0 Y0\nTRANS X1', 'TRANS: G41 is on'),
        ('G41 D1\nG1 X0 Y0\nX40\nG3 X44 I2\nX50', r'part\.nc:5: the cutter does not fit'),
        ('G41 D1\nG1 X0 Y0\nX20\nX23 Y-4\nX26 Y0\nX40\nG40 X50', 'does not fit'),
        ('G41 D1\nG1 X0 Y0\nX40\nY8\nX0\nG40 X-9', 'the cutter does not fit'),
        # An arc whose radius, at its end only, is that of the cutter.
        (
            'G20\nG41.1 D.25\nG1 X-3.9 Y-1.5\nY-2\nX-.7625\nY-1.5095\nX-.3125\n'
            'G3 X-.25 Y-1.5262 I.0625 J.1083\nG1 Y-2\nG40',
            r'part\.nc:9: the cutter does not fit',
        ),
        ('CUT3DC\nG41 D1\nG1 X0', 'the only supported compensation in space is CUT3DF'),
    ],
)
def test_what_cannot_be_compensated_is_refused_with_its_line(text, part):
    with pytest.raises(ProgramError, match=part):
        read(f'G0 X-20 Y0 F900\n{text}')


LAP = 'Y20\nX20\nY0\nX-20\n'  # its last line crosses the first one, which begins below the part
LOOP = np.array([[0, 0], [0, 20], [20, 20], [20, 0], [0, 0.0]])


@pytest.mark.parametrize(
    ('contour', 'last'),
    [
        (LAP, 8),  # a lead along the first edge, and an exit that crosses it
        (LAP + 'Y-20\nX0\n' + LAP, 14),  # twice
        (LAP + 'Z4\nX-30\nY-20\nX0\n' + LAP + 'X-25\nY-25\nX0\n' + LAP, 23),
        ('Y20\nX20\nY0\nX0\nY20\nX20\nY0\nX0\nY10\nX-8\n', 14),  # two laps, an exit across
        ('Y20\nX20\nY0\nX-3\nG3 X-15 I-6\n', 9),  # away on an arc
    ],
)
def test_leads_along_the_contour_and_laps_leave_the_part_whole(contour, last):
    """Issue 56: they were refused, while controls and LinuxCNC run them."""
    text = f'G41 D1\nG1 X0 Y-8 F900\n{contour}G40 G1 X-40\n'
    points = path(text, range(4, last + 1))
    away = distances(dense(points), LOOP)
    assert away.min() > 5.0 - CHORD
    inside = (np.abs(points[:, :2] - 10.0).max(axis=1) < 10.0).any()
    assert not inside


@pytest.mark.parametrize(
    'contour',
    [
        'Y20\nX20\nY0\nX-8\nY6\nX5\n',  # the exit comes back to the part
        'Y20\nX20\nY12\nX8\nY9\nX20\nY0\nX-8\n',  # a slot of 3 mm
        'Y20\nX20\nY0\nX-8\nY-9\nX0\nY30\nX-3\nY2\n',  # after the lap down along its edge
    ],
)
def test_a_cut_into_the_part_is_refused_also_beside_leads(contour):
    with pytest.raises(ProgramError, match='does not fit'):
        path(f'G41 D1\nG1 X0 Y-8 F900\n{contour}G40 G1 X-40\n')


def test_rotary_motion_is_refused_beside_a_contour():
    with pytest.raises(ProgramError, match='rotary motion'):
        read('G0 X-20 Y0 A0 C0\nG41 D1\nG1 X0 Y0 F900\nX40 A5', AC)
    with pytest.raises(ProgramError, match='move to a position beside the contour'):
        read('G41 D1\nG0 X0')
    with pytest.raises(ProgramError, match='upright'):
        read('TRAORI\nG0 X-20 Y0 A20 C0\nG41 D1\nG1 X0 Y0 F900\nX40', AC)


@pytest.mark.parametrize('name', few_of(2, ['part.nc', 'part.ngc']))
def test_edges_and_arcs_of_the_size_of_the_cutter_are_followed_or_refused(name):
    rng = np.random.default_rng(7)
    for _ in range(60):
        radius, place = rng.choice([1.0, 2.0, 5.0]), 0j
        lines = [
            'G0 X-20 Y-20 Z0 F900',
            f'{rng.choice(["G41.1", "G42.1"])} D{2 * radius}',
            'X0 Y0',
        ]
        for size in radius * rng.choice([0.5, 1.0, 1.0001, 2.0, 1e-3], rng.integers(2, 9)):
            arm = size * np.exp(1j * DEG * rng.choice([0, 90, 180, 270, rng.uniform(0, 360)]))
            turn = DEG * rng.choice([90, 180, 360, rng.uniform(1, 359)]) * rng.choice([-1, 0, 1])
            end = place + (arm if not turn else arm * (1 - np.exp(1j * turn)))
            code = (
                'G1'
                if not turn
                else f'{"G3" if turn > 0 else "G2"} I{arm.real:.5f} J{arm.imag:.5f}'
            )
            lines.append(f'{code} X{end.real:.4f} Y{end.imag:.4f}')
            place = complex(round(end.real, 4), round(end.imag, 4))
        with suppress(ProgramError):
            read('\n'.join([*lines, 'G40 G1 X-30 Y-30', 'M2']), name=name)
