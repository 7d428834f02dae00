"""
Take pictures of the operator page while the nodes run a program.

    python docs/make_page_pictures.py

makes a program of constant scallop height from ``examples/bumps.json``, runs it with
``cnc-interp panel`` in a real browser, and writes ``docs/pictures/page.png`` for docs/operation.md
and the animation ``docs/pictures/page.gif`` for the README. Needs Chromium,
requirements/panel.txt and Pillow.
"""

from __future__ import annotations

import io
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / 'test' / 'ros'))

from browser import Browser, Tab  # noqa: E402  the driver that the tests use

SIZE, SHOWN = (1366, 768), (956, 538)
#: The animation: at most so many frames, so far apart in the run and on the page [s].
FRAMES, STEP, SHOWN_STEP = 60, 0.3, 0.15
COLOURS = 96


def interp(*words: str) -> list[str]:
    """Return a command of the package."""
    return [sys.executable, '-m', 'cnc_interp', *words]


def frames_of(tab: Tab, folder: Path) -> list[Image.Image]:
    """Run the program on the page; return what is seen, and leave the middle as ``page.png``."""
    tab.wait(lambda: tab.text('status') == 'planned')
    tab.click('cycle start')
    tab.wait(lambda: tab.text('state') == 'running')
    seen: list[Image.Image] = []
    while tab.text('state') == 'running' and len(seen) < FRAMES:
        tab.screenshot(folder / 'frame.png')
        seen.append(Image.open(io.BytesIO((folder / 'frame.png').read_bytes())).convert('RGB'))
        time.sleep(STEP)
    seen[len(seen) // 2].quantize(256).save(HERE / 'pictures' / 'page.png', optimize=True)
    return seen


def write_animation(seen: list[Image.Image]) -> None:
    """Write the frames as a GIF with one palette, that of the last frame."""
    small = [frame.resize(SHOWN, Image.Resampling.LANCZOS) for frame in seen]
    palette = small[-1].quantize(COLOURS)
    first, *others = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in small]
    first.save(
        HERE / 'pictures' / 'page.gif', save_all=True, append_images=others,
        duration=round(1000 * SHOWN_STEP), loop=0, optimize=True,
    )  # fmt: skip


def main() -> None:
    """Make the program, run it, take the pictures."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        surface = HERE.parent / 'examples' / 'bumps.json'
        subprocess.run(
            interp('cam', 'iso-scallop', str(surface), '--stepover', '2', '--out', name),
            check=True,
        )
        program = str(folder / 'program.mpf')
        panel = interp('panel', program, '--port', '0', '--token', 'picture')
        page = subprocess.Popen(panel, stdout=subprocess.PIPE, text=True)
        browser = Browser()
        try:
            assert page.stdout is not None
            address = re.search(r'http://\S+/', page.stdout.readline())
            assert address is not None
            tab = browser.open(f'{address[0]}?token=picture', *SIZE)
            write_animation(frames_of(tab, folder))
        finally:
            browser.close()
            page.terminate()
            page.wait()


if __name__ == '__main__':
    main()
