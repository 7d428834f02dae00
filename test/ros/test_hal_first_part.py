"""A first part over HAL: tools, spindle, coolant, probe and a tapped hole at its pins, proven."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

sys.path.append(str(Path(__file__).parents[2] / 'benchmarks'))

import hal_session
from test_hal_spindle import AT, PITCH, RAMP, SIGNALS, WIRED, recorded_run

from cnc_interp.client.bag import Bag
from cnc_interp.commands.cli import main

pytestmark = pytest.mark.thorough

SURFACE = 138.391  #: Place of Z where the probe touches, at 3 mm below the zero of the part [mm].
SPEED = 900  #: Of the spindle [rev/min].
PROGRAM = f"""G21 G90
G0 X10 Y5 Z8
T3 M6
G38.2 Z-20 F300
G10 L20 P1 Z0
G0 Z8
S{SPEED} M3
M8
G1 Z-1 F600
X20
M9
G0 Z8
T4 M6
S{SPEED} M3
G84 X20 Z-6 R3 F{SPEED * PITCH}
G80
G0 Z8
M5
M2
"""


@pytest.fixture
def hal():
    reason = hal_session.why_not()
    if reason:
        pytest.skip(reason)
    text = (hal_session.FOLDER / 'simulated_axes.hal').read_text()
    text = text.replace('addf streamer.0', f'{WIRED}addf streamer.0')
    with hal_session.Session(text, SIGNALS, ['turns']) as session:
        session.tell('loadrt', 'comp', 'names=touches')
        for name, value in {'touches.in1': SURFACE, 'touches.hyst': 0.0}.items():
            session.tell('setp', name, str(value))
        session.tell('addf', 'touches', 'servo-thread')
        session.tell('net', 'z-fb', 'touches.in0')
        session.tell('net', 'touched', 'touches.out', AT['probe'])
        session.tell('net', 'tool_change', AT['tool_changed'])
        session.forget()
        yield session


def test_all_functions_come_out_in_order_and_in_place(hal, tmp_path, capsys):
    bag = recorded_run(PROGRAM, tmp_path)
    periods = hal.periods()
    names = [signal.name for signal in SIGNALS.wires]
    out = {name: periods.outputs[:, k] for k, name in enumerate(names)}

    def changes(name):
        return (np.flatnonzero(np.diff(out[name])) + 1).tolist()

    changed, _, second, _ = changes('tool_change')
    turns, stops, taps, halts, above, _ = changes('spindle_forward')
    back, again = changes('spindle_reverse')
    flows, dries = changes('coolant_flood')
    armed, heard = changes('probe_armed')
    assert out['tool_number'][changed] == 3 and out['spindle_speed'][turns] == SPEED
    assert changed < armed < heard < turns < flows < dries < stops <= second < taps
    assert out['tool_number'][second] == 4 and taps < halts <= back < again <= above
    # In their place: nothing moves where an answer is waited for, nor before it.
    z, x = periods.commanded[:, 2], periods.commanded[:, 0]
    assert (
        np.ptp(periods.commanded[turns : turns + round(0.9e3 * SPEED / RAMP)], axis=0).max() == 0.0
    )
    assert x[flows] == x[turns] and x[dries] > x[flows] + 9.9
    # The contact is the place of the very period in which the switch came on.
    touched = np.flatnonzero(periods.actual[armed:, 2] < SURFACE)[0] + armed
    assert z[touched : touched + 1000].min() < z[touched]  # it stops within its limits
    with Bag(bag) as recorded:
        (contact,) = recorded.read('probe_contact')
    assert 1e3 * contact.positions[2] in periods.actual[touched - 1 : touched + 2, 2]
    # The tap is in step with the encoder, in, through the reversal and out.
    hole = slice(taps, above + 1000)
    depth, turned = (z[hole].max() - z[hole]) / PITCH, periods.more[hole, 0]
    in_step = (depth > 4.0) & (depth < 6.1)
    bottom = z[touched:turns].min() - 6.0
    assert z[hole].min() == pytest.approx(bottom, abs=0.5 * PITCH)  # the spindle ends it
    assert np.ptp(PITCH * (turned - depth)[in_step]) < 15e-3
    assert main(['check', str(bag), '--json']) == 0
    parts = json.loads(capsys.readouterr().out)['parts']
    assert len(parts) == 2 and all(part['ok'] for part in parts)
