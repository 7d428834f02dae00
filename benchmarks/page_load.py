"""
Effect of the operator page on the 1 kHz stream: one program, again and again.

``PYTHONPATH=.:test/ros:test/page python benchmarks/page_load.py`` runs the program without a page,
with an open page in a real browser, with ten tabs, and with a page that is started and opened
while the machine moves. The cases alternate for several rounds with the same nodes. The machine's
clock reports how late its periods began in each run; the browser counts how often the visible page
changed. Lateness is the median over the rounds, all other figures are the worst of them. ``--only
"opened in motion" --rounds 20`` opens twenty pages while the machine moves.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState
from diagnostic_msgs.msg import DiagnosticArray
from nodes_under_test import NodesUnderTest
from operated import waves
from page_under_test import PageUnderTest

from cnc_interp.nodes import qos

#: Tabs that are open when the program starts; None: one is opened while it runs, the page too.
CASES: dict[str, int | None] = {
    'no page': 0,
    'one page': 1,
    'ten tabs': 10,
    'opened in motion': None,
}
#: Corners and turns that take a second.
WAVES_A_SECOND = 2
TICKS = os.sysconf('SC_CLK_TCK')
#: Counts how often the read-outs of a page change.
COUNT = """
window.updates = 0;
new MutationObserver(() => window.updates++).observe(
    document.querySelector('.dro'), {subtree: true, childList: true, characterData: true})
"""


@dataclass
class Measured:
    """One run: lateness [us], lowest buffer [ms], updates [1/s], shares of a core."""

    p50: float
    p99: float
    largest: float
    missed: int
    periods: int
    least: float
    starved: int
    updates: float
    page: float
    browser: float


def family(number: int) -> Iterator[tuple[int, list[str]]]:
    """Yield a process and its descendants, with the words of /proc/PID/stat after its name."""
    words: dict[int, list[str]] = {}
    children = defaultdict(list)
    for entry in Path('/proc').iterdir():
        if entry.name.isdigit():
            try:
                found = (entry / 'stat').read_text().rpartition(')')[2].split()
            except OSError:
                continue  # it has just ended
            words[int(entry.name)] = found
            children[int(found[1])].append(int(entry.name))
    waiting = [number]
    while waiting:
        one = waiting.pop()
        waiting += children[one]
        if one in words:
            yield one, words[one]


def cpu(number: int) -> float:
    """Return the CPU time of a process and its descendants, those that have ended too [s]."""
    return sum(sum(map(int, words[11:15])) for _, words in family(number)) / TICKS


class Stream(NodesUnderTest):
    """The nodes, and what the machine says about its clock."""

    def __init__(self, priority: int) -> None:
        super().__init__({'machine_node': {'realtime_priority': priority}})
        self.clock: dict[str, str] = {}
        self.node.create_subscription(
            DiagnosticArray, '/diagnostics', self._see_clock, qos.DIAGNOSTICS
        )

    def _see_clock(self, array: DiagnosticArray) -> None:
        for status in array.status:
            mine = status.hardware_id == self.namespace
            if mine and status.name == 'machine_node: clock':
                self.clock = {pair.key: pair.value for pair in status.values}

    def measure(self, text: str, tabs: int | None) -> Measured:
        """Run the program once."""
        page = PageUnderTest(self.namespace, self.domain) if tabs else None
        open_tabs = [page.open(width=1366, height=768) for _ in range(tabs or 0)] if page else []
        handle = self.start(text=text)
        wanted = handle.get_result_async()
        self.spin_until(self.moves)
        if tabs is None:
            page = PageUnderTest(self.namespace, self.domain)
            open_tabs = [page.open(width=1366, height=768)]
        if open_tabs:
            open_tabs[-1].run(COUNT)  # the one in front
        before = self.used(page)
        began = time.monotonic()
        self.spin_until(wanted.done, 3600.0)
        elapsed = time.monotonic() - began
        used = [(b - a) / elapsed for a, b in zip(before, self.used(page), strict=True)]
        updates = open_tabs[-1].run('window.updates') / elapsed if open_tabs else 0.0
        self.clock = {}
        self.spin_until(lambda: self.clock)
        if page is not None:
            page.close()
        result: RunProgram.Result = wanted.result().result
        assert result.code == RunProgram.Result.SUCCEEDED, result.message
        late = [float(self.clock[f'late_{name}_us']) for name in ('p50', 'p99', 'max')]
        return Measured(
            *late,
            int(self.clock['missed_periods']),
            int(self.clock['periods']),
            1e3 * result.least_buffered_time,
            result.starvations,
            updates,
            *used,
        )

    def moves(self) -> bool:
        """Tell whether the machine executes a program."""
        return bool(self.peers.state and self.peers.state.state == MachineState.RUNNING)

    @staticmethod
    def used(page: PageUnderTest | None) -> tuple[float, float]:
        """Return the CPU time of page and browser [s]."""
        return (cpu(page.process.pid), cpu(page.browser.process.pid)) if page else (0.0, 0.0)


def row(name: str, runs: list[Measured], first: list[Measured]) -> str:
    """Write a line of the table, with the lateness as a ratio to that of the first one."""

    def median(what: str, of: list[Measured]) -> float:
        return float(np.median([getattr(one, what) for one in of]))

    late = [
        f'{median(what, runs):.0f} ({median(what, runs) / median(what, first):.2f})'
        for what in ('p50', 'p99', 'largest')
    ]
    missed = sum(one.missed for one in runs) / sum(one.periods for one in runs)
    rates = [one.updates for one in runs if one.updates]
    cells = [
        name,
        *late,
        f'{1e6 * missed:.0f}',
        f'{min(one.least for one in runs):.0f}',
        f'{sum(one.starved for one in runs)}',
        f'{np.mean(rates):.1f}, {min(rates):.1f}' if rates else '-',
        f'{np.mean([one.page for one in runs]):.0%}' if rates else '-',
        f'{np.mean([one.browser for one in runs]):.0%}' if rates else '-',
    ]
    return '| ' + ' | '.join(cells) + ' |'


def main() -> int:
    """Measure, and print the table."""
    asked = argparse.ArgumentParser(description=__doc__)
    asked.add_argument('--seconds', type=float, default=60.0, help='of motion in each run')
    asked.add_argument('--rounds', type=int, default=3)
    asked.add_argument('--priority', type=int, default=10, help='SCHED_FIFO of the clock')
    asked.add_argument('--only', choices=list(CASES), nargs='+', default=list(CASES))
    options = asked.parse_args()
    text = waves(round(options.seconds * WAVES_A_SECOND))
    runs: dict[str, list[Measured]] = {name: [] for name in options.only}
    stream = Stream(options.priority)
    try:
        for k in range(options.rounds):
            for name in runs:
                runs[name].append(stream.measure(text, CASES[name]))
                load = os.getloadavg()[0]
                print(f'round {k + 1}, {name}: load {load:.1f}, {runs[name][-1]}', flush=True)
    finally:
        stream.close()
    print(
        '\n| | late p50, us | p99 | largest | a period late, of a million | least ready, ms '
        '| underruns | updates a second: mean, least | page | browser |'
    )
    print('|' + '---|' * 10)
    for name in runs:
        print(row(name, runs[name], runs[options.only[0]]))
    return 0


if __name__ == '__main__':
    sys.exit(main())
