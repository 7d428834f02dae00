"""M6 as a subprogram of the shop: planned, proven against LinuxCNC, and executed."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from cnc_interp.commands.cli import main
from cnc_interp.core import MachineError, ProgramError
from cnc_interp.machine_model.machine import Machine, content_of
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.job import JobSetup
from cnc_interp.program.reading import MdiReader, read_program, read_text
from cnc_interp.proof.linuxcnc_reader import interpreter
from cnc_interp.settings.options import Settings

ZERO = np.array([400.0, 250.0, -400.0])  #: Workpiece zero of the bundled vmc [mm].
SETUP = """
work_offsets: {G54: {X: 300.0, Y: 200.0, Z: -400.0}, G59.3: {X: 700.0, Y: 50.0, Z: -450.0}}
reference_points: {G30: {X: 10.0, Y: 20.0, Z: -5.0}}
tools: {1: {length: 60.0, radius: 4.0}, 3: {length: 75.0, radius: 5.0}}
tool: 1
"""
PART = """G21 G90 G54
G0 X0 Y0 Z100
T3 M6 G43 H3 G0 X20 (the ball; M6 in a comment)
S1000 M3
G1 X30 Z90 F2000
M6 T1
G43 H1 G0 X5 Y5
M30
"""


def machine_file(folder, macro='tool_change', **more):
    file = folder / 'mill.yaml'
    content = {**content_of('vmc'), 'tool_change_macro': macro, **more}
    file.write_text(yaml.safe_dump(content), encoding='utf-8')
    return file


def places(blocks):
    """Return the machine coordinates of the ends of all rows [mm]."""
    return blocks.tip * 1e3 + ZERO


def read(folder, text, macro='tool_change', setup=SETUP, suffix='.ngc'):
    part = folder / f'part{suffix}'
    part.write_text(text, encoding='utf-8')
    geometry = Transform.of(Machine.load(machine_file(folder, macro)))
    return read_program(part, geometry, Settings(), JobSetup.of_text(setup)).blocks


def test_m6_goes_to_the_change_position_and_the_rest_of_its_line_follows(tmp_path):
    blocks = read(tmp_path, PART)
    first = blocks.line_number == 3
    # Up, across, and from there the other words of the line, with the length of the new tool.
    assert np.allclose(places(blocks)[first], [[300, 200, -5], [10, 20, -5], [320, 20, -5]])
    assert blocks.rapid[first].all()
    # M6 before its T; lengths and modes of the program are as they were.
    again = places(blocks)[blocks.line_number == 6]
    assert np.allclose(again, [[330, 20, -5], [10, 20, -5]])
    assert np.allclose(places(blocks)[-1], [305, 205, -5])


def test_what_the_macro_changes_is_as_before_after_it(tmp_path):
    macro = 'O1 SUB\nG20 G91 G18\nM6\nO1 ENDSUB\n'
    text = 'G21 G90 G17 G54\nG1 X0 Y0 Z100 F2000\nT3 M6\nX30 Y10\nG2 X40 Y20 I10 J0\nM30\n'
    plain = text.replace('T3 M6', 'T3')
    assert np.allclose(read(tmp_path, text, macro).tip, read(tmp_path, plain, macro).tip)


def test_the_functions_of_the_machine_act_where_the_tool_is_changed(tmp_path):
    part, setup, out = (tmp_path / name for name in ('part.ngc', 'setup.yaml', 'out'))
    part.write_text(PART, encoding='utf-8')
    setup.write_text(SETUP, encoding='utf-8')
    options = ['--machine', str(machine_file(tmp_path)), '--setup', str(setup)]
    assert main(['plan', str(part), *options, '--out', str(out)]) == 0
    counts = json.loads((out / 'summary.json').read_text(encoding='utf-8'))['functions']
    assert counts['M6'] == 2 and counts['M3'] == 1  # the spindle is not started again
    machine = Machine.load(machine_file(tmp_path))
    steps = machine.signals.words['M6']
    with np.load(out / 'functions.npz') as found, np.load(out / 'blocks.npz') as blocks:
        changes = np.isin(found['step'], steps)
        before = blocks['tip'][found['block'][changes] - 1] * 1e3 + ZERO
        assert np.allclose(before, [10.0, 20.0, -5.0])
        assert blocks['exact_stop'][found['block'][changes] - 1].all()


@pytest.mark.skipif(not interpreter(), reason='no rs274: run tools/get_rs274')
@pytest.mark.parametrize('macro', ['tool_change', 'G0 Z200\nM6\nG4 P1\n'])
def test_linuxcnc_moves_alike_with_the_same_macro(tmp_path, capfd, macro):
    part, setup, out = (tmp_path / name for name in ('part.ngc', 'setup.yaml', 'out'))
    part.write_text(PART, encoding='utf-8')
    setup.write_text(SETUP, encoding='utf-8')
    file = machine_file(tmp_path, macro)
    options = ['--machine', str(file), '--setup', str(setup), '--out', str(out)]
    assert main(['plan', str(part), *options]) == 0
    check = ['check', str(out), '--program', str(part)]
    assert main(check) == 0
    assert "agree with the blocks; read by LinuxCNC's rs274" in capfd.readouterr().out
    file.write_text(file.read_text(encoding='utf-8').replace('tool_change_macro', 'macros_not'))
    file.write_text(yaml.safe_dump({k: v for k, v in content_of(file).items() if 'not' not in k}))
    assert main(check) == 1  # with M6 alone the tool would not have gone there


def test_tools_of_heidenhain_and_of_lines_by_hand_go_the_same_way(tmp_path):
    text = (
        'BEGIN PGM A MM\nL X+0 Y+0 Z+100 R0 FMAX\nTOOL CALL 3 Z S1000\nL X+10 FMAX\nEND PGM A MM\n'
    )
    found = places(read(tmp_path, text, suffix='.h'))
    assert any(np.allclose(place, [10, 20, -5]) for place in found)
    geometry = Transform.of(Machine.load(machine_file(tmp_path)))
    line = MdiReader(geometry, Settings()).line(
        'T3 M6', np.array([0.1, 0.1, -0.2]), JobSetup.of_text(SETUP)
    )
    assert np.allclose(places(line.read().blocks)[-1], [10, 20, -5])


def test_a_tool_setter_measures_the_new_tool(tmp_path):
    part = tmp_path / 'part.ngc'
    part.write_text('G54\nG0 X0 Y0 Z100\nT3 M6\nG43 H3\nG0 X10\nM30\n', encoding='utf-8')
    geometry = Transform.of(Machine.load(machine_file(tmp_path, 'tool_change_probe')))
    setup = JobSetup.of_text(SETUP)
    stream = read_program(part, geometry, Settings(), setup)
    probes = stream.blocks.tip[~stream.blocks.rapid] * 1e3 + ZERO
    assert np.allclose(probes[:, :2], [700, 50])  # above the setter
    assert probes[:, 2].min() == pytest.approx(-450 + 10)  # the nose stays away from it


@pytest.mark.parametrize(
    ('part', 'setup', 'told'),
    [
        ('G0 X1\nT3 M6\nM30\n', '', 'G30, which is not set'),
        ('FEDRAT/1000\nLOADTL/3\nGOTO/1,2,3\nGOTO/4,5,6\nFINI\n', SETUP, 'CL data'),
    ],
)
def test_what_cannot_be_changed_so_is_refused_in_one_line(tmp_path, part, setup, told):
    suffix = '.apt' if 'GOTO' in part else '.ngc'
    with pytest.raises(ProgramError, match=told):
        read(tmp_path, part, setup=setup, suffix=suffix)


def test_a_fault_in_the_macro_names_its_line(tmp_path):
    with pytest.raises(ProgramError, match=r'tool_change_macro:2: .*X'):
        read(tmp_path, PART, 'G0 Z200\nG0 X[1\nM6\n')


@pytest.mark.parametrize('given', ['missing', 3, 'missing.ngc'])
def test_a_macro_that_cannot_be_read_is_refused_with_its_key(tmp_path, given):
    with pytest.raises(MachineError, match='tool_change_macro'):
        Machine.load(machine_file(tmp_path, given))


def test_a_copied_machine_file_keeps_the_macro(tmp_path):
    (tmp_path / 'mine.ngc').write_text('G53 G0 Z0\nM6\n', encoding='utf-8')
    file = machine_file(tmp_path, 'mine')
    other = tmp_path / 'elsewhere' / 'copy.yaml'
    other.parent.mkdir()
    other.write_text(yaml.safe_dump(content_of(file)), encoding='utf-8')
    assert Machine.load(other).tool_change_macro == Machine.load(file).tool_change_macro != ''
    assert Path(file) != other


def test_variables_name_the_tool_in_the_spindle_and_the_selected_one(tmp_path):
    macro = 'G0 X#<_current_tool> Y#<_selected_tool>\nM6\nG0 X#<_current_tool>\n'
    text = 'G54\nG0 X0 Y0 Z100\nT3\nM6\nM30\n'
    setup = SETUP.replace('tool: 1', 'tool: 0')
    found = read(tmp_path, text, macro, setup)
    assert np.allclose(places(found)[1:, :2] - [300, 200], [[0, 3], [3, 3]])
    assert read_text('G0 X#5400\n', 'a', Transform.of(Machine.load('vmc'))).blocks.tip[0, 0] == 0.0
