"""The operator page in a real browser, beside real nodes: what it shows, does and refuses."""

import os
import re
import subprocess
import sys
import time

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')
pytest.importorskip(
    'nicegui', reason='needs requirements/panel.txt; run the tests with ./cnc test'
)
pytest.importorskip('websockets', reason='needs requirements/panel.txt')

from browser import Browser, found
from cnc_interp_msgs.msg import MachineState
from nodes_under_test import NodesUnderTest
from std_msgs.msg import Float64

from cnc_interp.nodes import qos

pytestmark = pytest.mark.skipif(
    found() is None, reason='needs a browser: apt-get install chromium'
)

TOKEN = 'a test knows it'


def zigzag(name, sides):
    """A program of lines to and fro, each of 1.5 s."""
    lines = ''.join(f'G1 X{30 * (k % 2)} Y{5 * (k % 8)} F2000\n' for k in range(1, sides + 1))
    return f'({name} <of lines>)\nG21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A15 C30\n{lines}M30\n'


#: Long enough that it has not ended before a test acts, on a slow machine.
PROGRAM = zigzag('ZIGZAG', 30)


class PanelUnderTest(NodesUnderTest):
    """The nodes, the page beside them as a process of its own, and a browser."""

    def __init__(self):
        super().__init__()
        self.overrides = []
        self.node.create_subscription(
            Float64, 'feed_override', lambda m: self.overrides.append(m.data), qos.OVERRIDE
        )
        domain = str(1 + os.getpid() % 100)
        command = [sys.executable, '-m', 'cnc_interp', 'panel', '--attach', '--port', '0']
        command += ['--namespace', self.namespace, '--domain', domain, '--token', TOKEN]
        # NiceGUI takes another way where pytest's variables are set.
        clean = {k: v for k, v in os.environ.items() if not k.startswith('PYTEST')}
        self.page = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=clean)
        self.address = re.search(r'http://\S+/', self.page.stdout.readline())[0]
        self.browser = Browser()

    def open(self, token=TOKEN, **size):
        tab = self.browser.open(f'{self.address}?token={token.replace(" ", "%20")}', **size)
        tab.wait(lambda: tab.text('rights') in ('in charge', 'view only'))
        return tab

    def open_in_charge(self):
        """Open a page and take the keys, which a closed page keeps for a while."""
        tab = self.open()
        if tab.text('rights') != 'in charge':
            tab.click('take over')
            tab.wait(lambda: tab.text('rights') == 'in charge')
        return tab

    def load(self, tab, path):
        tab.choose_file('input[type=file]', path)
        tab.wait(lambda: tab.text('program') == path.name and tab.text('status') == 'planned')

    def until(self, state):
        self.spin_until(lambda: self.peers.state and self.peers.state.state == state)

    def press_until(self, tab, key, state):
        """Press a key; again, as its user would, where a page cut off has lost it."""
        for _ in range(10):
            tab.click(key)
            soon = time.monotonic() + 12.0
            self.spin_until(lambda: self.peers.state.state == state or time.monotonic() > soon)
            if self.peers.state.state == state:
                return
        raise AssertionError(f'{key} had no effect; {self.last_words()}')

    def close(self):
        self.browser.close()
        self.page.terminate()
        self.page.wait(10.0)
        super().close()


@pytest.fixture(scope='module')
def panel():
    running = PanelUnderTest()
    yield running
    running.close()


@pytest.fixture
def program(tmp_path):
    path = tmp_path / 'zigzag.ngc'
    path.write_text(PROGRAM)
    return path


def shown_axes(tab):
    return [float(tab.text(f'axis {name}')) for name in 'XYZAC']


def mm_and_degrees(positions):
    return [x * 1e3 for x in positions[:3]] + [x * 57.29577951308232 for x in positions[3:]]


def test_a_program_is_operated_from_the_page(panel, program):
    tab = panel.open()
    assert tab.text('rights') == 'in charge'
    panel.load(tab, program)
    tab.click('check')
    tab.wait(lambda: tab.text('status') == 'every setpoint proven')

    tab.click('cycle start')
    panel.until(MachineState.RUNNING)
    panel.spin_until(lambda: panel.peers.state.path_position > 0.02)
    tab.press_key('override slider', 'ArrowLeft', times=10)
    panel.spin_until(lambda: panel.overrides[-1:] == [0.5])
    tab.wait(lambda: tab.text('override') == '50%')

    panel.press_until(tab, 'feed hold', MachineState.HELD)
    held = panel.next_state()
    tab.wait(lambda: tab.text('state') == 'held')
    time.sleep(0.5)  # the read-outs follow at 10 Hz
    for shown, true, digit in zip(
        shown_axes(tab), mm_and_degrees(held.positions), (1e-3,) * 3 + (1e-4,) * 2, strict=True
    ):
        assert abs(shown - true) <= digit
    assert tab.text('line') == str(held.line_number)
    assert [float(tab.text(f'tip {x}')) for x in 'xyz'] == pytest.approx(
        [1e3 * x for x in held.tip], abs=1e-3
    )
    assert tab.run('document.querySelector(".lines .now").textContent').startswith(
        f'{held.line_number}{PROGRAM.splitlines()[held.line_number - 1]}'
    )
    share = held.path_position / panel.loaded[-1].path_length
    assert abs(float(tab.text('progress').rstrip('%')) - 100 * share) < 0.11

    # A refreshed page keeps everything; the machine does not notice.
    tab.reload()
    tab.wait(lambda: tab.text('program') == program.name)
    tab.wait(lambda: tab.text('rights') == 'in charge')
    assert panel.next_state().state == MachineState.HELD

    tab.click('single block')
    tab.click('cycle start')
    line = held.line_number
    panel.spin_until(
        lambda: (
            panel.peers.state.state == MachineState.HELD
            and panel.peers.state.path_position > held.path_position
        )
    )
    assert panel.peers.state.line_number - line <= 1
    tab.click('single block')
    tab.click('cycle start')
    panel.until(MachineState.RUNNING)

    tab.click('EMERGENCY STOP')
    panel.until(MachineState.FAULT)
    tab.wait(lambda: tab.text('state') == 'fault')
    tab.click('reset')
    panel.until(MachineState.IDLE)
    tab.press_key('override slider', 'ArrowRight', times=10)
    panel.spin_until(lambda: panel.overrides[-1] == 1.0)

    tab.click('cycle start')
    panel.until(MachineState.RUNNING)
    panel.spin_until(lambda: panel.peers.state.completed)
    tab.wait(lambda: tab.text('progress') == '100.0%')
    assert tab.faults == []
    tab.close()


def test_only_one_page_with_the_token_commands(panel, program):
    first = panel.open_in_charge()
    stranger, second = panel.open('wrong'), panel.open()
    for tab in (stranger, second):
        assert tab.text('rights') == 'view only'
        assert tab.run('document.querySelector(`[data-mark="cycle start"]`).disabled')
    assert stranger.run('document.querySelector(`[data-mark="EMERGENCY STOP"]`).disabled')
    assert not second.run('document.querySelector(`[data-mark="EMERGENCY STOP"]`).disabled')

    stranger.click('take over')
    second.click('take over')
    second.wait(lambda: second.text('rights') == 'in charge')
    first.wait(lambda: first.text('rights') == 'view only')
    time.sleep(0.5)
    assert stranger.text('rights') == 'view only'

    # Closing the page in charge neither stops the motion nor keeps the keys.
    program.write_text(zigzag('ZIGZAG', 8))
    panel.load(second, program)
    second.click('cycle start')
    panel.until(MachineState.RUNNING)
    second.close()
    panel.spin_until(lambda: panel.peers.state.completed)
    first.wait(lambda: first.text('progress') == '100.0%')
    first.close()
    stranger.close()


def test_a_program_waits_behind_the_one_that_runs(panel, program, tmp_path):
    tab, second = panel.open_in_charge(), tmp_path / 'second.ngc'
    second.write_text(zigzag('SECOND', 4))
    panel.load(tab, program)
    tab.click('cycle start')
    panel.until(MachineState.RUNNING)

    def wait_behind():
        tab.click('then')
        tab.choose_file('input[type=file]', second)
        tab.wait(lambda: tab.text('waiting') == 'then second.ngc')

    wait_behind()
    time.sleep(1.0)  # a program that waits is told so twice a second
    tab.click('take out')
    tab.wait(lambda: tab.text('waiting') == '')
    wait_behind()
    assert tab.text('program') == program.name
    panel.spin_until(lambda: panel.loaded[-1].name == 'second.ngc')
    tab.wait(lambda: tab.text('program') == 'second.ngc' and tab.text('waiting') == '')
    panel.spin_until(
        lambda: (
            panel.peers.state.completed
            and panel.peers.state.program_id == panel.loaded[-1].program_id
        )
    )
    assert tab.faults == []
    tab.close()


def test_what_is_wrong_with_a_program_is_said(panel, tmp_path):
    tab = panel.open_in_charge()
    wrong = tmp_path / 'wrong.ngc'
    wrong.write_text('G21 G90 G94\nG0 X0 Y0 Z0\nG1 X10 F0\nM30\n')
    tab.choose_file('input[type=file]', wrong)
    tab.wait(lambda: tab.text('program') == 'wrong.ngc' and tab.text('status') != 'planning')
    assert 'wrong.ngc:3' in tab.text('status')
    tab.close()


def test_a_lost_node_is_named(panel):
    tab = panel.open()
    tab.wait(lambda: tab.text('state') == 'idle')
    panel.watching = False
    os.kill(panel.children.process_ids['feedrate_node'], 9)
    tab.wait(lambda: tab.text('state') == 'no answer')
    tab.wait(lambda: 'feedrate_node' in tab.text('why'))
    tab.close()
