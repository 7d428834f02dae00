"""Threads and tapped holes over HAL: the axis in step with an encoder, seen at HAL's pins."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

sys.path.append(str(Path(__file__).parents[2] / 'benchmarks'))

import hal_session

from cnc_interp.commands.cli import main
from cnc_interp.core.small_files import config_directory, read_yaml
from cnc_interp.machine.hal_pins import pins_of
from cnc_interp.machine_model.machine import find_machine_file
from cnc_interp.machine_model.signals import signals

pytestmark = pytest.mark.thorough

RAMP = 1500.0  #: Of the spindle [rev/min/s].
MILLING = read_yaml(config_directory() / 'signals' / 'milling.yaml')
MILLING['inputs']['spindle_angle'] = {'ramp_rpm_per_s': RAMP}
SIGNALS = signals({'signals': MILLING})
AT = pins_of(5, SIGNALS)[1]
COUNTS = 4096  #: Of its encoder in a turn.
PITCH, DEPTH = 1.5, 10
#: Setpoints in the FIFO: so many periods before it is used the angle is told.
AHEAD = 30
PROGRAM = f"""G21 G90
G0 X10 Y5 Z5
S600 M3
G33 Z-{DEPTH} K{PITCH}
G0 X12
G0 Z5
S900
G0 X10
G33 Z-{DEPTH} K{PITCH}
G0 X20
G0 Z5
G84 X20 Z-{DEPTH} R5 F{900 * PITCH}
G80
M5
M2
"""


ORDER = 'sense', 'asked', 'motor', 'spindle', 'counts', 'whole', 'number', 'turned', 'steady'
#: A spindle that takes its time, and an encoder of whole counts, read before HAL's FIFO.
WIRED = f"""loadrt mux4 names=sense
loadrt mult2 names=asked
loadrt limit2 names=motor
loadrt sim_spindle names=spindle
loadrt scale names=counts,turned
loadrt conv_float_s32 names=whole
loadrt conv_s32_float names=number
loadrt near names=steady
setp sense.in1 1
setp sense.in2 -1
setp motor.maxv {RAMP}
setp spindle.scale {1 / 60}
setp counts.gain {COUNTS}
setp turned.gain {1 / COUNTS}
setp steady.difference 5
net spindle_forward sense.sel0
net spindle_reverse sense.sel1
net spindle_speed asked.in0
net sense sense.out => asked.in1
net asked asked.out => motor.in steady.in1
net rate motor.out => spindle.velocity-cmd steady.in2
net place spindle.position-fb => counts.in
net counts counts.out => whole.in
net whole whole.out => number.in
net number number.out => turned.in
net turns turned.out => {AT['spindle_angle']}
net steady steady.out => {AT['spindle_at_speed']}
""" + ''.join(f'addf {name} servo-thread\n' for name in ORDER)


@pytest.fixture
def hal():
    reason = hal_session.why_not()
    if reason:
        pytest.skip(reason)
    text = (hal_session.FOLDER / 'simulated_axes.hal').read_text()
    text = text.replace('addf streamer.0', f'{WIRED}addf streamer.0')
    with hal_session.Session(text, SIGNALS, ['turns', 'rate']) as session:
        session.forget()
        yield session


def recorded_run(text, folder):
    """Run a program over HAL on a machine with this spindle; return its bag."""
    file, program, bag = (folder / name for name in ('m.yaml', 'part.ngc', 'bag'))
    file.write_text(
        find_machine_file('xyzac').read_text()
        + yaml.safe_dump({'signals': MILLING}, sort_keys=False)
    )
    program.write_text(text)
    words = ['run', str(program), '--machine', str(file), '--drives', f'hal,hal_depth={AHEAD}']
    done = subprocess.run(
        [sys.executable, '-m', 'cnc_interp', *words, '--record', str(bag), '--json'],
        capture_output=True,
        text=True,
        timeout=280,
    )
    assert done.returncode == 0, done.stderr[-2000:] + done.stdout[-2000:]
    return bag


def test_threads_and_a_tapped_hole_follow_the_encoder_at_the_pins(hal, tmp_path, capsys):
    bag = recorded_run(PROGRAM, tmp_path)
    periods, worst = hal.periods(), 0.0
    z, turns = periods.commanded[:, 2], periods.more[:, 0]
    moved = np.flatnonzero(np.diff(z))
    assert not periods.empty[moved[0] : moved[-1]].any()
    lines = [
        line
        for line in np.split(moved, np.flatnonzero(np.diff(moved) > 20) + 1)
        if np.ptp(z[line]) > 14.9 and z[line[0]] > z[line[len(line) // 2]]
    ]
    assert len(lines) == 3
    phases = []
    for k, line in enumerate(lines):
        rows = slice(line[0], line[-1] + 2)
        place = (z[line[0]] - z[rows]) / PITCH
        tapped = k == 2
        assert place.max() == pytest.approx(10.0, abs=0.1 if tapped else 1e-9)
        assert place[-1] == pytest.approx(0.0 if tapped else 10.0, abs=1e-9)
        in_step = (place > 1.0) & (tapped | (place < 9.0))
        off = PITCH * (turns[rows] - place)[in_step]
        assert np.ptp(off) < (15e-3 if tapped else 2e-3)
        phases.append(np.median(off))
        worst = max(worst, np.abs(off - PITCH * np.round(np.median(off) / PITCH)).max())
    between = (phases[1] - phases[0]) / PITCH
    assert abs(between - round(between)) * PITCH < 2e-3  # two passes of one thread
    assert main(['check', str(bag), '--json']) == 0
    found = json.loads(capsys.readouterr().out)['findings']
    (thread,) = (each for each in found if each['what'] == 'thread')
    assert thread['value'] == pytest.approx(1e-3 * worst, abs=1e-6)
