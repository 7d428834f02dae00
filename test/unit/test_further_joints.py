"""A rail U under an arm, and a turntable E1 under its part: programs, proof, and refusals."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from cnc_interp.commands.cli import main
from cnc_interp.core import DEG, MM, BlockError, MachineError, ProgramError, TravelError
from cnc_interp.description.urdf import describe_machine
from cnc_interp.kinematics.axis_path import evaluate
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.machine.tool_slide import along_tool
from cnc_interp.machine_model.machine import Machine, arms_directory
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import open_program, read_text
from cnc_interp.program.job import JobSetup
from cnc_interp.program.reading import MdiReader
from cnc_interp.proof.own_chain import OwnChain
from cnc_interp.proof.verify import verify_plan
from cnc_interp.run.path_chain import segments_of
from cnc_interp.run.planning_chain import plan_to_files
from cnc_interp.run.start_place import approach_inside
from cnc_interp.settings.options import Settings

CELL = Machine.load('ur10e_cell')
CHAIN = Transform.of(CELL)
E1, U = (CELL.axis_names.index(name) for name in ('E1', 'U'))
PART = """G21 G90 G94
G43.5
G0 X-60 Y-40 Z20 I0 J0 K1 U100
G1 Z0 F1500
X60 U250
X60 Y40 I0.1 J0 K1
X-60 E1=20
G0 Z30
E1=120 U-200
G1 Z0 F1500
X0 Y0 U-150
U-100
X20 I0 J0 K1
M30
"""


def planned(text, tmp_path, machine=CELL, name='part.ngc', **options):
    file = tmp_path / name
    file.write_text(text)
    settings = Settings(feedrate=0.02, **options)
    stream = open_program(file, Transform.of(machine), settings)
    return plan_to_files(stream, machine, tmp_path / 'out', settings)


def changed(tmp_path, **entries):
    shutil.copytree(arms_directory(), tmp_path, dirs_exist_ok=True)
    file = tmp_path / 'ur10e_cell.yaml'
    kept = [x for x in file.read_text().splitlines() if x.split(':')[0] not in entries]
    file.write_text('\n'.join(kept + [f'{key}: {value}' for key, value in entries.items()]))
    return Machine.load(file)


def test_the_rail_carries_the_arm_and_the_turntable_the_part():
    q = np.random.default_rng(1).uniform(-3.0, 3.0, (200, 8))
    still = q.copy()
    still[:, [E1, U]] = 0.0
    tip, axis = CHAIN.forward(still)
    # As the files have it: the rail runs along Y of the floor, and the turntable about Z through
    # the zero of the part.
    tip[:, 1] += q[:, U]
    c, s = np.cos(q[:, E1]), np.sin(q[:, E1])
    for found, rows in zip(CHAIN.forward(q), (tip, axis), strict=True):
        x, y, z = rows.T
        turned = np.stack([c * x + s * y, c * y - s * x, z], axis=1)
        assert np.abs(found - turned).max() < 1e-12
    for found, own in zip(CHAIN.forward(q), OwnChain.of(CELL).forward(q), strict=True):
        assert np.abs(found - own).max() < 1e-12


def test_a_program_with_a_rail_and_a_turntable_is_proven(tmp_path, capsys):
    planned(PART, tmp_path)
    proof = verify_plan(tmp_path / 'out', CELL)
    assert proof.ok, proof.failures
    columns, blocks = np.load(tmp_path / 'out/setpoints.npz'), np.load(tmp_path / 'out/blocks.npz')
    q, line = columns['position'], blocks['line'][columns['block']]
    for joint, axis in enumerate(CELL.limits.axes):
        for order, name in enumerate(('velocity', 'acceleration', 'jerk'), start=1):
            largest = np.abs(np.diff(q[:, joint], order)).max() / 1e-3**order
            assert largest <= 1.001 * getattr(axis, f'max_{name}')
    tip, axis = OwnChain.of(CELL).forward(q)
    cut = tip[(line == 5) | (line == 6)]  # along X while the rail runs, then along Y
    off = np.minimum(np.abs(cut[:, 1] + 40 * MM), np.abs(cut[:, 0] - 60 * MM))
    assert np.hypot(off, cut[:, 2]).max() < 0.02 * MM
    assert q[line == 5, U].max() - q[line == 5, U].min() > 149 * MM
    feed = np.linalg.norm(np.diff(cut, axis=0), axis=1) / 1e-3
    assert feed.max() == pytest.approx(0.025, rel=1e-3)  # F is the speed on the part
    alone = line == 12
    assert np.ptp(tip[alone], axis=0).max() < 1e-9
    assert np.ptp(q[alone, U]) == pytest.approx(50 * MM, rel=1e-3)
    assert q[-1, [E1, U]] == pytest.approx([120 * DEG, -0.1], abs=1e-9)
    plain = PART.replace('G43.5\n', '').replace(' I0.1 J0 K1', '').replace(' I0 J0 K1', '')
    planned(plain, tmp_path)
    program = str(tmp_path / 'part.ngc')
    assert main(['check', str(tmp_path / 'out'), '--program', program]) == 0
    assert 'agree with the blocks' in capsys.readouterr().out
    (tmp_path / 'part.ngc').write_text(plain.replace('E1=120', 'E1=121'))
    assert main(['check', str(tmp_path / 'out'), '--program', program]) == 1
    assert 'its extra axes are not those of row' in capsys.readouterr().out


def test_derivatives_by_path_length_are_those_of_the_positions():
    program = read_text(PART, 'part.ngc', CHAIN, Settings())
    segments = segments_of(program.blocks, CHAIN, Settings())
    path = AxisPathBuilder(CHAIN, 30 * MM, 1e-3).push(segments)
    tip, axis = OwnChain.of(CELL).forward(path.q)
    assert np.abs(tip - path.tip).max() < 1e-9 and np.abs(axis - path.axis).max() < 1e-9
    long = np.flatnonzero(np.diff(path.s) > 1 * MM)
    s, h = 0.5 * (path.s[long] + path.s[long + 1]), 2e-5
    jets = evaluate(path, s)
    course = np.array([evaluate(path, s + k * h)[0] for k in (-2, -1, 0, 1, 2)])
    slope = (course[0] - 8 * course[1] + 8 * course[3] - course[4]) / (12 * h)
    assert np.abs(slope - jets[1]).max() < 1e-7
    jump = path.cell_right[:3, :-1] - path.cell_left[:3, 1:]
    inside = ~path.stop[1:-1]
    assert np.abs(jump[1][inside]).max() < 1e-8 and np.abs(jump[2][inside]).max() < 1e-4
    moving = np.abs(jets[1][:, [E1, U]]).max(axis=0)
    assert (moving > 0.1).all()


@pytest.mark.parametrize('joint', ['E1', 'U'])
def test_a_further_joint_beside_its_word_is_not_proven(joint, tmp_path):
    planned(PART, tmp_path)
    file = tmp_path / 'out/blocks.npz'
    columns = dict(np.load(file))
    columns['extra_axes'][5, (E1, U).index(CELL.axis_names.index(joint))] += 1e-3
    np.savez(file, **columns)
    assert any(
        f'missed by {joint}' in text for text in verify_plan(tmp_path / 'out', CELL).failures
    )


@pytest.mark.parametrize('spin', ['fixed', 'auto'])
def test_a_part_beyond_the_arm_is_reached_with_the_rail(spin, tmp_path):
    text = 'G21 G90 G94\nG0 X0 Y{0} Z20{1}\nG1 Z0 F1500\nY{0} X50\nM30\n'
    with pytest.raises(BlockError, match='no configuration of ur10e_cell reaches this pose'):
        planned(text.format(1500, ''), tmp_path)
    planned(text.format(1500, ' U1400'), tmp_path, spin=spin)
    proof = verify_plan(tmp_path / 'out', CELL)
    assert proof.ok, proof.failures


def test_programs_without_words_begin_where_the_machine_file_has_the_joints(tmp_path):
    machine = changed(tmp_path, start='{U: 300.0, E1: -45.0}')
    text = 'FEDRAT/1500,MMPM\nGOTO/0,0,20,0,0,1\nGOTO/0,0,0,0.1,0,1\nGOTO/50,0,0,0,0,1\nFINI\n'
    planned(text, tmp_path, machine, 'part.apt', spin='auto')
    proof = verify_plan(tmp_path / 'out', machine)
    assert proof.ok, proof.failures
    q = np.load(tmp_path / 'out/setpoints.npz')['position']
    assert np.abs(q[:, [E1, U]] - [-45 * DEG, 0.3]).max() < 1e-12


@pytest.mark.thorough
def test_a_joint_leads_past_a_singular_pose_while_the_rail_moves(tmp_path):
    machine = changed(tmp_path, tcp='{xyz_mm: [80, 0.0, 130.0], rpy_deg: [0.0, 20.0, 0.0]}')
    chain, seen = Transform.of(machine), []
    for first in chain.branches(np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, 1.0])):
        # J5 turns through 0 while the rail runs, far from where it starts by the machine file.
        turned = zip(np.radians([-30.0, 0.0, 30.0]), (0.7, 0.76, 0.82), strict=True)
        at = np.array([[*first[:4], J5, first[5], 0.0, rail] for J5, rail in turned])
        lines = [
            f'X{x:.6f} Y{y:.6f} Z{z:.6f} I{i:.9f} J{j:.9f} K{k:.9f} U{rail:.6f}'
            for (x, y, z), (i, j, k), rail in zip(
                chain.forward(at)[0] / MM, chain.forward(at)[1], at[:, U] / MM, strict=True
            )
        ]
        home = np.array([*at[0, :U], -0.7])
        begun = replace(machine, arm=replace(machine.arm, home=home, spin=chain.spin_at(home)))
        text = '\n'.join(
            ['G21 G90 G94', 'G43.5', f'G0 {lines[0]}', f'G1 F600 {lines[1]}', lines[2]]
        )
        try:
            planned(text + '\nM30\n', tmp_path, begun)
        except BlockError:
            continue
        proof = verify_plan(tmp_path / 'out', machine)
        assert proof.ok, proof.failures
        q = np.load(tmp_path / 'out/setpoints.npz')['position']
        seen.append(q[:, 4].min() < 0.0 < q[:, 4].max())
    assert any(seen)


def test_words_by_hand_go_on_from_where_the_joints_stand():
    q = CELL.arm.home + np.array([0.0] * 6 + [0.4, 0.2])
    tip = CHAIN.forward(q[None])[0][0]
    assert np.array_equal(CHAIN.counted(q, tip)[3:], q[6:])
    line = MdiReader(CHAIN, Settings()).line('G91 G1 X5 U10 F600', q, JobSetup())
    blocks = line.read().blocks
    assert np.abs(blocks.tip[-1] - tip - [5 * MM, 0.0, 0.0]).max() < 1e-9
    assert np.abs(blocks.extra[[0, -1]] - [[0.4, 0.2], [0.4, 0.21]]).max() < 1e-12


def test_the_tool_moves_along_its_axis_by_hand_while_both_joints_rest():
    q = CELL.arm.home + np.array([0.0] * 6 + [0.4, 0.2])
    slide = along_tool(CELL, q)
    tip, axis = (rows[0] for rows in CHAIN.forward(q[None]))
    there = slide.nominal(np.array([[0.03]]))
    tips, axes = CHAIN.forward(there)
    assert np.abs(tips[0] - tip - 0.03 * axis).max() < 1e-9
    assert np.abs(axes[0] - axis).max() < 1e-9
    assert np.array_equal(there[0, 6:], q[6:])


def test_the_way_back_to_a_cut_draws_the_tool_back_at_both_ends():
    stands, place = CELL.arm.home.copy(), CELL.arm.home.copy()
    stands[U], place[[E1, U]] = 0.2, [0.3, 0.4]
    path = approach_inside(CHAIN, 30 * MM, stands, place, 20 * MM, 0.01)
    assert np.abs(path.q[0] - stands).max() < 1e-9 and np.abs(path.q[-1] - place).max() < 1e-9
    tips, axes = CHAIN.forward(path.q)
    for end, (row, joints) in {0: (1, stands), -1: (-2, place)}.items():
        corner = int(np.flatnonzero(path.stop)[row])
        assert np.abs(tips[corner] - tips[end] - 20 * MM * axes[end]).max() < 1e-9
        assert np.array_equal(path.q[corner, 6:], joints[6:])


def test_the_description_moves_the_links_as_the_chain_moves_the_tool():
    q = CELL.arm.home + np.linspace(0.1, 0.8, 8)
    positions = dict(zip(CELL.joint_names, q, strict=True))
    description = describe_machine(CELL)
    (turn, tip), (part, zero) = (
        description.pose(link, positions) for link in ('tool_tip', 'workpiece')
    )
    found, axis = CHAIN.forward(q[None])
    assert np.abs(part.T @ (tip - zero) - found[0]).max() < 1e-12
    assert np.abs(part.T @ turn[:, 2] - axis[0]).max() < 1e-12


@pytest.mark.parametrize(
    ('text', 'kind', 'why'),
    [
        ('G1 X9 F500\nE1=30', ProgramError, ':4: E1: F has no meaning while the tip rests'),
        ('G1 X9 F500 E2=5', ProgramError, ':3: E2: no axis has this name'),
        ('G1 X9 F500 V5', ProgramError, ':3: V: the machine has no axis V'),
        ('G0 Y1600 U1600', TravelError, ':3: .*axis U would have to go to 1600'),
    ],
)
def test_wrong_words_are_refused_by_line(text, kind, why, tmp_path):
    with pytest.raises(kind, match=why):
        planned(f'G21 G90 G94\nG0 X0 Y0 Z10\n{text}\nM30\n', tmp_path)


@pytest.mark.parametrize(
    ('entries', 'why'),
    [
        ({'start': '{U: 1600}'}, r'start\.U: outside its travel -1500 \.\.\. 1500'),
        ({'start': '{V: 0}'}, r'start\.V: unknown'),
        ({'start': '5'}, r'start: must hold positions'),
        ({'base': 'forearm'}, 'flange must follow 6 turning joints'),
        ({'joint_limits': 'limits/ur10e.yaml'}, r'joint_limits\.positioner: max_acceleration'),
    ],
)
def test_a_wrong_machine_file_is_refused_by_its_key(entries, why, tmp_path):
    with pytest.raises(MachineError, match=why):
        changed(tmp_path, **entries)


LONG = """UNITS/MM
FEDRAT/3000,MMPM
GOTO/0,{0},20,0,0,1
GOTO/0,{0},0,0,0,1
GOTO/60,{0},0,0,0,1
RAPID
GOTO/60,{0},50,0,0,1
RAPID
GOTO/0,{1},50,0,0,1
FEDRAT/3000,MMPM
GOTO/0,{1},0,0,0,1
GOTO/60,{1},0,0,0,1
FINI
"""


@pytest.mark.thorough
def test_spin_auto_moves_the_rail_between_cuts_to_where_the_arm_reaches_them(tmp_path, capsys):
    machine = changed(tmp_path, base='floor', part='{xyz_mm: [700, 0, 400]}', start='{}')
    assert machine.axis_names[6:] == ('U',)
    text = LONG.format(-300, 1800)
    with pytest.raises(BlockError):
        planned(text, tmp_path, machine, 'part.apt')
    planned(text, tmp_path, machine, 'part.apt', spin='auto')
    proof = verify_plan(tmp_path / 'out', machine)
    assert proof.ok, proof.failures
    columns, blocks = np.load(tmp_path / 'out/setpoints.npz'), np.load(tmp_path / 'out/blocks.npz')
    line, rail = blocks['line'][columns['block']], columns['position'][:, 6]
    assert np.abs(rail[line <= 5]).max() < 0.02 * MM  # the corner to the rapid at its end
    assert np.ptp(rail[line >= 11]) < 0.02 * MM and 0.4 < rail[-1] < 1.5
    said = ['check', str(tmp_path / 'out'), '--machine', str(tmp_path / 'ur10e_cell.yaml')]
    assert main([*said, '--program', str(tmp_path / 'part.apt')]) == 0
    assert 'agree with the blocks' in capsys.readouterr().out
