"""One system of coordinates: where a line leads, its own words are read, whatever counts there."""

import numpy as np
import pytest
from test_program_mdi import Desk

from cnc_interp.core import DEG, MM
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import Blocks, JobSetup
from cnc_interp.program.job import Tool
from cnc_interp.program.reading import ProgramStream
from cnc_interp.program.setup_table import touch_off_changes
from cnc_interp.program.text.source import Source
from cnc_interp.settings.options import Settings

XYZAC, XYZ = Machine.load('xyzac'), Machine.load('xyz')
ROTATED = {'X': 0.02, 'Y': -0.01, 'Z': 0.15, 'R': 33 * DEG}
SETUPS = {
    'plain': JobSetup(),
    'rotated offset': JobSetup({'G55': ROTATED}, active='G55'),
    'G92': JobSetup(g92={'Y': 0.003, 'C': 10 * DEG}, g92_on=True),
    'tool': JobSetup({'G54': ROTATED}, {3: Tool(0.0755)}, tool=3),
}
#: What is said before, and the rotary words of the line; ``A`` and ``C`` stay on tilted planes.
PRELUDES = {
    '': 'A10 C-20',
    'TRAORI': 'A10 C-20',
    'TRANS X5 Y2 Z-3': 'A10',
    'TRAORI\nTRANS X5 Y2 Z-3': 'A10 C5',
    'G68.2 X3 Y4 Z5 I20 J10 K0': '',
    'G68.2 X3 Y4 Z5 I20 J10 K0\nG53.1': '',
    'G52 X4': 'A5',
    'ROT Z30': '',
}


def zero_of(transform):
    return transform.linear(np.zeros((1, 3)), np.zeros((1, 2)))[0]


def reads(frame, transform, q):
    tip, axis = transform.forward(q[None])
    return frame.of_place(q, tip[0], axis[0], zero_of(transform))


@pytest.mark.parametrize('setup', SETUPS)
@pytest.mark.parametrize('prelude', PRELUDES)
def test_where_a_line_leads_its_words_are_read(setup, prelude):
    desk = Desk()
    desk.setup = SETUPS[setup]
    for line in ('G0 A0 C0', *prelude.splitlines()):
        desk(line)
    rotary = PRELUDES[prelude]
    desk(f'G0 X12 Y-7 Z31 {rotary}')
    found = reads(desk.modes.frame, desk.transform, desk.q)
    np.testing.assert_allclose(found[:3] / MM, [12, -7, 31], atol=1e-6)
    for word in rotary.split():
        assert found['AC'.index(word[0]) + 3] / DEG == pytest.approx(float(word[1:]), abs=1e-9)
    # A coordinate is touched off: it reads that, and the others what they did.
    zero = dict(zip('XYZAC', [*zero_of(desk.transform), 0.0, 0.0], strict=True))
    before = dict(zip('XYZAC', found.tolist(), strict=True))
    for change in touch_off_changes(desk.setup, '', {'Y': 0.0025}, before, desk.modes.frame, zero):
        desk.setup = desk.setup.changed(change)
    after = reads(desk.modes.frame, desk.transform, desk.q)
    np.testing.assert_allclose(after, [*(found[:1]), 0.0025, *found[2:]], atol=1e-9)
    # And the next line starts from there: it leads to its own words again.
    desk('G0 Y4')
    assert reads(desk.modes.frame, desk.transform, desk.q)[1] == pytest.approx(0.004, abs=1e-9)


def test_the_name_says_what_counts():
    desk = Desk()
    assert desk.modes.frame.coordinates == 'G54'
    desk('TRAORI')
    desk('TRANS X5')
    desk.setup = SETUPS['G92']
    assert desk.modes.frame.coordinates == 'G54 + G92 + TRANS, tool tip'
    desk('TRANS')
    desk('TRAFOOF')
    assert desk.modes.frame.coordinates == 'G54 + G92'


def test_lines_by_hand_count_with_the_tool_in_the_spindle_until_they_say_otherwise():
    desk = Desk('xyz')
    desk.setup = JobSetup({}, {3: Tool(0.0755), 4: Tool(0.05)}, tool=3)
    desk('G0 Z10')
    height = desk.q[2] - zero_of(desk.transform)[2]
    assert height == pytest.approx(0.0855) and 'G43' in desk.codes
    desk('G49 G0 Z10')
    assert desk.q[2] - zero_of(desk.transform)[2] == pytest.approx(0.010)
    desk('G0 Z11')
    assert desk.q[2] - zero_of(desk.transform)[2] == pytest.approx(0.011)
    desk('G43 H4 G0 Z10')
    assert desk.q[2] - zero_of(desk.transform)[2] == pytest.approx(0.060)


def test_blocks_of_a_program_carry_the_coordinates_of_their_lines():
    text = 'G21 G90\nTRAORI\nG0 X0 Y0 Z0 A0 C0\nTRANS X5\nG1 X10 F500\nTRANS X7\nG1 X10\nM30\n'
    transform = Transform.of(XYZAC)
    stream = ProgramStream(Source.of_text(text, 'a'), transform, Settings(), SETUPS['G92'])
    blocks = Blocks.concatenate(list(stream))
    modes = stream.modes
    for row in range(1, len(blocks)):
        frame = modes.after(modes.change_before(row)).frame
        found = frame.of_place(np.zeros(5), blocks.tip[row], np.array([0, 0, 1.0]), np.zeros(3))
        wanted = 0.0 if blocks.line_number[row] == 3 else 0.010
        assert found[0] == pytest.approx(wanted, abs=1e-12)
