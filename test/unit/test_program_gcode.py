"""Modal G-code, each meaning checked in SI against the sentence it stands for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_program_subdivision import TableAC

from cnc_interp.core import ProgramError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import Signals
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import JobSetup, Tool, open_program, read_program, read_text
from cnc_interp.program.blocks import GO_ON, OPTIONAL_STOP, POSES, ROTARY_LINEAR, STOP, targets
from cnc_interp.program.readers import gcode
from cnc_interp.settings.options import Settings

AC = Transform.of(Machine.load('xyzac'))


class ThreeAxes:
    """A machine without rotary axes."""

    axis_names, rotary_names = ('X', 'Y', 'Z'), ()
    extra_names, extra_direction, control, signals = (), np.zeros((0, 3)), {}, Signals()
    tool_change_macro, arm, scale = '', None, 1.0
    is_linear = np.ones(3, dtype=bool)

    @property
    def machine(self):
        """The same: what of a machine is read with its transformation."""
        return self

    five_axis = machine

    def tool_axis(self, rotary):
        raise AssertionError('a machine without rotary axes is never asked')

    def linear(self, tip, rotary):
        return tip


def read(text, geometry=None, setup=None, **options):
    return read_text(text, 'part.ngc', geometry or TableAC(), Settings(**options), setup)


def tips(text, **options):
    return (read(text, **options).blocks.tip * 1e3).round(9).tolist()


def test_start_pose_is_the_first_target_and_needs_no_feed():
    blocks = read('G21\nG1 X3 Z-2\nX4 F60\nM30').blocks
    np.testing.assert_allclose(blocks.tip * 1e3, [[3, 0, -2], [4, 0, -2]])
    np.testing.assert_allclose(blocks.axis, [[0, 0, 1], [0, 0, 1]])
    assert np.isnan(blocks.duration).all()
    assert blocks.feedrate[1] == pytest.approx(1e-3)
    np.testing.assert_array_equal(blocks.rotary[0], [0, 0])
    assert np.isnan(blocks.rotary[1]).all()


@pytest.mark.parametrize(
    'line',
    [
        'X-1.5Y2',
        'x-1.5 y2',
        'X  -1.500  Y +2.',
        'G1X-1.5Y2',
        'g01 x-1.5 y2',
        'N5 G1 X-1.5 Y2',
        'Y2 X-1.5',
        'X-1.5 (to the left) Y2',
        'X-1.5Y2 ; end',
        '\tX-1.5\tY2\t',
        'N10X-1.5Y2',
        '/X-1.5Y2',
        '/2 X-1.5 Y2',
        'N7 /G1 X-1.5 Y2',
        'X=-1.5 Y=2',
        '(tool (1))X-1.5Y2',
    ],
)
def test_spellings_of_one_move(line):
    for end in ('\n', '\r\n'):
        text = end.join(['%', 'O12 (name)', 'G0 X0 Y0', 'G1 F60', line, 'M2', '%'])
        blocks = read(text).blocks
        np.testing.assert_allclose(blocks.tip[-1] * 1e3, [-1.5, 2, 0])
        assert blocks.line_number[-1] == 5


def test_plain_lines_are_read_many_at_once(monkeypatch):
    taken, move_along = [], gcode.move_along

    def seen(*given):
        taken.append(move_along(*given))
        return taken[-1]

    monkeypatch.setattr(gcode, 'move_along', seen)
    lines = '\n'.join(f'X{k} Y{k % 2}' for k in range(1, 400))
    assert len(tips(f'G0 X0 Y0 Z0\nF100 (more than plain words)\nS1\nG1\n{lines}')) == 400
    assert taken and all(taken)


def test_incremental_and_inch():
    assert tips('G20 G0 X1\nG91 X1 Y-2\nG90 X0\nG21 Y10') == [
        [25.4, 0, 0],
        [50.8, -50.8, 0],
        [0, -50.8, 0],
        [0, 10, 0],
    ]
    assert read('G20 G0 X0\nG1 X1 F10').blocks.feedrate[1] == pytest.approx(0.254 / 60)


def test_incremental_rotary_words():
    text = 'M428\nG91\nG0 X1 C90\nG0 C300\nG0 A-10'
    np.testing.assert_allclose(np.degrees(read(text).blocks.rotary[:, 1]), [90, 390, 390])


def test_rapids_are_infinite_and_feed_is_modal():
    blocks = read('G0 X0\nG1 X1 F600\nG0 X2\nG1 X3\nX4 F1200').blocks
    np.testing.assert_allclose(blocks.feedrate, [np.inf, 0.01, np.inf, 0.01, 0.02])
    assert blocks.rapid.tolist() == [True, False, True, False, False]


def test_feed_of_programs_without_f():
    assert read('G0 X0\nG1 X1', feedrate=0.05).blocks.feedrate[1] == 0.05


def test_inverse_time():
    program = read('G0 X0\nG93\nG1 X1 F30\nX2\nG0 X3\nG94 G1 X4 F60')
    blocks = program.blocks
    np.testing.assert_allclose(blocks.duration, [np.nan, 2, 2, np.nan, np.nan])
    np.testing.assert_allclose(blocks.feedrate, [np.inf, np.nan, np.nan, np.inf, 1e-3])
    assert program.notices == ('line 4: G93: a block without F keeps the last one',)


def test_zero_length_blocks_are_merged_but_their_stop_and_feed_stay():
    blocks = read('G0 X0\nG1 X1 F600\nX1\nX1 F1200\nG9 X1\nX2\nG0 X2').blocks
    np.testing.assert_allclose(blocks.tip[:, 0] * 1e3, [0, 1, 2])
    np.testing.assert_allclose(blocks.feedrate[1:], [0.01, 0.02])
    assert blocks.exact_stop.tolist() == [False, True, True]
    assert blocks.line_number.tolist() == [1, 2, 6]


def test_exact_stop_modes_and_program_stops():
    text = 'G0 X0\nG61\nG1 X1 F600\nG64\nX2\nX3\nM0\nX4\nG9 X5\nX6\nG4 P2\nX7\nM30'
    blocks = read(text).blocks
    stops = (blocks.tip[blocks.exact_stop, 0] * 1e3).round(9)
    np.testing.assert_allclose(stops, [1, 3, 5, 6, 7])


def test_program_stops_say_whom_they_wait_for():
    text = (
        'G0 X0\nG1 X1 F600 M0\nX2\nM1\nX3\nM1\nM0\nX4\nM0\nG4 P1\nX4\nM1\nX5 G9\n'
        'G2 X7 R1 M1\nM60\nX8 Y1 R4\nM30'
    )
    blocks = read(text).blocks
    ends = {1: STOP, 2: OPTIONAL_STOP, 3: STOP, 4: STOP, 7: STOP}
    waits = {
        round(x * 1e3, 6): int(kind)
        for x, kind in zip(blocks.tip[:, 0], blocks.program_stop, strict=True)
        if kind
    }
    assert waits == ends
    assert (blocks.program_stop != GO_ON).sum() == len(ends)  # only the last chord of an arc
    assert blocks.exact_stop[blocks.program_stop != GO_ON].all()
    assert any('M1: with optional stop on: waits' in notice for notice in read(text).notices)


@pytest.mark.parametrize(
    ('text', 'waits'),
    [('G0 X0\nM0', True), ('M0\nG0 X0', True), ('M60', True), ('M1\nG0 X0', False)],
)
def test_a_stop_before_the_first_motion_is_waited_for_before_anything_moves(text, waits, tmp_path):
    file = tmp_path / 'part.ngc'
    file.write_text(f'{text}\nG1 X1 F600\nX2\n')
    stream = open_program(file, TableAC(), Settings())
    program = stream.read()
    assert not program.blocks.program_stop.any() and stream.waits_first == waits
    told = 'waits for cycle start before it goes' if waits else 'no wait before the first motion'
    assert any(told in notice for notice in program.notices)


def test_g64_keeps_the_path_within_p_whatever_q_allows():
    tolerances = read('G0 X0\nG64 P0.05 Q0.01\nG1 X1 F600\nG64 P0.03 Q0\nX2').blocks
    np.testing.assert_allclose(tolerances.contour_tolerance[1:] * 1e3, [0.05, 0.03])


@pytest.mark.parametrize(
    ('text', 'part'),
    [
        ('G64 Q0.01', 'Q0.01: write G64 P Q'),
        ('G64 P0.1 Q-1', 'Q-1: write G64 P Q'),
        ('G93 G1 X1 F60\nG94 X2', 'after the change of feed mode'),
    ],
)
def test_words_that_would_be_lost_are_refused(text, part):
    setup = JobSetup(tools={1: Tool(0.075), 2: Tool()})
    with pytest.raises(ProgramError, match=part):
        read(f'G0 X0\nG43.4 H2\nG49\n{text}\nG1 X9', setup=setup)


def test_g9_is_for_its_own_block_only():
    assert not read('G0 X0\nG9\nG1 X1 F600\nG1 X2').blocks.exact_stop[1]


def test_dwell_words_are_no_motion():
    assert tips('G0 X1\nG4 X5\nG04F2\nG0 Y1') == [[1, 0, 0], [1, 1, 0]]
    assert any('dwell' in notice for notice in read('G0 X1\nG4 X5').notices)


def test_path_tolerance_of_g64():
    text = 'G0 X0\nG64 P0.1\nG0 X1\nG20 G64 P0.001\nG0 X1\nG64\nG0 X2'
    blocks = read(text, contour_tolerance=1e-5, orientation_tolerance=2e-5).blocks
    np.testing.assert_allclose(blocks.contour_tolerance, [1e-5, 1e-4, 2.54e-5, 1e-5])
    np.testing.assert_allclose(blocks.orientation_tolerance, [2e-5, 1e-4, 2.54e-5, 2e-5])
    forced = read('G64 P0.1\nG0 X0', contour_tolerance=1e-5, force_tolerances=True)
    assert forced.blocks.contour_tolerance[0] == 1e-5 and 'forced' in forced.notices[0]


def test_harmless_codes_are_told_once_with_their_first_line():
    text = 'T1 M6\nS5000 M3\nG0 X0\nM8\nT2 M6\nS100 M3\nG17 G40\nG40\nG54\nG54 M5'
    notices = read(text).notices
    assert [notice.split(':')[1].strip() for notice in notices] == [
        'M6',
        'T',
        'M3',
        'S',
        'M8',
        'G40',
        'G54',
        'M5',
    ]
    assert notices[0].startswith('line 1:') and notices[-1].startswith('line 10:')


def test_the_extruder_of_a_printer_is_told_once():
    program = read('G0 X1\nG1 X2 E0.5 F600\nG92 E0\nG1 X3 E1.5')
    np.testing.assert_allclose(program.blocks.tip[:, 0] * 1e3, [1, 2, 3])
    assert [notice for notice in program.notices if ' E' in notice] == [
        'line 2: E: no effect, it does not move the tool'
    ]


def test_nothing_is_read_after_the_end():
    assert len(read('%\nG0 X0\nM30\nG2 nonsense').blocks) == 1
    assert len(read('%\nG0 X0\n%\nG2 nonsense').blocks) == 1
    assert len(read('(lead)\n%\nG0 X0\nG0 X1 M2\nnonsense').blocks) == 2


@pytest.mark.parametrize(
    ('on', 'off'),
    [
        ('M428', 'M429'),
        ('G43.4 H1', 'G49'),
        ('G234', 'G49'),
        ('TRAORI', 'TRAFOOF'),
        ('TRAORI(1)', 'TRAFOOF'),
        ('#TRAFO ON', '#TRAFO OFF'),
    ],
)
def test_tool_tip_programming_switches(on, off):
    text = f'{on}\nG0 X1 A10 C20\nG0 X2 A0 C0\n{off}\nG0 X3\nM30'
    blocks = read(text).blocks
    np.testing.assert_allclose(blocks.tip[-1] * 1e3, [3, 0, 0])
    # Off, words are axis positions: nothing moves at the switch, then X alone runs in M.
    text = f'{on}\nG0 X1 A10 C20\n{off}\nG91 G0 X2'
    blocks = read(text).blocks
    start, turn = np.array([1e-3, 0, 0]), TableAC.turn(np.radians([10, 20]))
    np.testing.assert_allclose(blocks.tip, [start, start + turn.T @ [2e-3, 0, 0]], atol=1e-15)


def test_rotary_words_that_stay_at_zero_need_no_switch():
    assert len(read('G0 X1 A0 C-0\nG1 X2 A0 F60').blocks) == 2


def test_machine_without_rotary_axes():
    blocks = read('G0 X0\nG1 X1 F60', geometry=ThreeAxes()).blocks
    np.testing.assert_allclose(blocks.axis, [[0, 0, 1]] * 2)
    assert np.isnan(blocks.rotary).all()
    with pytest.raises(ProgramError, match=': A: the machine has no axis A, only X Y Z'):
        read('G0 X0 A10', geometry=ThreeAxes())


def test_blocks_are_read_only_and_end_with_a_stop():
    blocks = read('G0 X0\nG0 X1').blocks
    assert blocks.exact_stop[-1] and not blocks.tip.flags.writeable


def test_a_file_reads_like_its_text(tmp_path):
    text = 'G0 X0\r\nG1 X1 F60\r\nM30\r\n'
    path = tmp_path / 'part.nc'
    path.write_bytes(b'\xef\xbb\xbf' + text.encode())
    program = read_program(path, TableAC(), Settings())
    assert program.dialect == 'gcode' and program.source == str(path)
    np.testing.assert_array_equal(program.blocks.tip, read(text).blocks.tip)
    with pytest.raises(ProgramError, match='cannot be opened'):
        read_program(tmp_path / 'none.nc', TableAC(), Settings())


@pytest.mark.parametrize('rows', [1, 2, 3, 7])
def test_the_batch_size_changes_nothing(rows, monkeypatch):
    random = np.random.default_rng(5)
    lines = ['M428', 'G0 X0 A10 C0']
    for _ in range(60):
        x, c = 4 * random.integers(0, 3), 20 * random.integers(0, 3)
        tilt = random.choice(['', '', '', ' A10', ' A-3'])
        lines.append(f'G1 X{x} C{c}{tilt} F{random.integers(1, 9)}')
        if random.random() < 0.2:
            lines.append(random.choice(['M0', 'G61', 'G64', 'ORIVECT', 'ORIAXES', 'G4 P1']))
    whole = read('\n'.join(lines)).blocks
    assert {POSES, ROTARY_LINEAR} == set(whole.interpolation)
    same_in_batches_of(rows, lines, whole, monkeypatch)


@pytest.mark.parametrize('rows', [1, 3, 7, 10])
def test_the_batch_size_changes_nothing_beside_arcs(rows, monkeypatch):
    random = np.random.default_rng(7)
    lines, x = ['G64 P0.02', 'G0 X0 Y0', 'G1 F600'], 0.0
    for _ in range(12):
        for _ in range(random.integers(0, 25)):
            x += random.choice([0.2, 0.2, 0.2, 30.0])
            lines.append(f'G1 X{x:.1f}')
        x += 2.0
        lines.append(f'{random.choice(["G2", "G3"])} X{x:.1f} I1 J0')
    whole = read('\n'.join(lines)).blocks
    assert len(np.unique(whole.contour_tolerance)) == 2
    same_in_batches_of(rows, lines, whole, monkeypatch)


def same_in_batches_of(rows, lines, whole, monkeypatch):
    monkeypatch.setattr(targets, '_BATCH_ROWS', rows)
    parts = read('\n'.join(lines)).blocks
    for name in whole.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name), name)


NUMBERS = st.integers(-99999, 99999).map(lambda n: n / 1000)


@given(
    points=st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS), min_size=2, max_size=20),
    spaced=st.booleans(),
    incremental=st.booleans(),
)
def test_any_polyline_comes_back(points, spaced, incremental):
    gap, wanted, here = (' ' if spaced else ''), [], (0.0, 0.0, 0.0)
    lines = ['G21 F100', 'G91' if incremental else 'G90']
    for point in points:
        words = np.subtract(point, here) if incremental else point
        if incremental and not wanted:
            wanted.append(here)  # the first way begins where the tool stands
        lines.append('G1' + ''.join(f'{gap}{k}{w:.3f}' for k, w in zip('XYZ', words, strict=True)))
        here = point
        if not wanted or wanted[-1] != point:
            wanted.append(point)
    found = read('\n'.join(lines)).blocks.tip * 1e3
    # Incremental sums may leave 1e-16 where a point repeats, never a block for it.
    np.testing.assert_allclose(found, wanted, atol=1e-9)


@given(st.text(alphabet='GMXYZACFNT0123456789.-+ ()/;%#=\n$,O', max_size=60))
def test_any_text_is_read_or_refused_with_its_lines(text):
    try:
        read('G0 X0\n' + text, AC)
    except ProgramError as error:
        told = str(error).split('\n')[: len(getattr(error, 'errors', [error]))]
        assert all(line.startswith('part.ngc') for line in told)
