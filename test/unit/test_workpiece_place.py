"""A workpiece that is clamped elsewhere: the machine file that says so, and what it changes."""

import json

import numpy as np
import pytest

from cnc_interp.commands.cli import main
from cnc_interp.commands.parser import BAD_INPUT, FINE
from cnc_interp.machine_model.machine import Machine, placed_machine
from cnc_interp.machine_model.transform_port import Transform

MM, DEG = 1e-3, np.pi / 180
PROGRAM = 'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A10 C0\nG1 X8 C20 F3000\nY9\nM30\n'


@pytest.mark.parametrize('name', ['xyzac', 'xyzbc', 'bc_trunnion'])
def test_poses_of_a_placed_machine_are_those_of_the_placed_workpiece(name, tmp_path):
    """The same axes, C turned back, put the tool to the same place of the table."""
    shift, turn = np.array([30.0, -20.0, 5.0]), 25.0
    placed = placed_machine(name, tuple(shift), turn, tmp_path / 'm.yaml')
    machine = Machine.load(name)
    rng = np.random.default_rng(3)
    q = rng.uniform(-0.3, 0.3, (20, 5))
    tip, axis = Transform.of(placed).forward(q)
    back = q.copy()
    back[:, 4] -= np.sign(machine.rotary_direction[1, 2]) * turn * DEG
    tip_there, axis_there = Transform.of(machine).forward(back)
    c, s = np.cos(turn * DEG), np.sin(turn * DEG)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    # On the table: the workpiece turned about its zero, and its zero shifted.
    np.testing.assert_allclose(tip @ R.T + shift * MM, tip_there, atol=1e-12)
    np.testing.assert_allclose(axis @ R.T, axis_there, atol=1e-12)


def test_a_plan_with_the_workpiece_elsewhere_is_proven_with_its_own_machine_file(tmp_path, capsys):
    program, out = tmp_path / 'a.ngc', tmp_path / 'out'
    program.write_text(PROGRAM)
    words = ['plan', str(program), '--out', str(out), '--place-x', '-35', '--turn', '40']
    assert main(words) == FINE
    assert main(['check', str(out)]) == FINE
    assert json.loads((out / 'summary.json').read_text())['machine'] == str(out / 'machine.yaml')
    m = Machine.load(out / 'machine.yaml').offsets[0] / MM
    assert np.hypot(m[0], m[1]) == pytest.approx(np.hypot(5.0, -70.0))
    plain = tmp_path / 'plain'
    assert main(['plan', str(program), '--out', str(plain)]) == FINE
    first, second = (np.load(f / 'setpoints.npz')['position'][0] for f in (out, plain))
    assert np.abs(first[:3] - second[:3]).max() > 20 * MM


def test_what_cannot_be_placed_is_refused(tmp_path, capsys):
    program, out = tmp_path / 'a.ngc', str(tmp_path / 'out')
    program.write_text(PROGRAM)
    for more, text in (
        (['--machine', 'head_head', '--turn', '10'], 'turns the workpiece about Z'),
        (['--machine', 'xyz', '--turn', '10'], 'turns the workpiece about Z'),
        (['--place-x', 'inf'], 'must be finite'),
        (['--place-x', '900'], 'travel'),
    ):
        assert main(['plan', str(program), '--out', out, *more]) == BAD_INPUT
        assert text in capsys.readouterr().err


def test_a_three_axis_machine_has_its_zero_elsewhere(tmp_path):
    before = Machine.load('xyz').offsets[0]
    after = placed_machine('xyz', (1.0, 2.0, 3.0), 0.0, tmp_path / 'm.yaml').offsets[0]
    np.testing.assert_allclose(after - before, [1e-3, 2e-3, 3e-3], atol=1e-12)
