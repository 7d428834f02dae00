"""A real browser for the tests: Debian's Chromium, spoken to over its DevTools protocol."""

import base64
import json
import shutil
import subprocess
import tempfile
import time
import urllib.request
from contextlib import ExitStack
from pathlib import Path

import pytest

pytest.importorskip('websockets', reason='needs requirements/panel.txt')

from websockets.sync.client import connect

NAMES = ('chromium', 'chromium-browser', 'google-chrome')
PATIENCE = 120.0  # [s]; a bound for slow and busy computers, not a timing
#: What a page shows is fresh: its user would press a key now.
IN_CONTACT = '!!(window.contact?.connected() && contact.age() < 2500)'
#: Codes of keys of the keyboard that have no character, or are told by their code, too.
CODES = {
    'Tab': 9,
    'Enter': 13,
    'Escape': 27,
    ' ': 32,
    'ArrowLeft': 37,
    'ArrowUp': 38,
    'ArrowRight': 39,
    'ArrowDown': 40,
    'R': 82,
    'F1': 112,
}
#: Drawing in software takes half a core at the 20 frames a second of the view, and smooth edges
#: take as long as all the rest of a frame. As in every browser, nothing is drawn in tabs behind.
FEW_FRAMES = """
window.requestAnimationFrame = (draw) => {
  const step = () => (document.hidden ? setTimeout(step, 300) : draw(performance.now()));
  return setTimeout(step, 300);
};
HTMLCanvasElement.prototype.getContext = (made => function (kind, choices) {
  return made.call(this, kind, kind === 'webgl2' ? {...choices, antialias: false} : choices);
})(HTMLCanvasElement.prototype.getContext);"""


PATH = next(filter(None, map(shutil.which, NAMES)), None)
if PATH is None:
    pytest.skip('needs a browser: apt-get install chromium', allow_module_level=True)


class DevToolsError(Exception):
    pass


def key_names(key):
    return {'key': key, 'windowsVirtualKeyCode': CODES.get(key, 0)}


def field(name):
    return f'document.querySelector(`input[data-mark="{name}"], [data-mark="{name}"] input`)'


class Browser:
    """A browser without a window; WebGL is computed in software."""

    def __init__(self):
        self._folder = tempfile.TemporaryDirectory(prefix='cnc_browser_')
        profile = Path(self._folder.name)
        self.process = subprocess.Popen(
            [
                PATH,
                '--headless=new',
                '--no-sandbox',
                '--disable-gpu-sandbox',
                '--remote-debugging-port=0',
                f'--user-data-dir={profile}',
                '--no-first-run',
                '--use-angle=swiftshader',
                '--enable-unsafe-swiftshader',
                '--hide-scrollbars',
                '--disable-dev-shm-usage',
                '--disable-background-networking',
                '--disable-gpu-compositing',
                '--disable-background-timer-throttling',
                '--disable-renderer-backgrounding',
                'about:blank',
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        marker = profile / 'DevToolsActivePort'
        deadline = time.monotonic() + PATIENCE
        while not (marker.exists() and marker.read_text().count('\n')):
            assert time.monotonic() < deadline, 'the browser does not start'
            time.sleep(0.05)
        self._address = f'127.0.0.1:{marker.read_text().splitlines()[0]}'

    def open(self, url, width=1366, height=768, mobile=False):
        request = urllib.request.Request(f'http://{self._address}/json/new', method='PUT')
        target = json.load(urllib.request.urlopen(request))
        tab = Tab(target['webSocketDebuggerUrl'])
        tab.size(width, height, mobile)
        tab.go(url)
        return tab

    def close(self):
        self.process.terminate()
        self.process.wait()
        shutil.rmtree(self._folder.name, ignore_errors=True)


class Tab:
    def __init__(self, url):
        self._open = ExitStack()
        # nothing is read while a test waits for the machine: no full queue, no questions for life
        socket = connect(url, max_size=None, max_queue=None, ping_interval=None)
        self._socket = self._open.enter_context(socket)
        self._number = 0
        self._button = 'none'  # of the mouse, while it is pressed
        self.faults = []
        self.said = []  # by the scripts of the page
        self.send('Runtime.enable')
        self.send('Page.enable')
        self.send('Page.addScriptToEvaluateOnNewDocument', source=FEW_FRAMES)

    def send(self, method, **parameters):
        self._number += 1
        self._socket.send(json.dumps({'id': self._number, 'method': method, 'params': parameters}))
        deadline = time.monotonic() + PATIENCE
        while True:  # events come in between
            message = json.loads(self._socket.recv(timeout=deadline - time.monotonic()))
            if message.get('method') == 'Runtime.exceptionThrown':
                self.faults.append(message['params']['exceptionDetails'])
            if message.get('method') == 'Runtime.consoleAPICalled':
                self.said += [part.get('value') for part in message['params']['args']]
            if message.get('id') == self._number:
                if 'error' in message:
                    raise DevToolsError(message['error']['message'])
                return message['result']

    def size(self, width, height, mobile=False):
        self.send(
            'Emulation.setDeviceMetricsOverride',
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=mobile,
        )

    def go(self, url):
        self.send('Page.navigate', url=url)

    def run(self, script):
        answer = self.send(
            'Runtime.evaluate', expression=script, returnByValue=True, awaitPromise=True
        )
        assert 'exceptionDetails' not in answer, answer
        return answer['result'].get('value')

    def text(self, name):
        return self.run(f'document.querySelector(`[data-mark="{name}"]`)?.textContent')

    def texts(self):
        return self.run(
            'Object.fromEntries([...document.querySelectorAll("[data-mark]")]'
            '.map(e => [e.dataset.mark, e.textContent]))'
        )

    def last_words(self):
        return self.said[-5:], self.texts()

    def shows(self, words):
        """Whether words are on the page; on one that is being loaded nothing is."""
        return self.run(f'!!document.body?.textContent.includes(`{words}`)')

    def click(self, name):
        """Press a key that is there and may be pressed, on a page in contact with its server."""
        key = f'document.querySelector(`[data-mark="{name}"]:not([disabled])`)'
        self.wait(lambda: self.run(f'{IN_CONTACT} && !!{key} && ({key}.click(), true)'))

    def centre(self, name):
        """Middle of an element that stands still and is hit there, by its mark."""
        script = f"""(() => {{
          const part = document.querySelector(`[data-mark="{name}"]`);
          const box = part?.getBoundingClientRect();
          const at = box && [box.left + box.width / 2, box.top + box.height / 2];
          return at && part.contains(document.elementFromPoint(...at)) ? at : null;
        }})()"""
        seen = []

        def is_still():
            seen.append(self.run(script))
            return seen[-1] is not None and seen[-2:-1] == seen[-1:]

        self.wait(is_still)
        return seen[-1]

    def pointer(self, kind, x, y, device='mouse'):
        """Press, move, release or cancel a mouse, a pen or a finger, as its user does."""
        if device == 'touch':
            names = {'press': 'Start', 'move': 'Move', 'release': 'End', 'cancel': 'Cancel'}
            points = [{'x': x, 'y': y}] if kind in ('press', 'move') else []
            self.send('Input.dispatchTouchEvent', type=f'touch{names[kind]}', touchPoints=points)
            return
        name = {'press': 'mousePressed', 'move': 'mouseMoved', 'release': 'mouseReleased'}[kind]
        down = self._button if kind == 'move' else 'left'
        self.send(
            'Input.dispatchMouseEvent',
            type=name,
            x=x,
            y=y,
            button=down,
            pointerType=device,
            buttons=int(kind == 'press' or (down == 'left' and kind == 'move')),
            clickCount=int(kind != 'move'),
        )
        self._button = {'press': 'left', 'release': 'none'}.get(kind, self._button)

    def click_with_mouse(self, name):
        at = self.centre(name)
        for kind in ('move', 'press', 'release'):
            self.pointer(kind, *at)

    def ask(self, name, answer):
        """Press a key until words are shown; a page that is loaded anew forgets the press."""

        def answered():
            if not self.run('!!window.wasAsked'):
                self.wait(lambda: self.run(f'{IN_CONTACT} && (window.wasAsked = true)'))
                self.click_with_mouse(name)
            return self.shows(answer)

        self.wait(answered)

    def wait(self, done, patience=PATIENCE):
        deadline = time.monotonic() + patience
        while not done():
            assert time.monotonic() < deadline, (
                f'waited too long; the page shows {self.last_words()}'
            )
            time.sleep(0.05)

    def choose_file(self, selector, path):

        def give():
            root = self.send('DOM.getDocument')['root']['nodeId']
            found = self.send('DOM.querySelector', nodeId=root, selector=selector)['nodeId']
            if found:  # an upload that has just ended gives its input back a moment later
                self.send('DOM.setFileInputFiles', nodeId=found, files=[str(path)])
            return bool(found)

        self.wait(give)

    def fill(self, name, text):
        """
        Write into a field, as its user does.

        Focus and text come in one step: a dialog that is just opening takes the focus to itself.
        """
        self.wait(
            lambda: self.run(
                f'(() => {{ const field = {field(name)}; field?.focus(); field?.select();'
                'return field && document.activeElement === field &&'
                f'document.execCommand("insertText", false, `{text}`); }})()'
            )
        )

    def value(self, name):
        return self.run(f'{field(name)}?.value')

    def press_key(self, name, key, times=1):
        """Press a key on an element of a page in contact with its server."""
        self.wait(lambda: self.run(IN_CONTACT))
        self.press_key_at_once(name, key, times)

    def press_key_at_once(self, name, key, times=1):
        self.run(f'document.querySelector(`[data-mark="{name}"] [tabindex]`).focus()')
        for kind in ('rawKeyDown', 'keyUp') * times:
            self.send('Input.dispatchKeyEvent', type=kind, **key_names(key))

    def type_key(self, key):
        """Press a key of the keyboard, wherever the focus is; its character is typed."""
        self.wait(lambda: self.run(IN_CONTACT))
        text = {'text': key} if len(key) == 1 else {}
        self.send('Input.dispatchKeyEvent', type='keyDown', **key_names(key), **text)
        self.send('Input.dispatchKeyEvent', type='keyUp', **key_names(key))

    def show(self):
        """Bring it to the front, as its user does; the tabs behind are not shown anything."""
        self.send('Page.bringToFront')

    def reload(self):
        """Refresh the page; returns when the old one is gone."""
        self.run('window.isOld = true')
        self.send('Page.reload')

        def is_new():
            try:
                return not self.run('window.isOld')
            except DevToolsError:  # it leaves just now
                return False

        self.wait(is_new)

    def screenshot(self, path):
        image = self.send('Page.captureScreenshot', format='png')
        Path(path).write_bytes(base64.b64decode(image['data']))

    def close(self):
        self.send('Page.close')
        self._open.close()
