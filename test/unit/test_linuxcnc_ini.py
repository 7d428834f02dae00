"""Machine files from INI files of LinuxCNC; limits that are likely in a wrong unit."""

import numpy as np
import pytest

from cnc_interp.commands.cli import main
from cnc_interp.core import DEG, INCH
from cnc_interp.machine_model.machine import Machine

TABLE = """[EMC]
MACHINE = My table  # not ours
[KINS]
KINEMATICS = xyzac-trt-kins sparm=identityfirst
JOINTS = 5
[HAL]
HALCMD = setp xyzac-trt-kins.y-rot-point -2
HALCMD = net :y-offset xyzac-trt-kins.y-offset
HALCMD = sets :y-offset 20
HALCMD = setp xyzac-trt-kins.z-offset 10
[TRAJ]
COORDINATES = X Y Z A C
LINEAR_UNITS = mm
; a comment
[AXIS_X]
MIN_LIMIT = -200
MAX_LIMIT = 200
MAX_VELOCITY = 500
MAX_ACCELERATION = 3000
MAX_JERK = 40000
[JOINT_0]
MIN_LIMIT = -150
MAX_LIMIT = 300
MAX_VELOCITY = 400
MAX_ACCELERATION = 4000
"""
REST = ''.join(
    f'[AXIS_{name}]\nMAX_VELOCITY = {v}\nMAX_ACCELERATION = {a}\n'
    for name, v, a in (('Y', 300, 2000), ('Z', 200, 1000), ('A', 90, 360), ('C', 180, 720))
)


def imported(tmp_path, text):
    (tmp_path / 'm.ini').write_text(text)
    status = main(['import-ini', str(tmp_path / 'm.ini'), '--out', str(tmp_path / 'm.yaml')])
    return status, tmp_path / 'm.yaml'


def test_the_narrowest_limits_and_the_geometry_of_the_table(tmp_path, capsys):
    text = (TABLE + REST).replace('[AXIS_Y]', '[AXIS_Y]\nMAX_JERK = 0')  # LinuxCNC's word for none
    status, file = imported(tmp_path, text)
    told = capsys.readouterr().err
    assert status == 0 and 'assumed: jerk of Y: none in the INI' in told
    assert 'jerk of X' not in told and 'z-rot-point: not in the INI' in told
    assert 'y-rot-point' not in told and '-offset' not in told
    machine = Machine.load(file)
    assert machine.axis_names == ('X', 'Y', 'Z', 'A', 'C')
    assert machine.max_velocity == pytest.approx([0.4, 0.3, 0.2, 90 * DEG, 180 * DEG])
    assert machine.max_acceleration == pytest.approx([3.0, 2.0, 1.0, 360 * DEG, 720 * DEG])
    assert machine.max_jerk == pytest.approx([40.0, 20.0, 10.0, 3600 * DEG, 7200 * DEG])
    assert machine.travel[0] == pytest.approx([-0.15, 0.2])
    assert not np.isfinite(machine.travel[1]).any()
    # The offsets as xyzac_trt.yaml has them for the rotation point 0 [mm].
    expected = [[0, 2, 0], [0, -20, -10], [0, 18, 10]]
    assert 1e3 * machine.offsets == pytest.approx(np.array(expected))
    assert list(machine.doubts()) == []


def test_inches_and_an_axis_with_two_motors(tmp_path):
    axes = ''.join(
        f'[JOINT_{n}]\nMAX_VELOCITY = 2\nMAX_ACCELERATION = 10\nMIN_LIMIT=0\nMAX_LIMIT=12\n'
        for n in range(4)
    )
    kins = '[KINS]\nKINEMATICS = trivkins coordinates=XYYZ kinstype=BOTH\n'
    status, file = imported(tmp_path, f'{kins}[TRAJ]\nLINEAR_UNITS = inch\n{axes}')
    machine = Machine.load(file)
    assert status == 0 and machine.axis_names == ('X', 'Y', 'Z')
    assert machine.max_velocity == pytest.approx(2 * INCH)
    assert machine.travel[2] == pytest.approx([0.0, 12 * INCH])


@pytest.mark.parametrize('letter', 'AB')
def test_a_fourth_axis_is_a_table_and_its_place_is_told(tmp_path, capsys, letter):
    text = (TABLE + REST).replace('xyzac-trt-kins', 'trivkins').replace('_A]', f'_{letter}]')
    status, file = imported(tmp_path, text.replace('X Y Z A C', f'X Y Z {letter}'))
    machine, told = Machine.load(file), capsys.readouterr().err
    assert status == 0 and f'{letter}: taken as a table' in told and 'primary_offset_mm' in told
    assert machine.axis_names[3] == letter
    assert machine.max_velocity[3] == pytest.approx(90 * DEG)


@pytest.mark.parametrize(
    ('old', 'new', 'told'),
    [
        ('KINEMATICS = xyzac-trt-kins', 'KINEMATICS = pumakins', 'pumakins is not known'),
        ('KINEMATICS = xyzac-trt-kins', 'OLD = 1', 'no KINEMATICS in [KINS]'),
        ('X Y Z A C', 'X Y Z A', 'xyzac-trt-kins with XYZA: known are XYZAC;'),
        ('LINEAR_UNITS = mm', 'LINEAR_UNITS = furlong', "'furlong' is no unit"),
        ('MAX_VELOCITY = 500', 'MAX_VELOCITY = fast', 'MAX_VELOCITY of X: must be a number'),
        ('[AXIS_Z]', '[AXIS_Q]', 'MAX_VELOCITY: missing in [AXIS_Z]'),
        ('MAX_VELOCITY = 400', 'MAX_VELOCITY = 0.4', 'is outside'),
    ],
)
def test_a_file_that_cannot_be_meant_is_one_line(tmp_path, capsys, old, new, told):
    status, _ = imported(tmp_path, (TABLE + REST).replace(old, new))
    line = capsys.readouterr().err
    assert status == 2 and told in line and line.count('\n') == 1 and 'm.ini' in line


@pytest.mark.parametrize(
    ('key', 'value', 'told'),
    [
        ('velocity_m_per_min', 0.1, 'Z: the largest velocity of the machine file is 100 mm/min'),
        ('velocity_m_per_min', 500.0, '500000 mm/min; is the unit right?'),
        ('acceleration_m_per_s2', 0.01, '30 s to its largest velocity'),
    ],
)
def test_a_plan_tells_limits_in_a_wrong_unit(tmp_path, capsys, key, value, told):
    limits = {'velocity_m_per_min': 18.0, 'acceleration_m_per_s2': 3.0, 'jerk_m_per_s3': 30.0}
    rows = [f'  {axis}: {limits | ({key: value} if axis == "Z" else {})}' for axis in 'XYZ']
    (tmp_path / 'm.yaml').write_text('limits:\n' + '\n'.join(rows).replace("'", '') + '\n')
    (tmp_path / 'p.ngc').write_text('G21 G90\nG0 X0 Y0 Z0\nG1 X1 F100\nM2\n')
    words = ['--machine', str(tmp_path / 'm.yaml'), '--out', str(tmp_path / 'out')]
    assert main(['plan', str(tmp_path / 'p.ngc'), *words]) == 0
    notes = [line for line in capsys.readouterr().err.splitlines() if 'right?' in line]
    assert len(notes) == 1 and told in notes[0]
