"""Take pictures of the operator page while the nodes run a program.

    python docs/make_page_pictures.py

makes a program of constant scallop height from ``examples/bumps.json``, runs it with
``cnc-interp panel`` in a real browser, and writes the animation ``docs/pictures/page.gif`` for the
README; then runs it again and writes ``page.png``, ``page_wide.png``, ``page_phone.png`` and the
numbered ``page_labelled.png`` for docs/operate/page.md. Needs Chromium, requirements/panel.txt and
Pillow.
"""

from __future__ import annotations

import io
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / 'test' / 'page'))

from browser import Browser, Tab  # noqa: E402  the driver that the tests use

SIZE, SHOWN = (1366, 768), (956, 538)
#: Width, height and whether it is a phone, of the single pictures.
SCREENS = {
    'page_phone': (390, 1980, True),
    'page_wide': (1920, 1080, False),
    'page': (*SIZE, False),
}
#: Marks of the parts that get a number, in the order of the list in docs/operate/page.md.
LABELLED = (
    'state',
    'rights',
    'program',
    'load',
    'check',
    'settings',
    'queue next',
    'setup',
    'tip x',
    'feed',
    'override slider',
    'to go',
    'line',
    'buffer',
    'contour',
    'cycle start',
    'feed hold',
    'reset',
    'single block',
    'EMERGENCY STOP',
    'look',
    'history messages',
    'keyboard',
    'jog',
)
RED, WHITE, RADIUS, LOW = (200, 30, 30), (255, 255, 255), 10, 26
#: The animation: at most so many frames, so far apart in the run and on the page [s].
FRAMES, STEP, SHOWN_STEP = 60, 0.3, 0.15
#: A page that has got another size draws everything anew [s].
SETTLE = 2.0
#: A picture takes seconds where the browser renders in software: the feed is lowered meanwhile.
STEPS_DOWN = 12
COLOURS = 128


def interp(*words: str) -> list[str]:
    """Return a command of the package."""
    return [sys.executable, '-m', 'cnc_interp', *words]


def start(tab: Tab) -> None:
    """Start the program, and see the machine run it."""
    tab.wait(lambda: tab.text('status') == 'planned' and tab.text('state') == 'idle')
    tab.click('cycle start')
    tab.wait(lambda: tab.text('state') == 'running')


def seen_on(tab: Tab, folder: Path) -> Image.Image:
    """Return what the page shows."""
    tab.screenshot(folder / 'seen.png')
    return Image.open(io.BytesIO((folder / 'seen.png').read_bytes())).convert('RGB')


def frames_of(tab: Tab, folder: Path) -> list[Image.Image]:
    """Run the program on the page, at a lower feed; return what is seen."""
    tab.wait(lambda: tab.text('state') == 'idle')
    tab.press_key('override slider', 'ArrowLeft', times=STEPS_DOWN)
    start(tab)
    seen = []
    while tab.text('state') in ('running', 'filling') and len(seen) < FRAMES:
        seen.append(seen_on(tab, folder))
        time.sleep(STEP)
    tab.wait(lambda: tab.text('state') == 'idle')
    tab.press_key('override slider', 'ArrowRight', times=STEPS_DOWN)
    return seen


def write_screens(tab: Tab, folder: Path) -> None:
    """Run the program again; write the page as screens of some sizes show it."""
    start(tab)
    for name, (width, height, phone) in SCREENS.items():
        tab.size(width, height, phone)
        time.sleep(SETTLE)
        shown = seen_on(tab, folder)
        while tab.text('contact'):  # rendering took so long that the page lost its server
            time.sleep(SETTLE)
            shown = seen_on(tab, folder)
        shown.quantize(256).save(HERE / 'pictures' / f'{name}.png', optimize=True)
    label(tab, shown, LABELLED)
    shown.quantize(256).save(HERE / 'pictures' / 'page_labelled.png', optimize=True)


def label(tab: Tab, shown: Image.Image, marks: tuple[str, ...]) -> None:
    """Draw a number at each part that the documentation names: at its corner, or before a text."""
    places = tab.run(
        'Object.fromEntries([...document.querySelectorAll("[data-mark]")].map(part => {'
        'const box = part.getBoundingClientRect();'
        'return [part.dataset.mark, [box.left, box.top, box.height]]; }))'
    )
    draw, font = ImageDraw.Draw(shown), ImageFont.load_default(13)
    for number, mark in enumerate(marks, start=1):
        left, top, height = places[mark]
        x, y = max(left - RADIUS, RADIUS), max(top + height / 2 if height < LOW else top, RADIUS)
        draw.ellipse((x - RADIUS, y - RADIUS, x + RADIUS, y + RADIUS), RED, WHITE)
        draw.text((x, y), str(number), WHITE, font, anchor='mm')


def write_animation(seen: list[Image.Image]) -> None:
    """Write the frames as a GIF with one palette, that of the last frame."""
    small = [frame.resize(SHOWN, Image.Resampling.LANCZOS) for frame in seen]
    palette = small[-1].quantize(COLOURS, kmeans=3)
    first, *others = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in small]
    first.save(
        HERE / 'pictures' / 'page.gif',
        save_all=True,
        append_images=others,
        duration=round(1000 * SHOWN_STEP),
        loop=0,
        optimize=True,
    )


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
        token_file = folder / 'token'
        token_file.write_text('known-to-pictures')
        panel = interp('panel', program, '--port', '0', '--token-file', str(token_file))
        page = subprocess.Popen(panel, stdout=subprocess.PIPE, text=True)
        browser = Browser()
        try:
            assert page.stdout is not None
            said = iter(page.stdout)
            address = next(found for line in said if (found := re.search(r'http://\S+/', line)))
            tab = browser.open(f'{address[0]}?token=known-to-pictures', *SIZE)
            write_animation(frames_of(tab, folder))
            write_screens(tab, folder)
        finally:
            browser.close()
            page.terminate()
            page.wait()


if __name__ == '__main__':
    main()
