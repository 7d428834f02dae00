"""Probing over the real nodes: a program that goes on with what it has touched."""

import json
import subprocess
import sys
from itertools import groupby

import numpy as np
import pytest
import yaml

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from operated import Bench

from cnc_interp.client.bag import Bag
from cnc_interp.commands.cli import main
from cnc_interp.core.small_files import config_directory
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.processes.node_processes import NODES

CONFIG = config_directory()

TOUCHES = """
probe: {radius_mm: 1.5, delay_ms: 2, noise_um: 1}
surfaces:
  - {box: [20, 0, -8], half: [10, 10, 5]}
"""
#: Touch the top fast, then twice slowly, then the side, and call these places 0.
PROGRAM = """G21 G90
G0 X20 Y0 Z15
G38.2 Z-20 F1200
O1 REPEAT [2]
  G38.4 Z[#5063+5] F300
  G38.2 Z[#5063-2] F60
O1 ENDREPEAT
G10 L20 P1 Z[#5422-#5063]
G0 Z5 (debug, top at #5063)
G0 X-5
Z-3
G38.3 X40 F120
O2 IF [#5070 EQ 1]
  G10 L20 P1 X[#5420-#5061-1.5]
O2 ENDIF
G38.5 X-5 F600
G38.3 X-8
O3 IF [#5070 EQ 0]
  G0 Z20
  X0
O3 ENDIF
M2
"""


@pytest.fixture(scope='module')
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp('probing')
    part, bag = folder / 'part.yaml', folder / 'bag'
    part.write_text(TOUCHES)

    def start(text, *words):
        program = folder / 'part.ngc'
        program.write_text(text)
        words = [
            'run',
            str(program),
            '--machine',
            'vmc',
            '--json',
            *words,
            '--drives',
            f'simulated,probe_touches={part}',
        ]
        return subprocess.run(
            [sys.executable, '-m', 'cnc_interp', *words],
            capture_output=True,
            text=True,
            timeout=280,
        )

    start.bag = bag
    return start


@pytest.mark.thorough
def test_a_program_goes_on_with_what_it_has_touched(run, capsys):
    done = run(PROGRAM, '--record', str(run.bag))
    assert done.returncode == 0, done.stderr[-2000:]
    told = json.loads(done.stdout)
    machine = Machine.load('vmc')
    tip, _ = Transform.of(machine).forward(np.array([list(told['position'].values())]))
    # The edge is at X 10 and the top at Z -3; delay and noise leave a few micrometres.
    assert np.allclose(tip[0] * 1e3, [10, 0, 17], atol=0.015)
    (top,) = (float(n.partition('top at')[2]) for n in told['notices'] if 'top at' in n)
    assert abs(top + 3.0) < 0.015
    with Bag(run.bag) as recorded:
        contacts = recorded.read('probe_contact')
    assert [c.line_number for c in contacts] == [3, 5, 6, 5, 6, 12, 16]
    assert main(['check', str(run.bag), '--json']) == 0
    parts = json.loads(capsys.readouterr().out)['parts']
    assert len(parts) == len(contacts) + 2 and all(part['ok'] for part in parts)


#: From an empty table to the end: probe, zero, mill with coolant, dwell, change the tool, tap.
FIRST_PART = """G21 G90
T3 M6
G0 X20 Y0 Z15
G38.2 Z-20 F600
G10 L20 P1 Z0
G0 Z8
S900 M3 M8
G1 Z-1 F600
X25
G4 P0.5
M9
G0 Z8
M5
T4 M6
S900 M3
G84 X20 Z-6 R3 F1350
G80
G0 Z8
M2
"""


def test_a_first_part_is_touched_milled_tapped_and_proven(run, tmp_path, capsys):
    bag = tmp_path / 'bag'
    done = run(FIRST_PART, '--record', str(bag))
    assert done.returncode == 0, done.stderr[-2000:]
    assert main(['check', str(bag), '--json']) == 0
    found = json.loads(capsys.readouterr().out)
    assert len(found['parts']) == 2 and all(part['ok'] for part in found['parts'])
    (thread,) = (each for each in found['findings'] if each['what'] == 'thread')
    assert 0.0 < thread['value'] < 10e-6
    with Bag(bag) as recorded:
        told = recorded.read('machine_signals')

    def seen(name):
        return [k for k, _ in groupby(m.output_values[m.outputs.index(name)] for m in told)]

    assert [tool for tool in seen('tool_number') if tool] == [3.0, 4.0]
    assert seen('spindle_reverse') == seen('coolant_flood') == [0.0, 1.0, 0.0]
    assert 900.0 in seen('spindle_speed') and seen('spindle_forward')[-1] == 0.0


@pytest.mark.thorough
@pytest.mark.parametrize(
    ('line', 'told'),
    [
        ('G38.2 Z0 F1200', 'line 3: G38.2: the probe made no contact up to the end of the line'),
        (
            'G38.2 Z-20 F1200\nG38.2 Z-25',
            'line 4: G38.2: the probe was in contact before it moved',
        ),
        ('G38.2 Z-20 F1200\nG0 X[1/0]', 'part.ngc:4: X: the expression has no value'),
    ],
)
def test_what_is_not_found_ends_the_program_at_rest(run, line, told):
    done = run(f'G21 G90\nG0 X20 Y0 Z15\n{line}\nM2\n')
    assert done.returncode == 1 and told in done.stdout, done.stdout + done.stderr
    assert ('WARNING' in done.stdout) == ('/0' in line)  # known before anything moves


@pytest.mark.thorough
def test_rotary_axes_are_found_by_touching_a_ball(tmp_path):
    """The machine file is 50 um wrong; what is written is right within 5 um."""
    wrong = yaml.safe_load((CONFIG / 'machines' / 'xyzac_trt.yaml').read_text())
    wrong['rotary']['secondary_offset_mm'][1] += 0.05
    wrong['rotary']['primary_offset_mm'][2] -= 0.04
    file, part, out = tmp_path / 'wrong.yaml', tmp_path / 'part.yaml', tmp_path / 'new.yaml'
    file.write_text(yaml.safe_dump(wrong))
    part.write_text(
        'probe: {noise_um: 1, delay_ms: 1}\nmachine: xyzac_trt\n'
        'surfaces: [{ball: [30, -20, 10], radius_mm: 12.5}]\n'
    )
    own = {'machine_node': {'probe_touches': str(part)}}
    nodes = Bench({node: {'machine': str(file), **own.get(node, {})} for node in NODES})
    try:
        nodes.run(text='G0 X31 Y-19.5 Z28', mdi=True)
        words = [
            '--ball',
            '25',
            '--tip',
            '3',
            '--feed',
            '1500',
            '--slow',
            '60',
            '--primary',
            '-40',
            '40',
            '--secondary',
            '0',
            '90',
        ]
        words += ['--domain', str(nodes.domain), '--namespace', nodes.namespace, '--out', str(out)]
        done = subprocess.Popen(
            [sys.executable, '-m', 'cnc_interp', 'probe-rotary', *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        nodes.spin_until(lambda: done.poll() is not None, 250)
        assert done.returncode == 0, done.stdout.read()
    finally:
        nodes.close()
    found, right = Machine.load(out), Machine.load('xyzac_trt')
    seen = [(1, 1), (2, 1), (2, 2)]
    for place in seen:
        assert abs(found.offsets[place] - right.offsets[place]) < 5e-6
