"""A machine with geometric errors over ROS: what is touched, shown and recorded is nominal."""

import json
import subprocess
import sys

import numpy as np
import pytest
import yaml

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from true_machines import TrueMachine

from cnc_interp.client.bag import Bag
from cnc_interp.commands.cli import main
from cnc_interp.core import UM
from cnc_interp.core.small_files import config_directory
from cnc_interp.machine_model.machine import Machine

TOUCHES = """
probe: {radius_mm: 1.5}
surfaces:
  - {box: [20, 0, -8], half: [10, 10, 5]}
"""
#: Touch the top twice, slowly the second time, and end there; then the side.
PROGRAM = """G21 G90
G0 X20 Y0 Z15
G38.2 Z-20 F600
G0 Z[#5063+0.2]
G38.2 Z-20 F30
(debug, top at #5063)
G0 Z15
G1 X-20 Y20 F3000
G4 P0.3 (the drives settle)
M2
"""


@pytest.mark.thorough
def test_a_probed_program_is_compensated_and_proven(tmp_path, capsys):
    true = TrueMachine(1)  # vmc
    assert true.length == 0.0
    file, part, bag = (tmp_path / name for name in ('mine.yaml', 'part.yaml', 'bag'))
    content = yaml.safe_load((config_directory() / 'machines' / 'vmc.yaml').read_text())
    content['errors'] = true.content['errors']
    file.write_text(yaml.safe_dump(content))
    part.write_text(TOUCHES)
    program = tmp_path / 'part.ngc'
    program.write_text(PROGRAM)
    words = ['run', str(program), '--machine', str(file), '--json', '--record', str(bag)]
    words += ['--drives', f'simulated,probe_touches={part}']
    done = subprocess.run(
        [sys.executable, '-m', 'cnc_interp', *words], capture_output=True, text=True, timeout=280
    )
    assert done.returncode == 0, done.stderr[-2000:]
    told = json.loads(done.stdout)
    assert list(told['position'].values()) == pytest.approx(
        program_end(Machine.load(file)), abs=1e-9
    )
    (top,) = (float(n.partition('top at')[2]) for n in told['notices'] if 'top at' in n)
    assert top == pytest.approx(-3.0, abs=2e-3)
    assert main(['check', str(bag), '--json']) == 0
    assert all(each['ok'] for each in json.loads(capsys.readouterr().out)['parts'])
    with Bag(bag) as recorded:
        joints, states = recorded.read('joint_states'), recorded.read('machine_state')
    off = np.array(joints[-1].position) - states[-1].positions
    assert np.abs(off).max() > 2 * UM
    tip = true.tips(np.array([joints[-1].position]))[0]
    assert tip == pytest.approx(np.array([-20e-3, 20e-3, 15e-3]), abs=1 * UM)


def program_end(machine):
    return np.array([-20e-3, 20e-3, 15e-3]) + machine.offsets[0]
