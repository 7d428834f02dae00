"""Machine files from INI files of LinuxCNC; limits that are likely in a wrong unit."""

import numpy as np
import pytest

from cnc_interp.commands.cli import main
from cnc_interp.core import DEG, INCH
from cnc_interp.machine.axis_motion import beyond_travel
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform

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
        ('X Y Z A C', 'X Y Z A', 'xyzac-trt-kins with XYZA: the axes must be XYZAC;'),
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
        ('acceleration_m_per_s2', 0.01, '30 s to reach its largest velocity'),
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


PLAIN = '[KINS]\nKINEMATICS = trivkins coordinates={}\n[TRAJ]\nLINEAR_UNITS = {}\n'


def axes_of(joints, more=''):
    """Sections of an axis for each letter, and of a joint for each letter as often as it comes."""
    rows = 'MAX_VELOCITY = 2\nMAX_ACCELERATION = 10\nMIN_LIMIT = -3\nMAX_LIMIT = 9\n'
    names = [f'AXIS_{letter}' for letter in dict.fromkeys(joints)]
    names += [f'JOINT_{n}' for n in range(len(joints))]
    return ''.join(f'[{name}]\n{rows}' for name in names) + more


def test_an_included_file_counts_as_part_of_the_ini(tmp_path):
    whole = PLAIN.format('XYZ', 'mm') + axes_of('XYZ')
    status, file = imported(tmp_path, whole)
    wanted = file.read_text()
    (tmp_path / 'joints.inc').write_text(axes_of('XYZ'))
    assert (
        imported(tmp_path, PLAIN.format('XYZ', 'mm') + '#INCLUDE joints.inc\n')[0] == status == 0
    )
    assert file.read_text() == wanted
    (tmp_path / 'joints.inc').unlink()
    assert imported(tmp_path, PLAIN.format('XYZ', 'mm') + '#INCLUDE joints.inc\n')[0] == 2


@pytest.mark.parametrize(('gone', 'travel'), [('MAX', [-3.0, np.inf]), ('MIN', [-np.inf, 9.0])])
def test_a_limit_to_one_side_is_kept(tmp_path, gone, travel):
    text = PLAIN.format('XYZ', 'mm') + axes_of('XYZ').replace(f'{gone}_LIMIT', 'NOT')
    machine = Machine.load(imported(tmp_path, text)[1])
    assert 1e3 * machine.travel[1] == pytest.approx(travel)
    beyond = np.zeros((1, 3))
    beyond[0, 1] = 10e-3 if gone == 'MIN' else -10e-3
    assert beyond_travel(machine, beyond) and not beyond_travel(machine, -beyond)


def test_what_an_ini_says_is_used_or_named(tmp_path, capsys):
    """A session found BACKLASH, HOME_*, REMAP and others dropped without a word."""
    more = """[JOINT_0]
BACKLASH = 0.3
COMP_FILE = x.comp
FERROR = 0.5
HOME_SEARCH_VEL = -5
HOME_OFFSET = -2
HOME_SEQUENCE = 1
[JOINT_2]
FERROR = 0.25
MIN_FERROR = 0.01
HOME_SEARCH_VEL = 5
HOME_OFFSET = 8.5
HOME_USE_INDEX = YES
HOME_SEQUENCE = 0
HOME = 1
[JOINT_1]
HOME_SEARCH_VEL = 5
HOME_OFFSET = 10
[EMCIO]
TOOL_CHANGE_POSITION = 0 0 2
TOOL_CHANGE_QUILL_UP = 1
RANDOM_TOOLCHANGER = 0
[RS274NGC]
REMAP = M6 modalgroup=6 ngc=toolchange
"""
    text = PLAIN.format('XYZ', 'mm') + 'MAX_LINEAR_VELOCITY = 1.5\n' + axes_of('XYZ', more)
    status, file = imported(tmp_path, text)
    told = capsys.readouterr().err
    machine = Machine.load(file)
    assert status == 0 and machine.max_velocity == pytest.approx(1.5e-3)
    assert machine.following_errors == pytest.approx({0: 0.5e-3, 2: 0.25e-3})
    assert machine.homing.switches == pytest.approx({'X': -2e-3, 'Z': 8.5e-3})
    assert machine.homing.index == pytest.approx({'Z': 8.5e-3})
    assert machine.homing.groups == (('Z',), ('X',))
    inputs = [signal.name for signal in machine.signals.inputs]
    assert {'home_x', 'home_z', 'index_waits_z'} <= set(inputs) and 'home_y' not in inputs
    for key in (
        *('BACKLASH of X', 'COMP_FILE of X', 'MIN_FERROR of Z', 'HOME of Z', 'HOME_OFFSET of Y'),
        *('TOOL_CHANGE_POSITION', 'TOOL_CHANGE_QUILL_UP', 'REMAP', 'velocity of X'),
    ):
        assert sum(key in line for line in told.splitlines()) == 1, key
    assert 'RANDOM_TOOLCHANGER' not in told


@pytest.mark.parametrize(
    ('joints', 'names'),
    [
        ('XYZC', 'XYZC'),
        ('XYZAC', 'XYZAC'),
        ('XYZBA', 'XYZAB'),
        ('XYZW', 'XYZW'),
        ('XYYZA', 'XYZA'),
    ],
)
def test_machines_without_a_transformation_have_tables_and_extra_axes(tmp_path, joints, names):
    status, file = imported(tmp_path, PLAIN.format(joints, 'mm') + axes_of(joints))
    machine = Machine.load(file)
    assert status == 0
    assert [axis.name for axis in machine.axes if not axis.locked] == list(names)


def test_a_unit_may_be_a_number(tmp_path):
    machine = Machine.load(
        imported(tmp_path, PLAIN.format('XYZ', 0.0393700787401575) + axes_of('XYZ'))[1]
    )
    assert machine.max_velocity == pytest.approx(2 * INCH)


@pytest.mark.parametrize('unit', ['mm', 'inch'])
@pytest.mark.parametrize('kind', [0, 1])
def test_a_comp_file_becomes_errors_of_the_screw(tmp_path, capsys, unit, kind):
    """Where the axis comes to 0.010 too far on average, it is commanded to 0.010 less."""
    rows = [(at, 0.012, 0.008) for at in range(-10, 11, 5)]
    if kind == 0:
        rows = [(at, at + ahead, at + back) for at, ahead, back in rows]
    else:
        rows = [(at, -ahead, -back) for at, ahead, back in rows]
    lines = '\n'.join(' '.join(f'{x:.6f}' for x in row) for row in rows)
    (tmp_path / 'x.comp').write_text(f'# nominal forward reverse\n{lines}\n')
    more = f'[JOINT_0]\nCOMP_FILE = x.comp\nCOMP_FILE_TYPE = {kind}\n'
    status, file = imported(tmp_path, PLAIN.format('XYZ', unit) + axes_of('XYZ', more))
    told = capsys.readouterr().err
    assert status == 0
    assert 'COMP_FILE of X: the mean of both directions' in told
    machine = Machine.load(file)
    size = 25.4e-3 if unit == 'inch' else 1e-3
    c = Transform.of(machine).errors.commanded(np.full((1, 3), 2.0 * size))
    assert c[0] == pytest.approx(np.array([1.99, 2.0, 2.0]) * size, abs=1e-9)


@pytest.mark.parametrize(
    ('rows', 'why'),
    [('0 0 0\n1 1 1\n', 'does not cover'), ('', 'no such rows'), ('0 0\n9 9\n', 'no such rows')],
)
def test_a_comp_file_that_cannot_be_used_is_named(tmp_path, capsys, rows, why):
    (tmp_path / 'x.comp').write_text(rows)
    more = '[JOINT_0]\nCOMP_FILE = x.comp\n'
    status, file = imported(tmp_path, PLAIN.format('XYZ', 'mm') + axes_of('XYZ', more))
    told = [line for line in capsys.readouterr().err.splitlines() if 'COMP_FILE of X' in line]
    assert status == 0 and len(told) == 1 and why in told[0]
    assert Machine.load(file).errors is None
