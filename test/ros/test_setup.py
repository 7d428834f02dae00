"""Offsets and tools of the machine over the real nodes: touch-off, programs, refusals, a kill."""

import json
import os
import random
import re
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState, SetupTable
from cnc_interp_msgs.srv import MoveAxes, ReadSetup, SetOffset, SetTool, TouchOff
from nodes_under_test import NodesUnderTest

from cnc_interp.nodes import qos
from cnc_interp.program import JobSetup

Result = RunProgram.Result
SERVICES = {
    'read_setup': ReadSetup,
    'set_offset': SetOffset,
    'set_tool': SetTool,
    'touch_off': TouchOff,
    'move_axes': MoveAxes,
}


class Bench(NodesUnderTest):
    """The nodes with a setup file, and clients of its services."""

    def __init__(self, file):
        self.file = file
        super().__init__({'program_node': {'setup': f"'{file}'", 'program_folders': "['/']"}})
        self.told = []
        self.node.create_subscription(SetupTable, 'setup_table', self.told.append, qos.LOADED)
        self.clients = {n: self.node.create_client(kind, n) for n, kind in SERVICES.items()}
        self.spin_until(lambda: all(c.service_is_ready() for c in self.clients.values()))

    def ask(self, service, **request):
        kind = SERVICES[service]
        if 'client' in kind.Request.get_fields_and_field_types():
            request['client'] = 'tester'
        answer = self.clients[service].call_async(kind.Request(**request))
        self.spin_until(answer.done)
        return answer.result()

    def do(self, service, **request):
        answer = self.ask(service, **request)
        assert answer.success, answer.message
        return answer.message

    def refused(self, service, **request):
        before = self.table()
        answer = self.ask(service, **request)
        assert not answer.success and '\n' not in answer.message
        assert self.table() == before
        return answer.message

    def table(self):
        return JobSetup.of_text(self.ask('read_setup').table.text)

    def move(self, **axes):
        answer = self.ask('move_axes', axes=list(axes), values=list(axes.values()))
        assert answer.success, answer.message
        wanted = np.array(answer.positions)
        self.spin_until(
            lambda: (
                self.peers.at_rest
                and np.abs(wanted - self.peers.state.commanded_positions).max() < 1e-9
            )
        )

    def start_to_stop(self, text):
        """Start a program and wait until it rests at its M0."""
        known = len(self.loaded)
        handle = self.start(text=text)
        self.spin_until(lambda: len(self.loaded) > known)
        self.spin_until(
            lambda: (
                self.peers.state.program_id == self.loaded[-1].program_id
                and self.peers.state.reason == MachineState.REASON_PROGRAM_STOP
                and self.peers.at_rest
            )
        )
        return handle

    def here(self):
        return np.array(self.next_state().commanded_positions)


@pytest.fixture(scope='module')
def bench(tmp_path_factory):
    running = Bench(tmp_path_factory.mktemp('setup') / 'setup.yaml')
    yield running
    running.close()


def test_touch_off_then_run_lands_where_it_must(bench):
    bench.do(
        'set_tool',
        number=3,
        fields=['length', 'radius', 'remark'],
        length=0.075,
        radius=0.005,
        remark='ball',
        load=True,
    )
    bench.move(X=0.1, Y=-0.05, Z=0.3)
    told = bench.do('touch_off', offset='G55', axes=['X', 'Y', 'Z'], values=[0.002, 0.0, 0.01])
    assert told == 'G55: not set -> X 98 Y -50 Z 215'
    bench.do('set_offset', offset='G55', activate=True)
    # Work X 2, Y 0, Z 10 with this tool is where the axes stood.
    program = 'G21 G90\nG43 H3\nG0 X0 Y0 Z30\nG1 X12 Y0 Z10 F3000\nM30\n'
    assert bench.run(text=program).code == Result.SUCCEEDED
    np.testing.assert_allclose(bench.here()[:3], [0.11, -0.05, 0.3], atol=1e-9)
    bench.spin_until(lambda: bench.told[-1].active == 'G54' and not bench.told[-1].in_use)
    assert bench.table() == JobSetup.load(bench.file)  # M30 has led back to G54; all else is kept
    assert bench.table().tools[3].remark == 'ball'
    assert bench.told[-1].changed_by == '<text> line 5'


def test_what_a_program_changes_is_kept_as_far_as_it_was_executed(bench):
    bench.do('set_offset', offset='G54', axes=['X', 'Y', 'Z'], values=[0.04, -0.07, 0.14])
    first = 'G21 G90\nG0 X0 Y0 Z0\nG1 X5 F3000\nG10 L20 P1 X1\nG92 Y2\nM30\n'
    assert bench.run(text=first).code == Result.SUCCEEDED
    np.testing.assert_allclose(bench.here()[:3], [0.045, -0.07, 0.14], atol=1e-9)
    kept = bench.table()
    assert kept.work_offsets['G54']['X'] == pytest.approx(0.044, abs=1e-12)
    assert kept.g92_on and kept.g92['Y'] == pytest.approx(-0.002, abs=1e-12)
    assert bench.run(text='G21 G90\nG0 X0 Y0\nG1 X3 Y4 F3000\n').code == Result.SUCCEEDED
    np.testing.assert_allclose(bench.here()[:2], [0.047, -0.068], atol=1e-9)
    # Stopped at M0: the change before it is kept, that after it never happened.
    handle = bench.start_to_stop(
        'G21 G90\nG0 X0\nG1 X9 F3000\nG10 L2 P3 X7\nX8\nM0\nG1 X2\nG10 L2 P3 X9\nX0\n'
    )
    bench.spin_until(lambda: 'G56' in bench.table().work_offsets)
    assert bench.press('reset').success
    bench.result_of(handle)
    assert bench.table().work_offsets['G56'] == {'X': 0.007}
    bench.do('set_offset', offset='G92', clear=True)


def test_what_a_running_program_uses_is_not_changed(bench):
    text = 'G21 G90\nG54 G0 X0 Y0\nG1 X1 F3000\nM0\nG1 X2\nG55 X1\nM30\n'
    handle = bench.start_to_stop(text)
    bench.spin_until(lambda: bench.table().active == 'G54')
    for name in ('G54', 'G55', 'G92'):
        told = bench.refused('set_offset', offset=name, axes=['X'], values=[0.0])
        assert (
            told
            == f'{name} is used by <text>, which is running; change it when the program has ended'
        )
    assert 'is used by' in bench.refused('touch_off', axes=['X'], values=[0.0])
    assert 'is used by' in bench.refused('set_tool', number=1, load=True)
    bench.do('set_offset', offset='G59.3', axes=['X'], values=[0.01])
    assert list(bench.told[-1].in_use) == ['G54', 'G55', 'G92']
    assert bench.press('reset').success
    bench.result_of(handle)
    bench.do('set_offset', offset='G54', axes=['C'], values=[0.0])


def test_a_waiting_program_starts_with_the_offsets_of_its_start(bench):
    bench.do('set_offset', offset='G54', axes=['X', 'Y', 'Z'], values=[0.04, -0.07, 0.14])
    bench.do('set_offset', offset='G54', activate=True)
    first = bench.start(text='G21 G90\nG54 G0 X0 Y0 Z0\nG1 X3 F3000\nG10 L2 P1 X50\nM30\n')
    second = bench.start(text='G21 G90\nG0 X0 Y0 Z0\nG1 X1 F3000\n')
    assert bench.result_of(first).code == bench.result_of(second).code == Result.SUCCEEDED
    np.testing.assert_allclose(bench.here()[0], 0.051, atol=1e-9)


@pytest.mark.parametrize(
    ('service', 'request_', 'part'),
    [
        ('set_offset', {'offset': 'G60', 'axes': ['X'], 'values': [0.0]}, 'G60: no such offset'),
        ('set_offset', {'axes': ['W'], 'values': [0.0]}, 'W has no offset'),
        ('set_offset', {'axes': ['X'], 'values': [float('nan')]}, 'X: an offset beyond'),
        ('set_offset', {'axes': ['X', 'X'], 'values': [0.0, 1.0]}, 'name each axis once'),
        ('set_offset', {'offset': 'G55'}, 'nothing to change'),
        ('set_tool', {'number': 0, 'fields': ['length']}, 'tools have numbers'),
        ('set_tool', {'number': 1, 'fields': ['radius'], 'radius': -1.0}, 'not be below 0'),
        ('set_tool', {'number': 1, 'fields': ['remark'], 'remark': 'a\nb'}, 'one line'),
        ('set_tool', {'number': 77, 'remove': True}, 'not in the table'),
        ('touch_off', {'offset': 'G92', 'axes': ['X'], 'values': [0.0]}, 'sets a work offset'),
        ('touch_off', {}, 'nothing to change'),
    ],
)
def test_wrong_values_are_refused_in_one_line(bench, service, request_, part):
    assert part in bench.refused(service, **request_)


def test_a_kill_during_edits_leaves_the_file_whole(bench):
    """What was answered is in the file; the edit under way is there, or it is not."""
    answered, pid = -1, bench.children.nodes['program_node'].process.pid
    bench.do('set_offset', offset='G58', clear=True, axes=['X', 'Y'], values=[0.0, 0.0])
    bench.watching = False
    kill = threading.Timer(random.uniform(0.2, 1.0), os.kill, (pid, signal.SIGKILL))
    kill.start()
    for k in range(1_000_000):
        values = [k * 1e-6, -k * 1e-6]
        request = SetOffset.Request(offset='G58', axes=['X', 'Y'], values=values, client='killer')
        answer = bench.clients['set_offset'].call_async(request)
        while not answer.done() and bench.children.nodes['program_node'].process.exitcode is None:
            bench.executor.spin_once(timeout_sec=0.05)
        if not answer.done():
            break
        answered = k
    kill.join()
    found = JobSetup.load(bench.file).work_offsets['G58']
    assert found['Y'] == -found['X'] and round(found['X'] * 1e6) in (answered, answered + 1)
    assert list(bench.children.revive()) == ['program_node']
    bench.told.clear()
    bench.spin_until(lambda: bench.told and bench.told[-1].text)
    assert JobSetup.of_text(bench.told[-1].text) == JobSetup.load(bench.file)


def cnc_interp(bench, *arguments):
    command = [sys.executable, '-m', 'cnc_interp', *arguments]
    command += ['--namespace', bench.namespace, '--domain', str(bench.domain)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.thorough
def test_the_command_line_shows_changes_and_refuses_in_one_line(bench):
    assert cnc_interp(bench, 'offsets', 'G57', 'X', '10', 'C', '-5', '--clear').returncode == 0
    bench.move(X=0.05)
    done = cnc_interp(bench, 'touch-off', 'X', '1.5', '--offset', 'G57')
    assert done.stdout == 'G57: X 10 C -5 -> X 48.5 C -5\n', done.stderr
    assert cnc_interp(bench, 'tools', '8', '--length', '60', '--remark', 'flat').returncode == 0
    shown = cnc_interp(bench, 'tools').stdout
    assert re.search(r'^8 +60\.000 +0\.000 +flat$', shown, re.M) and str(bench.file) in shown
    cnc_interp(bench, 'offsets', 'G57', '--use')
    shown = cnc_interp(bench, 'offsets').stdout
    assert re.search(r'^work G57 +1\.500 ', shown, re.M)
    assert re.search(r'^machine +50\.000 ', shown, re.M)
    assert json.loads(cnc_interp(bench, 'offsets', '--json').stdout)['active'] == 'G57'
    for words, part in (
        (('offsets', 'G60', 'X', '1'), 'G60: no such offset'),
        (('offsets', 'G54', 'X'), 'write each axis once'),
        (('tools', '0', '--length', '1'), 'tools have numbers from 1'),
        (('touch-off', 'W', '0'), 'no axis W'),
    ):
        wrong = cnc_interp(bench, *words)
        assert wrong.returncode == 2 and wrong.stderr.count('\n') == 1 and part in wrong.stderr
