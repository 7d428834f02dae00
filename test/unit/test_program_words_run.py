"""One small program for every word that moves: read, planned, and proven by what the axes do."""

from math import pi

import pytest
from whole_plans import plan_program, write_plan

from cnc_interp.core import DEG, MM
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import JobSetup, Tool, read_text
from cnc_interp.proof.verify import verify_plan
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.segments import SPLINE

MACHINE = Machine.load('xyzac')
SETUP = JobSetup(
    work_offsets={'G54': {'X': 10 * MM}, 'G55': {'X': 20 * MM, 'Y': 5 * MM, 'C': pi / 2}},
    tools={1: Tool(75 * MM), 2: Tool(50 * MM)},
    reference_points={'G28': {'Z': 200 * MM}, 'G30': {'X': 100 * MM}},
)
HEAD = 'G21 G90 G0 X0 Y0 Z0\nF1200\n'
#: Lines, and whether the setup is needed.
PROGRAMS = {
    'arcs': ('G2 X10 Y10 I10 J0\nG3 X0 Y0 I0 J-10\nG2 X10 R-8', False),
    'full circle, helix': ('G2 I5\nG3 I5 Z-4 P2', False),
    'planes': ('G18 G2 X10 Z0 I5 K0\nG19 G3 Y10 Z0 J5 K0', False),
    'incremental arc': ('G91 G2 X10 Y10 I10\nG90.1 G90 G3 X0 Y0 I5 J5', False),
    'arc with TCP': ('M128\nG2 X10 Y0 I5 C90', False),
    'arc without TCP': ('G2 X10 Y0 I5 C90', False),
    'work offsets': ('G54\nG1 X1\nG55 X1', True),
    'machine coordinates': ('G54 X1\nG53 G0 X0\nG1 X0', True),
    'shifts': ('G92 X5\nG1 X6\nG92.1 X6\nG52 X2\nX6\nG52 X0\nX6', False),
    'G10': ('G10 L2 P1 X3\nG54 G1 X0\nG10 L20 P1 X7\nG1 X8', True),
    'tool length': ('T1 M6\nG43\nG1 Z1\nG43 H2 Z1\nG49 Z1', True),
    'reference points': ('G28 Z5\nG1 X1\nG91 G28 Z0\nG90 G30\nG1 X0 Z0', True),
    'dwell and stops': ('G1 X1\nG4 P0.5\nX2\nM0\nX3\nM1\nG9 X4\nG61 X5\nY1\nG64 Y0', False),
    'cycles': (
        'G98 G81 X1 Y1 Z-5 R2\nX2\nG99 G82 X3 Z-5 R2 P1\nG83 X4 Z-5 R2 Q2\nG73 X5 Z-5 R2 Q2\n'
        'G85 X6 Z-3 R1\nG80\nG91 G81 X1 Z-5 R2 L2\nG80',
        False,
    ),
    'subprograms': (
        'M98 P100 L2\nG1 X9\no10 call [3] [4]\nG65 P200 A5\nM30\nO100\nG91 G1 X1\nG90\nM99\n'
        'O200\nG1 X#1\nM99\no10 sub\nG1 X#1 Y#2\no10 endsub',
        False,
    ),
    'loops': (
        '#1=0\nWHILE [#1 LT 3] DO1\n#1=[#1+1]\nG1 X#1\nEND1\nIF [#1 EQ 3] GOTO 50\nG1 X99\n'
        'N50 G1 X[#1*2] Y[SIN[30]]',
        False,
    ),
    'TCP': ('G43.4 H0\nG1 X10 A10 C20\nG49\nG1 X12\nM128\nX8 A8\nM129', False),
    'directions': (
        'TRAORI\nORIWKS\nORIVECT\nG1 X10 A3=0 B3=0.1 C3=1\nX20 A3=0.05 B3=0.1 C3=1\nORIAXES\nX25 '
        'A12 C20\nTRAFOOF\nG43.5\nX20 I0.1 J0.1 K1',
        False,
    ),
    'tolerances': ('G64 P0.05 Q0.01\nG1 X1\nY1\nG642\nCTOL=0.03\nX2\nOTOL=0.5\nY2', False),
    'feeds': ('G93 G1 X1 F60\nX2 F30\nG94 X3 F600\nG95 S1000 F0.5 Y2', False),
    'CL data': (
        'UNITS/MM\nMULTAX/ON\nFROM/0,0,10\nRAPID\nGOTO/0,0,0\nFEDRAT/500,MMPM\nGOTO/10,0,0,0,.6,.8\n'
        'TLAXIS/0,0.1,0.995\nGOTO/20,0,0\nCIRCLE/20,10,0,0,0,1,10\nGOTO/30,10,0\nSTOP\nGODLTA/0,0,5\n'
        'FINI',
        False,
    ),
}


@pytest.mark.parametrize('name', PROGRAMS)
def test_it_runs_and_is_proven(name, tmp_path):
    lines, set_up = PROGRAMS[name]
    text = lines if name == 'CL data' else f'{HEAD}{lines}\nM30\n'
    setup = SETUP if set_up else None
    program = read_text(text, 'part.ngc', Transform.of(MACHINE), Settings(), setup)
    write_plan(plan_program(program, MACHINE), tmp_path)
    proof = verify_plan(tmp_path, MACHINE)
    assert proof.ok, proof.failures


def test_a_curve_begins_in_the_turn_that_the_start_pose_names(tmp_path):
    dense = [f'G1 X{0.4 * k:g} Y{0.01 * k * k:g} A{12 + k / 10:g} C{k - 250}' for k in range(40)]
    text = '\n'.join(['TRAORI', 'G0 X0 Y0 Z0 A12 C-250', 'F3000', *dense, 'M30'])
    program = read_text(text, 'part.ngc', Transform.of(MACHINE), Settings())
    plan = plan_program(program, MACHINE)
    assert (plan.segments.kind == SPLINE).sum() > 0.8 * len(plan.segments)
    assert plan.setpoints.position[0, 4] == pytest.approx(-250 * DEG)
    write_plan(plan, tmp_path)
    proof = verify_plan(tmp_path, MACHINE)
    assert proof.ok, proof.failures
