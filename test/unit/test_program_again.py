"""The program read again: the second reader agrees with the first, and finds what differs."""

from shutil import copytree

import numpy as np
import pytest

from cnc_interp.commands.cli import main
from cnc_interp.core import DEG, MM, MM_PER_MIN, ProgramError
from cnc_interp.proof import linuxcnc_reader
from cnc_interp.proof.linuxcnc_reader import interpreter
from cnc_interp.proof.plain_reader import read_plainly
from cnc_interp.proof.plan_files import read_plan

PROGRAMS = {
    'lines.ngc': 'G21 G90\nG0 X0 Y0 (start)\nG1 X10 F3000\nN5 Y10 F1200 ; feed\nG0 Z5\nM30\n',
    'inch.ngc': 'G20\nG0 X0\nG1 X1 F20\nG91 Y0.5\nX-.25\nG90 X0\n',
    'arcs.ngc': (
        'G0 X0 Y0\nG2 X10 Y10 I10 J0 F2000\nG3 X20 Y20 R10\nG3 X20 Y20 I-5 J0 Z3\n'
        'G18 G2 X30 Z-2 R12\nG17 G2 X10 Y0 R-20\n'
    ),
    'kept.ngc': 'G64 P0.02\nG0 X0\nG1 X5 F900\nG64 P0.05\nG2 X5.2 Y-0.1 R0.5\nG1 X9\n',
    'timed.ngc': 'G0 X0\nG93 G1 X10 F30\nY10 F60\nG94 X0 F500\n',
    'tcp.ngc': 'TRAORI\nG0 X0 A10 C0\nG64 P0.02\nG1 X20 A15 C30 F3000\nC60\nY5\n',
    'circle.ngc': 'TRAORI\nORIVECT\nG0 X0 A10 C0\nG1 X20 A15 C30 F3000\nORIAXES\nX25 C60\nY5\n',
    'turns.ngc': 'G0 X0 Y0\nG3 X10 Y0 I5 J0 P2 F1000\nG1 X20\n',
    'stops.ngc': 'G0 X0\nG61\nG1 X5 Y5 F900\nX9\nG64\nX12\nY9\nY12\nM0\nX0\nG4 P1\nY0\n',
    'scaled.nc': (
        'G21 G90 G17\nG0 X0 Y0 Z0\nG51.1 X20 Y5\nG1 X10 F900\nG2 X12 Y14 R9\nG3 X14 Y14 R4\n'
        'G50.1 Y0\nG91 G1 X5\nG90 G51 X10 Y0 Z0 I2000 J2000 K500\nG3 X12 Y8 R30 Z3\nG18 G1 X9\n'
        'G50\nY0\nG17 G3 X20 Y0 R40\nG50.1\nG1 X3\nG51 Z4 P0.5\nG1 X9 Z9\nM30\n'
    ),
    'mirrored.mpf': (
        'G90 G0 X0 Y0 Z0\nMIRROR X0\nG1 X10 F900\nASCALE X2 Y2 Z2\nY10\nG2 I5 J0\n'
        'AMIRROR X0 Y0\nG1 X3 Y4\nSCALE\nX5 Y5\nM30\n'
    ),
    'plate.h': (
        '0 BEGIN PGM PLATE MM\n1 BLK FORM 0.1 Z X+0 Y+0 Z-9\n2 TOOL CALL 3 Z S900\n'
        '3 L X+0 Y+0 Z+5 R0 FMAX M3\n4 L Z-2 F300 ; down\n5 L IX+10 F900 M8\n6 CC X+10 Y+5\n'
        '7 C X+10 Y+10 DR+\n8 CR X+20 Y+20 R+12 DR-\n9 CYCL DEF 9.0 DWELL\n'
        '10 CYCL DEF 9.1 V.ZEIT 0.5\n'
        '11 L Z+5 FMAX M9\n12 CYCL DEF 7.0 DATUM\n13 CYCL DEF 7.1 X+40\n14 CYCL DEF 7.2 IY-5\n'
        '15 CYCL DEF 8.0 MIRROR\n16 CYCL DEF 8.1 X\n17 L X+10 Y+0 R0 F700\n18 CC X+10 Y+5\n'
        '19 C X+10 Y+10 DR+\n20 CYCL DEF 8.0 MIRROR\n21 CYCL DEF 8.1\n22 CYCL DEF 11.0 SCALING\n'
        '23 CYCL DEF 11.1 SCL 0.5\n24 L X+8 Y+6 Z+4\n25 CR X+12 Y+9 R+4 DR+\n26 CYCL DEF 11.0\n'
        '27 CYCL DEF 11.1 SCL 1\n28 CYCL DEF 26.0\n29 CYCL DEF 26.1 X2 Y0.5 CCX+3 CCY-1\n'
        '30 L X+5 IY+4\n31 L Z+20 FMAX M5\n32 STOP\n33 L X+0 FMAX\n34 END PGM PLATE MM\n'
    ),
    'axes.ngc': 'G0 X0 A0 C0\nG1 X10 A10 F2000\nC90\nY10 C0\n',
    'path.apt': (
        'PARTNO A\nUNITS/MM\nMULTAX\nFEDRAT/2000\nGOTO/0,0,0,0,0,1\nGOTO/10,0,0,0,0.28,0.96\n'
        'RAPID\nGOTO/10,10,0\nFINI\n'
    ),
}
#: Motions and arcs of each.
MOTIONS = {
    'lines.ngc': (4, 0),
    'inch.ngc': (5, 0),
    'arcs.ngc': (6, 5),
    'timed.ngc': (4, 0),
    'turns.ngc': (3, 1),
    'stops.ngc': (8, 0),
    'tcp.ngc': (4, 0),
    'circle.ngc': (4, 0),
    'axes.ngc': (4, 0),
    'scaled.nc': (11, 4),
    'mirrored.mpf': (6, 1),
    'plate.h': (13, 4),
    'path.apt': (3, 0),
    'kept.ngc': (4, 1),
}
#: One word of a program changed: what the comparison must say.
CHANGED = [
    ('lines.ngc', 'X10', 'X10.0001', 'line 3 of the program: ends 0.0001 mm'),
    ('lines.ngc', 'F1200', 'F1200.1', 'line 4 of the program: has F 1200.1 mm/min'),
    ('lines.ngc', 'G0 Z5', 'G1 Z5', 'line 5 of the program: is no rapid'),
    ('lines.ngc', 'G0 Z5\n', '', 'row 3 of the plan (line 5) is no motion of the text'),
    ('lines.ngc', 'M30', 'G0 Z6', 'line 6 of the program: has no row'),
    ('inch.ngc', 'G20', 'G21', 'line 3 of the program: ends 24.4 mm'),
    ('inch.ngc', 'G91', 'G90', 'line 5 of the program: ends'),
    ('arcs.ngc', 'G2 X10 Y10 I10 J0', 'G3 X10 Y10 I10 J0', 'line 2 of the program: turns by 270'),
    ('arcs.ngc', 'X20 Y20 R10', 'X20 Y20 R11', 'line 3 of the program: '),
    ('arcs.ngc', 'R-20', 'R20', 'line 6 of the program: its rows are not on the arc'),
    ('arcs.ngc', 'I-5 J0 Z3', 'I-6 J0 Z3', 'line 4 of the program: its rows are not on the arc'),
    ('kept.ngc', 'P0.02', 'P0.01', 'line 3 of the program: has a tolerance of 0.01 mm'),
    ('kept.ngc', 'P0.05', 'P0.047', 'may use 0.045 mm, and its arc 0.003'),
    ('kept.ngc', 'G64 P0.05', 'G61', 'line 5 of the program: rests at its end, but its row'),
    ('stops.ngc', 'G64', '', 'line 6 of the program: rests at its end, but its row 3 does not'),
    ('stops.ngc', 'G64\nX12', 'G64\nX12\nM0', 'line 6 of the program: rests at its end'),
    ('turns.ngc', 'P2', 'P3', 'line 2 of the program: turns by 900 deg, but its rows turn by'),
    ('tcp.ngc', 'G1 X20', 'OTOL=0.001 G1 X20', 'line 4 of the program: has an orientation tol'),
    ('timed.ngc', 'F60', 'F59', 'line 3 of the program: lasts'),
    ('tcp.ngc', 'A15', 'A15.001', 'line 4 of the program: its tool axis'),
    ('tcp.ngc', 'C60', 'C420', 'line 5 of the program: its rotary words'),
    ('tcp.ngc', 'TRAORI', 'TRAFOOF', 'line 2 of the program: ends'),
    ('circle.ngc', 'ORIVECT', 'ORIAXES', 'line 4 of the program: has rotary words, but its row'),
    ('axes.ngc', 'X10 A10', 'X10 A11', 'line 2 of the program: ends'),
    ('scaled.nc', 'G51.1 X20', 'G51.1 X21', 'line 4 of the program: ends 2 mm'),
    ('scaled.nc', 'G50.1 Y0', 'G50.1 X0', 'line 8 of the program: ends'),
    ('scaled.nc', 'G2 X12', 'G3 X12', 'line 5 of the program: its rows are not on the arc'),
    ('scaled.nc', 'J2000', 'J1000', 'line 10 of the program: ends'),
    ('scaled.nc', 'G51 Z4', 'G51 Z5', 'line 18 of the program: ends'),
    ('mirrored.mpf', 'MIRROR X0\nG1', 'MIRROR Y0\nG1', 'line 3 of the program: ends 20 mm'),
    ('plate.h', '8.1 X\n', '8.1 Y\n', 'line 18 of the program: ends'),
    ('plate.h', '7.2 IY-5', '7.2 IY-4', 'line 18 of the program: ends 1 mm'),
    ('plate.h', 'X+10 Y+10 DR+\n8', 'X+10 Y+10 DR-\n8', 'line 8 of the program: turns'),
    ('plate.h', 'SCL 0.5', 'SCL 0.6', 'line 25 of the program: ends'),
    ('plate.h', 'CCX+3', 'CCX+4', 'line 31 of the program: ends 1 mm'),
    ('plate.h', 'F700', 'F701', 'line 18 of the program: has F 701'),
    ('plate.h', '32 STOP\n', '32 ;\n', 'line 32 of the program: no program stop'),
    ('path.apt', '0.28,0.96', '0.29,0.957', 'line 6 of the program: its tool axis'),
    ('path.apt', 'RAPID\n', '\n', 'line 8 of the program: is no rapid'),
]


#: Plans that are copied, by their program.
MADE = {}


def planned(name, text, folder):
    """Plan a program, once for all tests; return its file and its plan."""
    program, plan = folder / name, folder / 'plan'
    program.write_text(text)
    if (name, text) in MADE:
        copytree(MADE[name, text], plan)
    else:
        assert main(['plan', str(program), '--out', str(plan)]) == 0
        MADE[name, text] = copytree(plan, folder / 'made')
    return program, plan


@pytest.mark.parametrize('name', PROGRAMS)
def test_both_readers_agree(name, tmp_path, capsys):
    program, plan = planned(name, PROGRAMS[name], tmp_path)
    capsys.readouterr()
    assert main(['check', str(plan), '--program', str(program)]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[-1] == 'proven'
    motions, arcs = MOTIONS[name]
    counts, *readers = said[-2].split('; ')
    assert counts == f'program text   {motions} motions, {arcs} arcs agree with the blocks'
    assert readers[-1] == 'read by the second reader of plain words'
    if not interpreter():
        assert readers[0] == "LinuxCNC's rs274 is not installed"
    elif name in ('tcp.ngc', 'circle.ngc', 'path.apt', 'scaled.nc', 'mirrored.mpf', 'plate.h'):
        assert readers[0].startswith("LinuxCNC's rs274 cannot read it: ")
    else:
        assert readers[0] == "read by LinuxCNC's rs274 to 0.0001 of its unit"


@pytest.mark.parametrize(('name', 'word', 'other', 'wanted'), CHANGED)
def test_a_changed_word_is_found(name, word, other, wanted, tmp_path, capsys):
    assert word in PROGRAMS[name]
    program, plan = planned(name, PROGRAMS[name], tmp_path)
    program.write_text(PROGRAMS[name].replace(word, other, 1))
    capsys.readouterr()
    assert main(['check', str(plan), '--program', str(program)]) == 1
    assert wanted in capsys.readouterr().out


def test_changed_rows_are_found(tmp_path, capsys):
    program, plan = planned('lines.ngc', PROGRAMS['lines.ngc'], tmp_path)
    columns = dict(read_plan(plan).blocks)
    columns['feed'] = columns['feed'] * 1.001
    columns['tip'] = columns['tip'] + [3e-8, 0, 0]
    np.savez(plan / 'blocks.npz', **columns)
    capsys.readouterr()
    assert main(['check', str(plan), '--program', str(program)]) == 1
    said = capsys.readouterr().out
    assert 'line 3 of the program: has F 3000 mm/min' in said and 'ends 3e-05 mm' in said


def test_extra_axes_with_tool_tip_programming_off(tmp_path, capsys):
    program = tmp_path / 'w.ngc'
    program.write_text('G0 X0 Y0 Z0 A0 C0 W0\nG1 X5 A20 C5 W3 F900\nW5\n')
    plan = ['plan', str(program), '--machine', 'xyzacw', '--out', str(tmp_path / 'plan')]
    assert main(plan) == 0
    assert main(['check', str(tmp_path / 'plan'), '--program', str(program)]) == 0
    program.write_text(program.read_text().replace('W3', 'W3.001'))
    capsys.readouterr()
    assert main(['check', str(tmp_path / 'plan'), '--program', str(program)]) == 1
    assert 'line 2 of the program: its extra axes' in capsys.readouterr().out


def test_a_way_below_a_nanometre_lasts_as_long_as_the_rows_say(tmp_path, capsys):
    """The second reader said that a way of 0.7 nm beside an extra axis takes no time."""
    way = 'G0 X8.4411328 Z1.2291459 W-17.5971466\nG1 X8.4411335 Z1.2291461 W-17.597146 F5881\nX9\n'
    program = tmp_path / 'w.ngc'
    program.write_text(way)
    plan = ['plan', str(program), '--machine', 'xyzacw', '--out', str(tmp_path / 'plan')]
    assert main(plan) == 0
    capsys.readouterr()
    assert main(['check', str(tmp_path / 'plan'), '--program', str(program)]) == 0


def test_great_circles_by_choice_have_no_rotary_words(tmp_path, capsys):
    program, plan = tmp_path / 'tcp.ngc', tmp_path / 'plan'
    program.write_text(PROGRAMS['tcp.ngc'])
    choice = ['--interpolation', 'vector']
    assert main(['plan', str(program), '--out', str(plan), *choice]) == 0
    assert main(['check', str(plan), '--program', str(program)]) == 0


def test_rows_without_the_rotary_words_of_the_text_are_found(tmp_path, capsys):
    program, plan = planned('tcp.ngc', PROGRAMS['tcp.ngc'], tmp_path)
    columns = dict(read_plan(plan).blocks)
    columns['rotary'] = np.full_like(columns['rotary'], np.nan)
    np.savez(plan / 'blocks.npz', **columns)
    capsys.readouterr()
    assert main(['check', str(plan), '--program', str(program)]) == 1
    assert (
        'line 2 of the program: has rotary words, but its row 0 has none'
        in capsys.readouterr().out
    )


def test_an_arc_after_a_switch_is_not_compared(tmp_path, capsys):
    text = 'G0 X0 Y0 Z0 A10 C0\nTRAORI\nG3 X5 Y0 Z0 I2.5 J0 F900\n'
    with pytest.raises(ProgramError, match='an arc after a switch'):
        read_plainly(text, 'a.ngc', ('X', 'Y', 'Z', 'A', 'C'))


@pytest.mark.parametrize('text', ['#1=5', 'G81 Z-2 R1', 'X[1+2]', 'M98 P5', 'G41 D1', 'G10 L2 P1'])
def test_what_is_not_plain_is_refused(text, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv('RS274', 'not installed')
    program, plan = planned('lines.ngc', PROGRAMS['lines.ngc'], tmp_path)
    program.write_text(f'G0 X0\n{text}\nG1 X5 F100\n')
    capsys.readouterr()
    assert main(['check', str(plan), '--program', str(program)]) == 2
    error = capsys.readouterr().err
    assert 'lines.ngc:2: ' in error and error.count('\n') == 1


NORMALS = (
    'G21 G90\nG0 X0 Y0 Z9 A0 C0\nG43.4\nG41.2 D1 R1\nG1 X1 Y2 Z-1 A5 C10 I3 K4 F900\n'
    'X4 C20 I1 J1 K3\nG40\nX9 Z3\n'
)


@pytest.mark.parametrize(
    ('word', 'other', 'wanted'),
    [
        ('', '', ''),
        ('J1 K3', 'J1.001 K3', 'line 6 of the program: ends '),
        ('R1', 'R1.001', 'line 5 of the program: ends '),
        ('G40', '', 'line 8 of the program: ends '),
        ('D1 R1', 'D1 R1 Q5 P1', 'line 5 of the program: ends '),
    ],
)
def test_contact_normals_are_read_again(word, other, wanted, tmp_path, capsys):
    setup = tmp_path / 'setup.yaml'
    setup.write_text('tools:\n  1: {length: 0, radius: 5}\n')
    program = tmp_path / 'normals.ngc'
    program.write_text(NORMALS)
    plan = ['plan', str(program), '--setup', str(setup), '--out', str(tmp_path / 'plan')]
    assert main([*plan, '--machine', 'xyzac']) == 0
    program.write_text(NORMALS.replace(word, other, 1))
    capsys.readouterr()
    failed = main(['check', str(tmp_path / 'plan'), '--program', str(program)])
    said = capsys.readouterr().out
    assert failed == bool(word) and wanted in said
    assert 'read by the second reader of plain words' in said or word


needs_linuxcnc = pytest.mark.skipif(not interpreter(), reason='no rs274: run tools/get_rs274')
LOOP = 'G21 G0 X0 Y0 Z0\n#1=0\nO1 while [#1 LT 5]\nG1 X[#1*2+1] Y[SIN[#1*30]] F900\n#1=[#1+1]\n'
LOOP += 'O1 endwhile\nG2 X20 Y0 I2 J-3 Z1 P2\nG81 X25 Z-2 R2\nX30\nG80\nM428\nG93 G1 X0 F9\nM2\n'
LOOP = LOOP.replace('I2 J-3', 'R12').replace(' P2', '')


@needs_linuxcnc
def test_a_program_that_only_linuxcnc_reads(tmp_path, capsys):
    program, plan = planned('loop.ngc', LOOP, tmp_path)
    for word, other, wanted in (
        ('', '', 'agree with the blocks; read by LinuxCNC'),
        ('X30', 'X30.001', 'line 9 of the program, by LinuxCNC: ends 0.001 mm'),
        ('#1*30', '#1*31', 'line 4 of the program, by LinuxCNC: ends'),
        ('LT 5', 'LT 6', 'by LinuxCNC: ends'),
        ('R12', 'R13', 'line 7 of the program, by LinuxCNC: '),
        ('F900', 'F901', 'line 4 of the program, by LinuxCNC: has F 901 mm/min'),
        ('F9\n', 'F9.1\n', 'line 12 of the program, by LinuxCNC: lasts'),
        ('Z-2 R2', 'Z-2 R3', 'line 8 of the program, by LinuxCNC: '),
    ):
        program.write_text(LOOP.replace(word, other, 1))
        capsys.readouterr()
        assert main(['check', str(plan), '--program', str(program)]) == bool(word)
        said = capsys.readouterr().out
        assert wanted in said and 'loop.ngc:2: #1=0: the second reader knows plain' in said


@needs_linuxcnc
def test_a_turn_after_a_place_with_more_digits_lasts_as_long_as_the_turn(tmp_path, capsys):
    """The digits that LinuxCNC leaves out counted as a motion of 24 nm: it lasted 10 us."""
    turn = 'G21 G90 G94\nG0 X38.1360914 Y43.3182487 A-27\nG1 Y43.4790242 A-28 F193\nA-27\nM2\n'
    program, plan = planned('turn.ngc', turn, tmp_path)
    for feed in ('F193', 'F194'):
        program.write_text(turn.replace('F193', feed))
        assert main(['check', str(plan), '--program', str(program)]) == (feed == 'F194')
    assert 'line 4 of the program, by LinuxCNC: lasts' in capsys.readouterr().out


@needs_linuxcnc
@pytest.mark.parametrize(
    'text',
    [
        ';py,open("FILE", "w")',
        '(py,open("FILE", "w"))',
        '( (py,open("FILE", "w"))',
        '(LOGOPEN,FILE)\n(LOG,a)',
        'O1 while [1]\nG0 X0\nO1 endwhile',
        'O<../part> call',
        'O1 while [1]\n#1=[#1+1]\nO1 endwhile',
        'O1 while [1]\nG1 X1 F9\nX2\nO1 endwhile',
        'O1 sub\nO1 call\nO1 endsub\nO1 call',
        '#1=' + '[' * 5000,
        'X' + '9' * 5000,
        '\0' * 99,
    ],
)
def test_a_hostile_program_is_one_line(text, tmp_path, capsys, monkeypatch):
    """LinuxCNC executes some comments as Python code; its loops may have no end."""
    program, plan = planned('lines.ngc', PROGRAMS['lines.ngc'], tmp_path)
    bait = tmp_path / 'bait'
    monkeypatch.setattr(linuxcnc_reader, 'SECONDS', 1)
    program.write_text(f'G0 X0 Y0\n{text.replace("FILE", str(bait))}\nG1 X5 #2=1 F100\n')
    capsys.readouterr()
    code = main(['check', str(plan), '--program', str(program)])
    said = capsys.readouterr()
    assert not bait.exists()
    if code == 2:
        assert said.err.count('\n') == 1
    else:
        assert code == 1 and 'by LinuxCNC' in said.out and not said.err


def test_words_of_a_plain_program():
    text = 'G0 X1\nG1 Y-2.5 A.5 F600\nG93 G1 X0 F2'
    moves = read_plainly(text, 'a.ngc', ('X', 'Y', 'Z', 'A', 'C'))
    assert [move.rapid for move in moves] == [True, False, False]
    np.testing.assert_allclose(moves[1].end, [1 * MM, -2.5 * MM, 0])
    assert moves[1].rotary[0] == pytest.approx(0.5 * DEG)
    assert moves[1].feed == pytest.approx(600 * MM_PER_MIN)
    assert moves[2].duration == pytest.approx(30.0)


@pytest.mark.parametrize(
    ('text', 'options', 'wanted'),
    [
        ('G0 X10 Y0\nG3 X0 Y10 I10 J0', ['--arc-centres', 'reversed'], 'arc_centres reversed'),
        ('G0 X40 Y0\nG3 X30 Y10 I30 J0\nX20 Y0 I30 J0\nX30 Y-10 I30 J0', [], 'not the vector'),
        ('G0 X1 Y0\nG1 X2', ['--units', 'inch'], 'units inch'),
        ('G0 X10 Y0\nG3 X0 Y10 I-10 J0\nX-20 Y10', [], 'an arc without I J K and R'),
        ('G0 X0 Y0 Z9\nG84 X1 Z-2 R3', [], 'the holes of G74, G84 and G89'),
    ],
)
def test_what_no_second_reader_knows_is_not_compared(text, options, wanted, tmp_path, capsys):
    program = tmp_path / 'part.nc'
    program.write_text(f'F900\n{text}\nM2\n')
    plan = ['plan', str(program), '--machine', 'xyz', '--out', str(tmp_path / 'plan')]
    assert main([*plan, *options]) == 0
    assert main(['check', str(tmp_path / 'plan'), '--program', str(program)]) == 2
    said = capsys.readouterr().err
    assert wanted in said or ('rs274 is not installed' in said and 'G84' in text)
