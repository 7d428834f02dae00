"""A run from a line: state and blocks are those of the whole program; doubt is told."""

from dataclasses import fields

import numpy as np
import pytest

from cnc_interp.core import ProgramError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import ProgramStream, read_text
from cnc_interp.program.text.source import Source
from cnc_interp.settings.options import Settings

XYZAC = Transform.of(Machine.load('xyzac'))
LOOP = """G21 G90 G54
T3 M6
S8000 M3
M8
G0 X0 Y0 Z10
G1 Z0 F1000
o100 repeat [3]
G91 G1 X5 F800
o100 endrepeat
G90 X50
M5 M9
G2 X60 Y10 I10 J0
G1 X0
M30
"""
CL = """UNITS/MM
LOADTL/4
SPINDL/RPM,9000,CLW
FEDRAT/1200,MMPM
GOTO/0,0,0,0,0,1
GOTO/10,0,0
COOLNT/ON
GOTO/10,10,0
FINI
"""


def started(text, line, which=0, name='<text>'):
    """Read a program that starts at a line; return the start and the blocks."""
    settings = Settings(from_line=line, line_pass=which)
    stream = ProgramStream(Source.of_text(text, name), XYZAC, settings)
    blocks = stream.read().blocks
    return stream.start.found(), blocks


@pytest.mark.parametrize(
    ('line', 'which', 'row', 'of_line'),
    [(1, 0, 1, 6), (8, 1, 2, 8), (8, 2, 3, 8), (8, 3, 4, 8), (10, 0, 5, 10), (12, 0, 6, 12)],
)
def test_the_first_motion_of_each_pass_is_found_and_no_block_changes(line, which, row, of_line):
    whole = read_text(LOOP, '<text>', XYZAC, Settings()).blocks
    start, blocks = started(LOOP, line, which)
    assert (start.row, blocks.line_number[row], start.line) == (row, of_line, line)
    for column in fields(whole):
        left, right = getattr(blocks, column.name), getattr(whole, column.name)
        assert np.array_equal(left, right, equal_nan=True)


def test_a_line_among_many_plain_ones_is_found_and_no_block_changes():
    text = 'G1 X0 F1000\n' + ''.join(f'X{k} Y{k % 7}\n' for k in range(1, 3000))
    whole = read_text(text, '<text>', XYZAC, Settings()).blocks
    for line in (2, 777, 2999):
        start, blocks = started(text, line)
        assert blocks.line_number[start.row] == line
        assert np.array_equal(blocks.tip, whole.tip)


def test_the_state_is_that_before_the_line():
    before, inside, after = (set(started(LOOP, *at)[0].words) for at in ((8, 1), (8, 2), (12, 0)))
    assert {'T3', 'S8000', 'M3', 'M8', 'G54', 'G21', 'G90', 'F1000', 'G1'} <= before
    assert {'G91', 'F800', 'M3', 'M8'} <= inside and 'G90' not in inside
    assert {'G90', 'F800', 'M5', 'M9'} <= after and not {'M3', 'M8'} & after


def test_words_of_the_state_set_that_state():
    text = 'G20 G91 G18 G93 G61\nG54\nG1 X1 F20\nX2 F20\nX3 F20\n'
    (start, _) = started(text, 4)
    again = ' '.join(word for word in start.words if not word.startswith('F'))
    (found, _) = started(f'{again}\nG1 X1 F20\nX2 F20\n', 3)
    assert found.words == start.words


def test_a_line_without_motion_starts_at_the_next_motion():
    start, blocks = started(LOOP, 11)
    assert blocks.line_number[start.row] == 12


@pytest.mark.parametrize(
    ('line', 'which', 'said'),
    [
        (8, 0, '<text>:8: executed 3 times; choose pass 1 to 3 (--pass)'),
        (8, 4, '<text>:8: executed 3 times only; choose pass 1 to 3 (--pass)'),
        (14, 0, '<text>:14: no motion follows this line'),
        (15, 0, '<text>:15: the program does not execute this line'),
    ],
)
def test_a_start_in_doubt_is_refused(line, which, said):
    with pytest.raises(ProgramError) as caught:
        started(LOOP, line, which)
    assert str(caught.value).startswith(said)


def test_lines_of_cl_data_start_too():
    start, blocks = started(CL, 7)
    assert blocks.line_number[start.row] == 8
    assert start.words == ('UNITS/MM', 'FEDRAT/1200,MMPM', 'LOADTL/4', 'SPINDL/RPM,9000,CLW')
