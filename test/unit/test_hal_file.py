"""HAL files of LinuxCNC with cnc_interp in the place of the motion controller."""

import re
from pathlib import Path

import pytest

from cnc_interp.commands.cli import main
from cnc_interp.convert import linuxcnc_files
from cnc_interp.convert.linuxcnc_hal import hal_file
from cnc_interp.convert.linuxcnc_wiring import Wiring
from cnc_interp.core import InterpError
from cnc_interp.machine.hal_pins import columns_of
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
    made, left_out = hal_file(HAL, 'XYZ', Wiring(joints))
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
    made, left_out = hal_file(looped, 'XYZ', Wiring('XYZ'))
    assert 'setp power-given.ok-in 1\n' in made and 'emergency stop' in left_out[-1]


@pytest.mark.parametrize(
    ('text', 'joints', 'told'),
    [
        (HAL, 'XYYZ', 'joint.3.motor-pos-cmd'),
        (HAL, 'XYYYZ', 'two motors'),
        (HAL, 'XYA', 'axes: X Y Z'),
        (HAL.replace('joint.2.motor-pos-fb', ''), 'XYZ', 'joint.2.motor-pos-fb'),
        (HAL.replace('addf motion-controller', 'addf another'), 'XYZ', 'motion-controller'),
        ('net\naddf\nloadrt\n', 'XYZ', 'no HAL file names'),
    ],
)
def test_an_axis_that_would_not_move_is_refused(text, joints, told):
    with pytest.raises(InterpError, match=told):
        hal_file(text, 'XYZ', Wiring(joints))


def test_the_command_reads_all_files_and_tells_what_is_not_connected(tmp_path, capsys):
    for name, lines in zip('ab', (HAL.splitlines()[:12], HAL.splitlines()[12:]), strict=True):
        (tmp_path / name).write_text('\n'.join(lines))
    words = ['hal', 'xyz', str(tmp_path / 'a'), str(tmp_path / 'b')]
    assert main([*words, '--out', str(tmp_path / 'made.hal')]) == 0
    assert (tmp_path / 'made.hal').read_text() == hal_file(HAL, 'XYZ', Wiring('XYZ'))[0]
    units, left_out = capsys.readouterr().err.splitlines()
    assert 'lengths' in units and left_out.startswith('not connected: net spindle-cw')
    assert main(['hal', 'xyz', str(tmp_path / 'missing')]) == 2


def test_a_file_that_is_not_there_is_sought_among_those_of_linuxcnc(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(linuxcnc_files, 'HAL_LIBRARY', tmp_path)
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'core_own.hal').write_text(HAL)
    for name in ('elsewhere/core_own.hal', 'LIB:core_own.hal'):
        assert main(['hal', 'xyz', name, '--out', 'made.hal']) == 0
    assert Path('made.hal').read_text() == hal_file(HAL, 'XYZ', Wiring('XYZ'))[0]
    assert main(['hal', 'xyz', 'LIB:core_own.hal', 'LIB:sim.tcl']) == 2
    assert 'LIB:sim.tcl: is Tcl' in capsys.readouterr().err


def test_inputs_of_reference_switches_take_over_their_pins():
    declared = signals_of({'signals': {'inputs': {'door': None, 'home_z': None}}})
    switch = 'net z-home parport.0.pin-12-in => joint.2.home-sw-in\n'
    made, left_out = hal_file(HAL + switch, 'XYZ', Wiring('XYZ'), declared)
    assert {'parport.0.pin-12-in', 'wsum.0.bit.6.in'} in signals(made)
    assert 'z-home' not in ' '.join(left_out)
    assert switch.strip() in hal_file(HAL + switch, 'XYZ', Wiring('XYZ'))[1]


def test_a_module_of_the_configuration_is_not_loaded_again():
    added = 'loadrt not count=2\nloadrt and2 names=a,b\n'
    loaded = [
        line
        for line in hal_file(added + HAL, 'XYZ', Wiring('XYZ'))[0].splitlines()
        if line.startswith('loadrt ')
    ]
    assert {
        'loadrt not names=not.0,not.1,power-unwanted',
        'loadrt and2 names=a,b,drive-tripped',
    } < set(loaded)
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
    made, left_out = hal_file(text, 'XYZ', Wiring('XYZ'), signals_of({'signals': given}))
    assert not left_out
    nets = signals(made)
    power = next(net for net in nets if 'power-given.ok-out' in net)
    assert {'on-spindle_forward.in1', 'on-spindle_speed.sel', 'stepgen.0.enable'} < power
    for net in (
        {'bits-0.out-01', 'on-spindle_forward.in0'},
        {
            'on-spindle_forward.out',
            'parport.0.pin-09-out',
            'spindle-on.in0',
        },
        {'streamer.0.pin.6', 'on-spindle_speed.in1'},
        {'on-spindle_speed.out', 'spindle-speed-out-abs.in1'},
        {'spindle-speed-out-abs.out', 'pwmgen.0.value'},
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
    made, left_out = hal_file(text, 'XYZ', Wiring('XYZ'), declared)
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


def converted(text, joints='XYZ', more=None, **wiring):
    """Return the nets of a converted file, what is loaded, the file, and what is left out."""
    declared = signals_of({'signals': 'milling'} if more is None else more)
    made, left_out = hal_file(text, sorted(set(joints)), Wiring(joints, **wiring), declared)
    loads = {line.split()[1]: line for line in made.splitlines() if line.startswith('loadrt ')}
    return signals(made), loads, made, left_out


def net_of(nets, pin):
    return next((net for net in nets if pin in net), set())


def test_modules_are_loaded_before_functions_are_called_and_all_instances_at_once():
    """A later ``loadrt and2`` moved ours below its ``addf``, and HAL did not find the function."""
    own = """loadrt and2 names=mine
addf mine servo-thread
loadrt bitslice count=2 personality=8,4
loadrt weighted_sum wsum_sizes=2,3
addf process_wsums servo-thread
net four wsum.1.sum
loadrt threads name1=slow period1=5000000
loadrt timedelay names=later
"""
    nets, loads, made, _ = converted(HAL + own)
    lines = made.splitlines()
    called = min(k for k, line in enumerate(lines) if line.startswith('addf'))
    assert all(lines.index(loads[module]) < called for module in ('and2', 'or2', 'bitslice'))
    instances = loads['and2'].partition('names=')[2].split(',')
    assert instances[0] == 'mine' and 'drive-tripped' in instances
    assert 'names=bitslice.0,bitslice.1,bits-0 personality=8,4,16' in loads['bitslice']
    assert 'wsum_sizes=2,3,16' in loads['weighted_sum']
    assert net_of(nets, 'wsum.1.sum') == {'wsum.1.sum'}
    assert 'sampler.0.pin.7' in net_of(nets, 'wsum.2.sum')
    assert 'name3=slow period3=5000000' in loads['threads']
    assert lines.count('addf process_wsums servo-thread') == 1


def test_what_is_unlinked_may_be_linked_again_and_other_words_link_as_well():
    own = """net old iocontrol.0.tool-change => loop.in
unlinkp iocontrol.0.tool-change
net new dialog.change iocontrol.0.tool-change
newsig place float
linksp place <= joint.0.motor-pos-cmd
linkps drive.in <= place
"""
    text = HAL.replace('net x-command joint.0.motor-pos-cmd => stepgen.0.position-cmd', '')
    nets, *_ = converted(text + own)
    assert net_of(nets, 'loop.in') == {'loop.in'}
    assert net_of(nets, 'dialog.change') == {'dialog.change', 'on-tool_change.out'}
    assert net_of(nets, 'drive.in') == {'drive.in', 'streamer.0.pin.0', 'sampler.0.pin.0'}


def test_sourced_files_are_part_of_the_file(tmp_path, capsys):
    (tmp_path / 'rest.hal').write_text(HAL)
    (tmp_path / 'x.hal').write_text('source rest.hal\n')
    for out, given in (('a', 'x.hal'), ('b', 'rest.hal')):
        words = ['hal', 'xyz', str(tmp_path / given), '--out', str(tmp_path / out)]
        assert main([*words, '--units', 'mm']) == 0, capsys.readouterr().err
    assert (tmp_path / 'a').read_text() == (tmp_path / 'b').read_text()


def test_an_ini_file_names_joints_units_and_hal_files(tmp_path, capsys):
    """An inch configuration was converted without a word, for 25.4 times the way."""
    ini = """[KINS]
KINEMATICS = trivkins coordinates=ZYX
[TRAJ]
LINEAR_UNITS = inch
[HAL]
HALFILE = a.hal
HALCMD = net own other.in stepgen.1.position-fb
"""
    (tmp_path / 'm.ini').write_text(ini)
    (tmp_path / 'a.hal').write_text(HAL)
    made = tmp_path / 'made.hal'
    assert main(['hal', 'xyz', str(tmp_path / 'm.ini'), '--out', str(made)]) == 0
    assert 'assumed' not in capsys.readouterr().err
    nets, text = signals(made.read_text()), made.read_text()
    command = net_of(nets, 'stepgen.0.position-cmd')  # joint 0 is Z
    assert command == {'stepgen.0.position-cmd', 'z-to-hal.out'}
    assert net_of(nets, 'z-to-hal.in') == {'streamer.0.pin.2', 'sampler.0.pin.2', 'z-to-hal.in'}
    assert 'z-from-hal.in' in net_of(nets, 'stepgen.0.position-fb')
    assert net_of(nets, 'sampler.0.pin.5') == {'sampler.0.pin.5', 'z-from-hal.out'}
    gains = dict(re.findall(r'setp (z-\w+-hal)\.gain (\S+)', text))
    assert float(gains['z-to-hal']) == pytest.approx(1.0 / 25.4)
    assert float(gains['z-from-hal']) == pytest.approx(25.4)


def test_a_locked_axis_has_no_motor_and_stands_where_it_is_sent():
    lines = HAL.replace('joint.2', 'joint.3').replace('joint.1', 'joint.2')
    made, _ = hal_file(lines.replace('joint.3', 'joint.1'), 'XYZB', Wiring('XYZ', locked='B'))
    assert {'streamer.0.pin.3', 'sampler.0.pin.3', 'sampler.0.pin.7'} in signals(made)


def test_a_spindle_has_the_pins_that_linuxcnc_derives():
    """A relay on ``spindle.0.on`` never closed, and a VFD on the signed speed never turned."""
    own = """net on spindle.0.on => relay
net speed spindle.0.speed-out => vfd.speed
net alarm vfd.fault => spindle.0.amp-fault-in
net number iocontrol.0.tool-prep-number => dialog.number
"""
    nets, _, made, left_out = converted(HAL + own)
    assert len(left_out) == 0
    assert net_of(nets, 'relay') == {'relay', 'spindle-on.out'}
    assert {'spindle-on.in0', 'spindle-speed-out.sel0'} < net_of(nets, 'on-spindle_forward.out')
    assert {'spindle-on.in1', 'spindle-speed-out.sel1'} < net_of(nets, 'on-spindle_reverse.out')
    assert net_of(nets, 'vfd.speed') == {'vfd.speed', 'spindle-speed-out.out'}
    assert net_of(nets, 'spindle-back.in') >= {'on-spindle_speed.out', 'spindle-speed-out.in1'}
    assert net_of(nets, 'spindle-back.out') == {'spindle-back.out', 'spindle-speed-out.in2'}
    assert net_of(nets, 'vfd.fault') == {'vfd.fault', 'fault-spindle.in1'}
    assert 'drive-tripped.in0' in net_of(nets, 'fault-spindle.out')
    assert net_of(nets, 'dialog.number') == {'dialog.number', 'tool-number.out'}
    calls = [line.split()[1] for line in made.splitlines() if line.startswith('addf ')]
    assert {'spindle-on', 'spindle-back', 'spindle-speed-out', 'tool-number'} < set(calls)


def test_the_chain_of_an_emergency_stop_closes_before_the_power_is_given():
    own = HAL.replace('net mushroom <= parport.0.pin-10-in\n', '').replace(
        'net mushroom => iocontrol.0.emc-enable-in',
        """net ask iocontrol.0.user-enable-out => latch.ok-in
net again iocontrol.0.user-request-enable => latch.reset
net closed latch.ok-out => iocontrol.0.emc-enable-in""",
    )
    nets, _, made, left_out = converted(own)
    assert {'latch.ok-in', 'bits-0.out-00', 'estop-asked.in'} < net_of(nets, 'power-asked.in')
    assert net_of(nets, 'latch.reset') == {'latch.reset', 'estop-asked.out'}
    assert net_of(nets, 'latch.ok-out') == {'latch.ok-out', 'power-given.ok-in'}
    assert net_of(nets, 'power-given.reset') == {'power-given.reset', 'power-asked.out'}
    delays = dict(re.findall(r'setp (\w+)-asked.on-delay (\S+)', made))
    assert 0.0 < float(delays['estop']) < float(delays['power'])
    assert not [line for line in left_out if 'stop' in line]


@pytest.mark.parametrize('joints', ['XYZ', 'XYZY'])
def test_limit_switches_are_inputs_of_their_axis(joints):
    text = HAL + ''.join(
        f'net low-{k} parport.0.pin-1{k}-in => joint.{k}.neg-lim-sw-in\n'
        for k in range(len(joints))
        if joints[k] == 'Y'
    )
    if len(joints) == 4:
        text += 'net second joint.3.motor-pos-cmd => joint.3.motor-pos-fb\n'
    inputs = {'inputs': {'limit_y_low': None}}
    nets, _, _, left_out = converted(text, joints, {'signals': inputs})
    assert not [line for line in left_out if 'lim-sw' in line]
    pin = 'wsum.0.bit.5.in'
    if len(joints) == 4:
        assert net_of(nets, pin) == {pin, 'limit_y_low.out'}
        assert net_of(nets, 'parport.0.pin-13-in') == {'parport.0.pin-13-in', 'limit_y_low.in1'}
    else:
        assert net_of(nets, 'parport.0.pin-11-in') == {'parport.0.pin-11-in', pin}


WHEEL = """net wheel encoder.3.counts => axis.x.jog-counts axis.z.jog-counts joint.0.jog-counts
net step mux4.0.out => axis.x.jog-scale axis.z.jog-scale
net x-chosen parport.1.pin-02-in => axis.x.jog-enable joint.0.jog-enable
net z-chosen parport.1.pin-04-in => axis.z.jog-enable
net ups parport.1.pin-05-in => cnc.power_fails
"""
NAMES = 'handwheel', 'handwheel_step', 'handwheel_x', 'handwheel_z', 'power_fails'


def test_a_handwheel_and_any_named_input_are_connected():
    nets, _, _, left_out = converted(
        HAL + WHEEL, 'XYZ', {'signals': {'inputs': dict.fromkeys(NAMES)}}
    )
    assert not [line for line in left_out if 'jog' in line or 'cnc.' in line]
    assert net_of(nets, 'encoder.3.counts') == {'encoder.3.counts', 'handwheel.in'}
    assert net_of(nets, 'handwheel.out') == {'handwheel.out', 'sampler.0.pin.6'}
    assert net_of(nets, 'mux4.0.out') == {'mux4.0.out', 'handwheel_step.in'}
    assert net_of(nets, 'handwheel_step.out') == {'handwheel_step.out', 'sampler.0.pin.7'}
    pins = {
        f'parport.1.pin-0{k}-in': f'wsum.0.bit.{bit}.in' for k, bit in ((2, 5), (4, 6), (5, 7))
    }
    for pin, ours in pins.items():
        assert net_of(nets, pin) == {pin, ours}


def test_two_handwheels_are_not_one():
    other = WHEEL.replace(
        ' axis.z.jog-counts', '\nnet other encoder.4.counts => axis.z.jog-counts'
    )
    _, _, _, left_out = converted(
        HAL + other, 'XYZ', {'signals': {'inputs': dict.fromkeys(NAMES)}}
    )
    assert len([line for line in left_out if 'jog-counts' in line]) == 2
