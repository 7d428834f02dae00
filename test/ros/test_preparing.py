"""Programs are read and checked to their last block before a node sends the first one."""

from dataclasses import fields

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

import numpy as np
from cnc_interp_msgs.action import RunProgram

from cnc_interp.core.errors import BlockError, ProgramError
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.nodes.program_check import prepare
from cnc_interp.program import read_text
from cnc_interp.program.blocks import Blocks
from cnc_interp.run.chain import plan_program
from cnc_interp.settings.choices import Settings

TRANSFORM = Transform.of(Machine.load('xyzac'))
ANGLES = np.linspace(0.0, 12.0, 1500)
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
    with pytest.raises(ProgramError, match=r'<text>:1502: X1\.2\.3'):
        prepared(TEXT + '\nG1 X1.2.3')
    with pytest.raises(BlockError, match=r'<text>.*1502.*axis X'):
        prepared(TEXT + '\nG1 X5000')
    with pytest.raises(ProgramError, match='no motion'):
        prepared(LINES[0])


def test_a_check_ends_when_it_is_told_to():
    def cancelled(share):
        if share > 0.3:
            raise BlockError('cancelled')

    with pytest.raises(BlockError, match='cancelled'):
        prepared(TEXT, cancelled)
