"""
Every public program: read, compared with LinuxCNC's interpreter, planned and proven; a table.

    python benchmarks/programs.py [--only NAME ...] [--beside CHECKOUT ...]

Each program runs in its own process with plan files in a temporary folder; its figures are stored
in ``out/programs``. The table ``programs_table.md`` of docs/measured is made from all stored
figures. Programs with a long motion are proven in parts of about ten minutes. ``--beside``
alternately measures `plan` of other checkouts and of this one, with one worker each, for the last
columns.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test' / 'unit'))
from linuxcnc_oracle import PROGRAMS as ORACLE_PROGRAMS
from linuxcnc_oracle import judged
from whole_plans import plan_program, summary_of, write_plan

from cnc_interp.core import MM_PER_MIN, InterpError, ProgramError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import Blocks, JobSetup, Program, open_program
from cnc_interp.proof.linuxcnc_reader import interpreter
from cnc_interp.proof.verify import verify_plan
from cnc_interp.settings.options import Settings

Row = tuple[str, list[str]]
ROOT = Path(__file__).resolve().parents[1]
PROGRAMS = ROOT.parent / 'shared' / 'programs'
TABLE, RESULTS = ROOT / 'docs' / 'measured' / 'programs_table.md', ROOT / 'out' / 'programs'
BESIDE = ROOT / 'out' / 'programs_beside.json'  #: Figures of other states of the code.
#: A part of a program takes about this long [s], if its feed were reached.
PART = 600.0
#: Longest time for one plan of ``--beside`` [s], and the most lines of a program for it.
PATIENCE, MOST_LINES = 300.0, 50_000
CORNERS = ROOT.parent / 'shared' / 'cases' / 'corners'
HARDEST = ('A_reversal', 'B_micro', 'C_rotation', 'D_pole', 'reorient_1um')  #: Of the corners.
#: Blocks of the spirals of ``shared/cases/dense``, and how many [mm].
SPIRAL, SPIRALS = CORNERS.parent / 'dense' / 'spiral.py', {'0.02': 20_000, '0.2': 10_000}


@dataclass(frozen=True)
class Case:
    """How a program is run: the machine it was written for, and what its operator set."""

    machine: str = 'xyz'
    setup: JobSetup = field(default_factory=JobSetup)
    feed: float | None = None
    remark: str = ''


CASES = {
    'camotics-heart': Case(),
    'cnclite-blend-mpf': Case(),
    'cnclite-square-apt': Case('xyzac', feed=1000.0, remark='--feed 1000'),
    'cnclite-tulsyan-apt': Case('xyzac', feed=1000.0, remark='--feed 1000'),
    'creo-finition-ncl': Case('head_head', remark='a part of 6 m'),
    'dmu50-boss-h': Case('xyzbc'),
    'fanuc-test-g91': Case('vmc'),
    'gcws-sinumerik840d': Case('bc_trunnion'),
    'hust-yelun-cl': Case('xyzac', feed=1000.0, remark='--feed 1000'),
    'linuxcnc-cds': Case(),
    'linuxcnc-impeller-xyzac': Case('xyzac'),
    'linuxcnc-lhchips4': Case(feed=3000.0, remark='--feed 3000'),
    'linuxcnc-stellabee': Case(),
    'mach-pulley-r-arcs': Case(),
    'nist-box-op5': Case(
        'vmc',
        JobSetup(work_offsets={'G58': {'X': 0.05, 'Y': 0.02, 'Z': -0.4}}),
        remark='--setup with G58',
    ),
    'opencn-congee-5x': Case('xyzbc', remark='TCP off'),
    'pycam-sample': Case(),
    'qtpyvcp-bezel': Case('vmc'),
    'solidcam-4x-rotx': Case('xyza', remark='4-axis, TCP off'),
    'spinner-achskreuz-mpf': Case('bc_trunnion', remark='AROT, TRAORI'),
    'ugs-gates': Case(),
}


def program_file(name: str) -> Path:
    """Return the program in a folder of the collection."""
    return next(path for path in sorted((PROGRAMS / name).iterdir()) if path.name != 'SOURCE')


def commit(checkout: Path = ROOT) -> str:
    """Return the state of the code."""
    command = ['git', '-C', str(checkout), 'rev-parse', '--short', 'HEAD']
    found = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    return found or 'no repository'


def made_at(results: dict[str, dict[str, Any]]) -> str:
    """Tell at which states of the code the rows were made."""
    names: dict[str, list[str]] = {}
    for name, result in results.items():
        names.setdefault(result['commit'], []).append(name)
    most = max(names, key=lambda key: len(names[key]))
    others = [f'{key}: {", ".join(names[key])}' for key in names if key != most]
    return f'State of the code: {most}' + (f'; but {"; ".join(others)}' if others else '') + '.'


def read(name: str, geometry: Transform) -> tuple[Program, float, float]:
    """Read a program; also the time to the first block and to the last [s]."""
    case = CASES[name]
    feed = None if case.feed is None else case.feed * MM_PER_MIN
    settings = Settings(feedrate=feed)
    begin = time.perf_counter()
    stream = open_program(program_file(name), geometry, settings, case.setup)
    first, parts = 0.0, []
    for blocks in stream:
        first = first or time.perf_counter() - begin
        parts.append(blocks)
    whole = time.perf_counter() - begin
    program = Program(Blocks.concatenate(parts), stream.notices, stream.source, stream.dialect)
    return program, first, whole


def parts_of(program: Program) -> list[Program]:
    """Cut a long program into parts; each begins where the one before ended."""
    blocks = program.blocks
    way = np.linalg.norm(np.diff(blocks.tip, axis=0), axis=1)
    speed = np.where(np.isfinite(blocks.feedrate[1:]), blocks.feedrate[1:], 0.5)
    seconds = np.where(np.isfinite(blocks.duration[1:]), blocks.duration[1:], way / speed)
    part = np.concatenate([[0], np.floor(np.cumsum(seconds) / PART)])
    edges = [0, *(np.flatnonzero(np.diff(part)) + 1).tolist(), len(blocks) - 1]
    return [
        replace(program, blocks=blocks[first : last + 1])
        for first, last in pairwise(edges)
        if last > first
    ]


def run_one(name: str) -> dict[str, Any]:
    """Read, compare, plan and prove one program."""
    case, file = CASES[name], program_file(name)
    machine = Machine.load(case.machine)
    geometry = Transform.of(machine)
    result: dict[str, Any] = {'lines': len(file.read_bytes().splitlines()), 'commit': commit()}
    try:
        read(name, geometry)  # kernels and file cache warm
        program, first, whole = read(name, geometry)
    except ProgramError as problem:
        why = str(problem).partition(f'{problem.word}: ')[2]
        return result | {'refused': f'line {problem.line_number}, {problem.word}: {why}'}
    result |= {
        'blocks': len(program.blocks) - 1,
        'first_block': first,
        'lines_per_second': result['lines'] / whole,
        'notices': len(program.notices),
        'oracle': agreement(name),
        'cycle_time': 0.0,
        'planning': 0.0,
        'contour': 0.0,
        'failures': [],
    }
    try:
        for part in parts_of(program):
            plan_and_prove(part, machine, result)
            print(f'{name}: {result["cycle_time"]:.0f} s', file=sys.stderr, flush=True)
    except InterpError as problem:
        result['failures'].append(str(problem))
    return result


def plan_and_prove(part: Program, machine: Machine, result: dict[str, Any]) -> None:
    """Plan a part of a program, prove its plan files and add up the figures."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        plan = plan_program(part, machine)
        result['planning'] += time.perf_counter() - begin
        write_plan(plan, Path(folder))
        summary = summary_of(plan)
        del plan
        proof = verify_plan(Path(folder), machine)
    result['cycle_time'] += summary['cycle_time']
    result['contour'] = max(result['contour'], summary['contour_deviation_bound'])
    if not proof.ok:
        result['failures'].extend(proof.failures[:3])


def agreement(name: str) -> str:
    """Compare the blocks of a program with what LinuxCNC's interpreter makes of it."""
    if name not in ORACLE_PROGRAMS or not interpreter():
        return '-'
    machine, partly = ORACLE_PROGRAMS[name]
    found = judged(program_file(name), machine, partly)
    agree = f'{found.motions:,}, {found.arcs:,}'
    return f'differs: {found.faults[0]}' if found.faults else agree


def table_of(results: dict[str, dict[str, Any]]) -> str:
    """Write the table."""
    ran = [r for r in results.values() if 'refused' not in r and not r['failures']]
    beside = json.loads(BESIDE.read_text(encoding='utf-8')) if BESIDE.exists() else {}
    lines = [
        '# The public programs',
        '',
        f'`benchmarks/programs.py`: {len(ran)} of {len(results)} programs run, every sample is '
        'proven. Reasons for the others: [programs.md](../operate/programs.md).',
        '',
        'The column LinuxCNC gives the numbers of motions and arcs that agree with its '
        'interpreter.',
        '',
        made_at(results),
        '',
        f'The figures are those of `plan --workers 1` at {beside.pop("states", "")}, in this '
        f'order. "-": rejected, or too slow. Of more than {MOST_LINES:,} lines, the first 20,000 '
        'are used.',
        '',
        '| program | machine | LinuxCNC | motion [s] | CPU [s] | wall [s] | memory [MB] |',
        '|---|---|---|---|---|---|---|',
    ]
    for name in sorted(CASES):
        lines.append(row_of(name, results.get(name), beside.pop(name, [])))
    lines += [f'| {name} | | | {" | ".join(told)} |' for name, told in beside.items()]
    return '\n'.join(lines) + '\n'


def row_of(name: str, result: dict[str, Any] | None, beside: list[str]) -> str:
    """Write the table's row of a program."""
    case, result = CASES[name], result or {'oracle': '', 'cycle_time': np.nan, 'failures': []}
    machine = ', '.join(filter(None, (case.machine, case.remark)))
    if 'refused' in result:
        return f'| {name} | refused at {result["refused"]} |'
    told = ' | '.join(beside or [f'{result["cycle_time"]:.1f}'])
    faults = ''.join(f'; {text}' for text in result['failures'][:1])
    return f'| {name} | {machine}{faults} | {result["oracle"]} | {told} |'


def timed(file: Path, arguments: list[str], checkout: Path) -> list[float]:
    """Return motion [s], processor time [s], wall time [s] and memory [MB] of `plan`; or none."""
    with tempfile.TemporaryDirectory() as folder:
        command = ['timeout', str(PATIENCE), sys.executable, '-m', 'cnc_interp', 'plan', str(file)]
        command += ['--out', folder, *arguments]
        if (checkout / 'cnc_interp' / 'commands').exists():  # else it is older than the option
            command += ['--workers', '1']
        environment = os.environ | {'PYTHONPATH': str(checkout)}
        if checkout != ROOT:
            environment['NUMBA_CACHE_DIR'] = str(checkout / 'kernels')
        quiet = subprocess.DEVNULL
        begin = time.perf_counter()
        process = subprocess.Popen(
            command, cwd=checkout, env=environment, stdout=quiet, stderr=quiet
        )
        _, status, used = os.wait4(process.pid, 0)
        wall, process.returncode = time.perf_counter() - begin, status
        if status:
            return []
        summary = json.loads((Path(folder) / 'summary.json').read_text(encoding='utf-8'))
    spent = used.ru_utime + used.ru_stime
    return [summary['cycle_time'], spent, wall, used.ru_maxrss / 1024.0]


def beside(
    checkouts: list[Path], only: list[str], folder: Path
) -> Iterator[tuple[str, list[str]]]:
    """Plan with one state of the code after the other; yield names and the last columns."""
    jobs: dict[str, list[tuple[Path, list[str]]]] = {}
    for name in only:
        case, file = CASES[name], program_file(name)
        lines = file.read_bytes().splitlines(keepends=True)
        if len(lines) > MOST_LINES:
            file = folder / file.name  # the first of them
            file.write_bytes(b''.join(lines[:20_000]))
        arguments = ['--machine', case.machine]
        arguments += [] if case.feed is None else ['--feed', str(case.feed)]
        if case.setup.work_offsets:
            setup = folder / f'{name}.yaml'
            setup.write_text(f'work_offsets: {case.setup.work_offsets}', encoding='utf-8')
            arguments += ['--setup', str(setup)]
        jobs[name] = [(file, arguments)]
    if len(only) == len(CASES):
        for length, blocks in SPIRALS.items():
            file = folder / f'spiral_{length}.ngc'
            subprocess.run([sys.executable, SPIRAL, length, str(blocks), file], check=True)
            jobs[f'spiral, {blocks:,} of {length} mm'] = [(file, ['--machine', 'xyz'])]
        jobs['corners A to D, reorient_1um'] = [(CORNERS / f'{name}.apt', []) for name in HARDEST]
    for name, files in jobs.items():
        found = [[timed(*file, state) for file in files] for state in checkouts]
        rows = [np.sum(row, axis=0) if all(row) else np.full(4, np.nan) for row in found]
        for row, state in zip(rows, found, strict=True):
            row[3] = max((figures[3] for figures in state if figures), default=np.nan)
        columns = zip(*rows, strict=True)
        texts = (
            '/'.join('-' if np.isnan(value) else f'{value:.{digits}f}' for value in column)
            for column, digits in zip(columns, (1, 1, 1, 0), strict=True)
        )
        yield name, list(texts)


def main() -> None:
    """Run the programs, each in a process of its own, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--only', choices=sorted(CASES), nargs='+', default=sorted(CASES))
    parser.add_argument('--beside', type=Path, nargs='+', help='checkouts of other states')
    parser.add_argument('--here', choices=sorted(CASES), help='run one in this process')
    options = parser.parse_args()
    RESULTS.mkdir(parents=True, exist_ok=True)
    if options.here:
        text = json.dumps(run_one(options.here), indent=2)
        (RESULTS / f'{options.here}.json').write_text(text + '\n', encoding='utf-8')
        return
    if options.beside:
        with tempfile.TemporaryDirectory() as folder:
            checkouts = [*(path.resolve() for path in options.beside), ROOT]
            told = json.loads(BESIDE.read_text(encoding='utf-8')) if BESIDE.exists() else {}
            told['states'] = ', '.join(map(commit, checkouts))
            for name, columns in beside(checkouts, options.only, Path(folder)):
                told[name] = columns
                BESIDE.write_text(json.dumps(told, indent=2) + '\n', encoding='utf-8')
                print(name, *columns, flush=True)
        return
    for name in options.only:
        subprocess.run([sys.executable, __file__, '--here', name], check=True)
        found = sorted(RESULTS.glob('*.json'))
        results = {file.stem: json.loads(file.read_text(encoding='utf-8')) for file in found}
        print(row_of(name, results[name], []), flush=True)
        TABLE.write_text(table_of(results), encoding='utf-8')


if __name__ == '__main__':
    main()
