"""
Each node and each pair of nodes lost in each phase of a run: result of the goal, and messages.

``PYTHONPATH=.:test/ros:test/unit python benchmarks/losses.py [--phases hold jog]``
tries the rows that have no figures yet, and writes docs/measured/losses.md. ``--busy`` tries rows
of all phases again beside two busy loops, as many as time allows. ``LIFE`` lists the phases of a
run; ``test/ros/test_losses.py`` tries its rows, too. The simulated operator follows the messages:
he presses cycle_start if the machine says that this continues the run, and reset if a text asks
for it. Windows are small, so that each node still has something to send when another one is lost.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from functools import cache
from itertools import combinations, permutations
from typing import Any, NamedTuple

from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState
from cnc_interp_msgs.srv import MoveAxes
from figures import ROOT, load, save, where
from operated import Bench, path_of, waves
from std_srvs.srv import Trigger

from cnc_interp.processes.node_processes import NODES

Result = RunProgram.Result
TABLE = ROOT / 'docs' / 'measured' / 'losses.md'
PARAMETERS: dict[str, dict[str, object]] = {
    'lookahead_node': {'block_window': 8},
    'feedrate_node': {'segment_window': 16, 'plan_ahead': 2.0},
}
PROGRAM = waves(8)
path = cache(lambda: path_of(PROGRAM))
LONG = PROGRAM.replace('TRAORI\n', 'TRAORI\n' + 'G90\n' * 60000)  #: The same path, longer checked.
FROZEN = 4.0  #: How long a node is frozen [s]; longer than ``peer_timeout``.
APART = 0.3  #: Time between the losses of two nodes [s].
LONGEST = 60.0  #: A goal without a result never ends [s].
INTRODUCTION = (
    'This table shows what happens to a run if nodes are lost. `benchmarks/losses.py` kills, '
    'restarts, or freezes for 4 s, each node and each pair of nodes in each phase. In every row '
    'the goal got its result, the next program ran, and all setpoints stayed on the path and '
    'within the limits.\nA run ends if the machine node or the program node is lost. Each cell '
    'has the number of rows and the longest time.'
)
BUSY = 'losses_busy'  #: The figures beside busy loops.
WHY = ('cycle start', 'restarted', 'lost', 'reset')  #: A text with one says what to press.
STANDS = 1.5  #: The operator presses a button after so long at rest [s].


#: Phase, what leads to it, and when it has come; each is reached through those before it.
LIFE: tuple[tuple[str, str, Callable[[Bench], bool]], ...] = (
    ('check', '', lambda b: any('checking' in text for _, text in b.diagnostics)),
    ('start', '', lambda b: bool(b.loaded)),
    ('approach', '', lambda b: is_ours(b) and b.state.samples > 0),
    ('motion', '', lambda b: is_ours(b) and b.state.path_position > 0.02),
    ('hold', 'feed_hold', lambda b: b.state.state == MachineState.HELD),
    ('resume', 'cycle_start', lambda b: b.state.state == MachineState.RUNNING),
    ('end', '', lambda b: b.state.path_position > path().s[-1] - 0.08),
)
PHASES = ('at rest', 'jog', *(phase for phase, _, _ in LIFE))
ALONE = [(node,) for node in NODES]
PAIRS = [*ALONE, *combinations(NODES, 2)]
LOSSES = {'kill': [*ALONE, *permutations(NODES, 2)], 'freeze': PAIRS, 'restart': PAIRS}


class Row(NamedTuple):
    phase: str
    loss: str
    nodes: tuple[str, ...]

    @property
    def name(self) -> str:
        return f'{self.phase}, {self.loss} {" ".join(self.nodes)}'

    def loses(self, node: str) -> bool:
        """Tell whether a node forgets everything."""
        return self.loss != 'freeze' and node in self.nodes


ROWS = [Row(p, loss, nodes) for p in PHASES for loss in LOSSES for nodes in LOSSES[loss]]


def is_ours(bench: Bench) -> bool:
    return bool(bench.loaded) and bench.state.program_id == bench.loaded[-1].program_id


def live_until(bench: Bench, wanted: str) -> None:
    if wanted == 'jog':
        move = MoveAxes.Request(axes=['X'], values=[0.1], relative=True, speed=0.2)
        bench.mover.call_async(move)
        bench.until_state(MachineState.JOGGING)
    if wanted in ('at rest', 'jog'):
        return
    bench.loaded.clear()
    bench.begin(LONG if wanted == 'check' else PROGRAM)
    for phase, button, has_come in LIFE:
        if button:
            bench.press(button)
        bench.spin_until(lambda has_come=has_come: has_come(bench))
        if phase == wanted:
            return


def lose(bench: Bench, row: Row) -> None:
    """Lose the nodes; afterwards all of them run again."""
    bench.watching = False
    if row.loss == 'freeze':
        for number in (signal.SIGSTOP, signal.SIGCONT):
            for node in row.nodes:
                os.kill(bench.children.nodes[node].process.pid, number)
            bench.spin_for(FROZEN if number == signal.SIGSTOP else 0.0)
        return
    for node in row.nodes:
        bench.spin_for(APART if node is not row.nodes[0] else 0.0)
        process = bench.children.nodes[node].process
        os.kill(process.pid, signal.SIGKILL if row.loss == 'kill' else signal.SIGTERM)
        bench.spin_until(lambda process=process: process.exitcode is not None)
        bench.start_again(node)


class Operator:
    """Reads states and diagnostics, and presses what they ask for."""

    def __init__(self, bench: Bench):
        self._bench, self._stood, self._at = bench, time.monotonic(), 0
        self.pressed: list[str] = []

    def look(self) -> None:
        bench, state, now = self._bench, self._bench.state, time.monotonic()
        if state.samples != self._at or not state.resting or bench.peers.missing(now, 1.0):
            self._stood, self._at = now, state.samples
        if now - self._stood < STANDS:
            return
        told = dict(bench.diagnostics).get('program_node: program', '')
        wanted = 'reset' if 'reset' in told else 'cycle_start' if state.may_resume else ''
        if wanted:
            self._stood = now + STANDS
            self.pressed.append(wanted)
            bench.buttons[wanted].call_async(Trigger.Request())


def try_row(bench: Bench, row: Row) -> dict[str, Any]:
    """Lose nodes in a phase of a run; return its figures."""
    bench.tidy()
    live_until(bench, row.phase)
    has_goal = row.phase not in ('at rest', 'jog')
    run = bench.state.program_id if has_goal and is_ours(bench) else ''
    bench.diagnostics[:] = [(part, '') for part, _ in bench.diagnostics]
    lost_at = time.monotonic()
    lose(bench, row)
    operator = Operator(bench)

    result = result_of(bench, operator.look) if has_goal else Result(code=Result.SUCCEEDED)
    took = time.monotonic() - lost_at
    told = [text for _, text in bench.diagnostics if text]
    following = next_program(bench, heard=not row.loses('machine_node'))
    if (run := run or result.program_id) and bench.told(run):
        bench.proven(run, path(), cut=row.loses('machine_node'))
    return {
        'code': result.code,
        'message': result.message,
        'took': took,
        'pressed': operator.pressed,
        'told': list(dict.fromkeys(told)),
        'next': following,
    }


def result_of(bench: Bench, look: Callable[[], None] = lambda: None) -> Any:
    """Return the result of the goal sent last; AssertionError where there is none for long."""

    def ended() -> bool:
        look()
        bench.sent.follow()
        return bench.sent.result is not None

    bench.spin_until(ended, LONGEST)
    return bench.sent.result


def next_program(bench: Bench, heard: bool) -> tuple[int, str]:
    """Run another program, as told in its answers; return code and message of the last answer.

    ``heard``: wait until its end is heard, and so all before it. Results overtake setpoints on a
    busy computer; then a run seemed to end in motion, beyond its limits.
    """
    deadline = time.monotonic() + LONGEST
    while True:
        bench.start(text=waves(1))
        result = result_of(bench)
        if result.code == Result.SUCCEEDED or time.monotonic() > deadline:
            break
        if 'reset' in result.message:
            bench.press('reset')
    if heard and result.code == Result.SUCCEEDED:
        bench.spin_until(lambda: any(m.end_of_program for m in bench.told(result.program_id)))
    return result.code, result.message


def fault_of(row: Row, figures: dict[str, Any]) -> str:
    code, endings = figures['code'], {Result.SUCCEEDED}
    if row.loses('program_node'):
        endings = {Result.STREAM_LOST} | (endings if row.phase == 'end' else set())
    elif 'machine_node' in row.nodes:
        endings |= {Result.STREAM_LOST, Result.STOPPED}
    if row.phase not in ('at rest', 'jog') and code not in endings:
        return f'the goal ended with {code}: {figures["message"]}'
    if figures['next'][0] != Result.SUCCEEDED:
        return f'the next program ended with {figures["next"]}'
    why = any(word in text for text in figures['told'] for word in WHY)
    return 'pressed without being told why' if figures['pressed'] and not why else ''


def table() -> Iterator[str]:
    held = load('losses')
    rows = [(row, held[row.name]) for row in ROWS if row.name in held]
    faults = [f'{row.name}: {fault}' for row, f in rows if (fault := fault_of(row, f))]
    yield from ('# Losses', '', INTRODUCTION, '')
    yield from (
        '| phase | rows | continued by itself | continued by cycle_start | ended |',
        '|---|---|---|---|---|',
    )
    for phase in PHASES:
        cells: list[list[float]] = [[], [], []]
        for f in (f for row, f in rows if row.phase == phase):
            cells[2 if f['code'] else bool(f['pressed'])].append(f['took'])
        words = [f'{len(c)}, {max(c):.0f} s' if c else '0' for c in cells]
        if any(cells):
            yield f'| {phase} | {sum(map(len, cells))} | {" | ".join(words)} |'
    yield from ('', f'Faults: {len(faults)}. {where(held)}', *faults)
    if again := load(BUSY):
        tried = [(row, again[row.name]) for row in ROWS if row.name in again]
        faults = [f'{row.name}: {fault}' for row, f in tried if (fault := fault_of(row, f))]
        once = [f'{row.name}: at fault before' for row, f in tried if f.get('before')]
        told = f'{len(again)} rows again beside two busy loops: {len(faults)} faults.'
        yield from ('', f'{told} {where(again)}', *faults, *once)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--phases', nargs='*', default=PHASES, choices=PHASES)
    parser.add_argument('--seconds', type=float, default=1e9, help='begin no row after this time')
    parser.add_argument('--busy', action='store_true', help='beside two busy loops')
    options = parser.parse_args()
    section, rows = 'losses', ROWS
    if options.busy:
        section, rows = BUSY, random.Random(0).sample(ROWS, len(ROWS))
    loop = f'import os\nwhile os.getppid() == {os.getpid()}: pass'
    for _ in range(2 * options.busy):
        subprocess.Popen([sys.executable, '-c', loop])
    held, begun, bench = load(section), time.monotonic(), Bench(PARAMETERS)
    for row in (row for row in rows if row.phase in options.phases):
        if row.name in held and not fault_of(row, held[row.name]):
            continue
        if time.monotonic() - begun > options.seconds:
            break
        try:
            figures = try_row(bench, row)
        except AssertionError:
            figures = {'code': -1, 'message': traceback.format_exc()[-9000:], 'took': 0.0}
            bench.close()
            bench = Bench(PARAMETERS)
        # It is tried again because it was at fault.
        figures['before'] = held[row.name].get('before', 0) + 1 if row.name in held else 0
        save(section, row.name, {'pressed': (), 'told': (), 'next': (-1, ''), **figures})
        print(row.name, figures, flush=True)
    bench.close()
    TABLE.write_text('\n'.join(table()) + '\n', encoding='utf-8')


if __name__ == '__main__':
    main()
