"""Programs read by LinuxCNC's interpreter and by ours (tools/get_rs274 fetches it)."""

import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from linuxcnc_oracle import PROGRAMS, columns_of, judged, motions_of

from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import open_program, read_program
from cnc_interp.proof.compared_moves import RowsByPlace
from cnc_interp.proof.linuxcnc_reader import LinuxCNCError, interpreter, read_by_linuxcnc
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.proof.program_again import compare_with_text
from cnc_interp.run.planning_chain import plan_to_files
from cnc_interp.settings.options import Settings

if not interpreter():
    pytest.skip('no rs274: run tools/get_rs274, set RS274', allow_module_level=True)

sys.path.append(str(Path(__file__).parents[2] / 'benchmarks'))
import linuxcnc_words

SHARED = Path(__file__).parents[3] / 'shared' / 'programs'
#: How many motions are compared at least.
MOTIONS = {
    'camotics-heart': 160,
    'cnclite-blend-mpf': 3200,
    'fanuc-test-g91': 130,
    'linuxcnc-cds': 260,
    'linuxcnc-impeller-xyzac': 4400,
    'linuxcnc-stellabee': 169000,
    'mach-pulley-r-arcs': 43000,
    'nist-box-op5': 3500,
    'opencn-congee-5x': 50,
    'pycam-sample': 33000,
    'qtpyvcp-bezel': 32000,
    'solidcam-4x-rotx': 12000,
    'ugs-gates': 15000,
}
SNIPPETS = {
    'planes': 'G18 G2 X4.5 Z0 I2 K0\nG19 G3 Y2 Z0 J1 K0\nG17 G2 X1 Y2 R5\nG3 X3 Y4 R-6',
    'helices': 'G2 X0.5 Y0 I5 Z3\nG3 I5 J2 Z-3 P3\nG18 G3 X4.5 Z-3 I2 K0 Y5 P2',
    'inch': 'G20\nG1 X0.5 F10\nG2 X0.6 Y0.1 I0.1\nG91 G1 X0.25\nG90 G21\nX4 F100',
    'incremental': 'G91 G1 X1 Y1\nX1\nG2 X1 Y1 R1\nG3 X-2 I-1\nG0 Z2',
    'centres': 'G90.1 G2 X3.5 Y0 I2 J0\nG3 X-0.5 Y0 I1.5 J0\nG91.1 G2 X2.5 Y0 I1.5 J0',
    'offsets': 'G10 L2 P1 X5 Y6\nG10 L2 P3 X-1 Z2\nG54 G0 X1\nG56 X1 Z1\nG55 X1\nG54 X0',
    'here': 'G0 X3 Y4\nG10 L20 P1 X0 Y1\nG0 X1\nG92 X5\nX6\nG92.2\nX7\nG92.3\nX8\nG92.1\nX9',
    'turned': (
        'G10 L2 P1 X10 R30\nG1 X10 Y0\nG2 X20 Y0 I5 J0\nG91 G1 X1\nG90 G53 G0 X1 Y1\nG1 X5 Y5\n'
        'G92 X3\nG1 X1\nG10 L20 P1 X5\nG1 X5 Y6\nG10 L2 P2 Y3 R-100\nG55 G1 X1 Y2\n'
        'G54 G1 X3\nG92.1\nG10 L2 P1 Y1 R[#5230+10]\nG1 X#5230 Y1\nG28\nG1 X1 Y2 Z3'
    ),
    'suspended': 'G0 X5 Y5\nG92 X10 Y20\nG92.2\nG92 X1\nG0 X0 Y0\nG92.1\nG92.3\nX1',
    'measured': (
        'G10 L2 P1 Z100\nG10 L2 P9 Z30\nG0 Z5\nG92 Z7\nG43 H2\nG10 L10 P1 Z1\nG43 H1\nG0 Z0\n'
        'G10 L11 P1 Z1\nG43 H1\nG0 Z2\nG10 L1 P1 Z10\nG43 H1\nG0 Z3'
    ),
    'tools': 'T1 M6 G43 G0 Z5\nG43 H2 Z5\nG49 Z5\nG43.1 Z3\nZ5\nG53 G0 Z1\nX2',
    'reference': 'G0 X5 Y5 Z5\nG91 G28 Z1\nG90 G0 X3\nG28\nG0 X1 Y1\nG30 X2',
    'drilling': 'G0 Z5\nG98 G81 X1 Y1 Z-2 R2\nX2\nG99 X3\nX4 Y2\nG80 G0 Z9',
    'drilling by default': 'G0 Z5\nG81 X1 Y1 Z-2 R2\nX2\nG80',
    'drilling by steps': (
        'G0 Z4\nG98 G91 G81 X1 Z-3 R-2 L3\nG90 G80 G0 X0\nG99 G82 X5 Z-1 R2 P1\nX6'
    ),
    'drilling beside': 'G18 G0 Y5\nG98 G81 X1 Z2 Y-2 R3\nX4\nG80 G17\nG0 X9 Y9',
    'boring': 'G0 Z5\nG98 G85 X1 Z-2 R1\nG99 G89 X3 Z-2 R1 P1\nG80',
    'loops': '#1=0\nO1 while [#1 LT 5]\nG1 X[#1*2] Y[SIN[#1*30]]\n#1=[#1+1]\nO1 endwhile',
    'calls': 'O9 sub\nG1 X#1 Y[#2**2]\nO9 return\nO9 endsub\nO9 call [1] [2]\nO9 call [3+1] [1]',
    'choices': '#<a>=2\nO1 if [#<a> GT 1]\nG1 X1\nO1 else\nG1 X2\nO1 endif\nO2 repeat [3]\n'
    'G91 G1 Y1\nO2 endrepeat\nG90\nO3 do\nG1 Z#<a>\n#<a>=[#<a>-1]\nO3 while [#<a> GT 0]',
    'functions': 'G1 X[ATAN[1]/[2]] Y[10 MOD 3] Z[ROUND[1.5]]\nX[FIX[-1.2]] Y[FUP[1.2]] Z[2**3]\n'
    'X[ABS[-3]] Y[SQRT[2]] Z[EXP[1]]\nX[LN[5]] Y[ACOS[0.5]/10] Z[TAN[45]]\nX[1 XOR 0] Y[2 EQ 2]',
    'positions': 'G1 X3 Y4\nX[#5420+1] Y[#5421*2] Z[#5422+1]',
    # Offsets and centres that are printed in inches are known to 0.00254 mm.
    'inch offsets': 'G20\nG10 L2 P1 X0.98426\nG0 X1\nG21\nG91 G1 Y1 F100\nG90 G1 X3',
    'inch turns': 'G0 X0 Y0 Z5\nG20\nG1 X0 F20\nG2 I0.403 J0\nG0 X-0.8585 Y-0.4',
    'kept tolerance': 'G20 G64 P0.01 F9\nG1 X1\nG21\nG98 G81 X2 Z-2 R2\nG80\nG1 X9 F9',
    'steep helix': 'G20 F33\nG91 G1 X0.12345\nG2 I0.35905 J0.00005 Z25.05',
    # LinuxCNC gives no block of inverse time less than 0.1 in/min.
    'short inverse time': 'G20\nG91\nG93 G1 X0.001 F20\nG90 X0.5 F3\nG94 F10\nG21',
    'rotary': 'G0 A10 C20\nG1 X5 A20\nG91 C30\nG90 G1 A0 C0 X0',
}


@pytest.mark.parametrize(
    'name',
    [pytest.param(n, marks=[pytest.mark.thorough] * (MOTIONS[n] > 3_300)) for n in PROGRAMS],
)
def test_public_programs(name):
    if not (SHARED / name).is_dir():
        pytest.skip('the collection of real programs is not at hand')
    path = next(path for path in (SHARED / name).iterdir() if path.name != 'SOURCE')
    machine, partly = PROGRAMS[name]
    agreement = judged(path, machine, partly)
    assert not agreement.faults, agreement.faults[:3]
    assert agreement.motions >= MOTIONS[name]


@pytest.mark.parametrize('name', SNIPPETS)
def test_each_kind_of_word(name, tmp_path):
    path = tmp_path / 'snippet.ngc'
    path.write_text(f'G21 G90 G94\nG0 X0 Y0 Z0\nF100\nG1 X0.5\n{SNIPPETS[name]}\nM2\n')
    machine = 'xyzac' if name == 'rotary' else 'xyz'
    agreement = judged(path, machine, partly=False, tools={1: 10.0, 2: 25.0})
    assert not agreement.faults, agreement.faults[:3]
    assert agreement.motions >= 3


@pytest.mark.parametrize(
    'text',
    [
        'T1 M6 G43\nG20 G49\nG0 Z1',
        'T1 M6\nG43 H2\nT1 M6\nG43\nG0 X1\n',
        'G10 L2 P1 X5\nG0 X[#5221+1]',
        'M61 Q2\nG43\nG0 Z1',
    ],
)
def test_what_rs274_by_itself_gets_wrong_is_not_compared(text, tmp_path):
    path = tmp_path / 'part.ngc'
    path.write_text(f'G21 G90\nG0 X0 Y0 Z10\n{text}\nM2\n')
    with pytest.raises(LinuxCNCError, match=r"LinuxCNC's rs274 (keeps|forgets|has the|by itself)"):
        judged(path, 'xyz', partly=False, tools={1: 10.0, 2: 25.0})


def test_a_reading_leaves_nothing_where_another_one_could_find_it(tmp_path, monkeypatch):
    monkeypatch.setenv('HOME', str(tmp_path))
    assert list(read_by_linuxcnc('T1 M6 G43 G1 X1 F1\n', ('X', 'Y', 'Z'), False, 9))
    assert not list(tmp_path.iterdir())


def test_the_comparison_sees_differences(tmp_path):
    path = tmp_path / 'snippet.ngc'
    path.write_text('G0 X0\nG3 X5 Y5 R5 F100\nG1 X9\nM2\n')
    machine = Machine.load('xyz')
    blocks = read_program(path, Transform.of(machine), Settings()).blocks
    motions = list(motions_of(path, machine, len(blocks)))
    assert not RowsByPlace(columns_of(blocks), machine).follow(motions).faults
    for changed in (
        replace(blocks, tip=blocks.tip + np.where(np.arange(len(blocks)) == 9, 1e-5, 0)[:, None]),
        replace(blocks, feedrate=blocks.feedrate * 1.01),
        replace(blocks, rapid=~blocks.rapid),
        blocks[: len(blocks) - 1],
    ):
        assert RowsByPlace(columns_of(changed), machine).follow(motions).faults


SETUP = """
work_offsets: {G54: {X: 45.5, Z: 150.0}, G56: {X: 12.25, Y: -70.0, C: 15.0}}
active: G56
g92: {Y: 2.5}
tools: {3: {length: 20.75, radius: 5.0}}
tool: 3
"""


@pytest.mark.parametrize('wrong', ['', 'X: 12.25', 'G56\n', 'Y: 2.5', 'length: 20.75', 'C: 15.0'])
def test_a_plan_with_offsets_and_tools_is_compared(wrong, tmp_path):
    program, machine = tmp_path / 'part.ngc', Machine.load('xyzac')
    program.write_text('G21 G90 F1000\nG43\nG0 X0 Y0 Z5 C0\nG1 X4 Y1 Z0\nG54 G1 X3 Z1\nM30\n')
    setup = tmp_path / 'setup.yaml'
    setup.write_text(SETUP)
    settings = Settings(setup=setup)
    stream = open_program(program, Transform.of(machine), settings)
    plan_to_files(stream, machine, tmp_path / 'plan', settings)
    plan = read_plan(tmp_path / 'plan')
    told = plan.summary['setup'].replace(wrong, wrong.replace('5', '4').replace('G46', 'G54'))
    plan = replace(plan, summary={**plan.summary, 'setup': told})
    found = compare_with_text(plan, machine, program)
    assert bool(found.faults) == bool(wrong), found.faults
    assert wrong or found.motions == 3


@pytest.mark.parametrize(
    ('text', 'other'),
    [
        ('G10 L2 P1 X5 Y6 Z-150\nG0 X1 Y1 Z1\nG1 X3 Y2', 'X5.1'),
        ('G0 X1 Y1 Z9\nG53 G0 X30 Y4 Z-100\nG1 X3 Y2', 'Z-100.1'),
        ('G0 X1 Y1 Z5\nG28 Z6\nG1 X3 Y2', 'Z6.1'),
        ('G2 X0 Y0 I12 J0\nG1 X3', 'I12.1'),
        ('G91 G1 X7 Y-3\nG2 X4 Y4 R4', 'X7.1'),
    ],
)
@pytest.mark.parametrize('machine', ['xyz', 'xyzac'])
def test_machine_coordinates_and_a_first_motion_from_where_the_tool_stands(
    text, other, machine, tmp_path
):
    """Right plans were called not proven: LinuxCNC counted from the workpiece zero."""
    program, machine, text = tmp_path / 'part.ngc', Machine.load(machine), f'F900\n{text}\nM2\n'
    settings = Settings(feedrate=0.05)
    for written, compared in ((text, text), (text, text.replace(other[:-2], other))):
        program.write_text(written)
        stream = open_program(program, Transform.of(machine), settings)
        plan_to_files(stream, machine, tmp_path / 'plan', settings)
        program.write_text(compared)
        found = compare_with_text(read_plan(tmp_path / 'plan'), machine, program)
        assert bool(found.faults) == (written != compared), found.faults
        assert 'rs274 to' in found.readers and found.motions >= 1 + (written == compared)


#: The random programs and expressions of a share; the seeds of all shares follow each other.
PROGRAMS_OF_SHARE, EXPRESSIONS_OF_SHARE = 200, 1000


def counted(judged, share, size):
    """Count the outcomes of a share of seeds; name the seed of each difference."""
    counts = Counter()
    for seed, what, told in judged(range(share * size, (share + 1) * size)):
        assert what != linuxcnc_words.DIFFERENT, (seed, told)
        by_us = what.startswith('refused by us')
        counts[what if by_us else what.split(',')[0].split(':')[0]] += 1
    return counts


@pytest.mark.thorough
@pytest.mark.parametrize('share', range(10))
def test_random_programs_are_read_as_linuxcnc_reads_them(share):
    counts = counted(linuxcnc_words.Readers().programs, share, PROGRAMS_OF_SHARE)
    assert counts[linuxcnc_words.ALIKE] >= 0.9 * PROGRAMS_OF_SHARE, counts
    refused = [what for what in counts if what.startswith('refused by us')]
    assert all('LinuxCNC repeats too often' in what for what in refused), counts


@pytest.mark.thorough
@pytest.mark.parametrize('share', range(10))
def test_random_expressions_have_the_values_of_linuxcnc(share):
    counts = counted(linuxcnc_words.Readers().expressions, share, EXPRESSIONS_OF_SHARE)
    assert counts[linuxcnc_words.ALIKE] >= 0.7 * EXPRESSIONS_OF_SHARE, counts
