"""A first part over HAL: tool change, spindle, coolant and probe at HAL's pins, then proven."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

sys.path.append(str(Path(__file__).parents[2] / 'benchmarks'))

import hal_session

from cnc_interp.client.bag import Bag
from cnc_interp.commands.cli import main
from cnc_interp.machine.hal_file import pins_of
from cnc_interp.machine_model.machine import find_machine_file
from cnc_interp.machine_model.signals import signals

pytestmark = pytest.mark.thorough

SIGNALS = signals({'signals': 'milling'})
INPUTS = pins_of(5, SIGNALS)[1]
SURFACE = 138.391  #: Place of Z where the probe touches, at 3 mm below the zero of the part [mm].
SPEED, LATE = 6000, 0.25  #: Of the spindle [rev/min], and what it takes to get there [s].
PROGRAM = """G21 G90
G0 X10 Y5 Z8
T3 M6
G38.2 Z-20 F300
G10 L20 P1 Z0
G0 Z8
S6000 M3
M8
G1 Z-1 F600
X20
M9
G0 Z8
M5
M2
"""


@pytest.fixture
def hal():
    reason = hal_session.why_not()
    if reason:
        pytest.skip(reason)
    with hal_session.Session(signals=SIGNALS) as session:
        session.tell('loadrt', 'limit2', 'names=spindle')
        session.tell('loadrt', 'comp', 'names=touches,speeds')
        given = {'touches.in1': SURFACE, 'speeds.in0': SPEED - 1.0, 'spindle.maxv': SPEED / LATE}
        given |= {'touches.hyst': 0.0, 'speeds.hyst': 0.0}
        for name, value in given.items():
            session.tell('setp', name, str(value))
        for name in ('spindle', 'touches', 'speeds'):
            session.tell('addf', name, 'servo-thread')
        session.tell('net', 'z-fb', 'touches.in0')
        session.tell('net', 'touched', 'touches.out', INPUTS['probe'])
        session.tell('net', 'spindle_speed', 'spindle.in')
        session.tell('net', 'speed', 'spindle.out', 'speeds.in1')
        session.tell('net', 'turning', 'speeds.out', INPUTS['spindle_at_speed'])
        session.tell('net', 'tool_change', INPUTS['tool_changed'])
        session.forget()
        yield session


def test_all_functions_come_out_in_order_and_in_place(hal, tmp_path, capsys):
    file, program, bag = (tmp_path / name for name in ('m.yaml', 'part.ngc', 'bag'))
    file.write_text(find_machine_file('xyzac').read_text() + '\nsignals: milling\n')
    program.write_text(PROGRAM)
    words = ['run', str(program), '--machine', str(file), '--drives', 'hal,hal_depth=300']
    done = subprocess.run(
        [sys.executable, '-m', 'cnc_interp', *words, '--record', str(bag), '--json'],
        capture_output=True, text=True, timeout=280,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2000:] + done.stdout[-2000:]
    periods = hal.periods()
    names = [signal.name for signal in SIGNALS.wires]
    out = {name: periods.outputs[:, k] for k, name in enumerate(names)}

    def changes(name):
        return (np.flatnonzero(np.diff(out[name])) + 1).tolist()

    changed, _ = changes('tool_change')
    turns, stops = changes('spindle_forward')
    flows, dries = changes('coolant_flood')
    armed, heard = changes('probe_armed')
    assert out['tool_number'][changed] == 3 and out['spindle_speed'][turns] == SPEED
    assert changed < armed < heard < turns < flows < dries < stops
    # In their place: nothing moves where an answer is waited for, nor before it.
    z, x = periods.commanded[:, 2], periods.commanded[:, 0]
    assert np.ptp(periods.commanded[turns : turns + round(1e3 * LATE)], axis=0).max() == 0.0
    assert x[flows] == x[turns] and x[dries] > x[flows] + 9.9
    # The contact is the place of the very period in which the switch came on.
    touched = np.flatnonzero(periods.actual[armed:, 2] < SURFACE)[0] + armed
    assert z[touched : touched + 1000].min() < z[touched]  # it stops within its limits
    with Bag(bag) as recorded:
        (contact,) = recorded.read('probe_contact')
    assert 1e3 * contact.positions[2] in periods.actual[touched - 1 : touched + 2, 2]
    assert main(['check', str(bag), '--json']) == 0
    parts = json.loads(capsys.readouterr().out)['parts']
    assert len(parts) == 2 and all(part['ok'] for part in parts)
