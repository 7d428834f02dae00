"""A run without a terminal waits where the operator must answer; an end of input is no Enter."""

import os
import pty
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import MachineState
from nodes_under_test import PATIENCE
from test_leftovers import family
from tiers import few_of

from cnc_interp.client.operator_client import OperatorClient
from cnc_interp.processes.node_processes import NODES

PROGRAM = 'G21 G90 G94 M3 S1000\nG0 X0 Y0 Z0\nG1 X5 F3000\nX8\nM0\nX10\nM30\n'
#: How long nothing may happen [s].
A_WHILE = 1.0


@pytest.fixture
def program(tmp_path):
    file = tmp_path / 'part.ngc'
    file.write_text(PROGRAM)
    return file


def start(program, *words, stdin=subprocess.DEVNULL, **options):
    command = [sys.executable, '-m', 'cnc_interp', 'run', str(program), *words]
    return subprocess.Popen(command, stdin=stdin, stderr=subprocess.PIPE, text=True, **options)


def place_told(run):
    """Read on until the run tells how it is continued; return namespace and domain."""
    for line in run.stderr:
        if found := re.search(r'--namespace (\S+) --domain (\d+)', line):
            return found[1], int(found[2])
    pytest.fail('not told how to go on')


def waits(client, reason):
    """Wait for a stop, and see that the machine stays there."""
    until = time.monotonic() + PATIENCE
    while client.state is None or not (
        client.state.reason == reason
        and client.state.waits_for == MachineState.WAITS_FOR_CYCLE_START
    ):
        assert time.monotonic() < until, client.state
        client.serve()
    samples, until = client.state.samples, time.monotonic() + A_WHILE
    while time.monotonic() < until:
        client.serve()
        assert (client.state.reason, client.state.samples) == (reason, samples)


@pytest.mark.parametrize('loses_a_node', few_of(2, [False, True]))
def test_without_a_terminal_it_waits_for_cycle_start(program, loses_a_node):
    words = ['--from-line', '3']  # that of the first motion waits, too
    if not loses_a_node:  # nor does a stop before it let anything move
        program.write_text(PROGRAM.replace('Z0\n', 'Z0\nM0\n'))
        words = []
    run = start(program, *words)
    try:
        # before anything moves, and not as a note among others
        assert any(line.startswith('line 1: M3: WARNING: ') for line in run.stderr)
        with OperatorClient('operator', *place_told(run)) as client:
            waits(client, MachineState.REASON_APPROACH)
            assert client.granted(client.ask('cycle_start')).ok
            waits(client, MachineState.REASON_PROGRAM_STOP)
            if loses_a_node:  # one that is started again does not go on, either
                for member in family(run.pid):
                    if Path(f'/proc/{member}/comm').read_text().strip() == 'feedrate_node':
                        os.kill(member, signal.SIGKILL)
                assert any('started again' in line for line in run.stderr)
                waits(client, MachineState.REASON_PROGRAM_STOP)
        run.send_signal(signal.SIGTERM)
        assert run.wait(PATIENCE) != 0
    finally:
        run.kill()


@pytest.mark.thorough
def test_a_signal_to_all_its_processes_cancels_a_run(program):
    """As ``timeout`` sends it: nodes and what starts them end in order."""
    run = start(program, start_new_session=True)
    place_told(run)
    os.killpg(run.pid, signal.SIGTERM)
    told = run.communicate(timeout=PATIENCE)[1]
    assert run.returncode == 1 and 'cancelled' in told and ' ended' not in told


@pytest.mark.thorough
def test_a_run_goes_on_and_ends_without_its_fork_server(program):
    run = start(program)
    namespace, domain = place_told(run)
    members = [Path(f'/proc/{member}') for member in family(run.pid)]
    forked = [one for one in members if b'forkserver' in (one / 'cmdline').read_bytes()]
    assert len(forked) == 1 + len(NODES)
    (server,) = (one for one in forked if (one / 'comm').read_text().strip() not in NODES)
    os.kill(int(server.name), signal.SIGKILL)
    with OperatorClient('operator', namespace, domain) as client:
        waits(client, MachineState.REASON_PROGRAM_STOP)
        assert client.granted(client.ask('cycle_start')).ok
    assert run.wait(PATIENCE) == 0
    assert not any(one.exists() for one in forked)


@pytest.mark.thorough
def test_pass_stops_goes_on(program):
    program.write_text(PROGRAM.replace('M0', 'T4 M6\nM0'))
    assert start(program, '--from-line', '4', '--pass-stops').wait(PATIENCE) == 0


@pytest.mark.thorough
def test_at_a_terminal_enter_goes_on_and_ctrl_d_does_not(program):
    ours, theirs = pty.openpty()
    run = start(program, stdin=theirs)
    try:
        # A terminal that is not the controlling one counts as none: nobody may be there.
        assert place_told(run)
    finally:
        run.kill()
    reader, writer = os.pipe()
    pid, terminal = pty.fork()
    if not pid:
        os.dup2(writer, 2)
        os.execv(sys.executable, [sys.executable, '-m', 'cnc_interp', 'run', str(program)])
    os.close(writer)
    try:
        with os.fdopen(reader) as told:
            assert any('Enter to go on' in line for line in told)
            os.write(terminal, b'\x04')
            time.sleep(A_WHILE)
            assert os.waitpid(pid, os.WNOHANG) == (0, 0), 'Ctrl-D is no Enter'
            os.write(terminal, b'\n')
            while not (ended := os.waitpid(pid, os.WNOHANG))[0]:
                time.sleep(0.1)
            assert os.waitstatus_to_exitcode(ended[1]) == 0
    finally:
        os.close(ours)
        os.close(theirs)
        os.close(terminal)
