"""`cnc-interp machine new`, and all mistakes of a machine file at once."""

import copy
import subprocess
import sys

import pytest
import yaml

from cnc_interp.convert.machine_questions import LAYOUTS, ask_machine
from cnc_interp.core import MachineError
from cnc_interp.machine_model.machine import Machine, find_machine_file, from_mapping

CONTENT = yaml.safe_load(find_machine_file('head_table').read_text())


def test_all_mistakes_are_reported_at_once_with_the_keys_that_the_layout_needs(tmp_path):
    content = copy.deepcopy(CONTENT)
    content['limits']['X']['velocity_m_per_min'] = 30000.0
    del content['limits']['X']['jerk_m_per_s3'], content['limits']['Z']
    content['limits']['Y']['top_speed'] = 3
    content['rotary']['workpiece_offset_mm'] = [0, 0]
    del content['rotary']['primary_offset_mm']
    content['control'] = {'dialect': 'klingon'}
    file = tmp_path / 'mine.yaml'
    file.write_text(yaml.safe_dump(content))
    with pytest.raises(MachineError) as raised:
        Machine.load(file)
    lines = str(raised.value).splitlines()
    assert all(line.startswith(f'{file}: ') for line in lines)
    keys = [line.removeprefix(f'{file}: ').partition(':')[0] for line in lines]
    assert sorted(keys) == sorted(
        [
            'limits.X.velocity_m_per_min',
            'limits.X.jerk_m_per_s3',
            'limits.Y.top_speed',
            'limits.Z',
            'rotary.workpiece_offset_mm',
            'rotary.primary_offset_mm',
            'rotary',
            'control.dialect',
        ]
    )
    needs = next(line for line in lines if 'needs' in line)
    assert 'tip_to_secondary_pivot_mm' in needs and 'secondary_offset_mm' in needs


@pytest.mark.parametrize('number', range(1, len(LAYOUTS) + 1))
def test_enter_keeps_a_machine_that_reads(number):
    answers = iter([str(number)])
    machine = from_mapping(ask_machine(lambda _: next(answers, ''), print))
    assert machine.name == 'my_machine'
    same = Machine.load(list(LAYOUTS.values())[number - 1])
    assert machine.axis_names == same.axis_names
    assert (machine.max_jerk == same.max_jerk).all() and (machine.offsets == same.offsets).all()


def test_a_wrong_answer_is_asked_again_and_an_axis_may_get_another_letter(tmp_path):
    file = tmp_path / 'mine.yaml'
    answers = ['9', '3', 'mill', 'B', '[0, 0, 0]', '[0, 1, 0]', *8 * [''], '-5', '7']
    done = subprocess.run(
        [sys.executable, '-m', 'cnc_interp', 'machine', 'new', str(file)],
        input='\n'.join(answers) + 50 * '\n',
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    machine = Machine.load(file)
    assert machine.name == 'mill' and machine.axis_names == ('X', 'Y', 'Z', 'B', 'C')
    assert machine.rotary_direction[0].tolist() == [0.0, 1.0, 0.0]
    assert 'must not be zero' in done.stdout and 'B turns the workpiece about' in done.stdout
    assert 'must be positive' in done.stdout
    again = subprocess.run(
        [sys.executable, '-m', 'cnc_interp', 'machine', 'new', str(file)],
        input='',
        capture_output=True,
        text=True,
    )
    assert again.returncode == 2 and 'exists' in again.stderr
