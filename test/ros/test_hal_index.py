"""Homing by an index pulse over HAL: LinuxCNC's handshake, in a converted configuration."""

import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

sys.path.append(str(Path(__file__).parents[2] / 'benchmarks'))

import hal_session
from operated import Bench, Result

from cnc_interp.commands.cli import main
from cnc_interp.convert.linuxcnc_hal import hal_file
from cnc_interp.convert.linuxcnc_wiring import Wiring
from cnc_interp.machine_model.machine import Machine, find_machine_file
from cnc_interp.machine_model.signals import signals
from cnc_interp.nodes.parameters import NODES

pytestmark = pytest.mark.thorough

INDEX = -13.0  #: Of X in the machine [mm].
HOMING = f"""
homing:
  switches: {{X: -20.0}}
  index: {{X: {INDEX}}}
signals:
  inputs: {{home_x: }}
"""
SIGNALS = signals(yaml.safe_load(HOMING), ['X'])
SWITCH, MET = -37.0, -30.0  #: The switch, and the index after it, as X stands really [mm].
#: A loop whose encoder, a spindle with an index in 10 mm, counts anew; its place is in x-true.
LINUXCNC = (
    """loadrt [EMCMOT]EMCMOT servo_period_nsec=1000000
loadrt lowpass names=y-axis,z-axis,a-axis,c-axis
loadrt sum2 names=x-drive
loadrt sim_spindle names=x-motor
loadrt scale names=x-lead
loadrt integ names=x-true
loadrt comp names=x-home
addf x-motor servo-thread
addf x-lead servo-thread
addf motion-command-handler servo-thread
addf motion-controller servo-thread
addf x-drive servo-thread
addf x-true servo-thread
addf x-home servo-thread
net x-cmd joint.0.motor-pos-cmd => x-drive.in0
net x-turns x-motor.position-fb => x-lead.in
net x-fb x-lead.out => x-drive.in1 joint.0.motor-pos-fb
net x-pulse x-motor.index-enable <=> joint.0.index-enable
net x-speed x-drive.out => x-motor.velocity-cmd x-true.in
net x-place x-true.out => x-home.in0
net x-switch x-home.out => joint.0.home-sw-in
setp x-drive.gain0 500
setp x-drive.gain1 -500
setp x-home.hyst 0
setp x-motor.scale 0.1
setp x-lead.gain 10
"""
    + f'setp x-home.in1 {SWITCH}\n'
    + ''.join(
        f"""addf {x}-axis servo-thread
net {x}-cmd joint.{k}.motor-pos-cmd => {x}-axis.in
net {x}-fb {x}-axis.out => joint.{k}.motor-pos-fb
setp {x}-axis.gain 0.5
"""
        for k, x in enumerate('yzac', 1)
    )
)


@pytest.fixture
def hal():
    reason = hal_session.why_not()
    if reason:
        pytest.skip(reason)
    made, left_out = hal_file(LINUXCNC, 'XYZAC', Wiring('XYZAC'), SIGNALS)
    assert len(left_out) == 1 and 'emergency stop' in left_out[0]
    text = made.replace('cnc-empty', 'empty').replace('cnc-x-asked', 'index_x')
    with hal_session.Session(text, SIGNALS) as session:
        yield session


@pytest.fixture
def bench(hal, tmp_path):
    file = tmp_path / 'indexed.yaml'
    file.write_text(find_machine_file('xyzac').read_text() + HOMING)
    takes = [n for n, declared in NODES.items() if any(p.name == 'machine' for p in declared)]
    parameters = {node: {'machine': f"'{file}'"} for node in takes}
    parameters['machine_node'] |= {'drives': 'hal', 'hal_depth': 300}
    running = Bench(parameters)
    yield running
    running.close()


def test_an_axis_counts_from_its_index_and_is_not_kicked_when_the_encoder_counts_anew(
    hal, bench, capfd
):
    command = ['home', '--namespace', bench.namespace, '--domain', str(bench.domain)]
    for again in range(2):
        hal.forget()
        assert main(command) == 0, capfd.readouterr().err
        periods = hal.periods()
        command_x, encoder = periods.commanded[:, 0], periods.actual[:, 0]
        if not again:  # what the loop sees: it counts anew, and its error does not show it
            assert np.abs(np.diff(encoder)).max() > 29.9
        most = Machine.load('xyzac').max_velocity[0] / hal_session.UNITS[0]
        assert np.abs(command_x - encoder).max() < 1.5 * 0.1 * most / 500.0
        assert periods.outputs[:, 0].any()
        state = bench.next_state()
        while state.positions != (state := bench.next_state()).positions:
            continue  # what waits in HAL's FIFO is played
        assert hal.tell('gets', 'index_x').strip() == 'FALSE'
        true = float(hal.tell('getp', 'x-true.out'))
        assert all(state.homed) and true > MET
        assert 1e3 * state.positions[0] == pytest.approx(true - MET + INDEX, abs=1e-4)
    result = bench.run(text='G0 X0\nG1 X10 F1000')
    assert result.code == Result.SUCCEEDED, result.message
