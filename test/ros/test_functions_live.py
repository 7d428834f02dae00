"""Spindle, coolant and tool changer over the real nodes, recorded and proven."""

import json
import re
import subprocess
import sys
import time

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp.client.bag import Bag
from cnc_interp.client.recorded_run import recorded_run, write_run
from cnc_interp.commands.cli import main
from cnc_interp.core import MM
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.verify import verify_plan

pytestmark = pytest.mark.thorough  # together in test_probing_live, with every change

PROGRAM = """G21 G90 G17
T5 M6
S8000 M3
G0 X0 Y0 Z20
M8
G1 Z0 F1000
X20
S9000 X25
M9 X30
M5
T6 M6
M3
G1 X0
M30
"""


def test_a_part_from_tool_change_to_the_end_is_recorded_and_proven(tmp_path, capsys):
    program, bag = tmp_path / 'part.ngc', tmp_path / 'bag'
    program.write_text(PROGRAM)
    words = ['run', str(program), '--machine', 'vmc', '--record', str(bag)]
    begun = time.monotonic()
    done = subprocess.run(
        [sys.executable, '-m', 'cnc_interp', *words], capture_output=True, text=True, timeout=280
    )
    taken = time.monotonic() - begun
    assert done.returncode == 0, done.stderr[-2000:]
    figures = re.search(r'cycle time +([\d.]+) s.*first motion ([\d.]+) s after', done.stdout)
    assert sum(map(float, figures.groups())) < taken
    assert main(['check', str(bag), '--program', str(program), '--json']) == 0
    assert json.loads(capsys.readouterr().out)['ok']
    with Bag(bag) as recorded:
        told = recorded.read('machine_signals')
        executed = [f for chunk in recorded.read('executed_setpoints') for f in chunk.functions]
    assert [f.number for f in executed] == list(range(len(executed)))
    outputs = [dict(zip(m.outputs, m.output_values, strict=True)) for m in told]
    inputs = [dict(zip(m.inputs, m.input_values, strict=True)) for m in told]
    # The changer was asked for each tool, and its answer ended the question. States are told now
    # and then, so the answer itself may lie between two of them.
    for tool in (5.0, 6.0):
        with_tool = [k for k, o in enumerate(outputs) if o['tool_number'] == tool]
        asked = [k for k in with_tool if outputs[k]['tool_change']]
        answered = [k for k in with_tool if inputs[k]['tool_changed']]
        assert asked and with_tool[-1] > asked[-1]
        assert all(asked[0] <= k for k in answered)
    assert {o['spindle_speed'] for o in outputs} >= {8000.0, 9000.0}
    assert not any(outputs[-1][name] for name in ('spindle_forward', 'coolant_flood'))


TAPPED = """G21 G90 G17
S600 M3
G0 X0 Y0 Z20
G84 Z-6 R4 F750
X12
G80 M5
G0 Z20
M30
"""


def test_tapped_holes_are_recorded_in_step_with_the_spindle_and_proven(tmp_path, capsys):
    program, bag, plan = tmp_path / 'tap.ngc', tmp_path / 'bag', tmp_path / 'plan'
    program.write_text(TAPPED)
    words = ['run', str(program), '--machine', 'vmc', '--record', str(bag)]
    done = subprocess.run(
        [sys.executable, '-m', 'cnc_interp', *words], capture_output=True, text=True, timeout=280
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert main(['check', str(bag), '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    (thread,) = (each for each in found['findings'] if each['what'] == 'thread')
    assert found['ok'] and 0.0 < thread['value'] < 10e-6
    machine = Machine.load('vmc')
    with Bag(bag) as recorded:
        write_run(recorded_run(recorded), machine, plan)
        lines = recorded.read('followed_spindle')
    depth = dict[int, float]()
    for m in lines:
        depth[m.line_number] = min(depth.get(m.line_number, 0.0), *m.positions[2::3])
    # The workpiece zero of the machine file lies at Z -400.
    assert list(depth) == [4, 5] and all(abs(z + 406 * MM) < 0.05 * MM for z in depth.values())
    assert verify_plan(plan, machine).ok
    # Some angles may be unknown, most may not; whatever is out of step is found.
    columns = dict(np.load(plan / 'followed.npz'))
    angle, number = columns['angle'], np.arange(len(columns['angle']))

    def failures(changed):
        np.savez(plan / 'followed.npz', **(columns | {'angle': changed}))
        return verify_plan(plan, machine).failures

    assert not failures(np.where(number % 20 == 0, np.nan, angle))
    assert 'is known in' in failures(np.where(number % 5 == 0, np.nan, angle))[0]
    assert any('thread' in fault for fault in failures(1.01 * angle))
