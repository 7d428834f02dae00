"""A gantry over HAL: each of two motors stops at its own switch, so homing squares it."""

import sys
from pathlib import Path

import pytest
import yaml

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

sys.path.append(str(Path(__file__).parents[2] / 'benchmarks'))

import hal_session
from operated import Bench, Result

from cnc_interp.commands.cli import main
from cnc_interp.convert.linuxcnc_hal import hal_file
from cnc_interp.convert.linuxcnc_wiring import Wiring
from cnc_interp.machine.homing import BACK
from cnc_interp.machine_model.machine import Machine, find_machine_file
from cnc_interp.machine_model.signals import signals
from cnc_interp.nodes.parameters import NODES

pytestmark = pytest.mark.thorough

AT = -20.0  #: Of the first switch of Y in the machine [mm].
HOMING = f"""
homing:
  switches: {{Y: {AT}}}
  squared: [Y]
signals:
  inputs: {{home_y: }}
"""
SIGNALS = signals(yaml.safe_load(HOMING), squared=['Y'])
#: Where the motors meet their switches, as they count from their start; the second switch is
#: mounted further in, by the difference of the home offsets.
SWITCHES, OFFSETS = (-12.0, -14.5), (AT, AT + 0.75)
LINUXCNC = (
    """loadrt [EMCMOT]EMCMOT servo_period_nsec=1000000
loadrt lowpass names=y1-drive,y2-drive,x-axis,z-axis,a-axis,c-axis
loadrt comp names=y1-home,y2-home
addf motion-command-handler servo-thread
addf motion-controller servo-thread
"""
    + ''.join(
        f"""addf y{m}-drive servo-thread
addf y{m}-home servo-thread
net y{m}-cmd joint.{k}.motor-pos-cmd => y{m}-drive.in
net y{m}-fb y{m}-drive.out => joint.{k}.motor-pos-fb y{m}-home.in0
net y{m}-switch y{m}-home.out => joint.{k}.home-sw-in
setp y{m}-drive.gain 0.5
setp y{m}-home.hyst 0
setp y{m}-home.in1 {at}
"""
        for m, k, at in ((1, 1, SWITCHES[0]), (2, 3, SWITCHES[1]))
    )
    + ''.join(
        f"""addf {x}-axis servo-thread
net {x}-cmd joint.{k}.motor-pos-cmd => {x}-axis.in
net {x}-fb {x}-axis.out => joint.{k}.motor-pos-fb
setp {x}-axis.gain 0.5
"""
        for k, x in zip((0, 2, 4, 5), 'xzac', strict=True)
    )
)


@pytest.fixture
def hal():
    reason = hal_session.why_not()
    if reason:
        pytest.skip(reason)
    wiring = Wiring('XYZYAC', switches={1: OFFSETS[0], 3: OFFSETS[1]})
    made, left_out = hal_file(LINUXCNC, 'XYZAC', wiring, SIGNALS)
    assert len(left_out) == 1 and 'emergency stop' in left_out[0]
    made = made.replace('cnc-empty', 'empty').replace('cnc-on-square_y-out', 'square_y')
    nets = {'cnc-y-cmd': 'y-cmd', 'cnc-y-place-out': 'y-fb'}
    for old, new in nets.items():
        made = made.replace(f'net {old} ', f'net {new} ')
    more = ['y1-cmd', 'y2-cmd', 'y1-fb', 'y2-fb']
    with hal_session.Session(made, SIGNALS, more) as session:
        yield session


@pytest.fixture
def bench(hal, tmp_path):
    file = tmp_path / 'gantry.yaml'
    file.write_text(find_machine_file('xyzac').read_text() + HOMING)
    takes = [n for n, declared in NODES.items() if any(p.name == 'machine' for p in declared)]
    parameters = {node: {'machine': f"'{file}'"} for node in takes}
    parameters['machine_node'] |= {'drives': 'hal', 'hal_depth': 300}
    running = Bench(parameters)
    yield running
    running.close()


def at_rest(bench):
    state = bench.next_state()
    while state.positions != (state := bench.next_state()).positions:
        continue  # what waits in HAL's FIFO is played
    return state


def test_homing_squares_a_gantry_whose_motors_start_askew(hal, bench, capfd):
    command = ['home', '--namespace', bench.namespace, '--domain', str(bench.domain)]
    most = Machine.load('xyzac').max_velocity[1] / hal_session.UNITS[1] * 1e-3  # in a period

    def square():
        """Both motors, counted from their switches, are where the machine says that Y is."""
        state = at_rest(bench)
        while float(hal.tell('getp', 'y2-skew.out')) != pytest.approx(OFFSETS[0] - OFFSETS[1]):
            continue
        for m, at, home in zip((1, 2), SWITCHES, OFFSETS, strict=True):
            counted = float(hal.tell('getp', f'y{m}-drive.out')) - at + home
            assert 1e3 * state.positions[1] == pytest.approx(counted, abs=3.0 * BACK * most)

    for _ in range(2):
        hal.forget()
        assert main(command) == 0, capfd.readouterr()
        square()
        more = hal.periods().more
        assert abs(more[1:] - more[:-1]).max() <= 1.01 * most  # no motor jumps
    result = bench.run(text='G0 Y0\nG1 Y10 F1000')
    assert result.code == Result.SUCCEEDED, result.message
    square()


def test_a_motor_that_lags_takes_the_power_away(hal, bench):
    bench.run(text='G0 Y0')
    hal.tell('setp', 'y2-drive.gain', '0.0')  # it is stuck
    command = ['home', '--namespace', bench.namespace, '--domain', str(bench.domain)]
    assert main(command) != 0
    assert hal.tell('gets', 'cnc-power').strip() == 'FALSE'
