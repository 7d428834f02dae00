"""HAL files of LinuxCNC with cnc_interp in the place of the motion controller."""

from pathlib import Path

import pytest

from cnc_interp.commands import machine_files
from cnc_interp.commands.cli import main
from cnc_interp.core import InterpError
from cnc_interp.machine.hal_file import columns_of, hal_file
from cnc_interp.machine_model.signals import signals as signals_of

HAL = """loadrt [KINS]KINEMATICS
loadrt [EMCMOT]EMCMOT base_period_nsec=[EMCMOT]BASE_PERIOD servo_period_nsec=[EMCMOT]SERVO_PERIOD
loadrt stepgen step_type=0,0,0
addf stepgen.capture-position servo-thread
addf motion-command-handler servo-thread
addf motion-controller servo-thread
addf stepgen.update-freq servo-thread
net x-command joint.0.motor-pos-cmd => stepgen.0.position-cmd  # the motor of X
net y-command joint.1.motor-pos-cmd => \\
  stepgen.1.position-cmd
net z-command joint.2.motor-pos-cmd => stepgen.2.position-cmd
net x-position stepgen.0.position-fb => joint.0.motor-pos-fb
net y-position stepgen.1.position-fb => joint.1.motor-pos-fb
net z-position stepgen.2.position-fb => joint.2.motor-pos-fb
net x-on joint.0.amp-enable-out => stepgen.0.enable
net y-on joint.1.amp-enable-out
net y-on => stepgen.1.enable parport.0.pin-01-out
net z-on joint.2.amp-enable-out => stepgen.2.enable
net z-alarm parport.0.pin-11-in => joint.2.amp-fault-in
net mushroom <= parport.0.pin-10-in
net mushroom => iocontrol.0.emc-enable-in
net spindle-cw spindle.0.forward => parport.0.pin-09-out
setp stepgen.0.position-scale [JOINT_0]SCALE
"""


def signals(text):
    """Pins of each signal; a pin is in one signal only, as HAL demands."""
    found = {}
    for words in (line.partition('#')[0].split() for line in text.splitlines()):
        if words[:1] == ['net']:
            found.setdefault(words[1], set()).update(w for w in words[2:] if '=' not in w)
    pins = [pin for group in found.values() for pin in group]
    assert len(pins) == len(set(pins))
    return list(found.values())


@pytest.mark.parametrize('joints', ['XYZ', 'YZX'])
def test_every_motor_hears_the_axis_of_its_joint(joints):
    made, left_out = hal_file(HAL, 'XYZ', joints)
    nets = signals(made)
    for joint, letter in enumerate(joints):
        i = 'XYZ'.index(letter)
        motor = {f'streamer.0.pin.{i}', f'sampler.0.pin.{i}', f'stepgen.{joint}.position-cmd'}
        assert motor in nets
        assert {f'stepgen.{joint}.position-fb', f'sampler.0.pin.{3 + i}'} in nets
    alarm = 'XYZ'.index(joints[2])
    assert {'parport.0.pin-11-in', f'wsum.0.bit.{alarm}.in', f'fault-{alarm}.in1'} in nets
    powered = {
        'power-given.ok-out',
        'wsum.0.bit.3.in',
        'parport.0.pin-01-out',
        'drive-tripped.in1',
    }
    for bits in ({'streamer.0.pin.6', 'bits-0.in'}, {'wsum.0.sum', 'sampler.0.pin.6'}):
        assert bits in nets
    assert powered | {f'stepgen.{k}.enable' for k in range(3)} in nets
    assert {'parport.0.pin-10-in', 'power-given.ok-in'} in nets
    assert left_out == ['net spindle-cw spindle.0.forward => parport.0.pin-09-out']
    assert 'cfg=ffffffu\n' in made and 'cfg=ffffffs\n' in made
    calls = [line.split()[1] for line in made.splitlines() if line.startswith('addf ')]
    assert calls[0] == 'stepgen.capture-position' and calls[-1] == 'stepgen.update-freq'
    assert calls.index('streamer.0') < calls.index('sampler.0')
    active = [line for line in made.splitlines() if not line.startswith('#')]
    assert 'joint.' not in ' '.join(active)
    assert 'setp stepgen.0.position-scale [JOINT_0]SCALE' in active


def test_without_a_contact_the_emergency_stop_is_told_to_be_missing():
    looped = HAL.replace('net mushroom <= parport.0.pin-10-in\n', '').replace(
        'net mushroom =>', 'net loop iocontrol.0.user-enable-out =>'
    )
    made, left_out = hal_file(looped, 'XYZ', 'XYZ')
    assert 'setp power-given.ok-in 1\n' in made and 'emergency stop' in left_out[-1]


@pytest.mark.parametrize(
    ('text', 'joints', 'told'),
    [
        (HAL, 'XYYZ', 'two motors'),
        (HAL, 'XYA', 'axes: X Y Z'),
        (HAL.replace('joint.2.motor-pos-fb', ''), 'XYZ', 'joint.2.motor-pos-fb'),
        (HAL.replace('addf motion-controller', 'addf another'), 'XYZ', 'motion-controller'),
        ('net\naddf\nloadrt\n', 'XYZ', 'no HAL file names'),
    ],
)
def test_an_axis_that_would_not_move_is_refused(text, joints, told):
    with pytest.raises(InterpError, match=told):
        hal_file(text, 'XYZ', joints)


def test_the_command_reads_all_files_and_tells_what_is_not_connected(tmp_path, capsys):
    for name, lines in zip('ab', (HAL.splitlines()[:12], HAL.splitlines()[12:]), strict=True):
        (tmp_path / name).write_text('\n'.join(lines))
    words = ['hal', 'xyz', str(tmp_path / 'a'), str(tmp_path / 'b')]
    assert main([*words, '--out', str(tmp_path / 'made.hal')]) == 0
    assert (tmp_path / 'made.hal').read_text() == hal_file(HAL, 'XYZ', 'XYZ')[0]
    assert capsys.readouterr().err.startswith('not connected: net spindle-cw')
    assert main(['hal', 'xyz', str(tmp_path / 'missing')]) == 2


def test_a_file_that_is_not_there_is_sought_among_those_of_linuxcnc(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(machine_files, 'HAL_LIBRARY', tmp_path)
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'core_own.hal').write_text(HAL)
    for name in ('elsewhere/core_own.hal', 'LIB:core_own.hal'):
        assert main(['hal', 'xyz', name, '--out', 'made.hal']) == 0
    assert Path('made.hal').read_text() == hal_file(HAL, 'XYZ', 'XYZ')[0]
    assert main(['hal', 'xyz', 'LIB:core_own.hal', 'LIB:sim.tcl']) == 2
    assert 'LIB:sim.tcl: is Tcl' in capsys.readouterr().err


def test_inputs_of_reference_switches_take_over_their_pins():
    declared = signals_of({'signals': {'inputs': {'door': None, 'home_z': None}}})
    switch = 'net z-home parport.0.pin-12-in => joint.2.home-sw-in\n'
    made, left_out = hal_file(HAL + switch, 'XYZ', 'XYZ', declared)
    assert {'parport.0.pin-12-in', 'wsum.0.bit.6.in'} in signals(made)
    assert 'z-home' not in ' '.join(left_out)
    assert switch.strip() in hal_file(HAL + switch, 'XYZ', 'XYZ')[1]


def test_a_module_of_the_configuration_is_not_loaded_again():
    added = 'loadrt not count=2\nloadrt and2 names=a,b\n'
    loaded = [
        line
        for line in hal_file(added + HAL, 'XYZ', 'XYZ')[0].splitlines()
        if line.startswith('loadrt ')
    ]
    assert loaded[:2] == [
        'loadrt not names=not.0,not.1,power-unwanted',
        'loadrt and2 names=a,b,drive-tripped',
    ]
    modules = [line.split()[1] for line in loaded]
    assert len(modules) == len(set(modules)) and 'timedelay' in modules


def test_bits_share_columns_and_more_numbers_than_hal_has_columns_are_refused():
    many = signals_of({'signals': {'inputs': {f'door_{k}': None for k in range(26)}}})
    assert columns_of(5, many) == ('ffffffffffu', 'ffffffffffsss')
    for count, fits in ((10, True), (11, False)):
        outputs = {f'level_{k}': {'range': [0, 1]} for k in range(count)}
        declared = signals_of({'signals': {'outputs': outputs}})
        if fits:
            assert columns_of(5, declared)[0] == 'f' * 20 + 'u'
            continue
        with pytest.raises(InterpError, match=r'streamer .* most 21 columns, .* needs 22'):
            columns_of(5, declared)


def test_what_the_end_of_the_machine_node_switches_off_has_a_gate_with_the_power():
    """After kill -9 of machine_node, the axes lost their power and the spindle turned on."""
    given = {
        'outputs': {'spindle_forward': None, 'spindle_speed': {'range': [0, 9]}, 'lamp': None},
        'switched_off': {
            'spindle_forward': 'always',
            'spindle_speed': ['lost_machine'],
            'lamp': ['fault'],
        },
    }
    text = HAL + 'net rate spindle.0.speed-out-abs => pwmgen.0.value\n'
    made, left_out = hal_file(text, 'XYZ', 'XYZ', signals_of({'signals': given}))
    assert not left_out
    nets = signals(made)
    power = next(net for net in nets if 'power-given.ok-out' in net)
    assert {'on-spindle_forward.in1', 'on-spindle_speed.sel', 'stepgen.0.enable'} < power
    for net in (
        {'bits-0.out-01', 'on-spindle_forward.in0'},
        {'on-spindle_forward.out', 'parport.0.pin-09-out'},
        {'streamer.0.pin.6', 'on-spindle_speed.in1'},
        {'on-spindle_speed.out', 'pwmgen.0.value'},
    ):
        assert net in nets
    calls = [line.split()[1] for line in made.splitlines() if line.startswith('addf ')]
    order = ['streamer.0', 'power-given', 'on-spindle_forward', 'sampler.0']
    assert [name for name in calls if name in order] == order
    assert 'on-lamp' not in made


def test_an_index_shifts_command_and_position_of_its_axis_in_the_same_period():
    given = {'signals': {'inputs': {'home_y': None}}}
    declared = signals_of(given, ['X', 'Y'])  # the switch of X is no input
    text = HAL + 'net y-index encoder.1.index-enable <=> joint.1.index-enable\n'
    made, left_out = hal_file(text, 'XYZ', 'XYZ', declared)
    assert 'y-index' not in ' '.join(left_out) and 'x-index' not in made
    nets = signals(made)
    for net in (
        {'encoder.1.index-enable', 'y-ask.out', 'y-found.in', 'wsum.0.bit.6.in'},
        {'stepgen.1.position-cmd', 'y-index.out'},
        {'stepgen.1.position-fb', 'y-index.fb-in', 'y-jump.in0'},
        {'streamer.0.pin.1', 'sampler.0.pin.1', 'y-index.in'},
        {'y-index.fb-out', 'y-jump.in1', 'sampler.0.pin.4'},
        {'bits-0.out-01', 'on-index_y.in0'},
        {'on-index_y.out', 'y-asks.in'},
        {'y-off.out', 'y-off.in0', 'y-index.offset', 'sampler.0.pin.6'},
    ):
        assert net in nets
