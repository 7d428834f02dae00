"""Blocks with rotary words, judged by an independent great circle and a dense sampling."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tiers import examples

from cnc_interp.machine_model.signals import Signals
from cnc_interp.program import read_text
from cnc_interp.program.blocks import POSES, ROTARY_LINEAR
from cnc_interp.settings.options import Settings

H = 0.03


class TableAC:
    """A table-tilting AC machine, both rotary axes through the workpiece zero."""

    axis_names, rotary_names = ('X', 'Y', 'Z', 'A', 'C'), ('A', 'C')
    extra_names, extra_direction, control, signals = (), np.zeros((0, 3)), {}, Signals()
    tool_change_macro, arm, scale = '', None, 1.0
    is_linear = np.array([True, True, True, False, False])
    singular_cone = np.radians(0.02)

    @property
    def machine(self):
        """The same: what of a machine is read with its transformation."""
        return self

    five_axis = machine

    def nearest_to_pole(self, start, end):
        share = np.linspace(0.0, 1.0, 2001)[:, None]
        rows = [self.tool_axis(a + share * (b - a)) for a, b in zip(start, end, strict=True)]
        return np.array([np.arccos(np.abs(o[:, 2]).max()) for o in rows])

    def tool_axis(self, rotary):
        a, c = rotary[:, 0], rotary[:, 1]
        return np.stack([np.sin(a) * np.sin(c), np.sin(a) * np.cos(c), np.cos(a)], axis=1)

    def forward(self, q):
        rotary = q[:, 3:]
        tip = [self.turn(r).T @ p for p, r in zip(q[:, :3], rotary, strict=True)]
        return np.array(tip), self.tool_axis(rotary)

    def linear(self, tip, rotary):
        return np.array([self.turn(r) @ p for p, r in zip(tip, rotary, strict=True)])

    @staticmethod
    def turn(rotary):
        """p_M = R_x(A) R_z(C) p_W."""
        (sa, sc), (ca, cc) = np.sin(rotary), np.cos(rotary)
        return np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]]) @ np.array(
            [[cc, -sc, 0], [sc, cc, 0], [0, 0, 1]]
        )


class HeadBC(TableAC):
    """Other letters, another axis order in the vector."""

    axis_names, rotary_names = ('X', 'Y', 'Z', 'B', 'C'), ('B', 'C')

    def tool_axis(self, rotary):
        b, c = rotary[:, 0], rotary[:, 1]
        return np.stack([np.sin(b) * np.cos(c), np.sin(b) * np.sin(c), np.cos(b)], axis=1)


def rotate_about(o, k, angle):
    """Rodrigues' formula, one vector."""
    return o * np.cos(angle) + np.cross(k, o) * np.sin(angle) + k * (k @ o) * (1 - np.cos(angle))


def on_great_circle(o_a, o_b, u):
    """Great circle by rotation about the common normal."""
    normal = np.cross(o_a, o_b)
    sine = np.linalg.norm(normal)
    if sine < 1e-14:
        return o_a
    return rotate_about(o_a, normal / sine, u * np.arctan2(sine, o_a @ o_b))


def worst_deviation(geometry, blocks, first, last, start, sweep):
    """Largest h x angle between linear rotary axes and the great circles of the pieces [m]."""
    worst, n = 0.0, last - first
    for piece in range(n):
        o_a, o_b = blocks.axis[first + piece - 1], blocks.axis[first + piece]
        for u in np.linspace(0.0, 1.0, 33):
            rotary = start + sweep * (piece + u) / n
            o = geometry.tool_axis(rotary[None])[0]
            o_c = on_great_circle(o_a, o_b, u)
            angle = np.arctan2(np.linalg.norm(np.cross(o, o_c)), o @ o_c)
            worst = max(worst, H * angle)
    return worst


def axes_block(a0, c0, a1, c1, tolerance_mm=0.02, geometry=None, first='A', travel=50):
    text = (
        f'M428\nG64 P{tolerance_mm}\nG0 X0 Y0 Z0 {first}{a0} C{c0}\n'
        f'G1 X{travel} Y-20 {first}{a1} C{c1} F1200\nM30'
    )
    return read_text(text, 't.ngc', geometry or TableAC(), Settings(flank_height=H)).blocks


@pytest.mark.parametrize(
    ('a0', 'c0', 'a1', 'c1'),
    [
        (15, 0, 15, 90),
        (15, 0, 15, 360),
        pytest.param(15, 30, 15, -690, marks=pytest.mark.thorough),
        (2, 0, 40, 90),
        (89, 0, 91, 170),
        pytest.param(45, 10, 135, 200, marks=pytest.mark.thorough),
        (-71.841, -35.93, -71.266, -32.919),
    ],
)
def test_pieces_follow_linear_rotary_axes_within_a_tenth(a0, c0, a1, c1):
    blocks = axes_block(a0, c0, a1, c1)
    start, sweep = np.radians([a0, c0]), np.radians([a1 - a0, c1 - c0])
    n = len(blocks) - 1
    worst = worst_deviation(TableAC(), blocks, 1, len(blocks), start, sweep)
    assert worst <= 0.1 * 0.02e-3
    u = np.arange(n + 1) / n
    np.testing.assert_allclose(blocks.rotary, start + u[:, None] * sweep, atol=1e-12)
    np.testing.assert_allclose(blocks.axis, TableAC().tool_axis(blocks.rotary), atol=1e-12)
    np.testing.assert_allclose(blocks.tip, u[:, None] * [[0.05, -0.02, 0.0]], atol=1e-15)
    turned = np.sum(blocks.axis[1:] * blocks.axis[:-1], axis=1)
    assert np.all(turned > 0.0)
    assert set(blocks.line_number[1:]) == {4}
    assert blocks.exact_stop.tolist() == [False] * n + [True]


@pytest.mark.parametrize(('a', 'sweep_c'), [(15, 90), (15, 360), (40, 33), (70, 500)])
def test_pieces_are_no_more_than_needed(a, sweep_c):
    # A small circle of polar angle a: covariant acceleration sin(a) cos(a) c^2, chord share 1/8.
    blocks = axes_block(a, 0, a, sweep_c)
    c = np.radians(sweep_c)
    needed = np.sqrt(H * np.sin(np.radians(a)) * np.cos(np.radians(a)) * c**2 / 8 / 2e-6)
    assert needed <= len(blocks) - 1 <= 1.03 * needed + 1


def test_pieces_halve_when_the_tolerance_is_four_times_as_wide():
    fine = len(axes_block(20, 0, 20, 300, 0.01)) - 1
    coarse = len(axes_block(20, 0, 20, 300, 0.04)) - 1
    assert coarse == pytest.approx(fine / 2, abs=1)


def test_rotation_in_one_great_circle_is_cut_by_angle_only():
    # A alone turns on a meridian, exactly a great circle; pieces turn less than 90 deg.
    assert len(axes_block(5, 0, 80, 0)) - 1 == 1
    assert len(axes_block(5, 0, 175, 0)) - 1 == 2


@pytest.mark.parametrize(
    ('a0', 'c0', 'a1', 'c1'), [(0, 0, 0, 400), (45, 10, -45, 200), (0, 0, 40, 90), (10, 0, 0.1, 5)]
)
def test_words_rule_where_directions_do_not_give_them(a0, c0, a1, c1):
    blocks = axes_block(a0, c0, a1, c1)
    assert blocks.interpolation.tolist() == [POSES, ROTARY_LINEAR]
    np.testing.assert_allclose(np.degrees(blocks.rotary_from[1]), [a0, c0], atol=1e-12)
    np.testing.assert_allclose(np.degrees(blocks.rotary[1]), [a1, c1], atol=1e-12)
    assert blocks.duration[1] == pytest.approx(np.hypot(50.0, 20.0) / 1200.0 * 60.0)


def test_long_motions_join_one_near_the_pole():
    """Each side of the pole was a stop: poses and linear rotary axes have no common corner."""
    lines = ['M428', 'G0 X0 A20 C10', 'G1 X20 A25 F600', 'X40 Y5 A20', 'X60 A-15', 'X80 C30']
    lines += ['G61', 'X100 C50', 'G64', 'X101 C52', 'X120 C60', 'X140 A20']

    def kinds(lines):
        blocks = read_text('\n'.join(lines), 't.ngc', TableAC(), Settings()).blocks
        return dict(zip(blocks.line_number.tolist(), blocks.interpolation.tolist(), strict=True))

    found = kinds(lines)
    # X60 and X140 pass the pole. The chain ends at the exact stop of line 8, and the short line 10
    # stays a curve of poses, so nothing before line 11 follows the words to X140.
    assert [found[line] for line in (3, 4, 5, 6, 8, 11, 12)] == [ROTARY_LINEAR] * 7
    assert found[10] == POSES and found[2] == POSES
    assert set(kinds([*lines[:4], 'X60 A15', *lines[5:11]]).values()) == {POSES}


def test_many_turns_are_cut_into_pieces_of_eight():
    blocks = axes_block(0, 0, 0, 36000)
    assert len(blocks) - 1 == 13
    np.testing.assert_allclose(blocks.rotary_from[2:], blocks.rotary[1:-1], atol=1e-12)


def test_other_rotary_letters_take_the_machine_order():
    blocks = axes_block(30, 0, 30, 60, geometry=HeadBC(), first='B')
    end = np.radians([30, 60])
    np.testing.assert_allclose(blocks.rotary[-1], end)
    np.testing.assert_allclose(blocks.axis[-1], HeadBC().tool_axis(end[None])[0])


def test_pure_rotation_stays_one_block_with_its_rotary_target():
    text = 'M428\nG0 X1 A15 C0\nG1 C360 F100\nG0 A0\nM30'
    blocks = read_text(text, 't', TableAC(), Settings()).blocks
    assert len(blocks) == 3
    np.testing.assert_allclose(np.degrees(blocks.rotary), [[15, 0], [15, 360], [0, 360]])
    assert blocks.rapid.tolist() == [True, False, True]


def test_inverse_time_is_shared_out_over_the_pieces():
    text = 'M428\nG93\nG0 X0 A15 C0\nG1 X10 C90 F30\nG1 X20 F120\nM30'
    blocks = read_text(text, 't', TableAC(), Settings()).blocks
    cut = blocks.line_number == 4
    assert cut.sum() > 10
    assert blocks.duration[cut].sum() == pytest.approx(2.0)
    assert np.ptp(blocks.duration[cut]) == 0.0
    assert blocks.duration[blocks.line_number == 5] == pytest.approx([0.5])
    assert np.isnan(blocks.feedrate[1:]).all()


def test_feedrate_is_kept_in_the_pieces():
    blocks = axes_block(15, 0, 15, 90)
    np.testing.assert_allclose(blocks.feedrate[1:], 0.02)
    assert np.isnan(blocks.duration).all()


def test_vector_blocks_beyond_90_deg_are_split_at_equal_angles():
    text = 'GOTO/0,0,0,0,0,1\nFEDRAT/600,MMPM\nGOTO/30,0,0,0,0.6,-0.8'
    blocks = read_text(text, 't.apt', TableAC(), Settings()).blocks
    assert len(blocks) == 3
    angle = np.arccos(-0.8)
    middle = [0.0, np.sin(angle / 2), np.cos(angle / 2)]
    np.testing.assert_allclose(blocks.axis[1], middle, atol=1e-12)
    np.testing.assert_allclose(blocks.tip[1], [0.015, 0, 0], atol=1e-15)


def test_orivect_leaves_the_rotary_axes_to_the_kinematics():
    text = 'TRAORI\nORIVECT\nG0 X0 A20 C0\nG1 X10 A20 C60 F600\nORIAXES\nG1 X20 C65\nM30'
    blocks = read_text(text, 't.mpf', TableAC(), Settings()).blocks
    np.testing.assert_allclose(np.degrees(blocks.rotary[0]), [20, 0])
    assert np.isnan(blocks.rotary[1]).all() and blocks.line_number[2] == 6
    np.testing.assert_allclose(np.degrees(blocks.rotary[-1]), [20, 65])


def test_interpolation_option_fixes_the_program_words():
    text = 'TRAORI\nORIVECT\nG0 X0 A20 C0\nG1 X10 C60 F600\nM30'
    options = Settings(interpolation='axes')
    program = read_text(text, 't.mpf', TableAC(), options)
    assert len(program.blocks) > 10 and 'ORIVECT' in program.notices[0]
    text = text.replace('ORIVECT\n', '')
    assert len(read_text(text, 't', TableAC(), Settings(interpolation='vector')).blocks) == 2


@settings(max_examples=examples(4, 60))
@given(
    a=st.tuples(st.floats(1, 178), st.floats(1, 178)),
    c=st.tuples(st.floats(-400, 400), st.floats(-400, 400)),
    tolerance=st.floats(0.02, 0.12),
)
def test_any_sweep_stays_within_a_tenth_of_the_tolerance(a, c, tolerance):
    a, c = np.round(a, 3), np.round(c, 3)
    blocks = axes_block(a[0], c[0], a[1], c[1], round(tolerance, 4))
    start = np.radians([a[0], c[0]])
    sweep = np.radians([a[1] - a[0], c[1] - c[0]])
    worst = worst_deviation(TableAC(), blocks, 1, len(blocks), start, sweep)
    assert worst <= 0.1e-3 * round(tolerance, 4) * (1 + 1e-9)
