"""Tables of poses and recorded paths: an arm follows them with the turn that they give."""

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from cnc_interp.commands.cli import main
from cnc_interp.core import MM, ProgramError, StreamError
from cnc_interp.machine_model.machine import Machine, content_of
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.proof.own_chain import OwnChain
from cnc_interp.proof.verify import verify_plan
from cnc_interp.run.run_state import RunId
from cnc_interp.settings.options import Settings

HEADER = 'x,y,z,qx,qy,qz,qw,feed\n'
DOWN = Rotation.from_euler('x', 180, degrees=True)
PLACES = np.array(
    [[-60, -40, 20], [-60, -40, 0], [60, -40, 0], [60, 40, 0], [0, 45, 3], [-60, 40, 5]]
)
TILTS = [[0, 0], [0, 0], [6, 4], [-5, 8], [3, -7], [0, 0]]
TURNS = np.array([0, 0, 20, 45, -10, 10])


def turned(tilts=TILTS, turns=TURNS):
    by_z = Rotation.from_euler('z', np.reshape(turns, (-1, 1)), degrees=True)
    return Rotation.from_euler('xy', tilts, degrees=True) * DOWN * by_z


def table(places=PLACES, rotations=None, feed=',1500'):
    rotations = turned() if rotations is None else rotations
    rows = np.hstack([places, rotations.as_quat()])
    return HEADER + ''.join(','.join(f'{v:.12g}' for v in row) + f'{feed}\n' for row in rows)


def path(places, rotations):
    """As ``ros2 topic echo`` prints a nav_msgs/Path."""
    text = 'header:\n  stamp:\n    sec: 0\n    nanosec: 0\n  frame_id: part\nposes:\n'
    for place, turn in zip(places * MM, rotations.as_quat(), strict=True):
        text += '- header:\n    frame_id: part\n  pose:\n    position:\n'
        text += ''.join(f'      {k}: {v!r}\n' for k, v in zip('xyz', place.tolist(), strict=True))
        text += '    orientation:\n'
        text += ''.join(f'      {k}: {v!r}\n' for k, v in zip('xyzw', turn.tolist(), strict=True))
    return text + '---\n'


def planned(folder, text, *words, machine='ur10e', name='part.csv'):
    program = folder / name
    program.write_text(text)
    given = ['plan', str(program), '--machine', machine, '--out', str(folder / 'plan'), *words]
    assert main(given) == 0
    return folder / 'plan'


def misses(position, places, rotations, machine='ur10e'):
    """Distance [mm] and angle [deg] of the nearest setpoint of each pose, by frames from files."""
    frames = OwnChain.of(Machine.load(machine)).poses(position)
    for place, wanted in zip(places * MM, rotations, strict=True):
        away = np.linalg.norm(frames[:, :3, 3] - place, axis=1)
        there = Rotation.from_matrix(frames[away.argmin(), :3, :3])
        yield away.min() / MM, np.degrees((there.inv() * wanted).magnitude())


@pytest.mark.parametrize('machine', ['ur10e', 'm710ic_50'])
def test_an_arm_keeps_the_turns_of_a_table(machine, tmp_path, capsys):
    plan = planned(tmp_path, table(), machine=machine)
    assert main(['check', str(plan), '--program', str(tmp_path / 'part.csv')]) == 0
    told = capsys.readouterr().out
    assert '\nspin  ' in told and told.endswith('proven\n')
    position = np.load(plan / 'setpoints.npz')['position']
    found = np.array(list(misses(position, PLACES, turned(), machine)))
    assert (found <= [0.02, 0.1]).all()  # corners are rounded
    assert (found[[0, -1]] <= 1e-6).all()  # the ends are not
    # Halfway between two poses, axis and turn are halfway, too, but the axis on a great circle.
    halfway = Rotation.concatenate([turned()[1], turned()[2]]).mean()
    ((away, angle),) = misses(position, PLACES[1:3].mean(axis=0)[None], [halfway], machine)
    assert away < 0.1 and angle < 0.4


def test_turns_go_on_beyond_half_a_turn(tmp_path):
    turns = np.arange(8) * 20.0 + 110.0
    places = np.stack([np.linspace(-60.0, 60.0, 8), np.zeros(8), np.zeros(8)], axis=1)
    rotations = turned(np.zeros((8, 2)), turns)
    plan = planned(tmp_path, table(places, rotations, ',600'))
    assert verify_plan(plan, Machine.load('ur10e')).ok
    position = np.load(plan / 'setpoints.npz')['position']
    spins = np.unwrap(OwnChain.of(Machine.load('ur10e')).spins(position))
    assert abs(np.ptp(spins) - np.radians(140.0)) < 1e-6
    for away, angle in misses(position, places, rotations):
        assert away < 0.02 and angle < 0.1


def test_a_recorded_path_is_the_same_program(tmp_path, capsys):
    transform, settings = Transform.of(Machine.load('ur10e')), Settings(feedrate=0.025)
    first = read_text(table(), 'part.csv', transform, settings).blocks
    second = read_text(path(PLACES, turned()), 'path.yaml', transform, settings).blocks
    for name, column in first.columns().items():
        if name != 'line_number':
            assert np.allclose(column, getattr(second, name), atol=1e-9, equal_nan=True), name
    assert first.extra.shape == (6, 1) and np.ptp(first.extra) > 0.01
    planned(tmp_path, path(PLACES, turned()), '--feed', '1500', '--spin', 'auto', name='path.yaml')
    assert 'the poses give the spin' in capsys.readouterr().err
    words = ['check', str(tmp_path / 'plan'), '--program', str(tmp_path / 'path.yaml')]
    assert main(words) == 0
    # Another program, in which one pose is turned by 0.1 deg.
    turned_by = turned(turns=TURNS + np.array([0, 0, 0, 0.1, 0, 0]))
    (tmp_path / 'path.yaml').write_text(path(PLACES, turned_by))
    assert main(words) == 1
    assert 'line 54 of the program: its turn about the tool axis' in capsys.readouterr().out


def test_a_machine_with_rotary_axes_takes_only_the_tool_axis():
    transform, settings = Transform.of(Machine.load('xyzac')), Settings()
    program = read_text(table(), 'part.csv', transform, settings)
    axes = -turned().as_matrix()[:, :, 2]
    assert np.abs(program.blocks.axis - axes).max() < 1e-9
    assert not program.blocks.extra.shape[1]
    assert any('only the tool axis counts' in notice for notice in program.notices)


def test_a_wrong_turn_is_not_proven(tmp_path):
    plan = planned(tmp_path, table())
    columns = dict(np.load(plan / 'blocks.npz'))
    columns['extra_axes'][3:] += 0.001  # 2 deg
    np.savez(plan / 'blocks.npz', **columns)
    proof = verify_plan(plan, Machine.load('ur10e'))
    assert not proof.ok and any('spin' in failure for failure in proof.failures)


def test_no_joint_leads_where_poses_give_the_turn(tmp_path, capsys):
    """With a free turn the same poses are passed: J6 leads, and the tool turns."""
    content = content_of('m710ic_50')
    content['tcp'] = {'xyz_mm': [80.0, 0.0, 120.0], 'rpy_deg': [0.0, -20.0, 0.0]}
    machine, program = tmp_path / 'wrist.yaml', tmp_path / 'part.csv'
    machine.write_text(yaml.safe_dump(content))
    places = np.array([[0.0, y, 0.0] for y in (0.0, 5.0, 10.0, 15.0)])
    tilt = Rotation.from_euler('y', [[-30.0], [-50.0], [-70.0], [-90.0]], degrees=True)
    rotations = tilt * DOWN * Rotation.from_euler('z', 180, degrees=True)
    program.write_text(table(places, rotations, ',600'))
    words = ['plan', str(program), '--machine', str(machine), '--out', str(tmp_path / 'plan')]
    assert main(words) == 2
    assert 'J5 comes within' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('text', 'line', 'part'),
    [
        (HEADER + '0,0,0,1,0,0,0.1,600\n0,0,0,1,0,0,600\n', 3, 'expected 8 numbers'),
        (HEADER + '0,0,0,1,0,0,0.5,600\n', 2, 'length 1.11803'),
        (HEADER + '0,0,0,1,0,0,0,0\n', 2, 'feed must be greater than 0'),
        (HEADER + '0,0,zero,1,0,0,0,600\n', 2, 'not a number'),
        (HEADER + '0,0,0,0,0,0,1,600\n', 2, 'along -Z of the part'),
        (HEADER + '0,0,0,1,0,0,0,600\n0,0,0,0,1,0,0,600\n', 3, 'about its own axis'),
        ('x,y,z,qx,qy,qz,qw,speed\n', 1, 'the columns are x y z qx qy qz qw and feed'),
        (table(feed='').replace(',feed', ''), 3, 'add the column feed'),
        ("header:\nposes:\n- '...'\n", 3, '--full-length'),
    ],
)
def test_wrong_tables_are_refused_by_line(text, line, part):
    with pytest.raises(ProgramError, match=part) as caught:
        read_text(text, 'part.csv', Transform.of(Machine.load('ur10e')), Settings())
    assert caught.value.line_number == line


def test_only_arms_take_a_spin_in_messages():
    pytest.importorskip('cnc_interp_msgs', reason='needs the message package')
    from cnc_interp.wire.message_checks import check_block
    from cnc_interp.wire.path_messages import block_messages

    transform = Transform.of(Machine.load('ur10e'))
    blocks = read_text(table(), 'part.csv', transform, Settings()).blocks
    (message, *_) = block_messages(blocks, RunId('p'), 0, 30 * MM, True)
    check_block(message, 0, spins=True)
    with pytest.raises(StreamError, match='extra_axes holds 1 values, the machine needs 0'):
        check_block(message, 0)
