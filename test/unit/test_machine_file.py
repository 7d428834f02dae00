"""Machine files: what is read, and what is refused with which key."""

import copy

import numpy as np
import pytest
import yaml

from cnc_interp.core import DEG, MM, REV, MachineError
from cnc_interp.machine_model.machine import Machine, find_machine_file, from_mapping

CONTENT = yaml.safe_load(find_machine_file('xyzac').read_text())


def test_reference_machine_in_si():
    machine = Machine.load('xyzac')
    assert machine.axis_names == ('X', 'Y', 'Z', 'A', 'C')
    assert np.allclose(machine.max_velocity, [0.5, 0.5, 0.5, REV / 4, REV / 3])
    assert np.allclose(machine.max_acceleration, [2.5, 3.0, 2.1, 0.83 * REV, 0.83 * REV])
    assert np.allclose(machine.max_jerk, [5, 5, 50, 5 * REV, 50 * REV])
    assert np.allclose(machine.offsets[0], np.array([40, -70, 60]) * MM)
    assert np.isinf(machine.travel[4]).all()
    assert machine.singular_cone == pytest.approx(0.02 * DEG)


@pytest.mark.parametrize(
    'name', sorted(path.stem for path in find_machine_file('xyz').parent.glob('*.yaml'))
)
def test_bundled_machines_load(name):
    assert Machine.load(name).name == name


@pytest.mark.parametrize(
    ('path', 'value', 'key'),
    [
        (('limits', 'Y'), None, 'limits.Y'),
        (('limits', 'X', 'velocity_m_per_min'), 0.0, 'limits.X.velocity_m_per_min'),
        (('limits', 'X', 'jerk_m_per_s3'), -5.0, 'limits.X.jerk_m_per_s3'),
        (('limits', 'Z', 'velocity_m_per_min'), 30000.0, 'is the unit right'),
        (('limits', 'Z', 'velocity_m_per_min'), 0.03, 'is the unit right'),
        (('limits', 'A', 'acceleration_rev_per_s2'), 'fast', 'limits.A.acceleration_rev_per_s2'),
        (('limits', 'X', 'travel_mm'), [5, -5], 'limits.X.travel_mm'),
        (('limits', 'X', 'top_speed'), 3, 'limits.X.top_speed'),
        (('limits', 'W'), {}, 'W: the machine has no such axis'),
        (('rotary', 'secondary'), None, 'rotary.secondary.name'),
        (('rotary', 'workpiece_offset_mm'), [1, 2], 'rotary.workpiece_offset_mm'),
        (('rotary', 'primary', 'carries'), 'nothing', 'rotary.primary.carries'),
        (('rotary', 'secondary', 'about'), [1, 0, 0], 'rotary.secondary.about'),
    ],
)
def test_wrong_value_is_refused_naming_the_key(path, value, key):
    content = copy.deepcopy(CONTENT)
    place = content
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = value
    with pytest.raises(MachineError, match=key.replace('.', r'\.')):
        from_mapping(content)


def test_missing_limit_is_refused_naming_the_key():
    content = copy.deepcopy(CONTENT)
    del content['limits']['C']['jerk_rev_per_s3']
    with pytest.raises(MachineError, match=r'limits\.C\.jerk_rev_per_s3: missing'):
        from_mapping(content)


def test_unknown_machine_lists_the_bundled_ones(tmp_path):
    with pytest.raises(
        MachineError, match='xyz, xyza, xyzac, xyzac_tired, xyzac_trt, xyzacw, xyzbc'
    ):
        Machine.load('hermle')
    broken = tmp_path / 'broken.yaml'
    broken.write_text('limits: [1, 2\n')
    with pytest.raises(MachineError, match='cannot be read as YAML'):
        Machine.load(broken)


def test_the_machine_says_kind_unit_limits_and_travel_of_every_axis():
    machine = Machine.load('xyzac')
    assert [axis.name for axis in machine.axes] == list('XYZAC')
    assert machine.is_linear.tolist() == [True, True, True, False, False]
    assert [axis.shown_unit for axis in machine.axes] == ['mm'] * 3 + ['deg'] * 2
    z, c = machine.axis('Z'), machine.axis('C')
    assert (z.max_velocity, z.max_acceleration, z.max_jerk) == (0.5, 2.1, 50.0)
    assert z.travel == (-0.5, 0.5) and c.endless and not z.endless
    assert z.position_text(0.0123456) == '12.346' and c.position_text(np.pi / 3) == '60.0000'
    assert np.array_equal(machine.limits.by_order[2], machine.max_jerk)
