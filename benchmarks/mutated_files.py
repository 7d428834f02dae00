"""
Mutated STEP, machine, setup and surface files, plans and bags: read, rejected, or a fault.

    python benchmarks/mutated_files.py [--count 1000] [--first 0] [--kinds step machine ...]

Each file is read in its own process, forked from one that has loaded all modules. The result, the
time, and the largest memory beyond that of the parent are recorded. A killed process, a traceback,
a rejection of more than one line, more than 10 s or more than 1 GB are printed with the seed that
makes the file again.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test' / 'unit'))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test' / 'property'))
from plan_directories import line_x, write
from test_cam_step import two_faces
from test_hostile_files import MACHINE, SMALL, mutant

from cnc_interp.cam.surface_file import answer
from cnc_interp.client.bag import TOPICS, Bag, BagWriter
from cnc_interp.commands.check import run_files
from cnc_interp.core import InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.proof.verify import verify

#: What is too long [s] and too much [MB].
LONG, MUCH = 10.0, 1024.0
#: A recorded run, and the topics of which a message of the middle is mutated.
BAG = Path(__file__).resolve().parents[1] / 'test' / 'replay' / 'held'
MESSAGES = ('executed_setpoints', 'machine_state', 'loaded_program')
PLAN = ('setpoints.npz', 'path.npz', 'blocks.npz', 'summary.json')
Kind = tuple[bytes, Path, Callable[[], str]]


def outcome(read: Callable[[], object]) -> str:
    """Return how reading ends: accepted, refused, or its fault."""
    try:
        with np.errstate(all='ignore'):
            said = read()
    except InterpError as refusal:
        said = str(refusal)
    except Exception as fault:
        return f'traceback: {type(fault).__name__}: {fault}'
    if isinstance(said, str) and said and '\n' in said.split('choose one of')[0]:
        return 'refused in more than one line'
    return 'refused' if isinstance(said, str) and said else 'accepted'


def kinds(folder: Path) -> dict[str, Kind]:
    """Return for each kind a sound file, where its mutants are written, and how it is read."""
    step = two_faces().write(folder / 'a.step')
    found: dict[str, Kind] = {
        'step': (step.read_bytes(), step, lambda: outcome(lambda: answer(step, 2)[2]))
    }
    for name, (content, suffix, read) in SMALL.items():
        file = folder / f'{name}{suffix}'
        found[name] = content, file, lambda read=read, file=file: outcome(lambda: read(file))
    content = line_x(MACHINE)
    for columns in ('setpoints', 'path'):  # few rows, so that a mutation meets a header
        content[columns] = {
            key: column[:, :9] if key.startswith('cell') else column[:10]
            for key, column in content[columns].items()
        }
    for name in PLAN:
        plan = write(folder / name.replace('.', '_'), content)
        found[name] = (
            (plan / name).read_bytes(),
            plan / name,
            lambda plan=plan: outcome(lambda: verify(read_plan(plan), MACHINE).ok),
        )
    for name in ('held.mcap', 'metadata.yaml'):
        bag = Path(shutil.copytree(BAG, folder / f'bag_{name}'))
        found[f'bag: {name}'] = (
            (bag / name).read_bytes(),
            bag / name,
            lambda bag=bag: outcome(lambda: proven(bag)),
        )
    for topic in MESSAGES:
        with Bag(BAG) as recorded:
            of_topic = [data for _, _, data in recorded.raw(topic)]
        file, place = folder / f'{topic}.message', len(of_topic) // 2
        found[f'bag: message of {topic}'] = (
            of_topic[place],
            file,
            lambda file=file, topic=topic, place=place: outcome(
                lambda: proven(with_message(folder / 'bag_of_message', topic, place, file))
            ),
        )
    return found


def proven(bag: Path) -> bool:
    """Return whether the last run of a bag is proven."""
    with run_files(bag, None) as (plan, machine, *_):
        return verify(read_plan(plan), Machine.load(machine)).ok


def with_message(path: Path, topic: str, place: int, file: Path) -> Path:
    """Write the recorded run with another message at a place among those of its topic."""
    shutil.rmtree(path, ignore_errors=True)
    with Bag(BAG) as recorded:
        writer, count = BagWriter(path), 0
        writer.note('machine_node', {'machine': recorded.parameters['machine_node.machine']})
        for name, stamp, data in recorded.raw(*TOPICS):
            writer.write(
                name, file.read_bytes() if (name, count) == (topic, place) else data, stamp
            )
            count += name == topic
        writer.close()
    return path


def tried(read: Callable[[], str]) -> tuple[str, float, float]:
    """Read in a fork; return its end, its processor time [s] and its growth of memory [MB]."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    inlet, outlet = os.pipe()
    child = os.fork()
    if not child:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        os.write(outlet, read().encode()[:1000])
        os._exit(0)
    os.close(outlet)
    with os.fdopen(inlet, 'rb') as end:
        said = end.read().decode()
    _, status, usage = os.wait4(child, 0)
    code = os.waitstatus_to_exitcode(status)
    spent = usage.ru_utime + usage.ru_stime
    return said or f'ended by signal {-code}', spent, (usage.ru_maxrss - before) / 1024


def main() -> None:
    """Try mutants and print a line of counts for each kind."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--count', type=int, default=1000)
    parser.add_argument('--first', type=int, default=0, help='first seed')
    parser.add_argument('--kinds', nargs='+', help='some kinds only')
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix='cnc_interp_'))
    try:
        for name, (sound, file, read) in kinds(folder).items():
            if options.kinds and name not in options.kinds:
                continue
            if name == 'step':
                import OCP.STEPControl  # noqa: F401
            else:
                read()  # compiles and loads what is needed
            found: Counter[str] = Counter()
            longest = most = spent = 0.0
            started = time.monotonic()
            for seed in range(options.first, options.first + options.count):
                file.write_bytes(mutant(sound, np.random.default_rng(seed)))
                end, seconds, memory = tried(read)
                longest, most, spent = max(longest, seconds), max(most, memory), spent + seconds
                kind = end.split(':')[0]
                found[kind] += 1
                # A death of the reader of STEP files is told in one line by its parent.
                if kind not in ('accepted', 'refused') or seconds > LONG or memory > MUCH:
                    print(f'{name}, seed {seed}: {end}, {seconds:.1f} s, {memory:.0f} MB')
            print(
                name,
                json.dumps(
                    {
                        'files': found.total(),
                        **dict(sorted(found.items())),
                        'longest [s]': round(longest, 2),
                        'most memory [MB]': round(most),
                        'all [CPU s]': round(spent, 1),
                        'all [s]': round(time.monotonic() - started),
                    }
                ),
                flush=True,
            )
    finally:
        shutil.rmtree(folder)


if __name__ == '__main__':
    main()
