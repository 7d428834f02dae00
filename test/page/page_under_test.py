"""The operator page as a process of its own beside real nodes, and a browser that shows it."""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')
pytest.importorskip(
    'nicegui', reason='needs requirements/panel.txt; run the tests with ./cnc test'
)

from browser import Browser, Tab
from cnc_interp_msgs.msg import MachineState, SetupTable
from nodes_under_test import NodesUnderTest, clean_environment
from std_msgs.msg import Float64

from cnc_interp.nodes import qos
from cnc_interp.page.contact import INTERRUPTED
from cnc_interp.program import JobSetup

TOKEN = 'every test knows it'

#: What draws machine, path and part.
VIEW = 'document.querySelector(".scene canvas")'


class PageUnderTest:
    def __init__(self, namespace, domain, *options):
        self._folder = tempfile.TemporaryDirectory()
        token_file = Path(self._folder.name) / 'token'
        token_file.write_text(TOKEN)
        command = [sys.executable, '-m', 'cnc_interp', 'panel', '--attach', '--port', '0']
        command += ['--namespace', namespace, '--domain', str(domain), '--token-file', token_file]
        self.process = subprocess.Popen(
            [*command, *options], stdout=subprocess.PIPE, text=True, env=clean_environment()
        )
        self.address = re.search(r'http://\S+/', self.process.stdout.readline())[0]
        self.browser = Browser()
        self.tabs, self.faults = [], []

    def open(self, token=TOKEN, **size):
        """
        Open a page and wait until it shows who commands, and its view is drawn.

        Drawing in software, a page that is hidden before waits for all that others draw.
        """
        tab = self.browser.open(f'{self.address}?token={token.replace(" ", "%20")}', **size)
        self.tabs.append(tab)
        tab.wait(lambda: tab.text('rights') in ('in charge', 'view only'))
        tab.wait(lambda: tab.run(f'!!{VIEW}'))
        tab.run(f'{VIEW}.getContext("webgl2").finish()')
        return tab

    def open_in_charge(self, **size):
        """Open a page and take command, which a closed page keeps for a while."""
        tab = self.open(**size)
        if tab.text('rights') != 'in charge':
            tab.click('take over')
            tab.wait(lambda: tab.text('rights') == 'in charge')
        return tab

    def close_tab(self, tab):
        self.tabs.remove(tab)
        self.faults += tab.faults
        tab.close()

    def close(self):
        self.browser.close()
        self.process.terminate()
        self.process.wait()
        self._folder.cleanup()


class PanelUnderTest(NodesUnderTest):
    def __init__(self, parameters=None, *options):
        super().__init__(parameters)
        self.set_override = self.node.create_publisher(Float64, 'feed_override', qos.OVERRIDE)
        self.told = self.listen('setup_table', SetupTable, qos.LOADED)
        self.spin_until(lambda: self.told)
        self.page = PageUnderTest(self.namespace, self.domain, *options)
        self.open, self.open_in_charge = self.page.open, self.page.open_in_charge

    @property
    def override(self):
        return self.peers.state.feed_override

    @property
    def setup(self):
        return JobSetup.of_text(self.told[-1].text)

    def last_words(self):
        return [tab.last_words() for tab in self.page.tabs], super().last_words()

    def until(self, state):
        self.spin_until(lambda: self.peers.state and self.peers.state.state == state)

    def load(self, tab, path):
        tab.wait(lambda: tab.text('state') == 'idle')
        tab.choose_file('input[type=file]', path)
        tab.wait(lambda: tab.text('program') == path.name and tab.text('status') == 'planned')

    def press_key(self, tab, key, done, press=Tab.click):
        """
        Press a key of the page, or one of the keyboard, and see it done.

        A busy computer may interrupt the connection for some seconds. Then the page must say so,
        the key must do nothing, and the first press after the contact is back must work.
        """
        done_at_once = False

        def settled():
            nonlocal done_at_once
            done_at_once = done()
            return done_at_once or tab.shows(INTERRUPTED)

        press(tab, key)
        self.spin_until(settled)
        if not done_at_once:
            tab.wait(lambda: not tab.shows(INTERRUPTED))
            assert not done(), f'{key}: {INTERRUPTED}, and the key did something'
            press(tab, key)
            self.spin_until(done)

    def give(self, tab, line, told=''):
        """Give a line and see the answer to it: the page still shows that to the line before."""
        told = told or f'{line}: done'
        tab.fill('mdi', line)
        self.press_key(tab, 'Enter', lambda: told in tab.text('mdi answer'), Tab.type_key)

    def begin(self, tab):
        """Start the loaded program, put in its tool if it waits for one, and see it on its way."""
        before = len(self.loaded)

        def asks():
            return tab.text('why').startswith('put tool')

        self.press_key(tab, 'cycle start', lambda: len(self.loaded) > before)
        self.spin_until(lambda: self.is_on_its_way() or asks())
        if asks():
            self.press_key(tab, 'cycle start', lambda: not asks())
        self.spin_until(self.is_on_its_way)

    def is_on_its_way(self):
        state, program = self.peers.state, self.loaded[-1]
        return state.program_id == program.program_id and state.path_position > 0.01

    def go_on(self, tab):
        """Go on where the page shows that the machine rests, and see it further on its path."""
        tab.wait(lambda: tab.text('state') in ('held', 'starved'))
        held = self.next_state().path_position
        self.press_key(tab, 'cycle start', lambda: self.peers.state.path_position > held)

    def reset(self, tab):
        self.press_key(tab, 'reset', lambda: self.peers.state.state == MachineState.IDLE)
        tab.wait(lambda: tab.text('state') == 'idle')

    def tidy(self):
        for tab in tuple(self.page.tabs):
            self.page.close_tab(tab)
        if self.override != 1.0:
            self.set_override.publish(Float64(data=1.0))
            self.spin_until(lambda: self.override == 1.0)
        if self.peers.state.state != MachineState.IDLE:
            self.press('emergency_stop')
            self.until(MachineState.FAULT)
            self.press('reset')
            self.until(MachineState.IDLE)
        faults, self.page.faults = self.page.faults, []
        assert faults == []

    def close(self):
        self.page.close()
        return super().close()
