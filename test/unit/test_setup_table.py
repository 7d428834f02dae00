"""The setup of the machine: its file, changes, the log, and programs that change it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc_interp.core import InterpError, ProgramError
from cnc_interp.core.small_files import LONGEST_YAML
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import JobSetup, Tool, open_program
from cnc_interp.program.blocks.targets import MOST_CHANGES
from cnc_interp.program.job import WORK_OFFSETS, SetupChange
from cnc_interp.program.setup_table import SetupTable
from cnc_interp.settings.options import Settings

AC = Transform.of(Machine.load('xyzac'))
ZERO = np.array([0.04, -0.06985, 0.14])
HEAD = 'G21 G90 F1000\n'


def read(tmp_path, text, setup=None):
    """Blocks of a program, the changes that it makes, and what it uses."""
    file = tmp_path / 'part.ngc'
    file.write_text(HEAD + text)
    stream = open_program(file, AC, Settings(), setup or JobSetup())
    return stream.read().blocks, stream.changes, stream.used


def after(setup, changes):
    for change in changes:
        setup = setup.changed(change.change)
    return setup


mm = st.integers(-(10**6), 10**6).map(lambda n: n * 1e-6)
positions = st.dictionaries(st.sampled_from('XYZABC'), mm, max_size=4)
tools = st.builds(
    Tool, mm, mm.map(abs), st.text(st.characters(categories=('L', 'N', 'P', 'Zs')), max_size=20)
).filter(lambda tool: tool.remark.isprintable())
setups = st.builds(
    JobSetup,
    st.dictionaries(st.sampled_from(WORK_OFFSETS), positions.filter(bool), max_size=3),
    st.dictionaries(st.integers(1, 99), tools, max_size=3),
    st.dictionaries(st.sampled_from(['G28', 'G30']), positions.filter(bool)),
    st.sampled_from(['', *WORK_OFFSETS]),
    positions,
    st.booleans(),
    st.integers(0, 99),
)


@settings(max_examples=30)
@given(setup=setups)
def test_a_setup_is_read_as_it_was_written(setup):
    again = JobSetup.of_text(setup.text())
    assert again.text() == setup.text()
    assert JobSetup.of_text(again.text()) == again
    for name, position in setup.work_offsets.items():
        assert again.work_offsets[name] == pytest.approx(position, abs=1e-11)
    assert again.g92 == pytest.approx(setup.g92, abs=1e-11)
    assert (again.active, again.tool) == (setup.active, setup.tool)
    for number, tool in setup.tools.items():
        assert again.tools[number].remark == tool.remark
        assert again.tools[number].length == pytest.approx(tool.length, abs=1e-14)


def test_a_table_outlives_its_process_and_logs_who_changed_what(tmp_path):
    file = tmp_path / 'setup.yaml'
    table = SetupTable(file)
    told = table.apply([SetupChange('work_offsets', {'X': 0.1234}, 'G54')], 'page 127.0.0.1')
    assert told == 'G54: not set -> X 123.4' and (table.changed_by, table.change) == (
        'page 127.0.0.1',
        told,
    )
    table.apply([SetupChange('tools', Tool(0.0751, 0.005, 'ball'), 3)], 'anna')
    table.apply([SetupChange('tools', None, 3), SetupChange('active', 'G55')], 'anna\n forged')
    assert table.apply([SetupChange('active', 'G55')], 'nobody') == ''
    with pytest.raises(InterpError, match='another program_node'):
        SetupTable(file)
    table.close()
    again = SetupTable(file)
    assert again.setup == table.setup and table.setup.active == 'G55'
    assert table.setup.work_offsets['G54']['X'] == pytest.approx(0.1234, abs=1e-15)
    lines = [line.split('\t') for line in (tmp_path / 'setup.yaml.log').read_text().splitlines()]
    assert [line[1:] for line in lines] == [
        ['page 127.0.0.1', 'G54: not set -> X 123.4'],
        ['anna', 'tool 3: not set -> length 75.1 radius 5 ball'],
        [
            'anna forged',
            'tool 3: length 75.1 radius 5 ball -> not set; active offset: G54 -> G55',
        ],
    ]
    assert sorted(path.name for path in tmp_path.iterdir()) == ['setup.yaml', 'setup.yaml.log']


def test_a_change_that_cannot_be_written_is_none(tmp_path):
    table = SetupTable(tmp_path / 'setup.yaml')
    table.apply([SetupChange('tool', 1)], 'test')
    many = [SetupChange('tools', Tool(remark='x' * 80), n) for n in range(1, LONGEST_YAML // 80)]
    with pytest.raises(InterpError, match='tool table is full'):
        table.apply(many, 'test')
    (tmp_path / '.setup.yaml.new').mkdir()
    with pytest.raises(InterpError, match='cannot be written'):
        table.apply([SetupChange('tool', 2)], 'test')
    assert table.setup == JobSetup.load(tmp_path / 'setup.yaml') == JobSetup(tool=1)


@pytest.mark.parametrize(
    ('text', 'part'),
    [
        ('active: G60', 'active: must be one of G54'),
        ('g92_on: 1', 'g92_on: must be true or false'),
        ('tools: {1: {radius: 2}}', 'tools.1: must have a length'),
        ('tools: {1: {length: 2, radius: -1}}', 'tools.1: the radius must not be below 0'),
        ('tools: {1: {length: 2, remark: "a\\nb"}}', 'tools.1: the remark must be one line'),
        ('tool: x', 'tool.x: the tool number must be a whole number'),
        ('g92: {Q: 1}', 'g92.Q: unknown axis'),
    ],
)
def test_wrong_entries_are_named(tmp_path, text, part):
    file = tmp_path / 'setup.yaml'
    file.write_text(text)
    with pytest.raises(ProgramError, match=part):
        JobSetup.load(file)


def test_what_a_program_changes_is_told_with_its_place(tmp_path):
    text = (
        'G54 G0 X0 Y0 Z0\nG1 X10\nG10 L2 P2 X5 Y6\nG55 G1 X20\nG92 Y1\nG1 X30\nT4 M6\n'
        'G10 L1 P4 Z80 R3\nG28.1\nG1 X0\nM30\n'
    )
    blocks, changes, used = read(tmp_path, text)
    kinds = [(c.change.name, c.line_number, c.block) for c in changes]
    # Row 0 is the start pose, rows 1 to 4 are the four lines that cut.
    assert kinds == [
        ('active offset', 2, 0),
        ('G55', 4, 2),
        ('active offset', 5, 2),
        ('G92', 6, 3),
        ('G92', 6, 3),
        ('spindle', 8, 4),
        ('tool 4', 9, 4),
        ('G28', 10, 4),
        ('active offset', 12, 5),
    ]
    assert len(blocks) == 5 and used == {'G54', 'G55', 'G92'}
    kept = after(JobSetup(), changes)
    assert kept.active == '' and kept.tool == 4 and kept.g92_on
    assert kept.work_offsets['G55'] == {'X': 0.005, 'Y': 0.006}
    assert kept.tools == {4: Tool(0.08, 0.003)}
    # Program Y is 0 in G54: point Y = 0, which G55 reads as 0 - (0.006 - zero); G92 makes it 1.
    assert kept.g92['Y'] == pytest.approx(0.0 - (0.006 - ZERO[1]) - 0.001)
    assert kept.reference_points['G28']['X'] == pytest.approx(0.005 + 0.030)


def test_the_next_program_starts_with_what_this_one_has_left(tmp_path):
    first = 'G0 X0 Y0 Z0\nG1 X7\nG10 L20 P1 X1\nG92 Z5\nM30\n'
    _, changes, _ = read(tmp_path, first)
    blocks, _, used = read(tmp_path, 'G0 X1 Y0 Z5\n', after(JobSetup(), changes))
    np.testing.assert_allclose(blocks.tip[-1], [0.007, 0, 0], atol=1e-15)
    assert used == {'G54', 'G92'}
    left = read(tmp_path, 'G55 G0 X0\nX1', JobSetup({'G55': {'X': 0.1}}))
    assert after(JobSetup(), left[1]).active == 'G55'  # only M2 and M30 lead back to G54


@pytest.mark.parametrize(
    ('text', 'wanted'),
    [
        # What LinuxCNC's rs274 2.9 prints for the same lines.
        ('G0 X5 Y5\nG92 X10 Y20\nG92.2\nG92 X1\nG0 X0 Y0', [4, 0, 0]),
        ('G0 X5 Y5\nG92 X10 Y20\nG92.2\nG92.3\nG0 X0 Y0', [-5, -15, 0]),
        ('G0 X5 Y5\nG92 X10 Y20\nG92.1\nG92.3\nG0 X0 Y0', [0, 0, 0]),
        ('G0 X5 Y5\nG92 X10\nG43 H1\nG10 L20 P1 X1 Z2\nG0 X0 Y0 Z0', [4, 0, -2]),
        ('G10 L1 P1 Z10 R3\nG43 H1\nG0 Z0', [0, 0, 10]),
        ('G0 Z5\nG92 Z7\nG43 H2\nG10 L10 P1 Z1\nG43 H1\nG0 Z0', [0, 0, 4]),
        ('G10 L2 P9 Z110\nG0 Z5\nG92 Z7\nG43 H2\nG10 L11 P1 Z1\nG43 H1\nG0 Z0', [0, 0, 32]),
        ('G10 L2 P1 X45\nG0 X#5221', [50, 0, 0]),
        ('G10 L1 P1 R3\nT1 M6\nG0 X#5410 Y#5400', [6, 1, 0]),
    ],
)
def test_offsets_mean_what_they_mean_in_linuxcnc(tmp_path, text, wanted):
    setup = JobSetup({'G54': dict(zip('XYZ', ZERO, strict=True))}, {1: Tool(0.02), 2: Tool(0.05)})
    blocks, _, _ = read(tmp_path, f'G0 X0 Y0 Z0\n{text}', setup)
    np.testing.assert_allclose(blocks.tip[-1] * 1e3, wanted, atol=1e-9)


@pytest.mark.parametrize(
    ('text', 'part'),
    [
        ('G10 L1 Z1', 'G10 L1 needs P'),
        ('G10 L1 P1 X1', 'G10 L1: a tool has a length'),
        ('G10 L1 P1 R-1', 'R-1: the radius must not be below 0'),
        ('G10 L3 P1', 'only L2 and L20'),
        ('TRAORI\nG10 L10 P1 Z1', 'with tool-tip programming off'),
    ],
)
def test_wrong_g10_is_refused_in_one_line(tmp_path, text, part):
    with pytest.raises(ProgramError, match=part):
        read(tmp_path, f'G0 X0 Y0 Z0\n{text}\n')


@pytest.mark.thorough
def test_many_changes_keep_memory_small_and_the_last_values(tmp_path):
    count = 2 * MOST_CHANGES
    loop = f'#1=0\nWHILE [#1 LT {count}] DO1\n#1=[#1+1]\nG10 L2 P2 X#1\nG1 Y#1\nEND1\n'
    text = f'G0 X0 Y0 Z0\n{loop}'
    blocks, changes, _ = read(tmp_path, text)
    assert len(changes) <= MOST_CHANGES and len(blocks) == count + 1
    assert after(JobSetup(), changes).work_offsets['G55']['X'] == pytest.approx(count * 1e-3)
    last = changes[-1]
    assert last.block == count
    rows = [c.block for c in changes]
    assert rows == sorted(rows)
