"""Probing: what is read, where the machine stops, and what a simulated probe touches."""

import ctypes
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from test_functions_played import MACHINE, NAMES, Bench

from cnc_interp.core import InterpError, MachineError, ProgramError
from cnc_interp.core.small_files import config_directory, read_yaml
from cnc_interp.machine.simulated_probe import COLUMNS, ProbingDrives, distance, read_surfaces
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import signals
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.program.reading import ProgramStream
from cnc_interp.program.text.source import Source
from cnc_interp.run.run_state import Reason, State
from cnc_interp.settings.options import Settings

T = 1e-3
ARMED, PROBE = NAMES.index('probe_armed'), [i.name for i in MACHINE.signals.inputs].index('probe')
LINE = 'G0 X0 Y0 Z0\nG38.2 X30 F1200\nM2\n'
TWICE = (
    'G21 G90\nG0 X1 Y2 Z30\nG38.2 Z-10 F300\nG10 L20 P1 Z[#5063/2]\nG1 Z8 F900\nX[6+#5070]\nM2\n'
)


def parts_of(text, answers, name='xyz'):
    """Return the tips [m] of each part of a program whose probe answers at axis positions."""
    machine = replace(Machine.load(name), signals=MACHINE.signals)
    stream = ProgramStream(Source.of_text(text, 'p.ngc'), Transform.of(machine), Settings())
    stream.read_live()
    found = [np.concatenate([part.tip for part in stream])]
    for at in answers:
        assert stream.probe is not None
        stream.go_on(np.array([1e-3, 2e-3, 0.0]) if at is None else at, at)
        found.append(np.concatenate([part.tip for part in stream]))
    return found, stream


def test_what_follows_a_probe_is_read_with_its_answer():
    (first, then), stream = parts_of(TWICE, [np.array([0.001, 0.002, 0.004])])
    assert stream.probe is None
    assert np.allclose(first[:, 2], [0.03, -0.01])
    # The probe answered at 4 mm, which G10 L20 calls 2 mm: Z8 is 6 mm above it.
    assert np.allclose(then * 1e3, [[1, 2, 4], [1, 2, 10], [7, 2, 10]])
    assert stream.changes[0].change.value == {'Z': pytest.approx(0.002)}


def test_siemens_measures_and_names_what_it_has_found():
    text = 'G71 G90\nG0 X1 Y2 Z30\nMEAS=1 G1 Z-10 F300\nIF $AC_MEA[1]==0 GOTOF LOST\n'
    text += 'G1 Z=$AA_MW[Z]+6 F900\nM30\nLOST:\nG1 Z40\nM30\n'
    for at, tip in ((np.array([0.001, 0.002, 0.004]), 10.0), (None, 40.0)):
        (first, then), _ = parts_of(text, [at])
        assert np.allclose(first[:, 2], [0.03, -0.01]) and then[-1, 2] * 1e3 == pytest.approx(tip)
    with pytest.raises(ProgramError, match='MEAS=1: measures along a line; write G1'):
        parts_of(text.replace('G1 Z-10', 'G0 Z-10'), [])
    with pytest.raises(ProgramError, match='MEAW'):
        parts_of(text.replace('MEAS=1', 'MEAW=1'), [])


def test_without_an_answer_the_program_sees_zero():
    text = 'G21 G90\nG0 X1 Y2 Z30\nG38.3 Z0 F300\nG1 X[10+#5070] Z#5063 F900\nM2\n'
    (_, then), _ = parts_of(text, [None])
    assert np.allclose(then[-1] * 1e3, [10, 2, 0])


def test_a_plan_counts_the_end_of_the_line():
    transform = Transform.of(MACHINE)
    program = read_text(TWICE, 'p.ngc', transform, Settings())
    assert np.allclose(program.blocks.tip[:2, 2], [0.03, -0.01])
    assert program.blocks.exact_stop[:2].all()
    assert any('end of the line' in notice for notice in program.notices)


@pytest.mark.parametrize(
    ('text', 'told'),
    [
        ('G38.2 Z-5 F100', 'move to a position before the part first'),
        ('G0 X0 Y0 Z0\nG38.2 F100', 'has no motion'),
        ('G0 X0 Y0 Z0\nG38.2 Z-5', 'feedrate'),
        ('G0 X0 Y0 Z0\nG1 X5 F100\nG41.1 D1\nG38.2 X9', 'G41.1 is on'),
    ],
)
def test_what_cannot_be_probed_is_refused(text, told):
    with pytest.raises(ProgramError, match=told):
        read_text(text, 'p.ngc', Transform.of(MACHINE), Settings())


def test_a_probe_needs_its_signals_and_rotary_axes_rest():
    with pytest.raises(ProgramError, match='has no probe'):
        read_text(LINE, 'p.ngc', Transform.of(Machine.load('xyz')), Settings())
    five = Transform.of(Machine.load('xyzbc'))
    with pytest.raises(ProgramError, match='turn the rotary axes first'):
        read_text('G0 X0 Y0 Z0 B0 C0\nG38.2 Z-5 C90 F100', 'p.ngc', five, Settings())
    table = {
        'outputs': {'probe_armed': {'range': [0, 2]}},
        'functions': {'G38.2': {'probe_armed': 2}},
    }
    with pytest.raises(MachineError, match='must end with probe_armed: 1'):
        signals({'signals': table})


class Touched(Bench):
    """A machine whose probe is on from a place on X on, ``late`` periods later."""

    def __init__(self, text=LINE, at=0.02, late=0):
        self.at, self.late, self.since = at, late, 0
        super().__init__(text)

    def step(self):
        beyond = self.play.feedback.position[-1, 0] >= self.at
        self.since = self.since + 1 if beyond else 0
        self.drives.inputs[PROBE] = self.since > self.late
        super().step()

    @property
    def path(self):
        return np.concatenate([e.rows.position[:, 0] for e in self.play.executed])


def test_the_axes_stop_within_their_limits_and_the_place_is_that_of_the_contact():
    bench = Touched()
    bench.run()
    (contact,) = bench.play.contacts
    assert bench.play.state.state is State.IDLE and bench.play.state.reason is Reason.PROBE
    speed = 0.02  # [m/s]
    assert 0.0 <= contact.position[0] - 0.02 <= 2 * speed * T and not contact.at_once
    x = bench.path
    jerk = np.abs(np.diff(x, 3)).max() / T**3
    assert jerk <= MACHINE.limits.by_order[2, 0] * 1.001
    # From the contact: to the next setpoint with a stop, then the stop itself.
    a, j = MACHINE.limits.by_order[1:, 0]
    stop = speed / 2 * (speed / a + a / j)
    assert x[-1] - contact.position[0] < stop + speed * 0.015
    assert bench.drives.outputs[ARMED] == 0.0


def test_without_contact_the_line_is_run_to_its_end_and_the_probe_is_watched_no_more():
    bench = Touched(at=1.0)
    bench.run()
    assert not bench.play.contacts and bench.path[-1] == pytest.approx(0.03)
    assert bench.play.state.reason is not Reason.PROBE and bench.drives.outputs[ARMED] == 0.0


def test_a_probe_that_is_on_before_is_told():
    bench = Touched(at=-1.0)
    bench.run()
    assert bench.play.contacts[0].at_once and bench.path[-1] < 1e-3


def test_away_from_the_part_it_waits_until_the_probe_is_off():
    bench = Touched(LINE.replace('G38.2', 'G38.4'), at=-1.0)
    while bench.play.axes.setpoints[-1, 0] < 0.01:
        bench.step()
    bench.at = 1.0
    bench.run()
    assert 0.01 <= bench.play.contacts[0].position[0] < 0.0101 and bench.path[-1] < 0.012


def test_a_contact_while_the_axes_stop_for_a_hold_ends_the_line():
    bench = Touched()
    while bench.play.axes.setpoints[-1, 0] < 0.01:
        bench.step()
    bench.play.hold()
    while bench.play.state.state is not State.HELD:
        bench.step()
    for _ in range(20):
        bench.step()
    assert bench.drives.outputs[ARMED] == 1.0 and not bench.play.contacts
    bench.play.start()
    while bench.play.axes.setpoints[-1, 0] < 0.015:
        bench.step()
    bench.play.hold()
    while bench.path[-1] - bench.path[-2] > 0.018 * T:
        bench.step()
    bench.at = 0.0  # touches on the stop tail
    bench.run()
    assert len(bench.play.contacts) == 1 and bench.play.state.reason is Reason.PROBE


def test_an_emergency_stop_ends_the_watch():
    bench = Touched()
    while bench.play.axes.setpoints[-1, 0] < 0.01:
        bench.step()
    bench.play.stop()
    assert bench.drives.outputs[ARMED] == 0.0
    bench.at = 0.0
    while bench.play.state.state is not State.FAULT:
        bench.step()
    assert not bench.play.contacts


@pytest.mark.parametrize(
    ('surface', 'place', 'wanted'),
    [
        ('{plane: [0, 0, 5], normal: [0, 0, 2]}', [3, 3, 9], 4),
        ('{ball: [1, 0, 0], radius_mm: 2}', [1, 4, 3], 3),
        ('{bore: [0, 0, 0], radius_mm: 10}', [3, 4, -5], 5),
        ('{bore: [0, 0, 0], radius_mm: 10}', [30, 40, 2], 2),
        ('{boss: [0, 0, 0], radius_mm: 10}', [9, 12, -5], 5),
        ('{box: [0, 0, 0], half: [10, 5, 5], turned_deg: 90}', [0, 12, 0], 2),
        ('{box: [0, 0, 0], half: [10, 5, 5], turned_deg: 90}', [7, 0, 0], 2),
    ],
)
def test_distances_are_those_of_geometry(tmp_path, surface, place, wanted):
    file = tmp_path / 'part.yaml'
    file.write_text(f'surfaces:\n  - {surface}\n')
    _, (row,), _ = read_surfaces(file)
    assert len(row) == COLUMNS
    assert distance(row, np.array(place) * 1e-3) == pytest.approx(wanted * 1e-3)


@pytest.mark.parametrize(
    ('text', 'told'),
    [
        ('[1]', 'may hold probe, surfaces'),
        ('surfaces: [{cone: [0, 0, 0]}]', 'surface 1: is one of plane, ball'),
        ('surfaces: [{ball: [0, 0], radius_mm: 1}]', 'ball must be'),
        ('surfaces: [{ball: [0, 0, 0]}]', 'radius_mm must be a number'),
        ('probe: {radius_mm: .nan}', 'radius_mm must be a number'),
        ('probe: {colour: 1}', 'may have radius_mm'),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(tmp_path, text, told):
    file = tmp_path / 'part.yaml'
    file.write_text(text)
    with pytest.raises(InterpError, match=told):
        read_surfaces(file)


@pytest.mark.parametrize('name', ['vmc', 'xyzbc', 'head_head', 'ram_mill'])
def test_the_ball_touches_where_the_tool_leads_it(tmp_path, name):
    """Drive a turned tool to a ball by inverse kinematics: on within a micrometre, then late."""
    machine = Machine.load(name)
    transform, file = Transform.of(machine), tmp_path / 'part.yaml'
    file.write_text(
        'probe: {radius_mm: 1.5, length_mm: 40, delay_ms: 3}\n'
        'surfaces: [{ball: [1, 2, 3], radius_mm: 10}]'
    )
    n, turned = len(machine.axis_names), 3 + 2 * machine.has_rotary
    drives = ProbingDrives(machine, T, np.zeros(n), file)
    place = [i.name for i in machine.signals.inputs].index('probe')
    step = ctypes.CFUNCTYPE(*[ctypes.c_int64] * 5)(drives.step)
    rotary = np.full(2, 0.3 * machine.has_rotary)
    axis = transform.tool_axis(rotary[None])[0]
    way = np.array([0.6, 0.0, 0.8])

    def touches(gap, periods):
        centre = np.array([1.0, 2.0, 3.0]) * 1e-3 + (11.5e-3 + gap) * way
        tip = centre + (40e-3 - 1.5e-3) * axis
        q = np.zeros(n)
        q[:3] = transform.linear(tip[None], rotary[None])[0]
        q[3:turned] = rotary[: turned - 3]
        setpoint, feedback = np.concatenate([q, np.zeros(n)]), np.zeros(4 * n)
        for _ in range(periods):
            step(drives.memory.ctypes.data, setpoint.ctypes.data, feedback.ctypes.data, n)
        return drives.inputs[place] != 0.0

    settle = 400  # periods until the drives stand
    assert not touches(1e-6, settle) and touches(-1e-6, settle)
    assert not touches(5e-3, settle)


@pytest.mark.parametrize('delay', [0, 3])
def test_a_time_stamp_tells_when_within_its_period_the_ball_has_touched(tmp_path, delay):
    file = tmp_path / 'part.yaml'
    file.write_text(
        f'probe: {{radius_mm: 0, delay_ms: {delay}}}\n'
        'surfaces: [{plane: [4.0137, 0, 0], normal: [-1, 0, 0]}]'
    )
    given = read_yaml(config_directory() / 'signals' / 'milling.yaml')
    given['inputs']['probe_since'] = None
    machine = replace(MACHINE, signals=signals({'signals': given}))
    drives = ProbingDrives(machine, T, np.zeros(3), file)
    step = ctypes.CFUNCTYPE(*[ctypes.c_int64] * 5)(drives.step)
    feedback, speed, k = np.zeros(12), 0.02, 0  # 20 um in a period
    while not drives.inputs[PROBE]:
        k += 1
        setpoint = np.array([speed * T * k, 0, 0, speed, 0, 0])
        step(drives.memory.ctypes.data, setpoint.ctypes.data, feedback.ctypes.data, 3)
    since = drives.inputs[machine.signals.input('probe_since')]
    wall = Transform.of(machine).linear(np.array([[4.0137e-3, 0, 0]]), np.zeros((1, 2)))[0, 0]
    late = speed * 1e-3 * delay
    assert 0.0 < since < T and abs(feedback[0] - wall - late) > 0.5e-6
    assert feedback[0] - feedback[3] * since - late == pytest.approx(wall, abs=20e-9)
