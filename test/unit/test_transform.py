"""The five-axis transformation against explicit rotation matrices and its own inverse."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cnc_interp.core import MM
from cnc_interp.machine_model.machine import Machine, from_mapping
from cnc_interp.machine_model.transform_port import Transform

BUNDLED = ('xyzac', 'xyzbc', 'bc_trunnion', 'head_head', 'head_table', 'xyza', 'xyzacw')
LIMITS = {
    **{
        n: {'velocity_m_per_min': 30, 'acceleration_m_per_s2': 2, 'jerk_m_per_s3': 5}
        for n in 'XYZ'
    },
    **{
        n: {'velocity_rev_per_min': 15, 'acceleration_rev_per_s2': 1, 'jerk_rev_per_s3': 5}
        for n in 'UV'
    },
}


def machine_with(first, second, carried):
    """Build a machine with given rotary directions and what they carry."""
    rotary = {
        'primary': {'name': 'U', 'about': first, 'carries': carried[0]},
        'secondary': {'name': 'V', 'about': second, 'carries': carried[1]},
        'workpiece_offset_mm': [40.0, -70.0, 60.0],
        'secondary_offset_mm': [1.0, 0.15, 80.0],
        'primary_offset_mm': [5.0, 6.0, 7.0],
        'tip_to_secondary_pivot_mm': [1.0, 2.0, 150.0],
        'secondary_to_primary_pivot_mm': [3.0, 4.0, 50.0],
    }
    return from_mapping({'name': 'test', 'rotary': rotary, 'limits': LIMITS})


MACHINES = {
    'AC table': machine_with([1, 0, 0], [0, 0, 1], ['workpiece', 'workpiece']),
    'BC table': machine_with([0, 1, 0], [0, 0, 1], ['workpiece', 'workpiece']),
    'nutating table': machine_with([0, 1, 1], [0, 0, 1], ['workpiece', 'workpiece']),
    'C table A head': machine_with([0, 0, 1], [1, 0, 0], ['workpiece', 'tool']),
    'B head C table': machine_with([0, 1, 0], [0, 0, 1], ['tool', 'workpiece']),
    'CA head': machine_with([0, 0, 1], [1, 0, 0], ['tool', 'tool']),
    'leaning BA head': machine_with([0, 1, 2], [1, 0, 0], ['tool', 'tool']),
}
RNG = np.random.default_rng(7)
Q = np.column_stack([RNG.uniform(-0.3, 0.3, (60, 3)), RNG.uniform(-3.0, 3.0, (60, 2))])


def pose_by_matrices(machine, q):
    """Tool tip and axis of one position, from rotation matrices written out."""
    first, second = (
        Rotation.from_rotvec(angle * direction).as_matrix()
        for angle, direction in zip(q[3:], machine.rotary_direction, strict=True)
    )
    one = np.eye(3)
    on_head = machine.rotary_on_head
    m, d, e = machine.offsets
    table_1, table_2 = (one if on_head[0] else first), (one if on_head[1] else second)
    head_1, head_2 = (first if on_head[0] else one), (second if on_head[1] else one)
    arms = machine.tool_offset
    reach = head_1 @ (head_2 @ arms[0] + arms[1]) - arms.sum(axis=0)
    if not any(on_head):
        reach = np.zeros(3)
    inner = table_1.T @ (q[:3] - reach - e) - d
    return table_2.T @ inner - m, (table_1 @ table_2).T @ head_1 @ head_2 @ [0, 0, 1]


@pytest.mark.parametrize('name', MACHINES)
def test_forward_is_the_product_of_rotations(name):
    machine = MACHINES[name]
    tip, axis = Transform.of(machine).forward(Q)
    for i, q in enumerate(Q):
        expected_tip, expected_axis = pose_by_matrices(machine, q)
        assert np.allclose(tip[i], expected_tip, atol=1e-14)
        assert np.allclose(axis[i], expected_axis, atol=1e-14)


@pytest.mark.parametrize('name', MACHINES)
def test_one_of_both_branches_is_where_we_came_from_and_both_are_right(name):
    transform = Transform.of(MACHINES[name])
    tip, axis = transform.forward(Q)
    for i, q in enumerate(Q):
        solutions = transform.rotary_solutions(axis[i])
        gaps = [np.abs(np.angle(np.exp(1j * (pair - q[3:])))).max() for pair in solutions]
        assert min(gaps) < 1e-7
        for pair in solutions:
            assert np.allclose(transform.tool_axis(pair[None])[0], axis[i], atol=1e-9)
    assert np.allclose(transform.linear(tip, Q[:, 3:]), Q[:, :3], atol=1e-14)


def test_reference_machine_formula():
    """p_M = R_x(A) (R_z(C) (p_W + m) + d) + e, o = (sin A sin C, sin A cos C, cos A)."""
    transform = Transform.of(Machine.load('xyzac'))
    a, c = 0.4, -1.1
    p = np.array([12.0, -7.0, 33.0]) * MM
    m, d = np.array([40.0, -70.0, 60.0]) * MM, np.array([0.0, 0.15, 80.0]) * MM
    r_x, r_z = Rotation.from_euler('x', a).as_matrix(), Rotation.from_euler('z', c).as_matrix()
    linear = transform.linear(p[None], np.array([[a, c]]))[0]
    assert np.allclose(linear, r_x @ (r_z @ (p + m) + d), atol=1e-15)
    expected = [np.sin(a) * np.sin(c), np.sin(a) * np.cos(c), np.cos(a)]
    assert np.allclose(transform.tool_axis(np.array([[a, c]]))[0], expected, atol=1e-15)


@pytest.mark.parametrize('tilt', [1e-2, 1e-3, 4e-4])
def test_the_table_is_found_near_the_pole_to_the_digits_of_the_tool_axis(tilt):
    transform = Transform.of(Machine.load('xyzac'))
    for turn in np.linspace(-3.0, 3.0, 25):
        lean = np.sin(tilt) * np.array([np.sin(turn), np.cos(turn)])
        positions = transform.rotary_solutions(np.array([*lean, np.cos(tilt)]))
        gaps = [np.abs(pair - [tilt, turn]).max() for pair in positions]
        assert min(gaps) < 2e-15


def test_unreachable_orientation_has_no_solution():
    """A nutating table at 45 deg tilts by at most 90 deg."""
    transform = Transform.of(MACHINES['nutating table'])
    assert transform.rotary_solutions(np.array([0.0, np.sin(2.0), np.cos(2.0)])) == []
    assert len(transform.rotary_solutions(np.array([0.0, np.sin(1.0), np.cos(1.0)]))) == 2


@pytest.mark.parametrize('name', BUNDLED)
def test_levers_are_the_derivatives_of_a_point_on_the_tool(name):
    transform = Transform.of(Machine.load(name))
    rng = np.random.default_rng(1)
    q = np.hstack([rng.uniform(-0.3, 0.3, (50, 3)), rng.uniform(-2.0, 2.0, (50, 2))])
    for height in (0.0, 0.03):
        levers = transform.levers(q[:, :3], q[:, 3:], height)
        for i in range(2):
            step = np.zeros(5)
            step[3 + i] = 1e-6
            ends = [
                tip + height * axis for tip, axis in map(transform.forward, (q - step, q + step))
            ]
            found = np.linalg.norm(ends[1] - ends[0], axis=1) / 2e-6
            np.testing.assert_allclose(levers[:, i], found, atol=1e-8)


@pytest.mark.parametrize('name', BUNDLED)
def test_nearest_angle_to_the_pole_on_linear_rotary_axes(name):
    transform = Transform.of(Machine.load(name))
    rng = np.random.default_rng(2)
    start, end = rng.uniform(-4.0, 4.0, (2, 50, 2))
    near = transform.nearest_to_pole(start, end)
    share = np.linspace(0.0, 1.0, 20001)[:, None]
    for k in range(50):
        axis = transform.tool_axis(start[k] + share * (end[k] - start[k]))
        cosine = np.abs(axis @ transform.pole).max()
        assert near[k] == pytest.approx(np.arccos(min(cosine, 1.0)), abs=3e-4)
