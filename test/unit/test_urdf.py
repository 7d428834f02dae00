"""URDF of the machines, read by another library, against the machines' own forward kinematics."""

import io
import shutil
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import trimesh
import yourdfpy

from cnc_interp.collision.drawing import drawn_bodies
from cnc_interp.collision.scene_file import read_scene
from cnc_interp.commands.cli import main
from cnc_interp.description.urdf import describe_machine, urdf_of
from cnc_interp.machine_model.joint import TOOL_TIP, WORKPIECE
from cnc_interp.machine_model.machine import Machine, arms_directory, machines_directory
from cnc_interp.machine_model.transform_port import Transform

BUNDLED = sorted(path.stem for path in machines_directory().glob('*.yaml'))
POSES = 50


def with_rotary(on_head):
    """Skew axes and offsets in all directions, so that no sign can hide."""
    return replace(
        Machine.load('xyzac'),
        name=f'rotary on head: {on_head}',
        rotary_direction=np.array([[0.8, 0.6, 0.0], [0.0, -0.6, 0.8]]),
        rotary_on_head=on_head,
        offsets=np.array([[0.04, -0.07, 0.06], [0.01, 0.15, 0.08], [-0.3, 0.2, 0.1]]),
        tool_offset=np.array([[0.02, 0.03, 0.25], [-0.05, 0.07, 0.11]]),
    )


MACHINES = [Machine.load(name) for name in (*BUNDLED, 'ur10e', 'm710ic_50', 'ur10e_cell')]
MACHINES += [with_rotary(on_head) for on_head in product((False, True), repeat=2)]


def read(text):
    return yourdfpy.URDF.load(io.StringIO(text), load_meshes=False)


def random_positions(machine, rng):
    finite = np.isfinite(machine.travel).all(axis=1)
    low, high = np.where(finite[:, None], machine.travel, [-9.0, 9.0]).T
    return rng.uniform(low, high, (POSES, len(machine.axis_names)))


@pytest.mark.parametrize('machine', MACHINES, ids=lambda machine: machine.name)
def test_a_reader_of_urdf_finds_tip_and_tool_axis_of_the_forward_kinematics(machine):
    robot = read(urdf_of(machine))
    description = describe_machine(machine)
    q = random_positions(machine, np.random.default_rng(5))
    tips, axes = Transform.of(machine).forward(q)
    for positions, tip, axis in zip(q, tips, axes):
        by_name = dict(zip(machine.joint_names, positions))
        robot.update_cfg(by_name)
        pose = robot.get_transform(TOOL_TIP, WORKPIECE)
        assert np.abs(pose[:3, 3] - tip).max() < 1e-9
        assert np.abs(pose[:3, 2] - axis).max() < 1e-9
        for link in (TOOL_TIP, WORKPIECE):  # the page draws with the description's own poses
            rotation, place = description.pose(link, by_name)
            found = robot.get_transform(link)
            assert np.abs(found[:3, :3] - rotation).max() < 1e-9
            assert np.abs(found[:3, 3] - place).max() < 1e-9


@pytest.mark.parametrize('machine', MACHINES, ids=lambda machine: machine.name)
def test_joints_have_names_and_limits_of_the_machine_file(machine):
    joints = read(urdf_of(machine)).joint_map
    moving = {name for name, joint in joints.items() if joint.type != 'fixed'}
    assert moving == set(machine.joint_names)
    for name, travel, speed in zip(machine.joint_names, machine.travel, machine.max_velocity):
        limit = joints[name].limit
        assert limit.velocity == pytest.approx(speed, rel=1e-12)
        if np.isfinite(travel).all():
            assert (limit.lower, limit.upper) == pytest.approx(tuple(travel), rel=1e-12)
        else:
            assert joints[name].type == ('prismatic' if name in 'XYZ' else 'continuous')


def test_the_urdf_of_an_arm_keeps_its_shapes_and_gets_two_frames(tmp_path):
    shutil.copytree(arms_directory(), tmp_path, dirs_exist_ok=True)
    file = tmp_path / 'ur10e.urdf'
    visual = '<visual><geometry><mesh filename="package://of/forearm.dae"/></geometry></visual>'
    own = file.read_text().replace(
        '<link name="forearm"/>', f'<link name="forearm">{visual}</link>'
    )
    file.write_text(own)
    assert main(['urdf', str(tmp_path / 'ur10e.yaml'), '--out', str(tmp_path / 'made.urdf')]) == 0
    made = read((tmp_path / 'made.urdf').read_text())
    before = read(own)
    assert set(made.link_map) == {*before.link_map, TOOL_TIP, WORKPIECE}
    found = made.link_map['forearm'].visuals[0].geometry.mesh.filename
    assert found.endswith('of/forearm.dae')


def test_the_bodies_of_a_scene_are_drawn_where_they_are(tmp_path):
    file = tmp_path / 'machine.urdf'
    words = ['urdf', 'xyzac', '--scene', 'xyzac', '--out', str(file)]
    assert main(words) == 0
    machine = Machine.load('xyzac')
    robot = yourdfpy.URDF.load(str(file))
    drawn = {link: robot.link_map[link].visuals for link in robot.link_map}
    for body in drawn_bodies(read_scene('xyzac'), machine):
        found = next(v for v in drawn[body.link] if v.name == body.name)
        mesh = trimesh.load(found.geometry.mesh.filename.removeprefix('file://'))
        assert np.allclose(mesh.bounds[0], body.triangles.min(axis=(0, 1)), atol=1e-6)
        assert np.allclose(mesh.bounds[1], body.triangles.max(axis=(0, 1)), atol=1e-6)
    assert not drawn['x_slide'], 'nothing but what is checked'
    assert main(words[:4]) == 2, 'the meshes need a place'
    main(['urdf', 'xyzac', '--frames', '--out', str(file)])
    assert '<visual' not in file.read_text()


@pytest.mark.parametrize('name', BUNDLED)
def test_the_files_beside_the_machines_are_current(name):
    text = (machines_directory() / f'{name}.urdf').read_text(encoding='utf-8')
    assert text == urdf_of(Machine.load(name)), (
        f'run: cnc-interp urdf {name} --out config/machines/{name}.urdf'
    )
