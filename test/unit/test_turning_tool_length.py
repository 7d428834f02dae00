"""A tool length that turns with the tool (G43.4 H): where the tip of the tool is, and how fast."""

from itertools import pairwise

import numpy as np
import pytest
from tiers import few_of

from cnc_interp import plan_program
from cnc_interp.commands.cli import main
from cnc_interp.core import MM, ProgramError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import JobSetup, Tool, read_text
from cnc_interp.settings.options import Settings

LENGTHS = {1: 80.0, 2: 35.0}
SETUP = JobSetup(tools={number: Tool(length * MM) for number, length in LENGTHS.items()})
HEAD = 'G21 G90 G94\nG0 X0 Y0 A0 C0\nG43.4 H1 Z60\n'
MACHINES = ['xyzac', 'xyzbc', 'head_head']


def read(text, machine='xyzac', **settings):
    letters = Machine.load(machine).axis_names[3:5]
    text = text.translate(str.maketrans('AC', ''.join(letters)))
    geometry = Transform.of(Machine.load(machine))
    return read_text(text, 'part.nc', geometry, Settings(**settings), SETUP)


def tips_of(blocks, length):
    return (blocks.tip - length * MM * blocks.axis) / MM


def beside_line(points, start, end):
    """Distance of each point from a line [mm]."""
    way = np.subtract(end, start)
    share = np.clip((points - start) @ way / (way @ way), 0.0, 1.0)
    return np.linalg.norm(points - start - share[:, None] * way, axis=1)


@pytest.mark.parametrize('machine', few_of(1, MACHINES))
def test_the_tip_keeps_its_line_and_its_feed_while_the_tool_turns(machine):
    blocks = read(f'{HEAD}G1 X40 Y10 Z20 A25 C30 F600\nX60 A10\n', machine).blocks
    tip, rows = tips_of(blocks, 80.0), blocks.line_number == 4
    np.testing.assert_allclose(tip[rows][-1], [40, 10, 20], atol=1e-9)
    np.testing.assert_allclose(tip[-1], [60, 10, 20], atol=1e-9)
    assert rows.sum() > 10
    assert beside_line(tip[rows], [0, 0, 60], [40, 10, 20]).max() < 1e-9
    np.testing.assert_allclose(blocks.duration[rows].sum(), np.sqrt(40**2 + 10**2 + 40**2) / 10)
    np.testing.assert_allclose(blocks.duration[blocks.line_number == 5].sum(), 2.0)
    between = 0.5 * (blocks.tip[1:] + blocks.tip[:-1])
    axis = blocks.axis[1:] + blocks.axis[:-1]
    chord = between / MM - 80.0 * axis / np.linalg.norm(axis, axis=1)[:, None]
    assert beside_line(chord[rows[1:]], [0, 0, 60], [40, 10, 20]).max() < 1.1e-3


def test_the_tip_rests_under_a_turn_and_goes_round_an_arc():
    text = f'{HEAD}G1 X20 Z10 F600\nG1 A20 C40 F900\nG2 X60 Y0 I20 A5 F600\nG1 A0 C0\n'
    blocks = read(text).blocks
    tip, line = tips_of(blocks, 80.0), blocks.line_number
    assert np.abs(tip[line == 5] - [20, 0, 10]).max() < 1e-9
    # Only the axes turn: F is in deg/min, as without a length.
    np.testing.assert_allclose(blocks.duration[line == 5].sum(), np.hypot(20, 40) / 15)
    on_arc = tip[line == 6] - [40, 0, 10]
    np.testing.assert_allclose(np.linalg.norm(on_arc, axis=1), 20.0, atol=1e-9)
    assert on_arc[:, 1].min() > -1e-9 and np.abs(on_arc[:, 2]).max() < 1e-9
    np.testing.assert_allclose(blocks.duration[line == 6].sum(), 2.0 * np.pi)
    np.testing.assert_allclose(tip[-1], [60, 0, 10], atol=1e-9)


def test_directions_turn_the_length_too_and_another_tool_has_its_own():
    text = f'{HEAD}G1 X20 Z10 A3=0 B3=0.6 C3=0.8 F600\nX30 A3=0.6 B3=0 C3=0.8\n'
    blocks = read(text + 'G0 Z60 A3=0 B3=0 C3=1\nG43.4 H2\nG1 X0 Z9 A3=0.6 B3=0 C3=0.8\n').blocks
    line = blocks.line_number
    np.testing.assert_allclose(tips_of(blocks, 80.0)[line == 4][-1], [20, 0, 10], atol=1e-9)
    np.testing.assert_allclose(tips_of(blocks, 80.0)[line == 5][-1], [30, 0, 10], atol=1e-9)
    np.testing.assert_allclose(tips_of(blocks, 35.0)[-1], [0, 0, 9], atol=1e-9)


def test_after_g49_the_axes_stand_where_they_stood():
    """The length that turned is given back along the tool."""
    blocks = read(f'{HEAD}G1 X40 Y10 Z20 A25 C30 F600\nG49\nG91 G1 Z0\nZ1\n').blocks
    q = Transform.of(Machine.load('xyzac')).linear(blocks.tip[-2:], blocks.rotary[-2:]) / MM
    np.testing.assert_allclose(q[1] - q[0], [0, 0, 1], atol=1e-9)


@pytest.mark.thorough
@pytest.mark.parametrize('machine', MACHINES)
def test_the_planned_tip_keeps_the_contour_tolerance(machine):
    text = f'{HEAD}G1 X40 Y10 Z20 A25 C30 F3000\nX60 Y-10 A5 C10\nX30 Z25 A15 C-20\n'
    places = [[0, 0, -80], [0, 0, 60], [40, 10, 20], [60, -10, 20], [30, -10, 25]]
    tolerance = 0.02
    program = read(text, machine, contour_tolerance=tolerance * MM)
    geometry = Transform.of(Machine.load(machine))
    plan = plan_program(program, geometry.machine)
    tip, axis = geometry.forward(plan.setpoints.position)
    points = tip / MM - 80.0 * axis
    away = np.min([beside_line(points, a, b) for a, b in pairwise(places)], axis=0)
    assert 1e-5 < away.max() < tolerance


@pytest.mark.parametrize(
    ('text', 'part'),
    [
        ('G1 X9 RND=2 F500\nX9 Y9 A5', 'cannot adjoin a turn of the tool'),
        ('G1 X9 F500\nBSPLINE X20', 'a spline takes no tool length'),
    ],
)
def test_what_cannot_turn_with_the_length_is_refused(text, part):
    with pytest.raises(ProgramError, match=part):
        read(HEAD + text)


def test_the_second_reader_knows_the_length_too(tmp_path, capsys):
    program, setup = tmp_path / 'part.nc', tmp_path / 'setup.yaml'
    setup.write_text(SETUP.text())
    program.write_text(f'{HEAD}G1 X4 Y1 Z50 A12 C25 F3000\nX6 A18\nG49\nM30\n')
    out = str(tmp_path / 'plan')
    assert main(['plan', str(program), '--setup', str(setup), '--out', out]) == 0
    assert main(['check', out, '--program', str(program)]) == 0
    for before, after, part in (
        ('A18', 'A18.01', 'line 5 of the program: ends'),
        ('H1', 'H2', 'line 3 of the program: ends 45 mm'),
        ('F3000', 'F2999', 'line 4 of the program: lasts'),
    ):
        changed = tmp_path / 'changed.nc'
        changed.write_text(program.read_text().replace(before, after))
        assert main(['check', out, '--program', str(changed)]) == 1
        assert part in capsys.readouterr().out
