"""Compensation along contact normals (G41.2, CUT3DF): the cutter touches exact surfaces."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cnc_interp.core import MM, InterpError, ProgramError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import JobSetup, Tool, read_text
from cnc_interp.program.setup_table import tool_changes
from cnc_interp.settings.options import Settings

FIVE_AXES = ['xyzac', 'xyzbc', 'bc_trunnion', 'head_head', 'head_table', 'xyzac_trt', 'xyzacw']
SETUP = JobSetup(
    tools={
        1: Tool(0.0, 5 * MM, 'ball', 5 * MM),
        2: Tool(0.0, 5 * MM, 'fillet', 1 * MM),
        3: Tool(0.0, 5 * MM, 'end', 0.0),
        4: Tool(0.0, 5 * MM),
    }
)
CUTTERS = {1: (0.0, 5.0), 2: (4.0, 1.0), 3: (5.0, 0.0)}


def read(text, machine='xyzac'):
    start = 'G21 G90\nG0 X0 Y0 Z50\nG43.4\nF1000\n'
    return read_text(
        start + text, 'part.ngc', Transform.of(Machine.load(machine)), Settings(), SETUP
    ).blocks


def ring_of(tip, axis, ring, corner):
    """Points of the circle on which the corner has its centres, dense [mm]."""
    across = np.cross(axis, [1.0, 0.0, 0.0] if abs(axis[0]) < 0.7 else [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    turn = np.linspace(0, 2 * np.pi, 20001)[:, None]
    circle = np.cos(turn) * across + np.sin(turn) * np.cross(axis, across)
    return tip + corner * axis + ring * circle


def on_sphere(radius=20.0, rows=7):
    """Contact points, normals and words of a pass over a sphere about 0, 0, -20."""
    for a, c in zip(np.linspace(5, 35, rows), np.linspace(-40, 60, rows), strict=True):
        tilt, turn = np.radians(a + 20), np.radians(c + 15)
        n = np.array([np.sin(tilt) * np.sin(turn), np.sin(tilt) * np.cos(turn), np.cos(tilt)])
        yield radius * n - [0, 0, 20], n, (a, c)


@pytest.mark.parametrize('tool', CUTTERS)
@pytest.mark.parametrize('name', FIVE_AXES)
def test_the_cutter_touches_a_sphere_at_each_point(name, tool):
    first, second = Machine.load(name).axis_names[3:5]
    lines = [
        'G1 '
        + ' '.join(f'{w}{v:.12f}' for w, v in zip('XYZIJK', [*c, *n], strict=True))
        + f' {first}{a:.9f} {second}{t:.9f}'
        for c, n, (a, t) in on_sphere()
    ]
    blocks = read(f'G41.2 D{tool}\n' + '\n'.join(lines) + '\nG40\nG0 X0 Y0 Z60\n', name)
    ring, corner = CUTTERS[tool]
    ends = np.flatnonzero(np.diff(blocks.line_number, append=0))
    ends = [i for i in ends if blocks.line_number[i] in range(6, 6 + len(lines))]
    assert len(ends) == len(lines)
    for i, (contact, normal, _) in zip(ends, on_sphere(), strict=True):
        tip, axis = blocks.tip[i] / MM, blocks.axis[i]
        away = np.linalg.norm(ring_of(tip, axis, ring, corner) - [0, 0, -20], axis=1)
        # The corner touches the sphere from outside, at the programmed point.
        assert away.min() - corner == pytest.approx(20.0, abs=1e-6)
        centre = contact + corner * normal
        gap = np.linalg.norm(ring_of(tip, axis, ring, corner) - centre, axis=1).min()
        assert gap < 2e-3 * max(ring, 1e-6) + 1e-9
    np.testing.assert_allclose(blocks.tip[-1] / MM, [0, 0, 60], atol=1e-9)


def test_a_nominal_tool_gives_the_difference_only():
    """Tips for tool 2, run with tool 1: as if contact points had been programmed for tool 1."""
    normal, axis = np.array([0.6, 0.0, 0.8]), np.array([0.0, 0.0, 1.0])
    contact = np.array([7.0, 3.0, -2.0])
    words = 'X{:.9f} Y{:.9f} Z{:.9f}'
    tip = contact + 1.0 * (normal - axis) + 4.0 * np.array([1.0, 0.0, 0.0])
    by_contact = read(f'G41.2 D1\nG1 {words.format(*contact)} I0.6 K0.8\n').tip[-1]
    by_tips = read(f'G41.2 D1 Q5 P1\nG1 {words.format(*tip)} I0.6 K0.8\n').tip[-1]
    same = read(f'G41.2 D2 Q5 P1\nG1 {words.format(*tip)} I0.6 K0.8\n').tip[-1]
    np.testing.assert_allclose(by_tips, by_contact, atol=1e-12)
    np.testing.assert_allclose(same / MM, tip, atol=1e-9)


def test_words_of_the_dialects_mean_the_same():
    fanuc = read('G41.2 D2\nG1 X5 Y1 Z-3 I3 K4\nX6\nG40\nX9 Y9 Z9').tip
    siemens = read('CUT3DF\nG41 D2\nG1 X5 Y1 Z-3 A5=3 C5=4\nX6\nG40\nX9 Y9 Z9').tip
    by_word = read('G42.2 D4 R1\nG1 X5 Y1 Z-3 I3 K4\nX6\nG40\nX9 Y9 Z9').tip
    np.testing.assert_array_equal(fanuc, siemens)
    np.testing.assert_array_equal(fanuc, by_word)
    # The normal is modal; the block after G40 leads to its end.
    np.testing.assert_allclose(fanuc[-2] - fanuc[-3], [1 * MM, 0, 0], atol=1e-12)
    np.testing.assert_allclose(fanuc[-1] / MM, [9, 9, 9], atol=1e-12)


def test_normals_turn_with_a_frame_and_stay_incremental():
    turned = read('ROT Z90\nG41.2 D1\nG1 X5 Y0 Z0 I1 K1\nG91 X1\n').tip / MM
    ball = 5 / np.sqrt(2)
    np.testing.assert_allclose(turned[-1], [0, 6 + ball, ball - 5], atol=1e-9)


def test_three_axes_and_a_tilted_plane():
    text = 'G21 G90\nG0 X0 Y0 Z50\n{}G41.2 D2\nG1 X5 Y0 Z0 I3 K4 F900\n'
    flat = [5 + 0.6 + 4, 0, 0.8 - 1]

    def tip(plane, machine):
        geometry = Transform.of(Machine.load(machine))
        return read_text(text.format(plane), 'part.ngc', geometry, Settings(), SETUP).blocks

    np.testing.assert_allclose(tip('', 'xyz').tip[-1] / MM, flat, atol=1e-9)
    tilted = tip('G68.2 X1 Y2 Z3 I30 J20\nG53.1\n', 'xyzac')
    turn = Rotation.from_euler('ZX', [30, 20], degrees=True)
    np.testing.assert_allclose(tilted.tip[-1] / MM, [1, 2, 3] + turn.apply(flat), atol=1e-9)
    np.testing.assert_allclose(tilted.axis[-1], turn.apply([0, 0, 1]), atol=1e-12)


def test_the_flank_and_the_bottom():
    side = read('G41.2 D2\nG1 X5 Y0 Z0 I1 K0\n').tip[-1] / MM
    np.testing.assert_allclose(side, [10, 0, -1], atol=1e-9)
    below = read('G41.2 D2\nG1 X5 Y0 Z0 K1\n').tip[-1] / MM
    np.testing.assert_allclose(below, [5, 0, 0], atol=1e-9)


def test_a_hollow_surface_that_the_tool_does_not_fit_is_refused_with_its_line():
    """A groove of radius 6 along Y takes a ball of 5; one of radius 4 does not."""

    def groove(radius):
        rows = []
        for angle in np.radians(np.arange(-60, 61, 10)):
            place = radius * np.sin(angle), -radius * np.cos(angle)
            rows.append(
                f'G1 X{place[0]:.9f} Z{place[1]:.9f} I{-np.sin(angle):.9f} K{np.cos(angle):.9f}'
            )
        return 'G41.2 D1\n' + '\n'.join(rows)

    tips = read(groove(6)).tip[-13:] / MM
    centres = tips + [0, 0, 5]
    np.testing.assert_allclose(np.hypot(centres[:, 0], centres[:, 2]), 1.0, atol=1e-8)
    with pytest.raises(ProgramError, match=r'part.ngc:7: G41.2: the cutter does not fit'):
        read(groove(4))


@pytest.mark.parametrize(
    ('text', 'part'),
    [
        ('G41.2 D1\nG1 X1', 'G41.2: write the contact normal in the block: I J K'),
        ('G41.2 D1\nG1 X1 I0 J0 K0', 'G41.2: the contact normal is zero'),
        ('G41.2 D1\nG1 X1 K-1', 'G41.2: the normal points down the tool'),
        ('G41.2 D2\nG1 X1 I0.0005 K1', 'G41.2: the normal is almost parallel'),
        ('G41.2 D1\nG2 X1 I1 K1', 'arcs have no contact normals; post lines'),
        ('G41.2 D4\nG1 X1 K1', 'G41.2: the corner radius of the tool is not known'),
        ('G41.2 D4 R6\nG1 X1 K1', 'R6: the corner radius must be from 0 to the radius, 5'),
        ('G41.2 D9\nG1 X1 K1', 'D9: the setup has no radius'),
        ('G41.2 D1 Q4\nG1 X1 K1', 'G41.2: Q is the radius and P the corner radius'),
        ('G49\nG41.2 D1\nG1 X1 K1', 'G41.2: needs tool-tip programming; write M428'),
        ('G49\nG43.5\nG41.2 D1\nG1 X1 K1', 'G41.2: with G43.5 I J K are the tool direction'),
        ('G41.2 D1\nG1 X1 K1\nG54', 'G54: G41.2 is on; write G40 first'),
        ('CUT3DC\nG41 D1\nG1 X1', 'CUT3DC: the only supported compensation in space is CUT3DF'),
    ],
)
def test_what_cannot_be_compensated_is_refused_in_one_line(text, part):
    with pytest.raises(ProgramError, match=part):
        read(text)


def test_the_corner_radius_can_be_set_while_the_machine_is_on():
    (change,) = tool_changes(SETUP, 4, {'corner_radius': 2 * MM}, remove=False, load=False)
    after = SETUP.changed(change)
    assert after.tools[4] == Tool(0.0, 5 * MM, '', 2 * MM)
    assert after.told(change) == 'length 0 radius 5 corner radius 2'
    for wrong in ({'corner_radius': 6 * MM}, {'corner_radius': -1 * MM}, {'radius': 0.5 * MM}):
        with pytest.raises(InterpError, match='corner radius must be from 0 to the radius'):
            tool_changes(after, 4, wrong, remove=False, load=False)


def test_the_corner_radius_is_kept_in_the_setup_file():
    assert JobSetup.of_text(SETUP.text()) == SETUP
    with pytest.raises(
        ProgramError, match=r'tools.1: the corner radius must be from 0 to the radius'
    ):
        JobSetup.of_text('tools:\n  1: {length: 1, radius: 2, corner_radius: 3}\n')
