"""
CPU time of page and nodes at rest and in a run: share of one core for each process.

``PYTHONPATH=.:test/ros:test/page:test/unit python benchmarks/cpu_share.py --seconds 60`` starts
``cnc-interp panel`` as its user does, with its own browser, and measures the CPU time of each
process of cnc_interp: at rest without an open page, at rest with one, and while a program runs
(``--run``). The sum does not include the browser, because it renders in software here.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from browser import Browser
from operated import waves
from page_load import TICKS, family

TOKEN = 'known to the measurement'
WARM = 8.0  #: Time after a change, until nodes and page rest [s].


def seconds(number: int) -> dict[str, float]:
    """Return the CPU time of a process and of each of its descendants, by name [s]."""
    found: dict[str, float] = {}
    for pid, words in family(number):
        name = (Path('/proc') / str(pid) / 'comm').read_text().strip()
        found[f'{name} {pid}'] = sum(map(int, words[11:13])) / TICKS
    return found


def told(case: str, before: dict[str, float], after: dict[str, float], elapsed: float) -> None:
    """Print the share of each process, and their sum."""
    shares = {name: (after[name] - before.get(name, 0.0)) / elapsed for name in after}
    each = ', '.join(
        f'{name.rpartition(" ")[0]} {share:.2%}'
        for name, share in sorted(shares.items(), key=lambda one: -one[1])
        if share >= 1e-4
    )
    load = os.getloadavg()[0]
    print(f'{case}: {sum(shares.values()):.2%} of a core ({each}); load {load:.1f}', flush=True)


def main() -> int:
    """Measure, and print a line for each case."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument('--seconds', type=float, default=60.0)
    asked.add_argument('--run', action='store_true', help='measure a run as well')
    options = asked.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / 'token').write_text(TOKEN)
        (folder / 'waves.ngc').write_text(waves(round(6 * options.seconds) + 120))
        words = ['panel', str(folder / 'waves.ngc'), '--port', '0']
        words += ['--token-file', str(folder / 'token')]
        command = [sys.executable, '-m', 'cnc_interp', *words]
        served = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        browser = Browser()

        def measure(case: str) -> None:
            time.sleep(WARM)
            before, began = seconds(served.pid), time.monotonic()
            time.sleep(options.seconds)
            told(case, before, seconds(served.pid), time.monotonic() - began)

        try:
            assert served.stdout is not None
            said = iter(served.stdout)
            address = next(found for line in said if (found := re.search(r'http://\S+/', line)))
            url = f'{address[0]}?token={TOKEN.replace(" ", "%20")}'
            tab = browser.open(url, 1366, 768)
            tab.wait(lambda: tab.text('status') == 'planned')
            measure('at rest, one page')
            if options.run:
                tab.click('cycle start')
                tab.wait(lambda: tab.text('state') == 'running')
                measure('in a run, one page')
                tab.click('feed hold')
                tab.wait(lambda: tab.text('state') == 'held')
                measure('in a hold, one page')
                tab.click('reset')
                tab.wait(lambda: tab.text('state') == 'idle')
            tab.close()
            measure('at rest, no page')
        finally:
            browser.close()
            served.terminate()
            served.wait()
    return 0


if __name__ == '__main__':
    sys.exit(main())
