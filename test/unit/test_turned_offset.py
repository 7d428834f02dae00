"""Work offsets that are turned about Z (G10 L2 R): where points, arcs and readouts are."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cnc_interp.core import DEG, MM, InterpError, ProgramError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import JobSetup, Tool, read_text
from cnc_interp.program.reading import MdiReader
from cnc_interp.program.setup_table import (
    offset_changes,
    touch_off_changes,
    values_by_axis,
)
from cnc_interp.proof.linuxcnc_reader import setup_of
from cnc_interp.settings.options import Settings

AC = Transform.of(Machine.load('xyzac'))
ZERO = AC.linear(np.zeros((1, 3)), np.zeros((1, 2)))[0]
AT_ZERO = dict(zip('XYZ', ZERO.tolist(), strict=True))


def last(text, setup=None):
    """Tool tip at the end of a program [mm], from the workpiece zero of the machine file."""
    setup = setup or JobSetup({'G54': AT_ZERO, 'G55': AT_ZERO})
    blocks = read_text(f'G21 G90\nG0 X0 Y0 Z0\nF1000\n{text}', 'part.ngc', AC, Settings(), setup)
    return blocks.blocks.tip[-1] / MM


def turned(angle, point):
    return Rotation.from_euler('z', angle, degrees=True).apply(point)


def g54(x, y, angle):
    """The word that puts G54 at X Y beside the workpiece zero, turned."""
    places = ZERO / MM + (x, y, 0)
    return f'G10 L2 P1 X{places[0]:.6f} Y{places[1]:.6f} R{angle}'


#: Where X Y of the turned offset read the start of the program.
START = turned(-30, [-10, -7, 0])


@pytest.mark.parametrize(
    ('text', 'inside'),
    [
        ('G1 X20 Y5 Z3', [20, 5, 3]),
        ('G92 X3\nG1 X20 Y5', [20 + START[0] - 3, 5, 0]),
        ('G52 X1 Y2\nG1 X20 Y5', [21, 7, 0]),
        ('TRANS X1\nAROT Z15\nG1 X20 Y0', [1, 0, 0] + turned(15, [20, 0, 0])),
        ('G1 X1 Y1\nG91 X4', [5, 1, 0]),
        ('G18 G1 X0 Y0\nG2 X10 Z0 I5 K0', [10, 0, 0]),
        (
            'G68.2 X1 Y2 Z3 I20 J10\nG1 X4 Y5 Z6',
            [1, 2, 3] + Rotation.from_euler('ZX', [20, 10], True).apply([4, 5, 6]),
        ),
    ],
)
def test_points_in_a_turned_offset(text, inside):
    found = last(f'{g54(10, 7, 30)}\n{text}')
    np.testing.assert_allclose(found, [10, 7, 0] + turned(30, inside), atol=2e-5)


def test_another_offset_is_not_turned():
    np.testing.assert_allclose(last(f'{g54(10, 7, 30)}\nG55 G1 X5'), [5, 0, 0], atol=1e-9)


@pytest.mark.parametrize('angle', [0, 30, -100, 215])
def test_l20_makes_the_coordinates_read_the_words_and_leaves_the_others(angle):
    words = f'{g54(10, 7, angle)}\nG92 X4 Y-3\nG1 X6 Y8\n'
    before = last(words)
    after = last(f'{words}G10 L20 P1 X50\nG1 X50 Y8')
    np.testing.assert_allclose(after, before, atol=1e-6)
    moved = last(f'{words}G10 L20 P1 X50\nG1 X51 Y10')
    np.testing.assert_allclose(moved - before, turned(angle, [1, 2, 0]), atol=1e-6)


def test_an_arc_and_a_tool_direction_turn_with_the_offset():
    setup = JobSetup({'G54': {**AT_ZERO, 'R': 40 * DEG}})
    text = 'G21 G90\nG0 X0 Y0 Z0\nTRAORI\nG1 A3=1 C3=2 F1000\nG3 X10 Y10 I0 J10\n'
    blocks = read_text(text, 'part.mpf', AC, Settings(), setup).blocks
    middle = turned(40, [0, 10, 0])
    arc = blocks.tip[blocks.line_number == 5] / MM
    assert len(arc) > 5
    np.testing.assert_allclose(np.linalg.norm(arc - middle, axis=1), 10, atol=1e-9)
    np.testing.assert_allclose(
        blocks.axis[-1], turned(40, np.array([1, 0, 2]) / np.sqrt(5)), atol=1e-12
    )


def test_variables_tell_the_rotation_and_l2_without_r_keeps_it():
    np.testing.assert_allclose(last('G10 L2 P2 R25\nG10 L2 P2 X1\nG1 X#5250 Y#5230'), [25, 0, 0])


def test_the_setup_file_keeps_the_rotation_and_linuxcnc_is_told_it():
    setup = JobSetup({'G55': {'X': 0.1, 'R': 30 * DEG}}, active='G55')
    assert JobSetup.of_text(setup.text()) == setup
    assert 'R: 30.0' in setup.text()
    assert setup_of(setup.text(), Machine.load('xyzac')).parameters[5250] == pytest.approx(30)
    with pytest.raises(ProgramError, match=r'G28.R: unknown axis'):
        JobSetup.of_text('reference_points:\n  G28: {R: 3}\n')


@pytest.mark.parametrize('angle', [0.0, 33.0, -150.0])
def test_touch_off_and_readout_agree_with_programs(angle):
    setup = JobSetup(
        {'G54': {**AT_ZERO, 'X': 0.05, 'R': angle * DEG}},
        {1: Tool(0.02)},
        g92={'Y': 0.003},
        g92_on=True,
        tool=1,
    )
    machine = dict(zip('XYZAC', [0.3, -0.1, 0.2, 0.1, -0.2], strict=True))
    zero = {**AT_ZERO, 'A': 0.0, 'C': 0.0}
    lines = MdiReader(Transform.of(Machine.load('xyzac')), Settings())

    def reads():
        q, frame = np.array(list(machine.values())), lines.modes(setup).frame
        found = frame.of_place(q, np.zeros(3), np.zeros(3), ZERO)
        return dict(zip(machine, found.tolist(), strict=True)), frame

    before, frame = reads()
    for change in touch_off_changes(setup, '', {'X': 0.012, 'Z': 0.001}, before, frame, zero):
        setup = setup.changed(change)
    after, _ = reads()
    wanted = {**before, 'X': 0.012, 'Z': 0.001}
    assert after == pytest.approx(wanted, abs=1e-12)
    words = ' '.join(f'{letter}{after[letter] / MM:.9f}' for letter in 'XYZ')
    tip = last(f'G43 H1\nG1 {words}', setup) * MM + ZERO
    np.testing.assert_allclose(tip, [machine[letter] for letter in 'XYZ'], atol=1e-9)


def test_a_rotation_is_asked_for_like_an_axis():
    values = values_by_axis(['X', 'R'], [0.1, 0.5], ('X', 'Y', 'Z', 'R'))
    (change,) = offset_changes(JobSetup(), 'G55', values, clear=False, activate=False)
    assert JobSetup().changed(change).rotation('G55') == 0.5
    with pytest.raises(InterpError, match='R has no offset here'):
        values_by_axis(['R'], [0.5], ('X', 'Y', 'Z'))


@pytest.mark.parametrize(
    ('text', 'part'),
    [
        ('G10 L20 P1 R30 X1', 'R30: L20 takes no rotation; write it with L2'),
        ('G10 L2 P1 R1e6', 'exponent'),
        ('G10 L2 P1 R99999', 'R99999: a rotation of more than ten turns'),
    ],
)
def test_a_wrong_rotation_is_refused_in_one_line(text, part):
    with pytest.raises(ProgramError, match=part):
        last(text)
