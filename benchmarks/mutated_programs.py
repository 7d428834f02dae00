"""
Mutated programs, planned and checked by the commands: rejections, unproven plans, faults.

    python benchmarks/mutated_programs.py [--count 5000] [--first 0] [--lines 25]

The programs are the first lines of those of ``test/unit/test_program_fuzz.py``, changed at random
in a few places. A plan that ``check`` does not prove, a rejection of more than one line and a
traceback are printed with the seed that makes the program again. One process, forked from one that
has loaded the kernels, tries the programs; if a program ends this process, another one continues.
A program that takes more than 60 s of processor time is counted and skipped, because a mutated
feed can make a motion of days.
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
from collections.abc import Iterator
from pathlib import Path
from typing import IO

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test' / 'unit'))
from test_program_fuzz import EXAMPLES, mutated, seeds

from cnc_interp.commands.cli import main as command

MACHINES = ('xyzac', 'xyzbc', 'bc_trunnion')
#: Longest processor time for one program [s].
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


def try_all(seeds: range, texts: list[bytes], out: IO[str]) -> None:
    """Write a line of JSON for each program: seed, outcome, what was said, processor time."""
    for seed in seeds:
        text, machine = program_of(seed, texts)
        signal.setitimer(signal.ITIMER_PROF, PATIENCE)  # ends this process
        begun = time.process_time()
        try:
            with tempfile.TemporaryDirectory() as folder:
                found = outcome(text, machine, Path(folder))
        except KeyboardInterrupt:
            os._exit(130)
        except BaseException as fault:
            found = 'traceback', f'{type(fault).__name__}: {fault}'
        out.write(json.dumps((seed, *found, time.process_time() - begun)) + '\n')
        out.flush()


def program_of(seed: int, texts: list[bytes]) -> tuple[bytes, str]:
    """Return a program and its machine."""
    return mutated(random.Random(seed), texts), MACHINES[seed % len(MACHINES)]


def tried(first: int, last: int, texts: list[bytes]) -> Iterator[tuple[int, str, str, float]]:
    """
    Yield seed, outcome, what was said and processor time [s] of each program.

    One process tries them one after the other. When it dies, a new one goes on with the next.
    """
    while first < last:
        inlet, outlet = os.pipe()
        child = os.fork()
        if not child:
            os.close(inlet)
            with os.fdopen(outlet, 'w') as out:
                try_all(range(first, last), texts, out)
            os._exit(0)
        os.close(outlet)
        with os.fdopen(inlet) as lines:
            for line in lines:
                first += 1
                yield tuple(json.loads(line))
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        if code == 130:
            raise KeyboardInterrupt
        if code == -signal.SIGPROF:
            yield first, f'longer than {PATIENCE} s', '', PATIENCE
        elif code:
            yield first, 'ended by a signal', f'signal {-code}', 0.0
        first += bool(code)


def main() -> None:
    """Try programs and print a line of counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--count', type=int, default=5000)
    parser.add_argument('--first', type=int, default=0, help='first seed')
    parser.add_argument('--lines', type=int, default=25, help='lines of a program')
    options = parser.parse_args()
    texts = [b'\n'.join(text.splitlines()[: options.lines]) + b'\n' for text in seeds()]
    found: Counter[str] = Counter()
    spent = slowest = 0.0
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:  # kernels are compiled, without an alarm
        outcome((EXAMPLES / 'pyramid.ngc').read_bytes(), MACHINES[0], Path(folder))
    with contextlib.suppress(KeyboardInterrupt):
        last = options.first + options.count
        for seed, what, said, seconds in tried(options.first, last, texts):
            found[what] += 1
            spent, slowest = spent + seconds, max(slowest, seconds)
            if what not in ('refused', 'proven'):
                machine = program_of(seed, texts)[1]
                print(f'seed {seed} on {machine}: {what}\n{said}', flush=True)
    counts = dict(sorted(found.items()))
    print(
        json.dumps(
            {
                'programs': found.total(),
                **counts,
                'slowest [CPU s]': round(slowest, 1),
                'all [CPU s]': round(spent),
                'all [s]': round(time.monotonic() - begun),
            }
        )
    )


if __name__ == '__main__':
    main()
