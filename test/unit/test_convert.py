"""What ``convert`` writes means what was read: path, cycle time and joins."""

from itertools import pairwise

import numpy as np
import pytest
from whole_plans import plan_program, write_plan

from cnc_interp.commands.cli import main
from cnc_interp.convert.conversion import convert
from cnc_interp.core import MM, UM
from cnc_interp.kinematics.axis_path import AxisPath, evaluate
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.proof.verify import verify_plan
from cnc_interp.settings.options import Settings

MACHINE = Machine.load('xyzac')
TRANSFORM = Transform.of(MACHINE)
H = 30 * MM

WALLS = """TRAORI
ORIVECT
G0 X0 Y0 Z0 A-12 C10
G1 X30 A-15 C-30 F3000
X34 Y25 A-20 C-75
X5 Y27 A-14 C-100
M30
"""
STOPS = """TRAORI
G64 P0.05
G0 X0 Y0 Z0 A10 C20
G9 G1 X10 F600
G1 Y10 A14
G93 G1 X0 F12
G94 G1 C80 F600
G1 X10 Y12 C90
M30
"""
CURVE = """TRAORI
F2400
G0 X0 Y0 Z0 XH=2 YH=5 ZH=18
G1 X10 Y0 Z0 XH=12 YH=5 ZH=18
BSPLINE SD=3 X14 Y0 XH=16 YH=5 PL=1
X20 Y3 XH=21 YH=9 PL=2
X25 Y9 XH=25 YH=15 PL=0
X27 Y17 XH=26 YH=22 PL=1 F1800
X26 Y24 XH=24 YH=28 PL=1
X23 Y30 XH=21 YH=34 PL=0
X20 Y34 XH=18 YH=38 PL=0
G1 X15 Y40.67 XH=13 YH=45 ZH=18
M30
"""


def read(text, name='p.mpf'):
    return read_text(text, name, TRANSFORM, Settings())


def plan_of(program, directory=None):
    plan = plan_program(program, MACHINE)
    if directory is not None:
        write_plan(plan, directory)
        proof = verify_plan(directory, MACHINE)
        assert proof.ok, proof.text()
    return plan


def poses_of(plan, count=5001):
    """Tip and point at flank height at equal shares of the path, shape (n, 6), and its stops."""
    path = AxisPath.join([piece.path for piece in plan.pieces])
    q = evaluate(path, np.linspace(path.s[0], path.s[-1], count))[0]
    tip, axis = TRANSFORM.forward(q)
    return np.hstack([tip, tip + H * axis]), int(path.stop.sum())


@pytest.mark.parametrize('text', [WALLS, CURVE], ids=['walls', 'curve'])
@pytest.mark.parametrize(
    'options',
    [Settings(), Settings(top='tolerance'), Settings(septic=True)],
    ids=['default', 'tolerance', 'septic'],
)
def test_native_splines_read_back_are_the_same_path(text, options, tmp_path):
    program = read(text)
    made = convert(program, MACHINE, options, 'siemens-bspline', 0.01 * UM)
    first = plan_program(program, MACHINE, options)
    again = plan_of(read(made.text), tmp_path)
    (was, stops), (now, stops_now) = poses_of(first), poses_of(again)
    assert np.abs(was - now).max() < 0.3 * UM and stops == stops_now
    assert again.pieces[-1].law.end_time == pytest.approx(first.pieces[-1].law.end_time, rel=3e-3)


@pytest.mark.parametrize('text', [WALLS, STOPS], ids=['walls', 'stops'])
@pytest.mark.parametrize('to', ['gcode', 'cl'])
def test_blocks_read_back_are_the_same_path(text, to):
    program = read(text)
    made = convert(program, MACHINE, Settings(), to, 0.01 * UM)
    back = read_text(made.text, f'p.{"ngc" if to == "gcode" else "apt"}', TRANSFORM, Settings())
    assert back.dialect == to
    if text == STOPS and to == 'cl':  # CL data have neither durations, tolerances nor turns
        assert any('rotary' in note for note in made.notes)
        assert np.abs(back.blocks.tip[-1] - program.blocks.tip[-1]).max() < 1e-12
        return
    was, now = program.blocks, back.blocks
    assert np.abs(was.tip - now.tip).max() < 1e-12
    assert np.abs(was.axis - now.axis).max() < 1e-11
    assert np.array_equal(was.exact_stop, now.exact_stop)
    assert np.allclose(was.duration, now.duration, rtol=1e-9, equal_nan=True)
    assert np.array_equal(was.rapid[1:], now.rapid[1:])
    if to == 'gcode':
        assert np.allclose(was.rotary, now.rotary, atol=1e-11, equal_nan=True)
        assert np.allclose(was.contour_tolerance, now.contour_tolerance, rtol=1e-9)
    times = [plan_of(p).pieces[-1].law.end_time for p in (program, back)]
    assert times[1] == pytest.approx(times[0], rel=1e-6)


def test_rotary_words_turn_on_without_jumps():
    """Around four walls C goes through a full turn; a word that fell back would unwind it."""
    axes = [(0, -0.2, 1), (0.2, 0, 1), (0, 0.2, 1), (-0.2, 0, 1), (0, -0.2, 1)]
    tips = [(0, 0), (20, 0), (20, 20), (0, 20), (0, 0)]
    lines = ['FEDRAT/1000', 'FROM/0,0,0,0,-0.196116135,0.980580676']
    for (x, y), (i, j, k) in zip(tips[1:], axes[1:], strict=True):
        size = np.linalg.norm([i, j, k])
        lines.append(f'GOTO/{x},{y},0,{i / size:.9f},{j / size:.9f},{k / size:.9f}')
    program = read_text('\n'.join([*lines, 'FINI']), 'p.apt', TRANSFORM, Settings())
    text = convert(program, MACHINE, Settings(), 'gcode', 0.01 * UM).text
    words = [w for line in text.splitlines() for w in line.split() if w.startswith('C')]
    turns = np.array([float(w[1:]) for w in words])
    assert np.abs(np.diff(turns)).max() < 91 and abs(turns[-1] - turns[0]) == pytest.approx(360)


def test_curves_become_chords_within_a_share_of_the_tolerance():
    program = read(CURVE)
    back = read(convert(program, MACHINE, Settings(), 'gcode', 0.01 * UM).text)
    assert not back.blocks.on_spline.any() and len(back.blocks) > 40
    smooth = poses_of(plan_of(program), 20001)[0][:, :3]
    way = back.blocks.tip
    for a, b in pairwise(way[2:]):  # middles of chords lie beside the curve
        gap = np.linalg.norm(smooth - (0.5 * (a + b)), axis=1).min()
        assert gap < 0.02 * MM


def test_notes_say_what_a_control_with_one_parameter_loses():
    """The written curve carries the connection: the rate goes on; five points alone would jump."""

    def figures(options):
        made = convert(read(WALLS), MACHINE, options, 'siemens-bspline', 0.01 * UM)
        rates = [note.split('up to ')[1].split()[0] for note in made.notes if 'rate' in note]
        assert all(note in made.text for note in made.notes)
        return [float(rate) for rate in rates]

    written, plain = figures(Settings(top='tolerance'))
    assert written < 1e-6 < 1e-4 < plain
    written, plain = figures(Settings(top='tolerance', parametrization='linear'))
    assert written == pytest.approx(plain, rel=1e-3) and plain > 1e-4
    line = read('TRAORI\nORIVECT\nG0 X0 A10 C20\nG1 X10 A14 F600\nM30\n')
    made = convert(line, MACHINE, Settings(), 'siemens-bspline', 0.01 * UM)
    assert 'rate jumps' in made.text and 'five control points' not in made.text  # no corner


def test_machines_without_rotary_axes_need_no_tool_axis_words():
    machine = Machine.load('xyz')
    program = read_text(
        'G0 X0 Y0\nG1 X10 F600\nY10\nM30', 'p.ngc', Transform.of(machine), Settings()
    )
    made = convert(program, machine, Settings(), 'siemens-bspline', 0.01 * UM)
    text = made.text
    assert not any('orientation' in note for note in made.notes)  # nothing turns
    assert 'BSPLINE' in text and 'XH' not in text and 'TRAORI' not in text
    back = read_text(text, 'p.mpf', Transform.of(machine), Settings())
    assert plan_program(back, machine).pieces[-1].law.end_time == pytest.approx(
        plan_program(program, machine).pieces[-1].law.end_time, rel=3e-3
    )


def test_cl_data_say_which_tolerances_they_have_lost():
    note = 'CL data have no tolerances; read them with --contour-tolerance '
    made = convert(read(STOPS), MACHINE, Settings(), 'cl', 0.01 * UM)
    assert any(line.startswith(note) for line in made.notes)
    made = convert(read(WALLS), MACHINE, Settings(), 'cl', 0.01 * UM)
    assert not any(line.startswith(note) for line in made.notes)


def test_command_writes_a_file_or_the_terminal(tmp_path, capsys):
    source, out = tmp_path / 'walls.mpf', tmp_path / 'walls.apt'
    source.write_text(WALLS)
    assert main(['convert', str(source), '--to', 'cl', '--out', str(out)]) == 0
    written = out.read_text()
    capsys.readouterr()
    assert main(['convert', str(source), '--to', 'cl']) == 0
    assert capsys.readouterr().out == written and written.startswith('PARTNO')
    assert main(['convert', str(tmp_path / 'none.mpf'), '--to', 'cl']) == 2


@pytest.mark.parametrize(('to', 'words'), [('gcode', ('M0', 'M1')), ('cl', ('STOP', 'OPSTOP'))])
def test_program_stops_survive(to, words):
    text = 'TRAORI\nG0 X0 Y0 Z0 A10 C20\nG1 X10 F600\nM0\nX20\nM1\nX30 Y5\nM30'
    program = read_text(text, 'stops.ngc', TRANSFORM, Settings())
    made = convert(program, MACHINE, Settings(), to, UM)
    again = read_text(made.text, 'again.ngc', TRANSFORM, Settings()).blocks
    assert all(word in made.text for word in words)
    assert again.program_stop.tolist() == program.blocks.program_stop.tolist() == [0, 1, 2, 0]
