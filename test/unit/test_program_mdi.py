"""Lines by hand: each starts where the machine stands and goes on with the modes before."""

import numpy as np
import pytest
from whole_plans import path_of

from cnc_interp.core import ProgramError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import Blocks, JobSetup, read_text
from cnc_interp.program.reading import MdiReader
from cnc_interp.settings.options import Settings

SETTINGS = Settings()
PLACES = {
    'xyzac': [0.1, 0.05, 0.2, 0.3, 7.0],
    'xyz': [0.01, -0.02, 0.03],
}


class Desk:
    """A machine that stands where the last line has ended."""

    def __init__(self, machine='xyzac', settings=SETTINGS):
        self.transform = Transform.of(Machine.load(machine))
        self.reader = MdiReader(self.transform, settings)
        self.q = np.array(PLACES[machine])
        self.setup = JobSetup.load(settings.setup) if settings.setup else JobSetup()

    def keep(self, line):
        """Do what program_node does when a line is executed."""
        self.reader.keep(line)
        for found in line.changes:
            self.setup = self.setup.changed(found.change)

    @property
    def modes(self):
        return self.reader.modes(self.setup)

    def __call__(self, text):
        """Give a line; return the way of the axes."""
        line = self.reader.line(text, self.q, self.setup)
        blocks = Blocks.concatenate(list(line))
        way = np.zeros(len(self.q))
        if len(blocks) > 1:
            path = path_of(blocks, self.transform, SETTINGS)
            assert np.abs(path.q[0] - self.q).max() < 1e-14  # no approach, no other branch
            way, self.q = path.q[-1] - self.q, path.q[-1]
        self.keep(line)
        return way

    @property
    def codes(self):
        return self.modes.codes


def test_modes_are_kept_from_line_to_line():
    desk = Desk()
    for text in ('G91 G20', 'F50', '(a comment)', 'G1'):
        assert not desk(text).any()
    assert desk('X1') == pytest.approx([0.0254, 0, 0, 0, 0], abs=1e-15)
    assert desk.modes.feedrate == pytest.approx(50 * 0.0254 / 60)
    assert desk.codes == (
        'G1',
        'G17',
        'G20',
        'G91',
        'G91.1',
        'G94',
        'G98',
        'G64',
        'G54',
        'G49',
        'ORIAXES',
    )
    desk.q = desk.q + 0.01  # moved by hand
    assert desk('Y1 C1') == pytest.approx([0, 0.0254, 0, 0, np.radians(1)], abs=1e-15)
    desk('G18 G93 G61')
    desk('S1000 T3 M6')
    assert {'G18', 'G93', 'G61'} <= set(desk.codes)
    modes = desk.modes
    assert (modes.spindle_speed, modes.tool) == (1000.0, 3) and np.isnan(modes.feedrate)
    with pytest.raises(ProgramError, match='no F'):
        desk('X1')
    desk('M30')
    assert desk.codes[0] == 'G17' and 'G20' not in desk.codes and 'G91' not in desk.codes


def test_variables_offsets_and_cycles_are_kept():
    desk = Desk('xyz')
    desk('#100=7')
    desk('G92 X0 Y0 Z0')
    assert 'G92' in desk.codes
    desk('G0 X#100')
    assert desk.q == pytest.approx([0.017, -0.02, 0.03], abs=1e-15)
    desk('G10 L2 P1 X0 Y0 Z0')
    desk('G10 L2 P2 X100')
    desk('G55')
    desk('G92.1')
    desk('G0 X1')
    assert desk.q[0] == pytest.approx(0.1 + 0.001, abs=1e-15)
    desk('G54 G90 G0 X0 Y0 Z50')
    desk('G81 X5 Z-2 R1 F100')
    assert 'G81' in desk.codes
    desk.q = desk.q + [0, 0, 0.02]  # lifted by hand: the next hole returns to that level
    assert desk('X9') == pytest.approx([0.004, 0, 0], abs=1e-15)


def test_a_refused_line_leaves_everything():
    desk = Desk()
    desk('G91 G1 F1000')
    before = desk.modes
    for text in ('G90 G20 X1 Q7', 'G93 F5 G41', '#101=5 G0 X#102', 'G90\nG0 X1', ''):
        with pytest.raises(ProgramError):
            desk(text)
        assert repr(desk.modes) == repr(before)  # with NaN
    with pytest.raises(ProgramError, match='101'):
        desk('G0 X#101')
    assert desk('X2') == pytest.approx([0.002, 0, 0, 0, 0], abs=1e-15)


@pytest.mark.parametrize('switch', ['TRAORI', 'G43.4', 'TRAORI ORIVECT'])
def test_tool_tip_programming_starts_at_the_pose_of_the_axes(switch):
    desk = Desk()
    desk(switch)
    for turn in ([0, 0, 0, 0.1, -0.4], [0.01, 0, 0, 0, 3.0]):
        desk.q = desk.q + turn  # moved by hand
        tip, axis = desk.transform.forward(desk.q[None])
        desk('G91 G1 X3 Y-1 F500')
        after = desk.transform.forward(desk.q[None])
        assert after[0] - tip == pytest.approx(np.array([[0.003, -0.001, 0]]), abs=1e-14)
        assert after[1] == pytest.approx(axis, abs=1e-14)
    tip, _ = desk.transform.forward(desk.q[None])
    desk('G1 A3=0.1 B3=0 C3=1')
    after = desk.transform.forward(desk.q[None])
    assert after[0] == pytest.approx(tip, abs=1e-14)
    assert after[1][0] == pytest.approx(np.array([0.1, 0, 1]) / np.hypot(0.1, 1), abs=1e-12)


def test_lines_by_hand_make_the_blocks_of_a_program():
    lines = ['G90 G54', 'G1 X10 Y5 F800', 'G2 X20 Y15 I10', 'G91 G1 Z-3', 'G3 X4 Y4 R4', 'G0 Z5']
    desk = Desk('xyz')
    start = desk.reader.line('G0', desk.q, desk.setup)
    tip = 1e3 * Blocks.concatenate(list(start)).tip[0]
    head = 'G0 X{:.17g} Y{:.17g} Z{:.17g}\nG61'.format(*tip)
    program = read_text('\n'.join([head, *lines]), 'all', desk.transform, SETTINGS).blocks
    ends = []
    for text in lines:
        line = desk.reader.line(text, desk.q, desk.setup)
        blocks = Blocks.concatenate(list(line))
        if len(blocks) > 1:
            desk.q = path_of(blocks, desk.transform, SETTINGS).q[-1]
            ends.append(blocks[1:])
        desk.keep(line)
    typed = Blocks.concatenate(ends)
    assert len(typed) == len(program) - 1
    for name in ('tip', 'axis', 'feedrate', 'rapid'):
        assert getattr(typed, name) == pytest.approx(getattr(program, name)[1:], abs=1e-13)
    # A short line beside arcs has their tolerance in a program; by hand it has no neighbours.
    ratio = program.contour_tolerance[1:] / typed.contour_tolerance
    assert ratio == pytest.approx(np.where(program.line_number[1:] == 6, 0.9, 1.0))
