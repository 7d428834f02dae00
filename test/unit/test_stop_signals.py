"""Signals that ask a command to end: seen, or held back until nothing must be left half done."""

import os
import signal
import subprocess
import sys
import threading

import pytest

from cnc_interp.processes.stop_signals import STOPS, stop_signals, stops_later


@pytest.fixture(autouse=True)
def hear_ctrl_c():
    """As in a terminal: what is started in the background does not hear it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize('number', STOPS)
def test_a_signal_is_seen_by_the_loop(number):
    with stop_signals() as stop:
        assert not stop
        signal.raise_signal(number)
        assert stop == [number]


def test_an_interrupt_comes_after_what_must_not_be_broken_off():
    done = []
    with pytest.raises(KeyboardInterrupt):
        with stops_later():
            signal.raise_signal(signal.SIGINT)
            done.append('to the end')
        done.append('not reached')
    assert done == ['to the end']


def test_it_also_comes_after_a_failure():
    with pytest.raises(KeyboardInterrupt), stops_later():
        signal.raise_signal(signal.SIGINT)
        raise ValueError


def test_the_handlers_are_those_of_before():
    before = {number: signal.getsignal(number) for number in STOPS}
    with stops_later():
        assert signal.getsignal(signal.SIGINT) is not before[signal.SIGINT]
    assert {number: signal.getsignal(number) for number in STOPS} == before


def test_other_threads_hold_nothing_back():
    reached = []

    def serve():
        with stops_later():
            reached.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=serve)
    thread.start()
    thread.join()
    assert reached == [signal.getsignal(signal.SIGINT)]


LOST = """
import signal, time
from argparse import Namespace
from cnc_interp import __main__
from cnc_interp.commands import cli

class Final:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)

def work(_):
    if load:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt as problem:
            raise ImportError('initialization failed') from problem
    Final()
    time.sleep(60.0)

signal.signal(signal.SIGINT, signal.default_int_handler)
cli.parser = lambda: Namespace(parse_args=lambda _: Namespace(command=work))
raise SystemExit(__main__.main())
"""


@pytest.mark.parametrize('load', [False, True])
def test_ctrl_c_in_a_finaliser_or_while_a_library_loads_is_not_lost(load):
    """A run went on to its end: the exception had come in a finaliser of llvmlite."""
    words = [sys.executable, '-c', f'load = {load}\n{LOST}']
    done = subprocess.run(words, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, 'cnc-interp: interrupted\n')


LOADING = """
import signal, sys
from cnc_interp import __main__

class Finder:
    def find_spec(self, name, *_):
        if name == 'cnc_interp.commands.cli':
            signal.raise_signal(number)

signal.signal(signal.SIGINT, signal.default_int_handler)
sys.meta_path.insert(0, Finder())
raise SystemExit(__main__.main())
"""


@pytest.mark.parametrize('number', STOPS)
def test_a_signal_while_the_commands_are_loaded_ends_with_one_line(number):
    """SIGTERM and a closed terminal ended the command without a word in its first second."""
    words = [sys.executable, '-c', f'number = {int(number)}\n{LOADING}']
    done = subprocess.run(words, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, 'cnc-interp: interrupted\n')


@pytest.mark.thorough
@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGHUP])
def test_a_plan_with_processes_ends_with_one_line(tmp_path, number):
    """Issue 56: each process that planned a part showed the traceback of its parent's handler."""
    program = tmp_path / 'long.nc'
    lines = (f'X{i % 7} Y{i % 11} Z{i / 1000}' for i in range(60_000))
    program.write_text('G21 G90 F3000\nG1 X0 Y0 Z0\n' + '\n'.join(lines))
    command = ['-m', 'cnc_interp', 'plan', str(program), '--machine', 'xyz', '--workers', '2']
    with subprocess.Popen(
        [sys.executable, *command, '--out', str(tmp_path / 'plan')],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    ) as plan:
        for line in plan.stderr:
            if line.startswith('planning'):
                break
        os.killpg(plan.pid, number)
        rest = [line for line in plan.stderr.read().splitlines() if not line.startswith('plann')]
    assert rest == ['cnc-interp: interrupted'] and plan.returncode == 130
