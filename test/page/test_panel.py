"""What the operator page is made of: keys, read-outs, the path as a mesh, the plan beside it."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip(
    'nicegui', reason='needs requirements/panel.txt; run the tests with ./cnc test'
)
pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import Jog, LoadedProgram, MachineState
from diagnostic_msgs.msg import DiagnosticStatus
from nodes_under_test import hear_ctrl_c

from cnc_interp import page
from cnc_interp.client.alarms import Alarm, AlarmList
from cnc_interp.client.length_unit import INCHES, MILLIMETRES
from cnc_interp.client.operator_client import SWITCHES, SharedValue
from cnc_interp.client.run_request import RunResult
from cnc_interp.client.setup_client import OffsetChange
from cnc_interp.commands.cli import main
from cnc_interp.core import DEG, MM, MM_PER_MIN
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.page import command, server
from cnc_interp.page.contact import Access
from cnc_interp.page.desk import KINDS, Desk, Job
from cnc_interp.page.dialogs import KEYBOARD, MARKS
from cnc_interp.page.hand_motion import ARROWS, TOOL, JogPad, beat_of, step_of
from cnc_interp.page.keys import RAPIDS
from cnc_interp.page.preview import DRAWN, Planner, Preview, thinned
from cnc_interp.page.readings import (
    axis_words,
    clock,
    history_text,
    progress_words,
    words_before_start,
)
from cnc_interp.page.scene import INDISTINCT, SCALE, UNSEEN, tube
from cnc_interp.page.start_choice import WayAhead
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.settings.options import Settings

PROGRAM = 'G21 G90 G94 (<b>)\nTRAORI\nG0 X0 Y0 Z0 A10 C0\nG1 X20 F3000\nG1 Y20 F1500\nM30\n'


def test_one_page_with_the_token_has_the_keys():
    access = Access('secret')
    access.enter('stranger', trusted=False)
    access.enter('first', trusted=True)
    access.enter('second', trusted=True)
    rights = [access.is_in_charge(tab) for tab in ('stranger', 'first', 'second')]
    assert rights == [False, True, False]
    access.take_over('second')
    assert access.is_in_charge('second') and not access.is_in_charge('first')


def test_a_refreshed_page_keeps_the_keys_and_a_closed_one_frees_them():
    access = Access('secret')
    access.enter('tab', trusted=True)
    access.enter('tab', trusted=True)  # the new page comes before the old one goes
    access.leave('tab')
    assert access.is_in_charge('tab')
    access.leave('tab')
    access.enter('other', trusted=True)
    assert access.is_in_charge('other') and not access.is_in_charge('tab')


def test_only_the_token_is_known_and_a_random_one_cannot_be_guessed():
    assert Access('secret').knows('secret')
    assert not any(Access('secret').knows(guess) for guess in ('', 'secre', 'secret '))
    assert len(Access().token) > 16 and Access().token != Access().token
    assert not Access().knows('')


def test_a_dense_path_is_drawn_with_what_can_be_seen():
    angle = np.linspace(0.0, 20.0, 20_000)
    points = np.c_[np.cos(angle), np.sin(angle), 0.02 * angle] * 50 * MM
    values = 1.0 + np.sin(3.0 * angle)
    file, rows = tube(points, values, 2.0, 0.5 * MM)
    radius, drawn, colours = read_tube(file)
    assert radius == np.float32(0.5 * MM) and len(drawn) < len(points) / 20
    assert np.allclose(drawn, points[rows], atol=1e-6)
    assert tuple(colours[0]) == (*SCALE[2], 255)
    turned = np.unwrap(np.arctan2(drawn[:, 1], drawn[:, 0]))
    course = np.stack([np.interp(angle, turned, column) for column in drawn.T], axis=1)
    # Both are shares of one distance, and the course is compared at equal angles.
    assert np.linalg.norm(course - points, axis=1).max() < 1.1 * UNSEEN * 0.5 * MM
    shown = np.stack([np.interp(angle, turned, column) for column in colours.T[:3]], axis=1)
    known = np.linspace(0.0, 2.0, len(SCALE))
    true = np.stack([np.interp(values, known, column) for column in np.transpose(SCALE)], axis=1)
    assert np.abs(shown - true).max() < 1.1 * 255 * INDISTINCT


def read_tube(file):
    """Radius, points and colours in the file of a tube."""
    count = (len(file) - 4) // 16
    radius, *places = np.frombuffer(file, '<f4', 1 + 3 * count)
    colours = np.frombuffer(file, np.uint8, 4 * count, 4 + 12 * count)
    return radius, np.reshape(places, (count, 3)), colours.reshape(count, 4)


def test_a_path_that_stands_still_has_two_points_too():
    to_and_fro = np.array([[0.0, 0.0, 0.0], [1e-6, 0.0, 0.0], [0.0, 0.0, 0.0]])
    for points in (np.zeros((3, 3)), to_and_fro):
        drawn = read_tube(tube(points, np.ones(3), 1.0, 1e-3)[0])[1]
        assert drawn.tolist() == [[0, 0, 0], [0, 0, np.float32(1e-3)]]


def test_a_change_of_an_offset_names_what_reads_otherwise_now():
    """A touch-off at a place that was set already had changed Y from -69.850 to -69.850."""
    before, after = {'X': 0.1, 'Y': -0.06985}, {'X': 0.2, 'Y': -0.06985 + 1e-11}
    assert OffsetChange('G54', {}, before, after).text(MILLIMETRES) == 'G54 X 100.000 → 200.000 mm'
    assert 'less than' in OffsetChange('G54', {}, after, {**before, 'X': 0.2}).text(MILLIMETRES)


def test_read_outs_are_in_the_words_of_the_shop():
    state = MachineState(
        positions=[0.0123456, -0.5, 0.0, 0.25, -12.3456 * DEG],
        tip=[0.001, 0.002, -0.003],
        axis=[0.0, 0.6, 0.8],
        line_number=12,
        samples=75500,
        interpolation_period=0.001,
    )
    words = axis_words(state, Machine.load('xyzac'), MILLIMETRES)
    assert [words[f'axis {x}'] for x in 'XYZ'] == ['12.346', '-500.000', '0.000']
    assert words['axis C'] == '-12.3456'
    assert [words[f'tip {x}'] for x in 'xyz'] == ['1.000', '2.000', '-3.000']
    assert words['tool z'] == '+0.80000'
    words = axis_words(state, Machine.load('xyzac'), INCHES)
    assert (words['axis X'], words['tip y'], words['axis C']) == ('0.4860', '0.0787', '-12.3456')
    words = progress_words(state, None, 1.0)
    assert (words['line'], words['elapsed'], words['left']) == ('12', '1:15.5', '–')
    assert clock(3 * 3600 + 62.04) == '3:01:02.0'


def test_alarms_that_come_again_are_told_apart_from_news():
    def alarm(message):
        return Alarm('12:00:00', 'warning', 'machine_node: setpoints', message)

    assert alarm('repeat of 10; 20 is next').repeats(alarm('repeat of 30; 40 is next'))
    assert not alarm('repeat of 10').repeats(alarm('gap before 10'))
    assert not alarm('line 4: M6: no effect').repeats(alarm('line 5: M5: no effect'))


@pytest.fixture(scope='module')
def planned(tmp_path_factory):
    folder = tmp_path_factory.mktemp('panel')
    (folder / 'part.ngc').write_text(PROGRAM)
    assert main(['plan', str(folder / 'part.ngc'), '--out', str(folder / 'plan')]) == 0
    return folder / 'plan'


def test_the_preview_is_the_plan(planned):
    preview, plan = Preview.read(planned), read_plan(planned)
    assert preview.length == plan.path['s'][-1]
    assert preview.time[0] == 0.0 and (np.diff(preview.time) >= 0.0).all()
    assert abs(preview.time[-1] - preview.cycle_time) <= 0.001
    middle = 0.5 * (preview.s[:-1] + preview.s[1:])
    limits = [preview.at(place).feed_limit for place in middle]
    np.testing.assert_array_equal(limits, preview.feed_limit[:-1])
    s, time = plan.setpoints['s'][:], plan.setpoints['time'][:]
    for k in np.flatnonzero(np.abs(s - 20 * MM) > 1 * MM)[10:-10:50]:
        place = preview.at(s[k])
        programmed = 3000 if s[k] < 20 * MM else 1500
        assert place.programmed_feed == pytest.approx(programmed * MM_PER_MIN)
        speed = (s[k + 1] - s[k - 1]) / (time[k + 1] - time[k - 1])
        assert speed <= place.feed_limit * 1.05
        assert abs(place.time - time[k]) < 0.02
        end = 20 * MM if s[k] < 20 * MM else preview.length
        assert place.block_end == pytest.approx(end, abs=0.1 * MM)
    left = progress_words(MachineState(path_position=preview.length / 2), preview, 0.5)['left']
    assert left == clock((preview.cycle_time - preview.at(preview.length / 2).time) / 0.5)


def test_long_paths_are_thinned_with_their_ends():
    rows = thinned(5 * DRAWN)
    assert len(rows) == DRAWN and rows[0] == 0 and rows[-1] == 5 * DRAWN - 1


@pytest.mark.parametrize(
    ('name', 'kept'),
    [
        ('a.ngc', 'a.ngc'),
        ('Teil 7-ü (2).NC', 'Teil 7-ü (2).NC'),
        ('', 'program.ngc'),
        ('..', 'program.ngc'),
        ('.plan', 'plan'),
        ('/etc/a.h', 'a.h'),
        ('a\0\n\udcff.apt', 'a___.apt'),
        ('x' * 300 + '.apt', 56 * 'x' + '.apt'),
    ],
)
def test_a_program_is_kept_whatever_it_is_called(name, kept):
    planner = Planner()
    try:
        path = planner.keep(name, PROGRAM)
        assert path.name == kept and path.read_text() == PROGRAM
        assert [path] == list(path.parent.iterdir())
    finally:
        planner.close()


def said(part, message, level=DiagnosticStatus.ERROR):
    return DiagnosticStatus(level=level, name=part, message=message)


def test_what_stops_several_parts_is_told_once():
    now = 0.0
    alarms = AlarmList(lambda: now)
    alarms.hear(said('machine_node: drives', 'emergency stop'))
    alarms.hear(said('machine_node: setpoints', 'emergency stop'))
    alarms.add('error', 'program', 'emergency stop')
    assert [a.source for a in alarms.history] == ['machine_node: drives']
    # The next stop is told by somebody else, whatever was told before.
    alarms.clear()
    now = 10.0
    alarms.add('error', 'program', 'emergency stop')
    alarms.hear(said('machine_node: drives', 'running'))
    assert [a.source for a in alarms.newest_first] == ['machine_node: drives', 'program']
    now = 20.0
    alarms.hear(said('machine_node: drives', 'emergency stop'))
    assert alarms.newest_first[0].source == 'machine_node: drives'


def test_an_alarm_goes_with_its_cause_and_stays_in_the_history():
    alarms = AlarmList()
    alarms.add('error', 'part.ngc', 'M3: WARNING: the spindle is NOT started')
    for silence in ('0.3', '0.4', '1.2'):
        alarms.hear(said('machine_node: jog', f'no message of the held key for {silence} s'))
    alarms.hear(said('machine_node: jog', 'X is at the end of its travel'))
    # One line for each cause: the last one of a part.
    assert [a.message[:4] for a in alarms.newest_first] == ['X is', 'M3: ']
    alarms.hear(said('machine_node: jog', 'follows jog', DiagnosticStatus.OK))
    assert [a.source for a in alarms.newest_first] == ['part.ngc']
    assert [a.count for a in alarms.history] == [1, 3, 1]


def test_two_programs_get_the_same_notice_each():
    alarms = AlarmList()
    alarms.add('notice', 'one.ngc', 'M8: no effect')
    alarms.add('notice', 'two.ngc', 'M8: no effect')
    assert [a.source for a in alarms.history] == ['two.ngc', 'one.ngc']
    # A program that is planned again, with another zero, tells its notices anew.
    alarms.forget('one.ngc')
    alarms.add('notice', 'one.ngc', 'M8: no effect')
    assert [(a.source, a.count) for a in alarms.history] == [('one.ngc', 1), ('two.ngc', 1)]


def test_alarms_are_added_and_cleared_by_several_threads():
    alarms, usual = AlarmList(), sys.getswitchinterval()
    sys.setswitchinterval(1e-6)

    def press():
        for k in range(300):
            alarms.add('notice', 'page', f'{"abcde"[k % 5]} was pressed')
            alarms.clear()

    try:
        with ThreadPoolExecutor(4) as threads:
            for ended in [threads.submit(press) for _ in range(4)]:
                ended.result()
    finally:
        sys.setswitchinterval(usual)
    assert sum(alarm.count for alarm in alarms.history) == 4 * 300


def test_a_program_that_is_refused_marks_its_line(tmp_path):
    job = Job('part.ngc', [], tmp_path / 'part.ngc', Settings())
    job.refuse('part.ngc:3: F0: a feed above 0 is needed')
    assert job.failed and job.fault_lines == (3,)
    job.refuse('part.ngc:3: Q5 (also lines 7, 9)\npart.ngc:5: F0: a feed above 0 is needed')
    assert job.fault_lines == (3, 5, 7, 9) and job.status.endswith(
        '(and 1 more, see the messages)'
    )
    job.refuse('the nodes do not answer')
    assert job.failed and job.fault_lines == ()


def test_a_program_that_is_not_started_shows_its_cycle_time(planned):
    plan = Preview.read(planned)
    words = words_before_start(plan, 0.5)
    assert words['left'] == clock(2.0 * plan.cycle_time)
    assert {words[name] for name in ('line', 'progress', 'to go', 'elapsed')} == {'–'}
    assert words_before_start(None, 1.0)['left'] == words_before_start(plan, 0.0)['left'] == '–'


def test_a_key_along_the_tool_tells_where_its_line_ends():
    machine = Machine.load('router')
    middle, top = machine.travel.mean(axis=1), machine.travel[:, 1]
    pad = object.__new__(JogPad)  # without its keys
    pad._machine, pad._names, pad._nodes = machine, machine.axis_names, SimpleNamespace()
    pad._nodes.state = SimpleNamespace(positions=middle)
    assert pad._end(TOOL, 1) == pad._end(TOOL, -1) == ''
    pad._nodes.state = SimpleNamespace(positions=[*middle[:2], top[2]])
    assert 'end of its travel' in pad._end(TOOL, 1) and pad._end(TOOL, -1) == ''


def test_the_way_to_the_path_leads_from_the_machine_to_the_place():
    transform = Transform.of(Machine.load('xyzac'))
    stands, place = np.array([0.0, 0.0, 0.2, 0.0, 0.0]), np.array([0.05, -0.07, 0.15, 0.3, 0.5])
    program = LoadedProgram(program_id='run', start_positions=place, start_notes=['at line 7'])
    state = MachineState(
        program_id='run',
        reason=MachineState.REASON_APPROACH,
        resting=True,
        path_position=-0.1,
        commanded_positions=stands,
    )
    ahead = WayAhead(transform)
    way = ahead.at(state, program)
    assert [name for name, _ in way.legs] == ['1 retract', '2 position', '3 plunge']
    assert way.text.startswith('at line 7\n') and 'reset' in way.text
    (start, end), _ = transform.forward(np.stack([stands, place]))
    assert way.legs[0][1][0] == pytest.approx(start) and way.legs[2][1][-1] == pytest.approx(end)
    assert ahead.at(state, program) is way
    # Once the machine moves, there is nothing left to decide; on the path the way is over.
    state.reason = MachineState.REASON_NONE
    assert (ahead.at(state, program).legs, ahead.at(state, program).text) == (way.legs, '')
    state.sequence = 3
    assert ahead.at(state, program) is None
    # Away from a hold by hand, and back.
    state.reason, state.path_position = MachineState.REASON_AWAY, 0.1
    assert ahead.at(state, program) is None
    state.resume_positions = place.tolist()
    assert 'moved away by hand' in ahead.at(state, program).text
    state.resting = False
    assert ahead.at(state, program) is None
    state.program_id = 'another'
    assert ahead.at(state, program) is None


def test_cleared_messages_stay_in_the_history():
    alarms = AlarmList()
    alarms.add('warning', 'machine_node', 'no setpoints')
    alarms.clear()
    assert alarms.newest_first == [] and len(alarms.history) == 1
    alarms.add('error', 'program', 'refused')
    assert [alarm.message for alarm in alarms.newest_first] == ['refused']
    lines = history_text(alarms.history).splitlines()
    assert 'no setpoints' in lines[0] and 'refused' in lines[1]
    alarms.clear()
    alarms.add('error', 'program', 'refused')  # it came again: that is news
    assert [alarm.count for alarm in alarms.newest_first] == [2]


def test_keys_of_the_pad_become_beats_and_steps():
    names = Machine.load('xyzac').axis_names
    assert beat_of('A', -0.2, names) == Jog(axes=['A'], shares=[-0.2])
    assert beat_of('tool', 0.2, names) == Jog(tool=0.2)
    assert beat_of('', 0.2, names) == beat_of('Q', 0.2, names) == Jog()
    turn, along = step_of('C', -10.0 * DEG, 0.5), step_of('tool', 0.1 * MM, 1.0)
    assert (turn.axes, list(turn.values), turn.relative) == (['C'], [-10.0 * DEG], True)
    assert (along.tool, along.relative, along.speed) == (0.1 * MM, True, 1.0)
    assert {name for name, _ in ARROWS.values()} <= set(names)


def test_what_is_listed_of_the_keyboard_is_on_the_page():
    texts = Path(page.__file__).parent.glob('*.py')
    marks = ''.join(t.read_text(encoding='utf-8') for t in texts if t.stem != 'dialogs')
    made = {f'rapid {percent}%' for percent in RAPIDS} | {s.replace('_', ' ') for s in SWITCHES}
    assert all(f"'{mark}'" in marks or mark in made for mark in MARKS.values())
    assert len(MARKS) == len(KEYBOARD) and not {' ', 'Enter'} & MARKS.keys()


def test_an_address_in_use_is_one_clear_line(capsys):
    import socket

    with socket.socket() as taken:
        taken.bind(('127.0.0.1', 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert main(['panel', '--attach', '--port', str(port)]) == 2
    said = capsys.readouterr().err
    assert said.count('\n') == 1 and f'127.0.0.1:{port}' in said and '--port' in said


@pytest.mark.parametrize(
    ('words', 'named'),
    [
        (['--port', '99999'], '65535'),
        (['--domain', '9999'], '232'),
        (['--namespace', 'bad name!'], "'bad name!'"),
        (['nosuch.ngc'], 'nosuch.ngc'),
        (['/dev/zero'], 'longer than'),
        (['--machine', 'nosuch'], 'xyzac'),
        (['--host', ''], '0.0.0.0'),
        (['--token-file', 'nosuch.txt'], 'nosuch.txt'),
        (['--token-file', '/dev/null'], 'not a file'),
        (['--token-file', 'short.txt'], 'at least 16 characters'),
    ],
)
def test_what_cannot_be_served_is_one_clear_line(words, named, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path('short.txt').write_text('fifteen letters\n')
    assert main(['panel', '--port', '0', *words]) == 2
    said = capsys.readouterr().err
    assert said.count('\n') == 1 and named in said


def test_a_late_echo_of_an_older_wish_does_not_count():
    override = SharedValue(1.0, patience=10.0)
    for k, value in enumerate((0.95, 0.9, 0.95, 0.5)):
        override.wish(value, now=float(k))
        assert override.at(float(k)) == value
    for value in (0.95, 0.9):  # the computer is slow
        override.hear(value)
        assert override.at(9.0) == 0.5
    override.hear(0.5)
    assert override.at(9.0) == 0.5
    override.hear(1.2)  # of another page
    assert override.at(9.0) == 1.2
    override.wish(0.7, now=20.0)  # never heard: theirs came after it
    override.hear(1.1)
    assert (override.at(29.0), override.at(31.0)) == (0.7, 1.1)


def test_ctrl_c_while_the_desk_is_made_closes_it(monkeypatch):
    closed = []

    class Interrupted:
        def __init__(self, *_):
            signal.raise_signal(signal.SIGINT)

        def close(self):
            closed.append(self)

    hear_ctrl_c()
    monkeypatch.setattr(server, 'Desk', Interrupted)
    with pytest.raises(KeyboardInterrupt):
        server.serve(server.Served(), '/', 1, dict)
    assert closed


def test_a_page_that_ends_late_hurts_no_run(monkeypatch):
    """Within five seconds a busy computer may not end it; then it sees that its run is gone."""
    hear_ctrl_c()
    monkeypatch.setattr(command, 'LAST_WAIT', 0.1)
    beside = command.PanelBeside.__new__(command.PanelBeside)
    deaf = [sys.executable, '-c', 'import signal; signal.pause()']
    beside._process = subprocess.Popen(
        deaf, preexec_fn=lambda: signal.signal(signal.SIGTERM, signal.SIG_IGN)
    )
    try:
        threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT)).start()
        beside.finish(RunResult(True, 'executed to the end', 'a.ngc', 'xyzac'))
    finally:
        beside._process.kill()
        beside._process.wait()


def test_charts_stand_while_the_machine_rests(monkeypatch):
    now = 100.0
    monkeypatch.setattr(time, 'monotonic', lambda: now)
    desk = SimpleNamespace(
        history=deque(),
        switched={},
        feeds=lambda state: (0.0, 0.0),
        _peak=np.zeros((3, 1)),
        _moved=0.0,
        _stopped=False,
        loop=None,
    )
    for speed in (*[0.1] * 5, *[0.0] * 50, 0.2):
        state = SimpleNamespace(single_block=False, feedrate=speed, state=MachineState.RUNNING)
        for kind in KINDS:
            setattr(state, f'recent_{kind}_use', np.array([speed]))
        Desk._see_state(desk, state)
        now += 0.25
    feeds = [moment.feed for moment in desk.history]
    assert feeds[:5] == [0.1] * 5 and feeds[-1] == 0.2
    assert feeds.count(0.0) == 4  # a second of them
