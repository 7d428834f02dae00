"""Take the pictures of docs/operate.md while an operator's tasks are done on the page.

    python docs/make_operate_pictures.py

serves the page for a machine that must be homed, has a probe and no tool changer, and does the
tasks of docs/operate.md in a real browser, with its mouse and keyboard. Writes
``docs/pictures/operate_*.png``, their parts numbered as in the text, and the sheets
``tasks_phone.png`` and ``tasks_wide.png`` with each task on other screens. ``--all FOLDER`` writes
each task on each screen, too. Needs Chromium, requirements/panel.txt and Pillow.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from make_page_pictures import HERE, SETTLE, SIZE, Browser, Tab, interp, label, seen_on
from PIL import Image

ROOT = HERE.parent
PROGRAM = ROOT / 'examples' / 'first_part.ngc'
#: The five-axis machine, with what its operator must do by hand; and a part for its probe.
MACHINE = (
    (ROOT / 'config' / 'machines' / 'xyzac.yaml').read_text(encoding='utf-8')
    + """
homing:
  switches: {X: -480.0, Y: -480.0, Z: 480.0}
  order: [[Z], [X, Y]]
  required: true
signals:
  outputs: {probe_armed: {range: [0, 2]}}
  inputs: {probe: null}
  functions: {G38.2: [{probe_armed: 1}], G38.4: [{probe_armed: 2}]}
"""
)
PART = 'surfaces: [{bore: [15.0, 12.0, 50.0], radius_mm: 8.0}]\n'
#: Width, height and whether it is a phone; columns and scale of the sheet of its pictures.
SCREENS = {'phone': ((390, 844, True), 5, 0.5), 'wide': ((1920, 1080, False), 3, 1 / 3)}
#: Steps by which the feed is lowered while the program runs: a picture takes seconds.
SLOWER = 19


class Walk:
    """The tasks of an operator on a page, with pictures of each."""

    def __init__(self, tab: Tab, folder: Path, everything: Path | None):
        self._tab, self._folder, self._everything = tab, folder, everything
        self._seen: dict[str, list[Image.Image]] = {name: [] for name in SCREENS}

    def picture(self, name: str, *marks: str) -> None:
        """Write what the page shows; number the parts with these marks."""
        time.sleep(SETTLE)
        shown = self._shown()
        self._keep(name, 'usual', shown)
        if marks:
            label(self._tab, shown, marks)
            shown.quantize(256).save(HERE / 'pictures' / f'operate_{name}.png', optimize=True)
        for screen, (size, _, _) in SCREENS.items():
            self._tab.size(*size)
            time.sleep(SETTLE)
            self._seen[screen].append(self._shown())
            self._keep(name, screen, self._seen[screen][-1])
        self._tab.size(*SIZE)
        time.sleep(1.0)

    def _keep(self, name: str, screen: str, shown: Image.Image) -> None:
        if self._everything is not None:
            shown.save(self._everything / f'{name}_{screen}.png')

    def _shown(self) -> Image.Image:
        """Return what the page shows while it is in contact."""
        while True:  # a busy computer interrupts the contact for the time of a picture
            self._tab.wait(lambda: self._tab.text('contact') == '')
            shown = seen_on(self._tab, self._folder)
            if self._tab.text('contact') == '':
                return shown

    def write_sheets(self) -> None:
        """Write all tasks as each of the other screens showed them, side by side."""
        for screen, ((width, height, _), columns, scale) in SCREENS.items():
            pictures = self._seen[screen]
            wide, high = round(width * scale), round(height * scale)
            sheet = Image.new('RGB', (columns * wide, -(-len(pictures) // columns) * high))
            for k, shown in enumerate(pictures):
                small = shown.resize((wide, high), Image.Resampling.LANCZOS)
                sheet.paste(small, (k % columns * wide, k // columns * high))
            sheet.quantize(256).save(HERE / 'pictures' / f'tasks_{screen}.png', optimize=True)

    def press(self, mark: str) -> None:
        """Press a key with the mouse."""
        self._tab.wait(lambda: self._tab.text('contact') == '')
        self._tab.click_with_mouse(mark)

    def state(self, *names: str) -> None:
        """Wait for a state of the machine."""
        self._tab.wait(lambda: self._tab.text('state') in names)

    def give(self, line: str) -> None:
        """Have a line executed in the MDI field."""
        self._tab.fill('mdi', line)
        self._tab.type_key('Enter')
        self._tab.wait(lambda: f'{line}: done' in self._tab.text('mdi answer'))

    def load(self) -> None:
        """See the program planned and proven."""
        self._tab.wait(lambda: self._tab.text('status') == 'planned')
        self.press('check')
        self._tab.wait(lambda: 'proven' in self._tab.text('status'))
        marks = 'state', 'program', 'load', 'check', 'look', 'setup', 'cycle start', 'keyboard'
        self.picture('load', *marks)

    def home(self) -> None:
        """Find the reference switches."""
        self.press('jog')
        self.press('home ')
        self.state('jogging')
        self.state('idle')
        self.picture('home')

    def move(self) -> None:
        """Move the axes by lines, and by the keys of the pad."""
        self.give('G0 Z60')
        self.give('G0 X0 Y0')
        self._tab.run(
            '[...document.querySelectorAll(`[data-mark="jog step"] button`)].at(-1).click()'
        )
        self._tab.wait(
            lambda: self._tab.run('document.querySelector(".jog").dataset.step') == '10'
        )
        self.press('jog Z-')
        self._tab.wait(lambda: self._tab.text('work Z') == '50.000')
        self.state('idle')
        self.picture('move', 'mdi', 'jog', 'jog step', 'jog Z-', 'jog speed', 'setup')
        self.press('close jog')

    def touch_off(self) -> None:
        """Say what the axes read here."""
        self.press('show touch off')
        for axis in 'XYZ':
            self._tab.fill(f'here {axis}', '0')
        self.picture('touch_off', 'here X', 'touch off', 'setup', 'offsets')
        self.press('touch off')
        self._tab.wait(lambda: self._tab.text('work Z') == '0.000')
        self.press('show touch off')
        self._tab.wait(lambda: self._tab.text('status') == 'planned')
        self.give('G0 Z40')

    def change_tool(self) -> None:
        """Start; the first line asks for tool 1."""
        for _ in range(SLOWER):
            self.press('slower')
        self.press('cycle start')
        self._tab.wait(lambda: 'put tool 1' in self._tab.text('why'))
        self.picture('tool_change', 'why', 'start', 'cycle start')

    def run(self) -> None:
        """Run the program, slowly enough for a picture."""
        self.press('cycle start')
        self._tab.wait(lambda: 'F2400' in self._tab.text('modes'))
        self.picture('run', 'line', 'modes', 'feed hold', 'override slider', 'to go', 'rapids')

    def away(self) -> None:
        """Hold, and move the tool away."""
        self.press('feed hold')
        self.state('held')
        self.press('100%')
        self.press('jog')
        self.press('jog tool+')
        self._tab.wait(lambda: 'moved away' in self._tab.text('why'))
        self.state('held')
        self.picture('away', 'why', 'jog tool+', 'start', 'cycle start')
        self.press('close jog')
        self.press('reset')
        self.state('idle')

    def start_at_a_line(self) -> None:
        """See the state and the way before the motion to a line."""
        self._tab.fill('start line', '15')
        self._tab.fill('start pass', '2')
        self.press('start here')
        self._tab.wait(lambda: 'line 15, pass 2' in self._tab.text('start'))
        self.press('cycle start')
        self._tab.wait(lambda: 'plunge' in self._tab.text('start'))
        self.picture('start_line', 'start line', 'start here', 'start', 'cycle start', 'reset')
        self.press('reset')
        self.state('idle')

    def probe(self) -> None:
        """Find the middle of a bore, and see what would be set."""
        self.give('G0 X15 Y12')
        self.give('G0 Z-5')
        self.press('probe')
        self.press('probe bore')
        self._tab.wait(lambda: self._tab.value('probe diameter'))
        self._tab.fill('probe diameter', '16')
        self.press('start probe')
        self._tab.wait(lambda: 'G54 X ' in (self._tab.text('found') or ''))
        self.picture('probe')
        self.press('leave found')

    def alarm(self) -> None:
        """Stop in an emergency while the program runs."""
        self.press('cycle start')
        self.state('held', 'running')
        self.press('EMERGENCY STOP')
        self.state('fault')
        self.picture('alarm')
        self.press('reset')
        self.state('idle')

    def shut_down(self) -> None:
        """Stand where the machine may be switched off."""
        self.give('G53 G0 Z400')
        self.picture('shut_down')


@contextmanager
def page(folder: Path) -> Iterator[Tab]:
    """Serve the page beside nodes of its own, and show it in a browser."""
    files = {'token': 'known-to-pictures', 'machine.yaml': MACHINE, 'part.yaml': PART}
    for name, text in files.items():
        (folder / name).write_text(text)
    words = ['--machine', folder / 'machine.yaml', '--setup', folder / 'setup.yaml']
    words += ['--drives', f'simulated,probe_touches={folder / "part.yaml"}']
    words += ['--port', '0', '--token-file', folder / 'token']
    command = interp('panel', str(PROGRAM), *map(str, words))
    served = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    browser = Browser()
    try:
        assert served.stdout is not None
        said = iter(served.stdout)
        address = next(found for line in said if (found := re.search(r'http://\S+/', line)))
        tab = browser.open(f'{address[0]}?token=known-to-pictures', *SIZE)
        tab.wait(lambda: tab.text('rights') == 'in charge')
        yield tab
    finally:
        browser.close()
        served.terminate()
        served.wait()


def main() -> None:
    """Do the tasks, take the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--all', type=Path, metavar='FOLDER')
    everything = parser.parse_args().all
    if everything is not None:
        everything.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name, page(Path(name)) as tab:
        walk = Walk(tab, Path(name), everything)
        for task in (
            walk.load,
            walk.home,
            walk.move,
            walk.touch_off,
            walk.change_tool,
            walk.run,
            walk.away,
            walk.start_at_a_line,
            walk.probe,
            walk.alarm,
            walk.shut_down,
        ):
            task()
            print(task.__name__, flush=True)
        walk.write_sheets()
        assert tab.faults == [], tab.faults


if __name__ == '__main__':
    main()
