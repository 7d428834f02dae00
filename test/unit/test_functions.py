"""Functions of a program: where they act, in plan files, and what the check makes of them."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import yaml

from cnc_interp.core import MachineError, ProgramError
from cnc_interp.core.small_files import config_directory
from cnc_interp.machine_model.machine import Machine, from_mapping
from cnc_interp.machine_model.machine_entries import Standstill
from cnc_interp.machine_model.signals import signals
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.program.blocks.functions import Functions
from cnc_interp.program.job import JobSetup
from cnc_interp.program.notices import warnings_of
from cnc_interp.program.reading import ProgramStream
from cnc_interp.program.text.source import Source
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.proof.program_again import compare_with_text
from cnc_interp.proof.verify import verify
from cnc_interp.run.planning_chain import plan_to_files
from cnc_interp.settings.options import Settings

MACHINE = replace(Machine.load('xyz'), signals=signals({'signals': 'milling'}))
PROGRAM = """G21 G90 G17
T5 M6
S8000 M3
G0 X0 Y0 Z50
M8
G1 Z0 F1000
S9000
X60 M9
M5 X70
M0
M3
X80 Y10
X90
M30
"""


def functions_of(
    text: str, machine: Machine = MACHINE, settings: Settings | None = None
) -> tuple[list[tuple[int, str]], ProgramStream]:
    """Return block and output of each function, and the program."""
    source = Source.of_text(text, 'part.ngc')
    stream = ProgramStream(source, Transform.of(machine), settings or Settings())
    lines = np.concatenate([part.line_number for part in stream])
    found = stream.functions
    assert (found.block <= len(lines)).all()
    told = zip(found.block, found.step, found.value, strict=True)
    return [
        (int(b), machine.signals.text(machine.signals.steps[k].output, v)) for b, k, v in told
    ], stream


def test_functions_act_before_or_after_the_motion_of_their_block() -> None:
    found, stream = functions_of(PROGRAM)
    outputs = [(block, text) for block, text in found if 'tool' not in text]
    assert outputs[2:] == [
        (0, 'spindle_speed 8000 rev/min'),
        (0, 'spindle_reverse off'),
        (0, 'spindle_forward on'),
        (1, 'coolant_flood on'),
        (2, 'spindle_speed 9000 rev/min'),
        (3, 'coolant_mist off'),
        (3, 'coolant_flood off'),
        (4, 'spindle_forward off'),
        (4, 'spindle_reverse off'),
        (4, 'spindle_reverse off'),
        (4, 'spindle_forward on'),
        *[
            (6, f'{name} off')
            for name in ('spindle_forward', 'spindle_reverse', 'coolant_mist', 'coolant_flood')
        ],
    ]
    # M5 acts before M0 waits, M3 after it.
    at_stop = stream.functions.before_stop[stream.functions.block == 4]
    assert at_stop.tolist() == [True, True, False, False]
    assert [notice[:11] for notice in stream.notices] == ['line 10: M0']


def test_a_machine_without_outputs_tells_what_it_needs_by_hand() -> None:
    found, stream = functions_of(PROGRAM, Machine.load('xyz'))
    assert found == [(0, 'tool 5')]
    warnings = warnings_of(stream.notices)
    for word, name in (('M3', 'spindle'), ('M8', 'coolant')):
        assert any(f'{word}: WARNING: the {name} is NOT' in warning for warning in warnings)


@pytest.mark.parametrize(
    ('words', 'changes'),
    [
        ('T5 M6', [(2, 5)]),
        ('T5\nX2\nM6', [(3, 5)]),
        ('T3 M6', []),  # which is in the spindle
        ('T5 M6\nX2\nT3 M6', [(2, 5), (3, 3)]),
        ('T5 M6 T3\nX2\nM6\nT3 M6', [(2, 5), (3, 3)]),
        ('T0 M6', [(2, 0)]),
        ('M61 Q5\nT5 M6', []),  # Q5 is in the spindle: there was no change
    ],
)
def test_m6_without_a_tool_changer_waits_for_another_tool(tmp_path, words, changes) -> None:
    text = f'G0 X0 Y0 Z0\nG1 X1 F1000\n{words}\nX9\nX8\nM30\n'
    machine, settings = Machine.load('vmc'), Settings()
    milling = dict(yaml.safe_load((config_directory() / 'signals/milling.yaml').read_text()))
    milling['functions'] = {k: v for k, v in milling['functions'].items() if k != 'M6'}
    machine = replace(machine, signals=signals({'signals': milling}))
    step = machine.signals.steps[machine.signals.words['M6'][-1]]
    assert step.rests and machine.signals.is_change(step)
    setup = JobSetup(tool=3)
    stream = ProgramStream(Source.of_text(text, 'p.ngc'), Transform.of(machine), settings, setup)
    plan_to_files(stream, machine, tmp_path)
    found = stream.functions
    waits = found.step == machine.signals.words['M6'][-1]
    assert [*zip(found.block[waits], found.value[waits], strict=True)] == changes
    # The spindle stops before anybody reaches for the tool.
    names = {machine.signals.outputs[machine.signals.steps[k].output].name for k in found.step}
    assert ('spindle_forward' in names) >= bool(changes)
    # It rests where its line ends, and the second reader wants the same changes.
    plan = read_plan(tmp_path)
    assert all(plan.blocks['exact_stop'][block - 1] for block, _ in changes)
    if 'M61' in words or 'M6 T3' in words:
        return  # which that reader does not know
    program = tmp_path / 'p.ngc'
    program.write_text(text)
    assert not compare_with_text(plan, machine, program).faults
    program.write_text(text.replace('X9\n', 'T7 M6\nX9\n'))
    assert any('M6 is due' in fault for fault in compare_with_text(plan, machine, program).faults)


@pytest.mark.parametrize(
    ('between', 'block'),
    [
        ('M8\nX10\nM9', 2),  # X10 again moves nothing: M8 waits for the next motion
        ('G1 X10 Y5\nM8', 3),
        ('G41.1 D2\nM8\nX10 Y20\nG40', 2),
    ],
)
def test_a_function_stays_between_its_motions(between: str, block: int) -> None:
    found, _ = functions_of(f'G0 X0 Y0 Z0\nG1 X10 F1000\n{between}\nX20 Y20\nM2')
    assert (block, 'coolant_flood on') in found


def test_a_function_at_a_rounded_corner_acts_after_it() -> None:
    text = 'G0 X0 Y0 Z0\nG1 X10 F1000 RND=2\nM8\nY10\nM2'
    found, _ = functions_of(text)
    block = next(block for block, name in found if name == 'coolant_flood on')
    tip = read_text(text, 'p.ngc', Transform.of(MACHINE), Settings()).blocks.tip
    assert tip[block - 1] == pytest.approx([0.01, 0.002, 0.0])


@pytest.mark.parametrize('word', ['M3', 'M6'])
def test_the_path_rests_where_a_function_waits(word: str) -> None:
    text = f'G0 X0 Y0 Z0\nG1 X10 F1000\n{word}\nX20\nM8\nX30\nM2'
    blocks = read_text(text, 'p.ngc', Transform.of(MACHINE), Settings()).blocks
    assert blocks.exact_stop.tolist() == [False, True, False, True]
    without = read_text(text, 'p.ngc', Transform.of(Machine.load('xyz')), Settings()).blocks
    assert not without.exact_stop[:-1].any()


def test_a_start_inside_keeps_what_still_counts() -> None:
    text = PROGRAM.replace('M0\n', 'T6 M6\nS500 M3\nM7\n')
    found, _ = functions_of(text, settings=Settings(from_line=15))
    before = [name for block, name in found if block == 0]
    assert 'tool_number 6' in before and 'tool_number 5' not in before
    assert 'coolant_mist on' in before
    assert before.count('spindle_forward on') == 1 and 'coolant_flood on' not in before
    assert before.index('tool_change on') < before.index('spindle_forward on')
    assert 'spindle_speed 500 rev/min' in before and 'spindle_speed 9000 rev/min' not in before


def test_a_speed_that_was_changed_later_is_set_before_the_spindle_starts() -> None:
    text = 'T5 M6\nS8000 M3\nG0 X0 Y0\nG1 X1 F100\nS9000 X2\nX3\nM3 T6 M6\nM3\nX4\nX5\nM30'
    found, _ = functions_of(text, settings=Settings(from_line=6))
    before = [name for block, name in found if block == 0]
    assert before.index('spindle_speed 9000 rev/min') < before.index('spindle_forward on')
    found, _ = functions_of(text, settings=Settings(from_line=10))
    before = [name for block, name in found if block == 0]
    assert before.index('tool_number 6') < before.index('spindle_forward on')
    assert before[-1] == 'spindle_forward on' and 'tool_number 5' not in before


@pytest.mark.parametrize(
    ('name', 'word', 'seconds'),
    [
        ('p.ngc', 'P0.5', 0.5),
        ('p.ngc', 'P2', 2.0),
        ('p.nc', 'X1.5', 1.5),
        ('p.nc', 'P2.5', 2.5),
        ('p.nc', 'P500', 0.0),
        ('fanuc.nc', 'P500', 0.5),
        ('fanuc.nc', 'U2.', 2.0),
        ('p.mpf', 'F3', 3.0),
        ('p.mpf', 'S30', 2.0),
        ('p.nc', '', 0.0),
    ],
)
def test_a_dwell_is_a_function_of_its_time(name: str, word: str, seconds: float) -> None:
    dialect = 'fanuc' if name.startswith('fanuc') else None
    text = f'S900 M3\nG0 X0 Y0 Z0\nG1 X5 F1000\nG4 {word}\nX9\nM2'
    settings = Settings(dialect=dialect) if dialect else Settings()
    source = Source.of_text(text, name)
    stream = ProgramStream(source, Transform.of(MACHINE), settings)
    blocks = stream.read().blocks
    found, steps = stream.functions, MACHINE.signals.steps
    (k,) = [k for k, step in enumerate(found.step.tolist()) if steps[step].word == 'G4']
    assert (found.block[k], found.value[k]) == (2, seconds) and blocks.exact_stop[1]
    assert 'spindle_speed' not in [
        MACHINE.signals.outputs[steps[s].output].name for s in found.step[found.block == 2]
    ]
    told = any('its time is not kept' in notice for notice in stream.notices)
    assert told is (word == 'P500' and not dialect)
    rests = found.standstill(MACHINE.signals, Standstill())
    assert rests[k] == seconds


@pytest.mark.parametrize(
    ('name', 'cycle', 'seconds'),
    [
        ('p.ngc', 'G98 G82 X5 Z-2 R1 P0.5 F900', 0.5),
        ('p.ngc', 'G98 G81 X5 Z-2 R1 F900', 0.0),
        ('fanuc.nc', 'O1234\nG0\nG89 X5 Z-2 R1 P500 F900', 0.5),
        ('p.nc', 'G82 X5 Z-2 R1 P500 F900', None),
        ('p.nc', 'G82 X5 Z-2 R1 P1.5 F900', 1.5),
        ('p.mpf', 'F900\nCYCLE82(5,0,1,-2,,0.7)', 0.7),
        ('p.mpf', 'F900\nCYCLE85(5,0,1,-2,,-30,90,90)', 2.0),
        ('p.mpf', 'F900\nCYCLE83(5,0,1,-2,,-1,,0,0.4)', 0.4),
        ('p.mpf', 'F900\nCYCLE83(5,0,1,-2,,-1)', 0.0),
        (
            'p.h',
            'CYCL DEF 200\nQ200=1\nQ201=-2\nQ206=900\nQ202=5\nQ203=0\nQ204=5\nQ211=0.3\n'
            'L X+5 FMAX M99',
            0.3,
        ),
        ('p.apt', 'CYCLE/DRILL,FEDTO,2,MMPM,900,RAPTO,1,DWELL,0.6\nGOTO/5,0,0\nCYCLE/OFF', 0.6),
        ('p.apt', 'FEDRAT/900\nGOTO/5,0,-2\nDELAY/0.8', 0.8),
    ],
)
def test_a_cycle_rests_at_the_bottom_for_its_dwell(
    name: str, cycle: str, seconds: float | None
) -> None:
    begin = {
        'h': 'BEGIN PGM P MM\nTOOL CALL 1 Z S900\nL X+0 Y+0 Z+9 R0 FMAX\n',
        'apt': 'UNITS/MM\nRAPID\nGOTO/0,0,9\n',
    }
    end = {'h': '\nL X+9 R0 FMAX\nEND PGM P MM', 'apt': '\nRAPID\nGOTO/9,0,9\nFINI'}
    kind = name.split('.')[-1]
    text = begin.get(kind, 'S900 M3\nG0 X0 Y0 Z9\n') + cycle + end.get(kind, '\nG80\nG0 X9\nM2')
    stream = ProgramStream(Source.of_text(text, name), Transform.of(MACHINE), Settings())
    blocks, found = stream.read().blocks, stream.functions
    rests = found.standstill(MACHINE.signals, Standstill())
    words = [MACHINE.signals.steps[step].word for step in found.step.tolist()]
    dwells = [k for k, word in enumerate(words) if word == 'G4']
    assert len(dwells) == bool(seconds)
    for k in dwells:
        before = found.block[k] - 1
        assert rests[k] == pytest.approx(seconds) and blocks.exact_stop[before]
        assert blocks.tip[before, 2] == pytest.approx(-2e-3)
    told = any('time is not kept' in notice for notice in stream.notices)
    assert told is (seconds is None)


def test_a_dwell_of_heidenhain_rests_for_its_time() -> None:
    text = (
        'BEGIN PGM P MM\nL X+0 Y+0 Z+0 R0 FMAX\nL X+5 F1000\nCYCL DEF 9.0 DWELL\n'
        'CYCL DEF 9.1 DWELL 1.5\nL X+9\nEND PGM P MM\n'
    )
    source = Source.of_text(text, 'p.h')
    stream = ProgramStream(source, Transform.of(MACHINE), Settings())
    blocks, found = stream.read().blocks, stream.functions
    assert blocks.exact_stop[1] and (found.block[0], found.value[0]) == (2, 1.5)
    assert MACHINE.signals.steps[found.step[0]].word == 'G4'


def test_what_a_subprogram_restores_is_switched_again() -> None:
    text = (
        'O1 sub\nM73\nM9 S700\nM4\nM7\nG1 X10\nO1 endsub\n'
        'S900 M3 M8\nG0 X0 Y0 Z0\nG1 X5 F1000\nO1 call\nX20\nO1 call\nX30\nM2'
    )
    found, _ = functions_of(text)
    begun, restored = (
        [k for k, (_, name) in enumerate(found) if name == f'spindle_{way} on']
        for way in ('reverse', 'forward')
    )
    back = [name for _, name in found[begun[0] : restored[1] + 4]]
    assert len(begun) == 2 and len(restored) == 3
    assert back == [
        'spindle_reverse on',
        'coolant_mist on',
        'spindle_speed 900 rev/min',
        'spindle_reverse off',
        'spindle_forward on',
        'coolant_mist off',
        'coolant_flood off',
        'coolant_flood on',
    ]


def test_cl_data_switch_the_same() -> None:
    text = (
        'LOADTL/3\nSPINDL/8000,CLW\nCOOLNT/MIST\nFEDRAT/100,MMPM\nGOTO/0,0,0\nGOTO/10,0,0\n'
        'COOLNT/OFF\nSPINDL/OFF\nFINI'
    )
    found, stream = functions_of(text)
    names = [name for _, name in found]
    assert stream.dialect == 'cl' and not stream.notices
    assert 'tool_number 3' in names and 'spindle_speed 8000 rev/min' in names
    assert (0, 'coolant_mist on') in found and (2, 'spindle_forward off') in found


@pytest.mark.parametrize(
    ('line', 'told'),
    [
        ('S70000 M3', 'spindle_speed 70000 is outside 0 ... 60000 rev/min'),
        ('M6 T100000', 'tool_number 100000 is outside'),
    ],
)
def test_a_value_beyond_its_range_is_refused(line: str, told: str) -> None:
    with pytest.raises(ProgramError, match=told):
        functions_of(f'G0 X0\n{line}\nG1 X1 F100\nM2')


def test_an_own_word_takes_values_of_its_block() -> None:
    own = signals(
        {
            'signals': {
                'outputs': {'clamp': {'range': [0, 10]}},
                'functions': {'M100': {'clamp': 'P'}},
            }
        }
    )
    found, _ = functions_of('G0 X0\nM100 P7\nG1 X1 F100\nM2', replace(MACHINE, signals=own))
    assert found == [(1, 'clamp 7')]
    with pytest.raises(ProgramError, match='clamp cannot be nan'):
        functions_of('G0 X0\nM100\nG1 X1 F100\nM2', replace(MACHINE, signals=own))


@pytest.mark.parametrize(
    ('changed', 'told'),
    [
        ({'functions': {'M8': {'flood': 1}}}, 'signals.functions.M8: each step sets one output'),
        ({'functions': {'M08': {'a': 1}}}, 'write an M code'),
        ({'functions': {'M0': {'a': 1}}}, 'write an M code'),
        ({'functions': {'M8': {'a': 2}}}, 'a is on or off, not 2'),
        ({'functions': {'M8': {'a': float('nan')}}}, 'write a number'),
        ({'functions': {'M8': {'a': 1, 'wait_for': 'x'}}}, 'must name an input: i; or operator'),
        ({'functions': {'M8': {'a': 1, 'limit_s': 3}}}, 'belongs to wait_for'),
        ({'functions': {'M8': {'a': 1, 'wait_for': 'i', 'limit_s': -1}}}, 'must be a time in s'),
        ({'functions': {'fault': {'a': 'S'}}}, 'write a number'),
        ({'functions': {'fault': {'a': 0, 'wait_for': 'i'}}}, 'a stop cannot wait'),
        ({'functions': {'lost_machine': {'a': 0}}}, 'write an M code'),
        (
            {'functions': {'M6': [{'a': 1, 'wait_for': 'i'}, {'a': 0, 'wait_for': 'not i'}]}},
            'would accept an old answer of i; begin with {a: 0, wait_for: not i}',
        ),
        ({'switched_off': {'b': 'always'}}, 'switched_off.b: must name outputs'),
        ({'switched_off': {}}, 'switched_off.a: is missing: write always, never .as for a clamp'),
        ({'switched_off': {'a': ['crash']}}, 'switched_off.a: must be always, never, or a list'),
        (
            {'outputs': {'a': {'range': [1, 2]}}, 'switched_off': {'a': 'always'}},
            'a 0 is outside 1 ... 2',
        ),
        ({'interlocks': {'b': 'i'}}, 'interlocks.b: must name an output'),
        ({'interlocks': {'a': 'not a'}}, 'interlocks.a: must list what holds while it is on: i'),
        ({'interlocks': {'a': 'spindle_turning'}}, 'must list what holds while it is on: i'),
        ({'after': ['M8']}, 'must list words'),
        ({'inputs': {'i': {'follows': 'x'}}}, 'must name outputs'),
        ({'outputs': {'a': {'range': [1, 0]}}}, 'must be .lowest, highest.'),
        ('drilling', "no signals 'drilling'; choose milling"),
    ],
)
def test_a_machine_file_that_cannot_be_meant_is_refused(changed: object, told: str) -> None:
    given = changed
    if isinstance(changed, dict):
        rows = {'outputs': {'a': None}, 'inputs': {'i': None}, 'switched_off': {'a': 'always'}}
        given = {**rows, **changed}
    limits = {'velocity_m_per_min': 30.0, 'acceleration_m_per_s2': 3.0, 'jerk_m_per_s3': 30.0}
    with pytest.raises(MachineError, match=told):
        from_mapping({'limits': dict.fromkeys('XYZ', limits), 'signals': given})


def test_the_check_proves_every_function_and_finds_a_wrong_one(tmp_path) -> None:
    text = PROGRAM.replace('S9000\n', 'S9000\nG4 P1\n')
    source = Source.of_text(text, 'part.ngc')
    stream = ProgramStream(source, Transform.of(MACHINE), Settings())
    plan_to_files(stream, MACHINE, tmp_path)
    summary = json.loads((tmp_path / 'summary.json').read_text())
    assert summary['functions'] == {
        'G4': 1,
        'M6': 1,
        'S': 2,
        'M3': 2,
        'M8': 1,
        'M9': 1,
        'M5': 1,
        'M30': 1,
    }
    plan = read_plan(tmp_path)
    assert verify(plan, MACHINE).ok
    for other, faults in ((text, 0), (text.replace('S9000', 'S9001'), 1)):
        (tmp_path / 'part.ngc').write_text(other)
        assert len(compare_with_text(plan, MACHINE, tmp_path / 'part.ngc').faults) == faults
    blocks, sample = plan.block, plan.functions['sample']
    m8 = MACHINE.signals.words['M8'].start
    at = int(np.argmax(sample > 0))
    assert blocks[sample[at]] == plan.functions['block'][at] > blocks[sample[at] - 1]
    for changed, told in (
        ({'sample': sample + (np.arange(len(sample)) == at)}, 'was executed after the beginning'),
        ({'sample': sample - (np.arange(len(sample)) == at)}, 'was executed before its block'),
        ({'sample': np.where(np.arange(len(sample)) == at, -1, sample)}, 'was not executed'),
        ({'block': plan.functions['block'][::-1]}, 'is not in the order of the blocks'),
        ({'step': plan.functions['step'] + 100}, 'names steps that the machine does not have'),
        (
            {'step': np.where(plan.functions['step'] == m8, m8 - 1, plan.functions['step'])},
            'summary.json says functions',
        ),
    ):
        proof = verify(replace(plan, functions={**plan.functions, **changed}), MACHINE)
        assert any(told in failure for failure in proof.failures), told


def test_an_override_counts_for_the_rows_that_follow_it(tmp_path) -> None:
    """M49 takes the feed override away; the spindle override counts with G95 only."""
    words = ('F600', 'M49', 'M48 G95 F0.6', 'G94 F600')
    lines = [f'{word} X{10 + 10 * k}' for k, word in enumerate(words)]
    source = Source.of_text('\n'.join(['M3 S1000', 'G1 X0 F600', *lines, 'M30']), 'part.ngc')
    machine = Machine.load('vmc')
    stream = ProgramStream(source, Transform.of(machine), Settings())
    plan_to_files(stream, machine, tmp_path)
    plan = replace(read_plan(tmp_path), path={})
    rows = np.flatnonzero(plan.blocks['line'] > 2)

    def allowed(overrides: list[float]) -> list[bool]:
        """Tell for which rows a motion that is 1.2 times too fast is allowed."""
        summary = {**plan.summary, 'overrides': [overrides]}
        feeds = (np.where(np.arange(rows[-1] + 1) == row, 1 / 1.2, 1.0) for row in rows)
        slower = ({**plan.blocks, 'feed': plan.blocks['feed'] * share} for share in feeds)
        return [verify(replace(plan, blocks=b, summary=summary), machine).ok for b in slower]

    assert allowed([0, 1.0, 1.0]) == [False, False, False, False]
    assert allowed([0, 1.2, 1.0]) == [True, False, True, True]
    assert allowed([0, 1.0, 1.2]) == [False, False, True, False]
    assert allowed([0, 1.2, 1.2]) == [True, False, True, True]


def test_functions_do_not_change_the_motion(tmp_path) -> None:
    text = 'G0 X0 Y0 Z0\n' + ''.join(
        f'S{1000 + k} G1 X{k} Y{k % 3} F2000 M8\n' for k in range(1, 40)
    )
    plain = text.replace(' M8', '')
    plain = re.sub(r'S\d+ ', '', plain)
    for name, program in (('with', text), ('without', plain)):
        stream = ProgramStream(
            Source.of_text(program + 'M2', 'p.ngc'), Transform.of(MACHINE), Settings()
        )
        plan_to_files(stream, MACHINE, tmp_path / name)
    a, b = (np.load(tmp_path / name / 'setpoints.npz') for name in ('with', 'without'))
    assert all(np.array_equal(a[name], b[name]) for name in a.files)
    assert len(np.load(tmp_path / 'with' / 'functions.npz')['block']) == 39 * 2 + 4
    assert set(Machine.load('xyz').signals.words) == {'M6'} and len(Functions.none()) == 0


def test_tool_changes_and_the_spindle_take_the_times_of_the_machine_file() -> None:
    text = 'T1 M6\nS6000 M3\nG1 X1 F100\nS9000\nX2\nT2 M6\nM3\nX3\nS3000\nM5\nX4\nM30\n'
    stream = ProgramStream(Source.of_text(text, 'p.ngc'), Transform.of(MACHINE), Settings())
    for _ in stream:
        pass
    rests = stream.functions.standstill(MACHINE.signals, Standstill(5.0, 1e-6, 2e-6))
    by_line = np.bincount(stream.functions.line_number, rests, 13)
    # Up to 6000 and 9000, down for the change, up to 9000, down to 3000 and to rest: by squares.
    assert by_line[[1, 2, 4, 6, 7, 9, 10]] == pytest.approx([5, 36, 45, 167, 81, 144, 18])
    assert by_line.sum() == pytest.approx(496.0)


ORIENT = {
    'outputs': {'angle': {'unit': 'deg', 'range': [0, 360]}, 'orient': None},
    'inputs': {'oriented': {'follows': 'orient', 'after_s': 0.2}},
    'switched_off': {'orient': 'always'},
    'functions': {'M19': [{'angle': 'R'}, {'orient': 1, 'wait_for': 'oriented', 'limit_s': 20}]},
}


def test_m19_orients_the_spindle_to_the_angle_r(tmp_path) -> None:
    machine = replace(Machine.load('xyz'), signals=signals({'signals': ORIENT}))
    text = 'G21 G90 F1000\nG0 X0 Y0 Z0\nG1 X10\nM19 R90.5\nX20\nM19\nX30\nM30\n'
    found, _ = functions_of(text, machine)
    assert found == [
        (2, 'angle 90.5 deg'),
        (2, 'orient on'),
        (3, 'angle 0 deg'),
        (3, 'orient on'),
    ]
    plan_to_files(
        ProgramStream(Source.of_text(text, 'part.ngc'), Transform.of(machine), Settings()),
        machine,
        tmp_path / 'out',
        Settings(),
    )
    plan, part = read_plan(tmp_path / 'out'), tmp_path / 'part.ngc'
    assert plan.blocks['exact_stop'][[1, 2]].all()  # the path rests while the spindle turns
    part.write_text(text, encoding='utf-8')
    assert compare_with_text(plan, machine, part).faults == ()
    part.write_text(text.replace('R90.5', 'R91'), encoding='utf-8')
    assert 'M19' in compare_with_text(plan, machine, part).faults[0]
    with pytest.raises(ProgramError, match='angle 400 is outside'):
        functions_of(text.replace('R90.5', 'R400'), machine)


def test_m19_without_a_function_moves_nothing_and_takes_its_words() -> None:
    found, _ = functions_of('G0 X0 Y0\nM19 R90 P1 Q5\nG0 X10\n', Machine.load('xyz'))
    assert found == []
