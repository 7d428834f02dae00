"""The operator page as a process of its own beside real nodes, and a browser that shows it."""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

from browser import Browser
from cnc_interp_msgs.msg import MachineState
from nodes_under_test import NodesUnderTest, clean_environment
from std_msgs.msg import Float64

from cnc_interp.nodes import qos
from cnc_interp.page.contact import INTERRUPTED

TOKEN = 'every test knows it'
#: True while the page says that a key did nothing because the connection was interrupted.
REFUSED = f'document.body.textContent.includes("{INTERRUPTED}")'

#: What draws machine, path and part.
VIEW = 'document.querySelector(".scene canvas")'


class PageUnderTest:
    """The page beside nodes that run, and a browser."""

    def __init__(self, namespace, domain):
        self._folder = tempfile.TemporaryDirectory()
        token_file = Path(self._folder.name) / 'token'
        token_file.write_text(TOKEN)
        command = [sys.executable, '-m', 'cnc_interp', 'panel', '--attach', '--port', '0']
        command += ['--namespace', namespace, '--domain', str(domain), '--token-file', token_file]
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, text=True, env=clean_environment()
        )
        self.address = re.search(r'http://\S+/', self.process.stdout.readline())[0]
        self.browser = Browser()
        self.tabs = []

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
        tab.close()

    def close(self):
        self.browser.close()
        self.process.terminate()
        self.process.wait()
        self._folder.cleanup()


class PanelUnderTest(NodesUnderTest):
    """The nodes, and the page beside them."""

    def __init__(self, parameters=None):
        super().__init__(parameters)
        self.set_override = self.node.create_publisher(Float64, 'feed_override', qos.OVERRIDE)
        self.page = PageUnderTest(self.namespace, self.domain)
        self.open, self.open_in_charge = self.page.open, self.page.open_in_charge

    @property
    def override(self):
        """The feed override that counts."""
        return self.peers.state.feed_override

    def last_words(self):
        """What each page shows, and what the nodes said."""
        return [tab.texts() for tab in self.page.tabs], super().last_words()

    def until(self, state):
        self.spin_until(lambda: self.peers.state and self.peers.state.state == state)

    def load(self, tab, path):
        """Load a program and wait until it is planned."""
        tab.wait(lambda: tab.text('state') == 'idle')
        tab.choose_file('input[type=file]', path)
        tab.wait(lambda: tab.text('program') == path.name and tab.text('status') == 'planned')

    def press_key(self, tab, key, done):
        """
        Press a key and see it done.

        A busy computer may interrupt the connection for some seconds. Then the page must say so,
        the key must do nothing, and the first press after the contact is back must work.
        """
        tab.click(key)
        self.spin_until(lambda: done() or tab.run(REFUSED))
        if not done():
            tab.wait(lambda: not tab.run(REFUSED))
            assert not done(), f'{key}: {INTERRUPTED}, and the key did something'
            tab.click(key)
            self.spin_until(done)

    def begin(self, tab):
        """Start the loaded program, and see the machine on its way along the path."""
        before = len(self.loaded)
        self.press_key(tab, 'cycle start', lambda: len(self.loaded) > before)
        self.spin_until(self.is_on_its_way)

    def is_on_its_way(self):
        """Tell whether the machine has executed some of the program loaded last."""
        state, program = self.peers.state, self.loaded[-1]
        return state.program_id == program.program_id and state.path_position > 0.01

    def go_on(self, tab):
        """Go on where the page shows that the machine rests, and see it further on its path."""
        tab.wait(lambda: tab.text('state') in ('held', 'starved'))
        held = self.next_state().path_position
        self.press_key(tab, 'cycle start', lambda: self.peers.state.path_position > held)

    def reset(self, tab):
        """Clear a fault, or give up what is left of the program."""
        self.press_key(tab, 'reset', lambda: self.peers.state.state == MachineState.IDLE)
        tab.wait(lambda: tab.text('state') == 'idle')

    def tidy(self):
        """Close all tabs and bring the machine to rest at full override, for the next test."""
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

    def close(self):
        self.page.close()
        return super().close()
