"""An arm from a URDF: its kinematics, a plan that is proven, and what is refused."""

import csv
import json
import shutil
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
import yaml

import cnc_interp
from cnc_interp.commands.cli import main
from cnc_interp.core import MM, BlockError, MachineError, ProgramError, SingularityError
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.machine_model import chain_kernels
from cnc_interp.machine_model.joint_chain import JointChain
from cnc_interp.machine_model.machine import Machine, arms_directory
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import open_program, read_text
from cnc_interp.program.blocks import Blocks
from cnc_interp.proof.own_chain import OwnChain
from cnc_interp.proof.verify import verify_plan
from cnc_interp.run import spin_choice
from cnc_interp.run.path_chain import PathChain, segments_of
from cnc_interp.run.planning_chain import plan_to_files
from cnc_interp.run.spin_choice import SpinSearch
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.segments import SPLINE

ARMS = ('ur10e', 'm710ic_50')
PART = """UNITS/MM
FEDRAT/1500,MMPM
GOTO/-60,-40,20,0,0,1
GOTO/-60,-40,0,0,0,1
GOTO/60,-40,0,0.1,0,0.994987437
GOTO/60,40,0,0,0.1,0.994987437
GOTO/-60,40,5,0,0,1
FINI
"""


def arm(name):
    found = Transform.of(Machine.load(name))
    assert isinstance(found, JointChain)
    return found


def poses(chain, count, seed):
    """Return joints, tips and axes of poses that are far from singular and do not point down."""
    random, found = np.random.default_rng(seed), []
    while len(found) < count:
        q = random.uniform(-2.5, 2.5, len(chain.machine.axis_names))
        regular = abs(np.linalg.det(chain.pose_rates(q))) > 0.03
        if regular and chain.forward(q[None])[1][0, 2] > -0.8:
            found.append(q)
    return np.array(found), *chain.forward(np.array(found))


def spin_of(chain, q, axis):
    """Return the spin of joints: how far their side is turned from part X, as arms.md has it."""
    side = np.array(chain_kernels.posture(chain.packed, q)[0][1])
    x = np.array([1.0, 0.0, 0.0])
    x = x - axis[0] / (1.0 + axis[2]) * (axis + [0.0, 0.0, 1.0])
    return float(np.arctan2(np.cross(x, side) @ axis, x @ side))


def tuples(jets):
    return tuple(tuple(float(c) for c in jets[:, i]) for i in range(3))


@pytest.mark.parametrize('name', ARMS)
def test_the_proof_comes_to_the_same_poses_from_the_files(name):
    chain, random = arm(name), np.random.default_rng(2)
    q = random.uniform(-3.0, 3.0, (500, 6))
    tip, axis = chain.forward(q)
    own_tip, own_axis = OwnChain.of(chain.machine).forward(q)
    assert np.abs(tip - own_tip).max() < 1e-12
    assert np.abs(axis - own_axis).max() < 1e-12


def matrix(pinocchio, given):
    xyz, rpy = np.array(given['xyz_mm']) * 1e-3, np.radians(given['rpy_deg'])
    return pinocchio.SE3(pinocchio.rpy.rpyToMatrix(*rpy), xyz).homogeneous


@pytest.mark.parametrize('name', ARMS)
def test_pinocchio_comes_to_the_same_poses(name):
    pinocchio = pytest.importorskip('pinocchio', exc_type=ImportError)
    chain, random = arm(name), np.random.default_rng(3)
    model = pinocchio.buildModelFromUrdf(str(arms_directory() / f'{name}.urdf'))
    content = yaml.safe_load((arms_directory() / f'{name}.yaml').read_text())
    tool, part = (matrix(pinocchio, content[key]) for key in ('tcp', 'part'))
    data, frame = model.createData(), model.getFrameId('flange')
    for q in random.uniform(-3.0, 3.0, (200, 6)):
        pinocchio.framesForwardKinematics(model, data, q)
        pose = np.linalg.inv(part) @ data.oMf[frame].homogeneous @ tool
        tip, axis = (rows[0] for rows in chain.forward(q[None]))
        assert np.abs(tip - pose[:3, 3]).max() < 1e-9
        assert np.abs(axis + pose[:3, 2]).max() < 1e-9


@pytest.mark.parametrize('name', ARMS)
def test_all_configurations_reach_the_pose(name):
    chain = arm(name)
    for q, tip, axis in zip(*poses(chain, 40, 4), strict=True):
        spun = chain.spun(spin_of(chain, q, axis))
        # Of the travel only the whole turns count here.
        free = np.tile([-2.0 * np.pi, 2.0 * np.pi], (6, 1))
        found = JointChain(spun.machine.having(travel=free), spun.packed).branches(tip, axis)
        tips, axes = chain.forward(found)
        assert np.abs(tips - tip).max() < 1e-11
        assert np.abs(axes - axis).max() < 1e-11
        gaps = np.abs(np.sin(0.5 * (found - q))).max(axis=1)
        assert gaps.min() < 1e-9
        assert len(found) >= 2


@pytest.mark.parametrize('name', ARMS)
def test_jets_are_the_derivatives_of_the_joints(name):
    chain, random = arm(name), np.random.default_rng(6)
    u = np.linspace(-4.0, 4.0, 9)
    h = 2e-3
    for q, tip, axis in zip(*poses(chain, 30, 5), strict=True):
        packed = chain.packed
        led = chain_kernels.NO_JOINT, (spin_of(chain, q, axis), 0.0, 0.0, 0.0)
        p = np.vstack([tip, random.normal(size=(3, 3)) * 0.2])
        turn = random.normal(size=3)
        o, last = [axis], axis
        for k in range(1, 4):
            last = np.cross(turn, last) / k
            o.append(last)
        o = np.array(o)
        jets, measure = chain_kernels.joint_jets(packed, tuples(p), tuples(o), q, 0.0, *led)
        assert measure > 0.0
        courses = []
        for x in u * h:
            angle, about = np.linalg.norm(turn) * x, turn / np.linalg.norm(turn)
            there = axis * np.cos(angle) + np.cross(about, axis) * np.sin(angle)
            there += about * (about @ axis) * (1.0 - np.cos(angle))
            still = np.zeros((4, 3)), np.zeros((4, 3))
            still[0][0], still[1][0] = x ** np.arange(4) @ p, there
            given = tuples(still[0]), tuples(still[1])
            courses.append(chain_kernels.joint_jets(packed, *given, q, 0.0, *led)[0][0])
        fit = np.polynomial.polynomial.polyfit(u, np.array(courses), 8)
        for k, allowed in enumerate((1e-11, 1e-8, 1e-6, 1e-4)):
            size = max(np.abs(jets[k]).max(), 1.0)
            assert np.abs(fit[k] / h**k - jets[k]).max() < allowed * size


@pytest.mark.parametrize('name', ARMS)
def test_a_program_is_planned_and_proven(name, tmp_path, capsys):
    program = tmp_path / 'part.apt'
    program.write_text(PART)
    out = tmp_path / 'out'
    assert main(['plan', str(program), '--machine', name, '--out', str(out)]) == 0
    assert main(['check', str(out), '--program', str(program)]) == 0
    assert capsys.readouterr().out.endswith('proven\n')
    position = np.load(out / 'setpoints.npz')['position']
    limits, period = Machine.load(name).limits.axes, 1e-3
    for joint, axis in enumerate(limits):
        bounds = axis.max_velocity, axis.max_acceleration, axis.max_jerk
        for order, bound in enumerate(bounds, start=1):
            largest = np.abs(np.diff(position[:, joint], order)).max() / period**order
            assert largest <= 1.001 * bound
    assert json.loads((out / 'summary.json').read_text())['cycle_time'] > 1.0


def test_a_setpoint_beside_the_path_is_not_proven(tmp_path):
    program = tmp_path / 'part.apt'
    program.write_text(PART)
    out = tmp_path / 'out'
    assert main(['plan', str(program), '--machine', 'ur10e', '--out', str(out)]) == 0
    columns = dict(np.load(out / 'setpoints.npz'))
    columns['position'][:, 3] += 2e-3  # J4 by 0.1 deg all along
    np.savez(out / 'setpoints.npz', **columns)
    assert main(['check', str(out)]) == 1


def planned(text, tmp_path, machine, name='part.apt', **options):
    file = tmp_path / name
    file.write_text(text)
    settings = Settings(feedrate=0.02, **options)
    stream = open_program(file, Transform.of(machine), settings)
    return plan_to_files(stream, machine, tmp_path / 'out', settings)


def changed(tmp_path, name, **entries):
    """Return the machine of a bundled arm with other entries; None removes one."""
    shutil.copytree(arms_directory(), tmp_path, dirs_exist_ok=True)
    file = tmp_path / f'{name}.yaml'
    kept = file.read_text().splitlines()
    kept = [line for line in kept if line.split(':')[0] not in entries]
    kept += [f'{key}: {value}' for key, value in entries.items() if value is not None]
    file.write_text('\n'.join(kept))
    return Machine.load(file)


def wrist(tmp_path, lean):
    """Return an M-710iC whose tool leans from the flange [deg], and a way through its wrist."""
    tcp = f'{{xyz_mm: [{80 if lean else 0}, 0.0, 120.0], rpy_deg: [0.0, {lean}, 0.0]}}'
    machine = changed(tmp_path, 'm710ic_50', tcp=tcp, spin_deg=180.0)
    lines = [
        f'GOTO/0,{y},0,{-np.sin(a):.9f},0,{np.cos(a):.9f}'
        for y, a in zip(
            (0, 5, 10, 15), np.radians([10, 30, 50, 70]) - np.radians(lean), strict=True
        )
    ]
    return machine, '\n'.join(['FEDRAT/600', *lines, 'FINI'])


def test_a_joint_leads_past_a_singular_pose_without_a_stop(tmp_path):
    machine, text = wrist(tmp_path, -20)
    planned(text, tmp_path, machine)
    q = np.load(tmp_path / 'out/setpoints.npz')['position']
    chain = Transform.of(machine)
    spins = [spin_of(chain, row, chain.forward(row[None])[1][0]) - np.pi for row in q[::20]]
    turned = np.abs((np.array(spins) + np.pi) % (2.0 * np.pi) - np.pi)
    assert q[:, 4].min() < 0.0 < q[:, 4].max()  # through the wrist
    assert max(turned[0], turned[-1]) < 1e-5 < 1e-3 < turned.max()
    proof = verify_plan(tmp_path / 'out', machine)
    assert proof.ok, proof.failures
    assert not np.load(tmp_path / 'out/path.npz')['stop'][1:-1].any()


@pytest.mark.parametrize(
    ('start', 'way'),
    [
        ((-0.2226591, 0.7850721, -0.9200657, 3.0341562, -0.1969919, -2.0361198), (466, 376, 36)),
        ((0.5674224, 0.0313211, -0.1227815, -1.1538698, -0.2503881, 1.2844783), (233, -517, -195)),
        ((0.4796118, 0.240914, -0.4634033, -3.1354665, -0.2860105, 1.2878671), (-160, -84, 984)),
    ],
)
def test_a_long_line_through_the_wrist_is_passed_without_a_stop(start, way):
    """Newton's method found another branch at the far end of a cell, and the line was refused.

    In the third line J5 comes within 0.1 deg of zero and returns.
    """
    machine = Machine.load('m710ic_50')
    last, lean = machine.arm.lines[-1], np.pi / 4.0
    across = np.cross(last[:3], [0.0, 1.0, 0.3])
    across /= np.linalg.norm(across)
    axis = -np.cos(lean) * last[:3] - np.sin(lean) * across
    side = np.cross(axis, last[:3]) / np.sin(lean)
    tool = np.array([last[3:] + 0.2 * last[:3] + 0.1 * across, side, axis])
    chain = JointChain.of(replace(machine, arm=replace(machine.arm, tool=tool)))
    q = np.array(start)
    (tip,), (axis,) = chain.forward(q[None])
    chain = chain.spun(spin_of(chain, q, axis)).starting(q)
    from_to = np.array([tip, tip + 0.6 * np.array(way) / np.linalg.norm(way)]) / MM
    lines = [f'GOTO/{",".join(f"{x:.9f}" for x in (*point, *axis))}' for point in from_to]
    program = read_text('\n'.join(['FEDRAT/36000', *lines, 'FINI']), 'p.apt', chain, Settings())
    path_chain = PathChain(chain, Settings())
    parts = [path_chain.push(program.blocks).path, path_chain.finish().path]
    path = AxisPath.join([part for part in parts if part is not None])
    assert path.q[:, 4].min() < 0.0 < path.q[:, 4].max() or np.abs(path.q[:, 4]).min() < 0.05
    assert not path.stop[1:-1].any()
    tips, axes = chain.forward(path.q)
    assert np.abs(tips - path.tip).max() < 1e-9 and np.abs(axes - path.axis).max() < 1e-9


def test_a_joint_leads_alike_however_the_blocks_arrive(tmp_path):
    machine, _ = wrist(tmp_path, -20)
    lean = np.radians([*np.linspace(30.0, 90.0, 40), *[90.0] * 20])
    way = [*np.linspace(0.0, 15.0, 40), *np.linspace(20.0, 500.0, 20)]
    lines = [
        f'GOTO/0,{y},0,{-np.sin(a):.9f},0,{np.cos(a):.9f}' for y, a in zip(way, lean, strict=True)
    ]
    file = tmp_path / 'part.apt'
    file.write_text('\n'.join(['FEDRAT/600', *lines, 'FINI']))
    chain, settings = Transform.of(machine), Settings()
    blocks = Blocks.concatenate(list(open_program(file, chain, settings)))
    segments, paths = segments_of(blocks, chain, settings), []
    for size in (len(segments), 7, 1):
        builder = AxisPathBuilder(chain, settings.flank_height, settings.interpolation_period)
        parts = [builder.push(segments[k : k + size]) for k in range(0, len(segments), size)]
        paths.append(AxisPath.join([part for part in parts if part is not None]))
    whole, *others = paths
    assert whole.q[:, 4].min() < 0.0 < whole.q[:, 4].max()
    for other in others:
        for name, column in vars(whole).items():
            assert np.array_equal(column, getattr(other, name)), name


def test_a_line_through_the_wrist_is_refused_with_joint_and_remedy(tmp_path):
    machine, text = wrist(tmp_path, 0)  # J6 is the spin, so that no joint can lead
    with pytest.raises(SingularityError, match=r':4: J5 .* of 0\.0, .* J4 and J6 turn against'):
        planned(text, tmp_path, machine)


def test_what_is_out_of_reach_is_refused_by_line(tmp_path):
    text = 'FEDRAT/600\nGOTO/0,0,0,0,0,1\nGOTO/900,0,0,0,0,1\nFINI\n'
    with pytest.raises(BlockError, match=':3: ') as refused:
        planned(text, tmp_path, Machine.load('ur10e'))
    assert 'reach' in str(refused.value) or 'turn against' in str(refused.value)


def test_a_first_pose_out_of_reach_is_refused(tmp_path):
    text = 'FEDRAT/600\nGOTO/5000,0,0,0,0,1\nGOTO/5010,0,0,0,0,1\nFINI\n'
    with pytest.raises(BlockError, match='no configuration of ur10e reaches this pose'):
        planned(text, tmp_path, Machine.load('ur10e'))


@pytest.mark.parametrize('word', ['A10', 'B-5', 'C90'])
def test_rotary_words_are_refused_by_name(word, tmp_path):
    text = f'G21 G90 G94\nG0 X0 Y0 Z20\nG1 X30 {word} F1000\nM30\n'
    with pytest.raises(ProgramError, match=f':3: {word[0]}: the machine has no axis {word[0]}'):
        planned(text, tmp_path, Machine.load('ur10e'), 'part.ngc')


@pytest.mark.parametrize(
    ('entries', 'why'),
    [
        ({'joint_limits': None}, 'joint_limits: missing'),
        ({'joint_limits': 'none.yaml'}, 'joint_limits: cannot be read'),
        ({'flange': 'hand'}, 'no joints of the URDF lead from base to hand'),
        ({'tcp': 'base'}, 'base is not fixed to flange'),
        ({'part': 'forearm'}, 'forearm is not fixed to base'),
        ({'urdf': 'none.urdf'}, 'cannot be read as URDF'),
        ({'urdf': 'ur10e.yaml'}, 'cannot be read as URDF'),
        ({'base': 'upper_arm'}, 'flange must follow 6 turning joints'),
        ({'home_deg': '[0, 0]'}, 'must be a list of 6 numbers'),
        ({'speed': '3'}, 'arm.speed: unknown'),
        ({'limits': '{J1: 3}'}, "limits: may only be 'guess'"),
    ],
)
def test_a_wrong_entry_is_refused_by_its_key(entries, why, tmp_path):
    with pytest.raises(MachineError, match=why):
        changed(tmp_path, 'ur10e', **entries)


def test_missing_limits_are_guessed_on_request_only(tmp_path):
    limits = '{shoulder_pan: {has_velocity_limits: true, max_velocity: 1.5}}'
    with pytest.raises(MachineError, match=r'joint_limits\.shoulder_pan: max_acceleration'):
        changed(tmp_path, 'ur10e', joint_limits=limits)
    machine = changed(tmp_path, 'ur10e', joint_limits=limits, limits='guess')
    assert machine.limits.axes[0].max_velocity == 1.5
    assert 'J1 acceleration, J1 jerk' in next(machine.doubts())


def test_a_plan_with_guessed_limits_says_so_whenever_it_is_proven(tmp_path, capsys):
    shutil.copytree(arms_directory(), tmp_path, dirs_exist_ok=True)
    (tmp_path / 'limits/ur10e.yaml').write_text('joint_limits: {}')
    (tmp_path / 'part.apt').write_text(PART)
    out = str(tmp_path / 'out')
    given = ['plan', str(tmp_path / 'part.apt'), '--out', out, '--machine']
    assert main([*given, str(tmp_path / 'ur10e.yaml')]) == 2
    assert 'max_acceleration (has_acceleration_limits) is missing' in capsys.readouterr().err
    assert main([*given, str(tmp_path / 'ur10e.yaml'), '--limits', 'guess']) == 0
    assert 'limits of ur10e are guessed: J1 acceleration, J1 jerk' in capsys.readouterr().err
    assert main(['check', out]) == 0
    assert 'guessed limits J1 acceleration, J1 jerk' in capsys.readouterr().out
    assert main(['report', out]) == 0
    told = 'limits of ur10e are guessed: J1 acceleration, J1 jerk'
    assert told in (tmp_path / 'out/report.html').read_text()
    capsys.readouterr()
    machine = str(tmp_path / 'out/machine.yaml')
    assert main(['estimate', str(tmp_path / 'part.apt'), '--machine', machine]) == 0
    assert told in capsys.readouterr().err


def test_a_batch_plans_and_proves_arms_and_names_guessed_limits(tmp_path):
    shutil.copytree(arms_directory(), tmp_path, dirs_exist_ok=True)
    (tmp_path / 'part.apt').write_text(PART)
    content = yaml.safe_load((tmp_path / 'ur10e.yaml').read_text())
    del content['joint_limits']
    (tmp_path / 'mine.yaml').write_text(yaml.safe_dump(content | {'limits': 'guess'}))
    given = ['batch', str(tmp_path / 'part.apt'), '--machine', str(tmp_path / 'mine.yaml')]
    assert main([*given, 'm710ic_50', '--workers', '1', '--out', str(tmp_path / 'table')]) == 0
    with (tmp_path / 'table/table.csv').open() as file:
        rows = list(csv.DictReader(file))
    assert [row['verdict'] for row in rows] == ['proven', 'proven']
    assert 'limits of ur10e are guessed: J1 acc' in rows[0]['notices']


def test_spin_auto_is_faster_than_the_one_of_the_machine_file(tmp_path, capsys):
    (tmp_path / 'part.apt').write_text(PART.replace('1500', '6000'))
    times = {}
    for spin in ('fixed', 'auto'):
        out = tmp_path / spin
        given = ['plan', str(tmp_path / 'part.apt'), '--machine', 'ur10e', '--out', str(out)]
        assert main([*given, '--spin', spin]) == 0
        assert main(['check', str(out)]) == 0
        times[spin] = json.loads((out / 'summary.json').read_text())['cycle_time']
    assert times['auto'] < times['fixed']


def test_blocks_become_curves_up_to_a_length_that_grows_with_the_reach(tmp_path):
    turn = np.linspace(0.0, 6.2, 90)  # chords of 7 mm, longer than those of machines
    places = zip(100.0 * np.cos(turn), 100.0 * np.sin(turn), strict=True)
    lines = [f'GOTO/{x:.5f},{y:.5f},0,0,0,1' for x, y in places]
    text = '\n'.join(['FEDRAT/6000', *lines, 'FINI'])
    for longest, curves in ((5.0 * MM, True), (3.0 * MM, False)):
        planned(text, tmp_path, Machine.load('ur10e'), longest_block=longest)
        assert (np.load(tmp_path / 'out/segments.npz')['kind'] == SPLINE).any() == curves
        proof = verify_plan(tmp_path / 'out', Machine.load('ur10e'))
        assert proof.ok, proof.failures
    assert Machine.load('xyzac').scale == 1.0


def test_the_library_plans_as_the_command_does(tmp_path):
    summary = planned(PART, tmp_path, Machine.load('ur10e'), spin='auto')
    plan = cnc_interp.plan(tmp_path / 'part.apt', machine='ur10e', feedrate=0.02, spin='auto')
    assert plan.cycle_time == summary['cycle_time']
    assert cnc_interp.check(plan).ok
    assert any('spin' in notice for notice in plan.program.notices)


CUTS = """UNITS/MM
FEDRAT/9000,MMPM
GOTO/-60,-40,0,0,0,1
GOTO/60,-40,0,0.1,0,0.994987437
GOTO/60,40,0,0,0.1,0.994987437
RAPID
GOTO/60,40,60,0,0,1
RAPID
GOTO/-60,100,60,0,0,1
FEDRAT/9000,MMPM
GOTO/-60,100,0,0,0.3,0.953939201
GOTO/-60,40,0,-0.3,0,0.953939201
GOTO/-60,-40,5,0,0,1
FINI
"""


def test_the_spin_changes_between_cuts_only(tmp_path, monkeypatch):
    # Each cut may have one spin only, and the two differ.
    machine = Machine.load('m710ic_50')
    monkeypatch.setattr(spin_choice, 'SPINS', np.radians([40.0, 90.0]))
    further = SpinSearch._begun

    def one_each(self, way, spin, number, avoids):
        if abs(spin - np.radians([40.0, 90.0][number])) < 1e-9:
            yield from further(self, way, spin, number, avoids)

    monkeypatch.setattr(SpinSearch, '_begun', one_each)
    planned(CUTS, tmp_path, machine, spin='auto')
    proof = verify_plan(tmp_path / 'out', machine)
    assert proof.ok, proof.failures
    columns, chain = np.load(tmp_path / 'out/setpoints.npz'), Transform.of(machine)
    rows = np.load(tmp_path / 'out/blocks.npz')['line']
    q = columns['position']
    axes = chain.forward(q)[1]
    spins = np.degrees([spin_of(chain, *row) for row in zip(q, axes, strict=True)]) % 360.0
    for lines, spin in (((4, 5), 40.0), ((11, 12, 13), 90.0)):
        cut = np.isin(rows[columns['block']], lines)
        assert cut.any()
        assert np.abs(spins[cut] - spin).max() < 1e-6


@pytest.mark.thorough
def test_no_constant_spin_is_faster_than_the_chosen_one(tmp_path):
    """The spin decides at which corners of these lines a stop is faster than rounding."""
    random = np.random.default_rng(1190000)
    tips, leans = random.uniform(-50.0, 50.0, (8, 3)), random.uniform(-0.25, 0.25, (8, 2))
    axes = np.hstack([leans, np.ones((8, 1))])
    rows = np.hstack([tips * [1.0, 1.0, 0.4], axes / np.linalg.norm(axes, axis=1)[:, None]])
    lines = [f'GOTO/{",".join(f"{value:.9f}" for value in row)}' for row in rows]
    text, machine = '\n'.join(['FEDRAT/3000', *lines, 'FINI']), Machine.load('m710ic_50')
    chosen = planned(text, tmp_path, machine, spin='auto')['cycle_time']
    for spin in np.radians(np.arange(0, 360, 45)):
        turned = replace(machine, arm=replace(machine.arm, spin=spin))
        with suppress(BlockError):
            assert chosen <= (1.0 + 1e-6) * planned(text, tmp_path, turned)['cycle_time']


@pytest.mark.thorough
def test_best_bends_the_spin_and_is_not_slower(tmp_path):
    machine, times = Machine.load('ur10e'), {}
    for spin in ('auto', 'best'):
        times[spin] = planned(CUTS, tmp_path, machine, spin=spin)['cycle_time']
        proof = verify_plan(tmp_path / 'out', machine)
        assert proof.ok, proof.failures
    assert times['best'] <= times['auto']


def test_spin_auto_goes_where_the_fixed_spin_cannot(tmp_path):
    machine = changed(tmp_path, 'm710ic_50', spin_deg=180.0)
    with pytest.raises(BlockError):
        planned(PART, tmp_path, machine)
    assert planned(PART, tmp_path, machine, spin='auto')['cycle_time'] > 1.0


def test_a_part_that_no_spin_reaches_is_refused_by_line(tmp_path):
    text = 'FEDRAT/600\nGOTO/0,0,0,0,0,1\nGOTO/300,0,0,0,0,1\nGOTO/900,0,0,0,0,1\nFINI\n'
    with pytest.raises(BlockError, match=r':[34]: no constant spin of ur10e follows'):
        planned(text, tmp_path, Machine.load('ur10e'), spin='auto')


def test_frames_can_be_links_of_the_urdf(tmp_path):
    machine = changed(tmp_path, 'ur10e', flange='wrist_3', tcp='flange', part='base')
    home = machine.arm.home[None]
    tip, axis = Transform.of(machine).forward(home)
    own_tip, own_axis = OwnChain.of(machine).forward(home)
    assert np.abs(tip - own_tip).max() < 1e-12
    assert np.abs(axis - own_axis).max() < 1e-12


@pytest.mark.parametrize(
    ('words', 'why'),
    [
        (['plan', 'PROGRAM', '--from-line', '4'], 'is an arm; this needs a machine with X Y Z'),
        (['plan', 'PROGRAM', '--place-x', '5'], 'is an arm; move `part` in its machine file'),
        (['convert', 'PROGRAM', '--to', 'gcode'], 'is an arm; this needs a machine with X Y Z'),
    ],
)
def test_what_needs_axes_of_a_machine_is_refused_in_one_line(words, why, tmp_path, capsys):
    program = tmp_path / 'part.apt'
    program.write_text(PART)
    given = [str(program) if word == 'PROGRAM' else word for word in words]
    out = ['--out', str(tmp_path / 'made.ngc')]
    assert main([*given, *out, '--machine', 'ur10e']) == 2
    told = capsys.readouterr().err.strip().splitlines()
    assert why in told[-1]


def test_g_code_turns_the_tool_by_directions(tmp_path, capsys):
    text = (
        'G21 G90 G94\nG0 X0 Y0 Z20\nG43.5\nG1 X30 Z0 I0.1 J0 K1 F1000\n'
        'Y50 I0 J0.1 K1\nG49\nG1 X0 Y0 Z5\nM30\n'
    )
    machine = Machine.load('ur10e')
    planned(text, tmp_path, machine, 'part.ngc')
    assert main(['check', str(tmp_path / 'out'), '--machine', 'ur10e']) == 0
    last = np.load(tmp_path / 'out/setpoints.npz')['position'][-1:]
    tip, axis = OwnChain.of(machine).forward(last)
    assert np.abs(tip - [0.0, 0.0, 5e-3]).max() < 1e-9
    # Where tool-tip programming is off, the tool keeps its direction.
    assert np.abs(axis - np.array([0.0, 0.1, 1.0]) / np.hypot(0.1, 1.0)).max() < 1e-8


def test_the_links_of_an_arm_keep_their_clearances_or_the_program_is_refused(tmp_path, capsys):
    text = (
        'FEDRAT/1500,MMPM\nGOTO/0,0,20,0,0,1\nGOTO/0,0,{low},0,0,1\nGOTO/{x},0,{low},0,0,1\nFINI\n'
    )
    program, out = tmp_path / 'part.apt', tmp_path / 'out'
    given = ['plan', str(program), '--machine', 'ur10e', '--scene', 'ur10e', '--out', str(out)]
    program.write_text(text.format(low=-39, x=50))
    assert main(given) == 0
    assert main(['check', str(out)]) == 0
    told = capsys.readouterr().out
    # The table ends 40 mm below the zero of the part.
    assert 'cutter and table' in told
    columns = dict(np.load(out / 'collision.npz'))
    columns['normal'] = -columns['normal']
    np.savez(out / 'collision.npz', **columns)
    assert main(['check', str(out)]) == 1
    program.write_text(text.format(low=-41, x=50))
    assert main(given) != 0
    assert ':3: ' in (told := capsys.readouterr().err) and 'table' in told
    program.write_text(text.format(low=100, x=-600))  # the tool comes to the arm itself
    assert main(given) != 0
    assert 'line 4, holder cone 2 and shoulder' in capsys.readouterr().err
