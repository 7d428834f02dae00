"""Programs are read and checked to their last block before a node sends the first one."""

import os
from dataclasses import fields
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

import numpy as np
from cnc_interp_msgs.action import RunProgram
from diagnostic_msgs.msg import KeyValue
from whole_plans import plan_program

from cnc_interp.core import BlockError, InterpError, ProgramError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.nodes.program_check import prepare
from cnc_interp.program import open_program, read_text
from cnc_interp.program.blocks import Blocks
from cnc_interp.run.planning_chain import plan_to_files
from cnc_interp.settings.options import Settings

TRANSFORM = Transform.of(Machine.load('xyzac'))
ANGLES = np.linspace(0.0, 32.0, 4000)
LINES = [
    'G21 G90 G0 X30 Y0 Z0 F2000',
    *(f'G1 X{30 * np.cos(u):.4f} Y{30 * np.sin(u):.4f} Z{u:.4f}' for u in ANGLES),
]
TEXT = '\n'.join(LINES)


def prepared(text, told=lambda share: None, **values):
    return prepare(RunProgram.Goal(text=text), TRANSFORM, Settings(**values), told)


@pytest.mark.parametrize('compress', [False, True])
def test_blocks_are_those_of_the_reader_and_the_length_that_of_the_path_to_be_run(compress):
    shares = []
    ready = prepared(TEXT, shares.append, compress=compress)
    program = read_text(TEXT, '<text>', TRANSFORM, Settings())
    stored, read = ready.blocks[0 : len(ready.blocks)], program.blocks
    for column in fields(Blocks):
        assert getattr(stored, column.name).tobytes() == getattr(read, column.name).tobytes()
    options = Settings(compress=compress)
    plan = plan_program(program, TRANSFORM.machine, options)
    assert ready.path_length == pytest.approx(plan.setpoints.s[-1], abs=1e-9)
    assert shares == sorted(shares) and shares[-1] == 1.0 and len(shares) > 5
    ready.blocks.close()


def test_a_fault_in_the_last_line_is_told_before_anything_moves():
    with pytest.raises(ProgramError, match=rf'<text>:{len(LINES) + 1}: X1\.2\.3'):
        prepared(TEXT + '\nG1 X1.2.3')
    with pytest.raises(BlockError, match=rf'<text>.*{len(LINES) + 1}.*axis X'):
        prepared(TEXT + '\nG1 X5000')
    with pytest.raises(ProgramError, match='no motion'):
        prepared(LINES[0])


def test_a_check_ends_when_it_is_told_to():
    def cancelled(share):
        if share > 0.3:
            raise BlockError('cancelled')

    with pytest.raises(BlockError, match='cancelled'):
        prepared(TEXT, cancelled)


@pytest.fixture
def folder(tmp_path):
    """A folder of programs, beside it a secret."""
    (tmp_path / 'secret').write_text('root:x:0')
    (tmp_path / 'parts').mkdir()
    (tmp_path / 'parts' / 'a.ngc').write_text(TEXT)
    (tmp_path / 'parts' / 'link.ngc').symlink_to(tmp_path / 'secret')
    (tmp_path / 'parts_of_others').mkdir()
    (tmp_path / 'parts_of_others' / 'b.ngc').write_text(TEXT)
    return tmp_path


def prepared_file(path, *folders):
    goal = RunProgram.Goal(program=str(path))
    return prepare(goal, TRANSFORM, Settings(), lambda share: None, [str(f) for f in folders])


@pytest.mark.parametrize('allowed', ['parts', 'parts/a.ngc', 'parts/../parts'])
def test_a_program_of_a_folder_is_read(folder, allowed):
    assert prepared_file(folder / 'parts' / 'a.ngc', '', folder / allowed).text == TEXT


@pytest.mark.parametrize(
    'path',
    [
        'secret',
        'parts/../secret',
        'parts/link.ngc',
        'parts/../nosuch',
        'parts_of_others/b.ngc',
        '/etc/passwd',
        '/dev/zero',
    ],
)
def test_nothing_else_is_read_and_the_answer_does_not_tell_whether_it_exists(folder, path):
    """Whoever reached program_node could have it read any file, and quote its first line."""
    told = []
    for name in (folder / path, folder / 'nosuch'):
        with pytest.raises(InterpError) as refusal:
            prepared_file(name, folder / 'parts')
        told.append(str(refusal.value).replace(str(name), ''))
    assert told[0] == told[1] and 'program_folders' in told[0]


def test_without_a_folder_no_file_is_read_and_a_text_has_a_name(folder):
    with pytest.raises(InterpError, match='program_folders'):
        prepared_file(folder / 'parts' / 'a.ngc')
    goal = RunProgram.Goal(program='/etc/part.ngc', text='G1 X10 F100\nG1 Xfoo\n')
    with pytest.raises(InterpError, match=r'^part\.ngc'):
        prepare(goal, TRANSFORM, Settings(), lambda share: None)


@pytest.mark.parametrize(
    ('text', 'moves'),
    [
        ('S3000 M3\nG1 X60 F500\nM2\n', False),
        ('S3000 M3\nM2\n', False),
        ('G38.2 X60 F500\nM2\n', False),
        ('G0 X0\nM8\nG1 X0 F500\nM9\nM2\n', False),
        ('S3000 M3\nG1 X0 F500\nX60\nM2\n', True),
    ],
)
def test_a_program_is_refused_exactly_where_plan_refuses_it(text, moves, tmp_path):
    """One line of motion switched spindle and coolant on, and was "done, without motion"."""
    machine, refusals = Machine.load('vmc'), []
    file, transform = tmp_path / 'p.ngc', Transform.of(machine)
    file.write_text(text)
    goal = RunProgram.Goal(program=str(file))
    for act in (
        lambda: prepare(goal, transform, Settings(), print, [str(tmp_path)]),
        lambda: plan_to_files(
            open_program(file, transform, Settings()), machine, tmp_path / 'plan'
        ),
    ):
        try:
            act()
            refusals.append('')
        except ProgramError as problem:
            refusals.append(str(problem))
    assert refusals[0] == refusals[1] and (refusals[0] == '') is moves


@pytest.mark.parametrize('machine', ['/etc/passwd', '/dev/zero', 'bc_trunnion'])
def test_a_goal_for_another_machine_is_refused_and_no_file_is_read(machine):
    with pytest.raises(InterpError, match='the nodes run machine'):
        prepare(RunProgram.Goal(text=TEXT, machine=machine), TRANSFORM, Settings(), print)


@pytest.mark.parametrize('kind', ['device', 'pipe', 'folder'])
def test_what_is_no_file_is_never_opened(folder, kind):
    """A pipe below the folder blocked the node for ever; a device has no end."""
    path = Path('/dev/zero') if kind == 'device' else folder / 'parts' / 'pipe.ngc'
    if kind == 'pipe':
        os.mkfifo(path)
    elif kind == 'folder':
        path.mkdir()
    with pytest.raises(InterpError, match='it is not a file'):
        prepared_file(path, '/dev', folder / 'parts')


def test_the_setup_of_a_goal_is_held_to_the_folders(folder):
    """The first word of any file of the computer was told to everybody on the domain."""
    goal = RunProgram.Goal(text=TEXT)
    goal.settings = [KeyValue(key='setup', value=str(folder / 'secret'))]
    with pytest.raises(InterpError, match='program_folders') as refusal:
        prepare(goal, TRANSFORM, Settings(), lambda share: None, [str(folder / 'parts')])
    assert 'root:x' not in str(refusal.value)


def test_a_subprogram_of_the_folder_is_read_and_one_linked_from_outside_is_not(folder):
    main, called = folder / 'parts' / 'main.ngc', folder / 'parts' / '10.ngc'
    main.write_text('o10 call\nM2\n')
    called.write_text(f'o10 sub\n{TEXT}\no10 endsub\n')
    assert prepared_file(main, main).path_length > 0.0
    called.rename(folder / '10.ngc')
    called.symlink_to(folder / '10.ngc')
    with pytest.raises(InterpError, match=r'subprogram.*program_folders'):
        prepared_file(main, main)
    assert prepared_file(main, folder).path_length > 0.0
    main.write_text(f'o<{"x" * 300}> call\nM2\n')  # longer than a file may be called
    with pytest.raises(InterpError, match='is not in this file or its folder'):
        prepared_file(main, main)
