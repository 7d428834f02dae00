"""The bundled machines: formulas of LinuxCNC, a 4-axis table, heads, machine coordinates."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from whole_plans import plan_program

from cnc_interp.core import MM, TravelError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.settings.options import Settings

RNG = np.random.default_rng(3)
Q = np.column_stack([RNG.uniform(-0.3, 0.3, (40, 3)), RNG.uniform(-3.0, 3.0, (40, 2))])


def turn(axis, angle):
    return Rotation.from_euler(axis, angle).as_matrix()


@pytest.mark.parametrize('conventional', [False, True])
@pytest.mark.parametrize(('name', 'tilt'), [('xyzac_trt', 'x'), ('xyzbc_trt', 'y')])
def test_tilting_rotary_tables_of_linuxcnc(name, tilt, conventional):
    """With P the rotation point, D the offset, k = -1 or with conventional-directions +1:
    tip = P + Rz(k C) (R(k tilt) (q - P - D) + D)."""
    machine = Machine.load(name)
    point, k = np.array([3.0, -4.0, 5.0]) * MM, 1.0 if conventional else -1.0
    shift = (np.array([0, 20, 10]) if tilt == 'x' else np.array([20, 0, 10])) * MM
    direction = machine.rotary_direction * (-1.0 if conventional else 1.0)
    offsets = np.array([-point, -shift, point + shift])
    bundled = np.array([0 * point, -shift, shift])
    np.testing.assert_allclose(machine.offsets, bundled, atol=1e-15)
    transform = Transform.of(replace(machine, rotary_direction=direction, offsets=offsets))
    tips = transform.forward(Q)[0]
    for q, tip in zip(Q, tips, strict=True):
        inside = turn(tilt, k * q[3]) @ (q[:3] - point - shift) + shift
        np.testing.assert_allclose(tip, point + turn('z', k * q[4]) @ inside, atol=1e-12)
    np.testing.assert_allclose(transform.linear(tips, Q[:, 3:]), Q[:, :3], atol=1e-12)


def test_fourth_axis():
    transform = Transform.of(Machine.load('xyza'))
    q = Q.copy()
    q[:, 4] = 0.0
    tips, axes = transform.forward(q)
    for i, (x, y, z, a, _) in enumerate(q):
        back = turn('x', -a)
        np.testing.assert_allclose(tips[i], back @ (np.array([x, y, z]) - [0.4, 0.25, -0.4]))
        np.testing.assert_allclose(axes[i], back[:, 2], atol=1e-15)
        gaps = [
            np.abs(np.sin(0.5 * (pair - q[i, 3:]))).max()
            for pair in transform.rotary_solutions(axes[i])
        ]
        assert min(gaps) < 1e-9


@pytest.mark.parametrize('cut', ['G1 A30', 'G1 A-30', 'G1 A400', 'G1 X20 A180'])
def test_a_wrapped_path_crosses_every_angle(cut):
    """The tool stands on the axis' top; the table turns through zero and any other angle."""
    geometry = Transform.of(machine := Machine.load('xyza'))
    text = f'G0 X0 Y0 Z30 A-20\nF600 {cut}\nG1 X40 Y3\nA-10 X0\n'
    plan = plan_program(read_text(text, 'wrap.ngc', geometry, Settings()), machine)
    angles = np.degrees(plan.setpoints.position[:, 3])
    wanted = float(cut.split('A')[1])
    assert angles[0] == pytest.approx(-20, abs=1e-6) and angles[-1] == pytest.approx(-10)
    assert angles.max() == pytest.approx(max(wanted, -10), abs=1e-2)
    assert np.abs(plan.setpoints.position[:, 4]).max() < 1e-9
    # Axis positions are those of the words: X Y Z from the machine's zero.
    last = plan.setpoints.position[-1]
    np.testing.assert_allclose(last[:3], [0.4, 0.253, -0.37], atol=1e-9)


def test_the_locked_axis_is_not_there():
    geometry = Transform.of(machine := Machine.load('xyza'))
    program = read_text('G0 X0 A0\nG1 B5 F100', 't', geometry, Settings())
    with pytest.raises(TravelError, match='axis B'):
        plan_program(program, machine)


@pytest.mark.parametrize('name', ['head_table', 'head_head'])
def test_heads_keep_the_tip_where_they_are_told(name):
    """TCP on: the tip rests in W while the head swings; the axes make up for its arms."""
    geometry = Transform.of(machine := Machine.load(name))
    first, second = machine.axis_names[3:]
    text = f'TRAORI\nG0 X10 Y20 Z30 {first}10 {second}20\nG1 {first}40 {second}50 F600'
    plan = plan_program(read_text(text, 't', geometry, Settings()), machine)
    tip, axis = geometry.forward(plan.setpoints.position)
    np.testing.assert_allclose(tip, np.broadcast_to([0.01, 0.02, 0.03], tip.shape), atol=1e-9)
    wanted = geometry.tool_axis(np.radians([[40.0, 50.0]]))[0]
    np.testing.assert_allclose(axis[-1], wanted, atol=1e-9)
    assert np.ptp(plan.setpoints.position[:, :3], axis=0).max() > 0.05


def test_machine_zero_of_a_machining_centre():
    geometry = Transform.of(machine := Machine.load('vmc'))
    text = 'G0 X10 Y20 Z5\nG1 Z-3 F600\nG53 G0 Z0\nG91 G28 X0 Y0'
    program = read_text(text, 't', geometry, Settings())
    np.testing.assert_allclose(program.blocks.tip[-1] * 1e3, [-400, -250, 400])
    q = plan_program(program, machine).setpoints.position
    np.testing.assert_allclose(q[0], [0.41, 0.27, -0.395], atol=1e-12)
    np.testing.assert_allclose(q[-1], [0, 0, 0], atol=1e-12)
