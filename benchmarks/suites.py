"""
Test suites of others for the reader: LinuxCNC's interpreter tests, Sinumerik's, and our cases.

``PYTHONPATH=. python benchmarks/suites.py ../shared/suites`` reads every program of both suites,
and with ``../shared/cases`` those of the corpus. It prints a table: motions as expected, rejected
as expected, rejected although valid, accepted although invalid, or other motions. The motions of
the corpus are compared with the second readers, if one of them knows all words. The last table
counts programs with follow-up errors: rejections that disappear when the first rejected line is
left out. ``--all`` prints every case; ``--only cases/corners cases/rotary`` counts only these
parts.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import importlib.util
import io
import json
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import yaml

from cnc_interp.commands.cli import BAD_INPUT, FINE
from cnc_interp.commands.cli import main as main_of_commands
from cnc_interp.core import INCH, MM, InterpError, ProgramError, RefusedLinesError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import ANGLE, FOLLOWS, FREE, Signals, signals
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import Blocks, JobSetup, Tool, read_text
from cnc_interp.program.blocks.functions import Functions
from cnc_interp.program.job import WORK_OFFSETS
from cnc_interp.program.reading import open_program
from cnc_interp.run.plan_writer import block_columns
from cnc_interp.settings.options import Settings

AGREES, MUST, REFUSED, ACCEPTED, WRONG, EMPTY, NOT_COMPARED = (
    'agrees',
    'refused as it must be',
    'refused, but runs',
    'ACCEPTED, but is refused',
    'WRONG',
    'no motion in it',
    'read as the corpus demands; no second reader knows all words',
)
ROOT = Path(__file__).resolve().parents[1]
#: Inputs of the corpus: its own, and those beside the repository.
CORPUS = ROOT / 'test' / 'corpus' / 'inputs', ROOT.parent / 'shared' / 'cases'
SUFFIXES = {'.ngc', '.nc', '.mpf', '.spf', '.h', '.apt', '.cl', '.ncl', '.min', '.i'}
#: Positions of the Sinumerik suite agree within this [mm].
NEAR = 2e-3
#: Cases that are not as expected, with the reason.
EXCEPTIONS = {
    'ccomp-lathe-comp': 'lathe tools with an orientation, which a setup does not have',
    'g72-missing-iteration': 'a cycle of lathes',
    **dict.fromkeys(
        (f'g84-g{plane}-g{level}' for plane in (18, 19) for level in (98, 99)),
        'LinuxCNC taps along the wrong axis',
    ),
    'good-good-arc.big.metric.center-format': 'it takes more than 100 h',
    'oword-unwind': 'it ends with an error on LinuxCNC, too',
    'custom_vars': 'a variable that is set nowhere',
    'edge_cases': 'an axis ELX, which no machine here has',
    'simple': 'G2 without a centre',
}
#: A milling machine without an encoder: LinuxCNC's canon calls reverse the spindle of a tap, too.
_MILLING = signals({'signals': 'milling'})
SIGNALS = replace(
    _MILLING,
    inputs=tuple(one for one in _MILLING.inputs if one.name != ANGLE),
    words={word: k for word, k in _MILLING.words.items() if word not in (FOLLOWS, FREE)},
)
#: Speed, direction, tool, flood and mist.
State = tuple[float, float, float, float, float]
NOTHING: State = (0.0, 0.0, 0.0, 0.0, 0.0)
AT_ZERO = {name: dict.fromkeys('XYZAC', 0.0) for name in WORK_OFFSETS}


def read(
    path: Path,
    machine: str,
    tools: dict[int, Tool],
    feed: float | None,
    switching: Signals = SIGNALS,
) -> tuple[Blocks, Functions]:
    """Read a program on a machine whose zeros are all in one point."""
    plain = Machine.load(machine)
    plain = replace(plain, offsets=np.zeros_like(plain.offsets), signals=switching)
    settings = Settings(feedrate=feed)
    stream = open_program(path, Transform.of(plain), settings, JobSetup(AT_ZERO, tools))
    return stream.read().blocks, stream.functions


def switched(functions: Functions, signals: Signals) -> list[State]:
    """Return what a program switches: each state of spindle, tool and coolant after another."""
    names = [output.name for output in signals.outputs]
    now, found = dict.fromkeys(names, 0.0), [NOTHING]
    for step, value in zip(functions.step.tolist(), functions.value.tolist(), strict=True):
        output = names[signals.steps[step].output]
        now[output] = value
        if output == 'tool_number':
            continue  # it is there after the change
        turns = now['spindle_forward'] - now['spindle_reverse']
        state = (now['spindle_speed'], turns, now['tool_number'])
        state += (now['coolant_flood'], now['coolant_mist'])
        if state != found[-1]:
            found.append(state)
    return found


def expected_states(text: str) -> list[State]:
    """Return the same of LinuxCNC's canon calls."""
    speed, turns, tool, flood, mist, chosen = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    found = [NOTHING]
    for name, inner in re.findall(r'([A-Z_]+)\(([^()]*)\)', text):
        match name:
            case 'SET_SPINDLE_SPEED':
                speed = float(inner.split(',')[-1])
            case 'START_SPINDLE_CLOCKWISE':
                turns = 1.0
            case 'START_SPINDLE_COUNTERCLOCKWISE':
                turns = -1.0
            case 'STOP_SPINDLE_TURNING':
                turns = 0.0
            case 'SELECT_TOOL':
                chosen = float(inner)
            case 'CHANGE_TOOL':
                tool = chosen
            case 'FLOOD_ON' | 'FLOOD_OFF':
                flood = float(name == 'FLOOD_ON')
            case 'MIST_ON' | 'MIST_OFF':
                mist = float(name == 'MIST_ON')
        state = (speed, turns, tool, flood, mist)
        if state != found[-1]:
            found.append(state)
    return found


def tools_of(table: Path) -> dict[int, Tool]:
    """
    Return a tool table of LinuxCNC in inches.

    Tools of a lathe are left out: Q1 to Q8 say beside which place of its nose the tool is
    measured, and G41 and G42 lead that place. No setup can hold it.
    """
    found = {}
    for line in table.read_text().splitlines() if table.exists() else ():
        word = dict(re.findall(r'([TZDQ])(-?[\d.]+)', line.split(';')[0].upper()))
        if 1 <= int(word.get('Q', 0)) <= 8:
            continue
        length, across = (float(word.get(letter, 0.0)) * INCH for letter in 'ZD')
        found[int(word['T'])] = Tool(length, across / 2.0)
    return found


def loaded(path: Path) -> ModuleType:
    """Return a script as a module."""
    spec = importlib.util.spec_from_file_location('judge', path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def linuxcnc(folder: Path) -> Iterator[tuple[str, str, str]]:
    """Yield case, verdict and reason for LinuxCNC's own tests."""
    judge = loaded(folder / 'judge.py')
    for case in json.loads((folder / 'cases.json').read_text())['cases']:
        here = folder / 'cases' / case['id']
        program = here / 'program.ngc'
        text = re.sub(r'\(.*?\)|;.*', '', program.read_text(errors='replace')).upper()
        axes = 'AC' if re.search(r'\b[AC]\s*[-#\[\d]|\bA\s*EXISTS', text) else ''
        runs = case['outcome'] == 'reads'
        try:
            machine = 'xyzac' if axes else 'xyz'
            switching = _MILLING if 'G33' in text else SIGNALS
            blocks, functions = read(
                program, machine, tools_of(here / 'test.tbl'), None, switching
            )
        except InterpError as problem:
            why = str(problem).splitlines()[0].split('program.ngc:')[-1]
            if 'no motion found' in why and runs:
                yield case['id'], AGREES if not case['motions'] else WRONG, EMPTY
            else:
                yield case['id'], REFUSED if runs else MUST, why
            continue
        if not runs:
            yield case['id'], ACCEPTED, case['error']
            continue
        told = here / 'expected'
        expected = told.read_text() if told.exists() else ''
        faults, count = judge.compare(expected, block_columns(blocks), axes)
        wanted, got = expected_states(expected), switched(functions, switching)
        if wanted != got:
            faults = [*faults, f'switches {got[1:]}, not {wanted[1:]}']
        yield case['id'], WRONG if faults else AGREES, (faults or [f'{count} motions'])[0]


def sinumerik(folder: Path) -> Iterator[tuple[str, str, str]]:
    """Yield case, verdict and reason for the Sinumerik programs: their X, Y, Z in order."""
    for program in sorted((folder / 'cases').glob('*.mpf')):
        with program.with_suffix('.csv').open() as table:
            rows = list(csv.DictReader(table))
        places = []
        at = np.zeros(3)
        for row in rows:
            at = np.array([float(row.get(n) or v) for n, v in zip('XYZ', at, strict=True)])
            places.append(at)
        wanted = [p for i, p in enumerate(places) if not i or (p != places[i - 1]).any()]
        named = {n for n in 'ABC' if any(row.get(n) for row in rows)}
        machine = {'': 'xyz', 'A': 'xyza'}.get(''.join(sorted(named)), 'xyzac')
        try:
            blocks = read(program, machine, {}, 1000.0 * MM / 60.0)[0]
        except InterpError as problem:
            why = str(problem).splitlines()[0].split('.mpf:')[-1]
            if len(wanted) < 2 and 'no motion found' in why:
                yield program.stem, AGREES, EMPTY
            else:
                yield program.stem, REFUSED, why
            continue
        tips = block_columns(blocks)['tip'] / MM
        row, missing = 0, None
        for place in wanted:
            while row < len(tips) and np.abs(tips[row] - place).max() > NEAR:
                row += 1
            if row == len(tips):
                if place.any() or missing is not None:  # the first row may stand before all motion
                    missing = place
                    break
                row = 0
        if missing is None and np.abs(tips[-1] - wanted[-1]).max() > NEAR:
            missing = tips[-1]
        reason = f'{len(wanted)} places' if missing is None else f'{missing} is not reached'
        yield program.stem, AGREES if missing is None else WRONG, reason


@cache
def corpus() -> list[dict[str, Any]]:
    """Return the table of the programs that broke us once."""
    table = yaml.safe_load((CORPUS[0].parent / 'cases.yaml').read_text())
    return list(table['cases'])


def part_of(case: dict[str, Any]) -> str:
    """Return the folder of an input beside the repository; 'own' for one of the corpus."""
    return str(case['input']).rpartition('/')[0] or 'own'


def parts_of_corpus() -> list[str]:
    """Return the folders of the corpus."""
    return sorted({part_of(case) for case in corpus()})


def cases(part: str, _: Path) -> Iterator[tuple[str, str, str]]:
    """Yield case, verdict and reason for the programs that broke us once, as users run them."""
    for case in corpus():
        if part_of(case) != part or case.keys() & {'command', 'generate', 'fault'}:
            continue
        path = next(each for folder in CORPUS if (each := folder / case['input']).exists())
        given = case.get('options', [])
        options = [str(CORPUS[1] / w) if w.endswith('.yaml') else w for w in given]
        wanted = case['today'].get('refused', ())
        wanted = [wanted] if isinstance(wanted, str) else wanted
        machine = case.get('machines', ['xyzac'])[0]
        with tempfile.TemporaryDirectory() as plan:
            words = ['plan', str(path), '--machine', machine, '--out', plan, *options]
            code, told = said_by(words)
            told = [line for line in told if not line.startswith('note: ')]
            if code != FINE or wanted:
                expected = len(told) == len(wanted) and all(map(str.__contains__, told, wanted))
                refused = MUST if expected else REFUSED if code else ACCEPTED
                yield case['input'], refused, (*told, '')[-1]
                continue
            code, told = said_by(['check', plan, '--program', str(path)])
        verdict = {FINE: AGREES, BAD_INPUT: NOT_COMPARED}.get(code, WRONG)
        yield case['input'], verdict, ' '.join(told[-2:])


def said_by(words: list[str]) -> tuple[int, list[str]]:
    """Run a command; return its exit code and the lines of what it tells of faults."""
    out, error = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        code = main_of_commands(words)
    return code, (error.getvalue() or out.getvalue()).splitlines()


def follow_ups(path: Path, read_it: Callable[[str], object]) -> tuple[int, list[str]]:
    """Return the number of refusals of a program, and those that follow from the first one."""
    text = path.read_text('utf-8-sig', errors='replace')

    def refusals(text: str) -> tuple[ProgramError, ...]:
        try:
            read_it(text)
        except RefusedLinesError as problem:
            return tuple(each for each in problem.errors if isinstance(each, ProgramError))
        except ProgramError as problem:
            return (problem,)
        return ()

    told = refusals(text)
    if len(told) < 2:
        return len(told), []
    lines = text.splitlines()
    lines[told[0].line_number - 1] = ''
    left = {(each.line_number, each.word) for each in refusals('\n'.join(lines) + '\n')}
    beyond = (each for each in told[1:] if (each.line_number, each.word) not in left)
    return len(told), [str(each) for each in beyond]


def count_follow_ups(folder: Path) -> None:
    """Print how many programs have refusals, and which of them follow from others."""
    counts: Counter[str] = Counter()
    programs = [*folder.rglob('*.ngc'), *folder.rglob('*.mpf'), *CORPUS[0].iterdir()]
    programs += [path for path in CORPUS[1].rglob('*') if path.suffix.lower() in SUFFIXES]
    for path in sorted(programs):
        axes = set(re.findall(r'(?<![A-Z])[ABC](?=[-+\s=]*\d)', path.read_text(errors='replace')))
        machine = Machine.load('xyz' if not axes else 'xyzbc' if 'B' in axes else 'xyzac')
        geometry = Transform.of(machine)

        def read_it(text: str, path: Path = path, geometry: Transform = geometry) -> None:
            read_text(text, path.name, geometry, Settings())

        told, followers = follow_ups(path, read_it)
        counts['programs'] += 1
        counts['refused'] += told > 0
        counts['refused for several reasons'] += told > 1
        counts['with follow-up errors'] += bool(followers)
        for follower in followers:
            print(f'    FOLLOW-UP: {path}: {follower}')
    print('\nrefusals:', json.dumps(counts))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('folder', type=Path)
    parser.add_argument('--all', action='store_true', help='print every case')
    parser.add_argument('--only', nargs='+', metavar='SUITE', help='a suite, or cases/FOLDER')
    arguments = parser.parse_args()
    judges = {'linuxcnc-interp': linuxcnc, 'cead-sinumerik': sinumerik}
    judges |= {f'cases/{part}': partial(cases, part) for part in parts_of_corpus()}
    for name in arguments.only or judges:
        found = list(judges[name](arguments.folder / name))
        print(f'\n{name}: {len(found)} cases')
        for verdict, count in Counter(verdict for _, verdict, _ in found).most_common():
            print(f'  {count:3d}  {verdict}')
        for case, verdict, why in found:
            if arguments.all or verdict not in (AGREES, MUST, NOT_COMPARED):
                because = f' ({EXCEPTIONS[case]})' if case in EXCEPTIONS else ''
                print(f'    {verdict}: {case}: {why}{because}')
    if not arguments.only:
        count_follow_ups(arguments.folder)


if __name__ == '__main__':
    main()
