"""Take the pictures of docs/operate.md while an operator's tasks are done on the page.

    python docs/make_operate_pictures.py

starts ``cnc-interp panel examples/first_part.ngc`` and does in a real browser what steps 2 to 7 of
docs/operate.md say: load, move by hand, touch off, run, hold and move away, start at a line. Each
step's picture is ``docs/pictures/operate_*.png``, its parts numbered as in the text. Needs
Chromium, requirements/panel.txt and Pillow.
"""

from __future__ import annotations

import re
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from make_page_pictures import HERE, SETTLE, SIZE, Browser, Tab, interp, label, seen_on
from PIL import Image

PROGRAM = HERE.parent / 'examples' / 'first_part.ngc'

#: Steps by which the feed is lowered while the program runs: a picture takes seconds.
SLOWER = 19


class Walk:
    """The tasks of an operator on a page, with a picture of each.

    Parameters
    ----------
    tab : Tab
        The page, in charge.
    folder : Path
        For what lasts no longer than the script.

    """

    def __init__(self, tab: Tab, folder: Path):
        self._tab, self._folder = tab, folder

    def picture(self, name: str, *marks: str) -> None:
        """Write what the page shows; number the parts with these marks."""
        time.sleep(SETTLE)
        shown = self._seen()
        label(self._tab, shown, marks)
        shown.quantize(256).save(HERE / 'pictures' / f'operate_{name}.png', optimize=True)

    def _seen(self) -> Image.Image:
        """Return what the page shows while it is in contact."""
        while True:  # a busy computer interrupts the contact for the time of a picture
            self._tab.wait(lambda: self._tab.text('contact') == '')
            shown = seen_on(self._tab, self._folder)
            if self._tab.text('contact') == '':
                return shown

    def state(self, *names: str) -> None:
        """Wait for a state of the machine."""
        self._tab.wait(lambda: self._tab.text('state') in names)

    def give(self, line: str) -> None:
        """Have a line executed in the MDI field."""
        self._tab.fill('mdi', line)
        self._tab.type_key('Enter', 13)
        self._tab.wait(lambda: f'{line}: done' in self._tab.text('mdi answer'))

    def load(self) -> None:
        """See the program planned and proven."""
        self._tab.wait(lambda: self._tab.text('status') == 'planned')
        self.state('idle')
        self._tab.click('check')
        self._tab.wait(lambda: 'proven' in self._tab.text('status'))
        marks = 'state', 'program', 'load', 'check', 'look', 'setup', 'cycle start', 'keyboard'
        self.picture('load', *marks)

    def move(self) -> None:
        """Move the axes by lines, and by the keys of the pad."""
        self.give('G0 Z60')
        self.give('G0 X0 Y0')
        self._tab.click('jog')
        self._tab.run(
            '[...document.querySelectorAll(`[data-mark="jog step"] button`)].at(-1).click()'
        )
        self._tab.wait(
            lambda: self._tab.run('document.querySelector(".jog").dataset.step') == '10'
        )
        self._tab.click('jog Z-')
        self._tab.wait(lambda: self._tab.text('work Z') == '50.000')
        self.state('idle')
        self.picture('move', 'mdi', 'jog', 'jog step', 'jog Z-', 'jog speed', 'setup')
        self._tab.click('jog')

    def touch_off(self) -> None:
        """Say what the axes read here."""
        self._tab.click('show touch off')
        for axis in 'XYZ':
            self._tab.fill(f'here {axis}', '0')
        self.picture('touch_off', 'here X', 'touch off', 'setup', 'offsets')
        self._tab.click('touch off')
        self._tab.wait(lambda: self._tab.text('work Z') == '0.000')
        self._tab.click('show touch off')
        self._tab.wait(lambda: self._tab.text('status') == 'planned')
        self.give('G0 Z40')

    def run(self) -> None:
        """Run the program, slowly enough for a picture."""
        self._tab.press_key('override slider', 'ArrowLeft', times=SLOWER)
        self._tab.click('cycle start')
        self._tab.wait(lambda: 'F2400' in self._tab.text('modes'))
        self.picture('run', 'line', 'modes', 'feed hold', 'override slider', 'to go', 'rapids')

    def away(self) -> None:
        """Hold, and move the tool away."""
        self._tab.click('feed hold')
        self.state('held')
        self._tab.click('100%')
        self._tab.click('jog')
        self._tab.click('jog tool+')
        self._tab.wait(lambda: 'leads back' in self._tab.text('why'))
        self.state('held')
        self.picture('away', 'why', 'jog tool+', 'start', 'cycle start')
        self._tab.click('jog')
        self._tab.click('reset')
        self.state('idle')

    def start_at_a_line(self) -> None:
        """See the state and the way before the motion to a line."""
        self._tab.fill('start line', '15')
        self._tab.fill('start pass', '2')
        self._tab.click('start here')
        self._tab.wait(lambda: 'line 15, pass 2' in self._tab.text('start'))
        self._tab.click('cycle start')
        self._tab.wait(lambda: 'plunge' in self._tab.text('start'))
        self.picture('start_line', 'start line', 'start here', 'start', 'cycle start', 'reset')


@contextmanager
def page(folder: Path) -> Iterator[Tab]:
    """Serve the page beside nodes of its own, and show it in a browser."""
    token_file = folder / 'token'
    token_file.write_text('known-to-pictures')
    words = ['--setup', str(folder / 'setup.yaml'), '--port', '0', '--token-file', str(token_file)]
    served = subprocess.Popen(
        interp('panel', str(PROGRAM), *words), stdout=subprocess.PIPE, text=True
    )
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
    with tempfile.TemporaryDirectory() as name, page(Path(name)) as tab:
        walk = Walk(tab, Path(name))
        for task in (
            walk.load,
            walk.move,
            walk.touch_off,
            walk.run,
            walk.away,
            walk.start_at_a_line,
        ):
            task()
        assert tab.faults == [], tab.faults


if __name__ == '__main__':
    main()
