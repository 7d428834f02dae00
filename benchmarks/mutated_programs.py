"""
Mutated programs, planned and checked by the commands: refusals, unproven plans, faults.

    python benchmarks/mutated_programs.py [--count 5000] [--first 0] [--lines 25]

The programs are the first lines of those of ``test/unit/test_program_fuzz.py``, changed in a few
places by chance. A plan that ``check`` does not prove, a refusal of more than one line and a
traceback are printed with the seed that makes the program again. Each program has a process of its
own, forked from one that has loaded the kernels. A program that takes longer than 60 s is counted
and left: a mutated feed can make a motion of days.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test' / 'unit'))
from test_program_fuzz import EXAMPLES, mutated, seeds

from cnc_interp.cli import main as command

MACHINES = ('xyzac', 'xyzbc', 'bc_trunnion')
#: Longest time for one program [s].
PATIENCE = 60


def said_by(words: list[str]) -> tuple[int, str]:
    """Run a command; return its exit code and what it says."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = command(words)
    return code, said.getvalue()


def outcome(text: bytes, machine: str, folder: Path) -> tuple[str, str]:
    """Plan and check a program; return what came of it, and what was said."""
    program, plan = folder / 'part.txt', folder / 'plan'
    program.write_bytes(text)
    words = ['plan', str(program), '--machine', machine, '--feed', '1000', '--out', str(plan)]
    code, said = said_by(words)
    if code == 2:
        lines = [line for line in said.splitlines() if line.startswith('cnc-interp: ')]
        return ('refused' if len(lines) == 1 else 'refused in more than a line'), said
    if code == 130:
        raise KeyboardInterrupt
    if code:
        return 'not proven by plan', said
    code, said = said_by(['check', str(plan)])
    return {0: 'proven', 1: 'not proven by check'}.get(code, 'refused by check'), said


def tried(text: bytes, machine: str) -> tuple[str, str]:
    """Return the outcome of a program that is planned and checked in a fork."""
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryFile() as told:
        child = os.fork()
        if not child:
            signal.alarm(PATIENCE)  # ends the fork
            try:
                found = outcome(text, machine, Path(folder))
            except KeyboardInterrupt:
                os._exit(130)
            except BaseException as fault:
                found = 'traceback', f'{type(fault).__name__}: {fault}'
            told.write(json.dumps(found).encode())
            told.flush()
            os._exit(0)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if code == 130:
            raise KeyboardInterrupt
        if code == -signal.SIGALRM:
            return f'longer than {PATIENCE} s', ''
        if code:
            return 'ended by a signal', f'signal {-code}'
        told.seek(0)
        what, said = json.loads(told.read())
        return what, said


def main() -> None:
    """Try programs and print a line of counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--count', type=int, default=5000)
    parser.add_argument('--first', type=int, default=0, help='first seed')
    parser.add_argument('--lines', type=int, default=25, help='lines of a program')
    options = parser.parse_args()
    texts = [b'\n'.join(text.splitlines()[: options.lines]) + b'\n' for text in seeds()]
    found: Counter[str] = Counter()
    slowest, begun = 0.0, time.monotonic()
    with tempfile.TemporaryDirectory() as folder:  # kernels are compiled, without an alarm
        outcome((EXAMPLES / 'pyramid.ngc').read_bytes(), MACHINES[0], Path(folder))
    with contextlib.suppress(KeyboardInterrupt):
        for seed in range(options.first, options.first + options.count):
            text, machine = mutated(random.Random(seed), texts), MACHINES[seed % len(MACHINES)]
            started = time.monotonic()
            what, said = tried(text, machine)
            found[what] += 1
            slowest = max(slowest, time.monotonic() - started)
            if what not in ('refused', 'proven'):
                print(f'seed {seed} on {machine}: {what}\n{said}', flush=True)
    counts = dict(sorted(found.items()))
    print(json.dumps({
        'programs': found.total(), **counts, 'slowest [s]': round(slowest, 1),
        'all [s]': round(time.monotonic() - begun),
    }))  # fmt: skip


if __name__ == '__main__':
    main()
