"""Plans beside their programs: whatever is changed in one of them, `check --program` finds it.

Words of a text, functions, durations, dwells, program stops, feeds, tolerances, columns, cuts and
the summary are changed one at a time, by rule, in several programs. `GIVEN` lists what is taken
as given (docs/proven.md); of everything else a fault must be reported.
"""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest

from cnc_interp.commands.cli import main
from cnc_interp.core import InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.plan_files import BY_OPERATOR, BY_PROBE, read_plan
from cnc_interp.proof.program_again import compare_with_text
from cnc_interp.proof.verify import verify

PROGRAMS = {
    'mill.ngc': (
        'vmc',
        'G21 G90 G17 G64 P0.03\nT5 M6\nS8000 M3\nG0 X0 Y0 Z5\nM8\nG1 Z0 F1000\nS9000\nX6 M9\n'
        'G4 P0.2\nY4 F600\nM0\nM4\nX0\nM1\nG2 X4 Y4 I2 J0\nG93 G1 X0 F60\nG95 X2 F0.1\n'
        'G94 F500 Y0\nM5 X1\nM7\nX2\nM30\n',
    ),
    'turn.ngc': (
        'xyzac_trt',
        'G21 G90 G64 P0.05\nS500 M3\nG0 X0 Y0 Z0 A5 C0\nG1 X5 A10 C20 F2000\nC40\nG4 P0.1\nM428\n'
        'G0 X5 Y0 Z5 A10 C40\nG1 X8 C50 F1500\nG93 X0 F60\nG94 F900 Y3\nM5\nY0\nM2\n',
    ),
    'fanuc.nc': (
        'vmc',
        'O1234\nG20 G90\nM0\nS900 M4\nG0 X0 Y0.05 Z0.2\nG1 Z0 F20 M8\nG4 P500\nX0.2\nG4 X0.25\n'
        'T7 M6\nM3\nG91 Y0.1\nG90 G3 X0.1 Y0.2 R0.1\nM9\nM30\n',
    ),
}
OPTIONS = {'fanuc.nc': ['--dialect', 'fanuc']}


@cache
def made(name):
    """Return the plan of a program in memory, its machine, and the program's file."""
    machine, text = PROGRAMS[name]
    folder = Path(mkdtemp())
    (folder / name).write_text(text)
    words = ['plan', str(folder / name), '--machine', machine, '--out', str(folder / 'plan')]
    assert main([*words, *OPTIONS.get(name, [])]) == 0
    return read_plan(folder / 'plan').in_memory(), Machine.load(machine), folder / name


def faults_of(plan, machine, program):
    try:
        return compare_with_text(plan, machine, program).faults or verify(plan, machine).failures
    except InterpError as refusal:
        return [f'refused: {refusal}']


# ---------------------------------------------------------------------- what is changed, by rule
#: What a code of the text is replaced by.
OTHER_CODES = {
    **{'M3': 'M4', 'M4': 'M3', 'M5': '', 'M7': 'M8', 'M8': 'M7', 'M9': '', 'M6': '', 'M0': 'M1'},
    **{'M1': 'M0', 'M30': 'M2', 'M2': 'M30', 'G1': 'G0', 'G0': 'G1', 'G2': 'G3', 'G3': 'G2'},
    **{'G93': 'G94', 'G95': 'G94', 'G94': 'G93', 'G90': 'G91', 'G91': 'G90', 'G20': 'G21'},
    **{'G21': 'G20', 'G4': '', 'M428': '', 'G64': 'G61'},
}
WORD = re.compile(r'([A-Z])(-?\d+\.?\d*)')


def changed_words(text):
    """Yield each text with one word changed: a smaller number, another code or none."""
    for k, line in enumerate(text.splitlines()):
        for found in WORD.finditer(line):
            letter, number = found.groups()
            if (letter in 'GM' and found[0] not in OTHER_CODES) or letter == 'O':
                continue
            other = OTHER_CODES.get(found[0])
            if letter not in 'GM':
                value = 0.99 * float(number) or 0.01
                other = f'{letter}{value:.6g}' if letter != 'T' else f'T{int(number) + 1}'
            lines = text.splitlines()
            lines[k] = f'{line[: found.start()]}{other}{line[found.end() :]}'
            yield f'line {k + 1}, {found[0]} -> {other or "none"}', '\n'.join(lines) + '\n'
    for k, line in enumerate(text.splitlines()):
        lines = text.splitlines()
        if WORD.match(line) and line[0] != 'O':
            yield f'line {k + 1} is left out', '\n'.join([*lines[:k], '', *lines[k + 1 :]]) + '\n'


def changed_functions(plan):
    """Yield functions.npz with one row changed."""
    found = plan.functions
    count = len(found['step'])
    for k in range(count):
        one = np.arange(count) == k
        yield f'step {k} is left out', {n: np.delete(c, k) for n, c in found.items()}
        yield f'step {k} twice', {n: np.insert(c, k, c[k]) for n, c in found.items()}
        yield f'step {k} is the next one', found | {'step': found['step'] + one}
        other = np.where(one, np.where(found['value'] == 0, 1.0, 0.5 * found['value']), 0)
        yield (
            f'step {k} sets another value',
            found | {'value': np.where(one, other, found['value'])},
        )
        yield f'step {k} comes a period later', found | {'sample': found['sample'] + one}
        yield f'step {k} does not come', found | {'sample': np.where(one, -1, found['sample'])}
    calls = np.flatnonzero(np.diff(found['line_number'], prepend=-1))
    for first, last in zip(calls, [*calls[1:], count], strict=True):
        own = np.isin(np.arange(count), np.arange(first, last))
        name = f'functions of line {found["line_number"][first]}'
        yield f'{name} are left out', {n: c[~own] for n, c in found.items()}
        for way in (-1, 1):
            block = np.clip(found['block'] + way * own, 0, len(plan.blocks['tip']))
            sample = np.searchsorted(plan.block, block)
            sample = np.where(own, sample, found['sample'])
            if (block != found['block']).any():
                moved = found | {'block': block, 'sample': sample}
                yield f'{name} come {"before" if way < 0 else "after"} a row', moved
        line = found['line_number'] + own
        yield f'{name} are said to be of the next line', found | {'line_number': line}


def changed_rows(plan):
    """Yield blocks.npz with one row of a column changed."""
    blocks = plan.blocks
    rows = np.arange(len(blocks['tip']))
    last = np.flatnonzero(np.diff(blocks['line'], append=-1))[1:]
    moves = np.linalg.norm(np.diff(blocks['tip'], axis=0, prepend=blocks['tip'][:1]), axis=1)
    for k in last:
        one, feed, duration = rows == k, blocks['feed'], blocks['duration']
        rapid, timed = blocks['rapid'][k], np.isfinite(duration[k])
        yield f'row {k}: program stop', {'program_stop': (blocks['program_stop'] + one) % 3}
        rests = np.linalg.norm(plan.path['tip'][plan.path['stop']] - blocks['tip'][k], axis=1)
        if blocks['program_stop'][k] or rests.min() > 1e-6:  # else the motion rests anyway
            yield f'row {k}: exact stop', {'exact_stop': blocks['exact_stop'] ^ one}
        yield f'row {k}: rapid', {'rapid': blocks['rapid'] ^ one}
        yield f'row {k}: line', {'line': blocks['line'] + one}
        yield f'row {k}: tip', {'tip': blocks['tip'] + 1e-6 * one[:, None]}
        yield (
            f'row {k}: tolerances',
            {
                name: blocks[name] * (1.0 + one)
                for name in ('contour_tolerance', 'orientation_tolerance')
            },
        )
        own = moves[k] / feed[k] if np.isfinite(feed[k]) and not rapid else 1.0
        yield (
            f'row {k}: a tenth of its time',
            {'duration': np.where(one, 0.1 * (duration[k] if timed else own), duration)},
        )
        yield (
            f'row {k}: longer',
            {'duration': np.where(one, 1.01 * (duration[k] if timed else own), duration)},
        )
        if not timed:
            yield f'row {k}: faster', {'feed': np.where(one, 1.01 * min(feed[k], 1.0), feed)}
        if not rapid:
            endless = {'feed': np.where(one, np.inf, feed)}
            yield f'row {k}: endless', endless | {'duration': np.where(one, np.nan, duration)}
        if np.isfinite(blocks['rotary'][k]).all():
            yield f'row {k}: words', {'rotary': blocks['rotary'] + 1e-5 * one[:, None]}


def changed_cuts(plan):
    """Yield records that end early, with a cause that the program does not have."""
    ends = np.flatnonzero(np.diff(plan.block) > 0)
    for place in (*ends[::2], len(plan.block) // 3):
        count = int(place) + 1
        line = plan.blocks['line'][plan.block[place]]
        columns = {name: column[:count] for name, column in plan.setpoints.items()}
        summary = dict(plan.summary) | {
            'samples': count,
            'cycle_time': (count - 1) * plan.period,
            'path_length': float(columns['s'][-1]),
        }
        found = plan.functions
        sample = np.where(found['sample'] < count, found['sample'], -1)
        functions = found | {'sample': sample}
        causes = '', f'{BY_PROBE}, in line {line}', f'{BY_OPERATOR}, in line {line}'
        for cause in (*causes, f'held in line {line}'):
            given = summary | ({'cut': cause} if cause else {})
            name = f'cut after setpoint {place} of line {line}: {cause or "no cause"}'
            yield name, replace(plan, setpoints=columns, summary=given, functions=functions)


#: Figures of the summary, and what they are changed to.
SUMMARY = {
    'waits_first': lambda value: not value,
    'functions': lambda value: {'M3': 7},
    'cycle_time': lambda value: 0.5 * value,
    'interpolation_period': lambda value: 2.0 * value,
    'samples': lambda value: value - 1,
    'blocks': lambda value: value + 1,
    'path_length': lambda value: 0.9 * value,
    'flank_height': lambda value: 1.0,
    'cut': lambda value: f'{BY_PROBE}, in line 3',
    'start': lambda value: {'line': 3},
}


def manipulations(name):
    """Yield what is changed and the plan and text afterwards."""
    plan, _, _ = made(name)
    text = PROGRAMS[name][1]
    for what, other in changed_words(text):
        yield what, plan, other
    for what, other in changed_functions(plan):
        yield what, replace(plan, functions=other), text
    for what, other in changed_rows(plan):
        yield what, replace(plan, blocks={**plan.blocks, **other}), text
    for what, other in changed_cuts(plan):
        yield what, other, text
    for key, change in SUMMARY.items():
        summary = dict(plan.summary) | {key: change(plan.summary.get(key))}
        yield f'summary: {key}', replace(plan, summary=summary), text


#: What is taken as given: words of the change, and why.
GIVEN = {
    'line [34], G0 -> G1': 'the first motion leads to the start pose; it has no feed',
    'line 5, G0 -> G1': 'likewise, in fanuc.nc',
    'summary: flank_height': 'it is printed as given; without rotary axes it means nothing',
}


@pytest.mark.parametrize('name', PROGRAMS)
def test_the_plans_as_made_agree_with_their_programs(name):
    assert not faults_of(*made(name))


@pytest.mark.parametrize(
    'part', [pytest.param(k, marks=pytest.mark.thorough if k else ()) for k in range(24)]
)
@pytest.mark.parametrize('name', PROGRAMS)
def test_every_manipulation_is_found(name, part, tmp_path, monkeypatch):
    monkeypatch.setenv('RS274', 'not installed')  # the second reader of plain words alone
    _, machine, _ = made(name)
    passed, tried = [], 0
    for k, (what, plan, text) in enumerate(manipulations(name)):
        if k % 24 == part:
            tried += 1
            program = tmp_path / name
            program.write_text(text)
            if not faults_of(plan, machine, program):
                passed.append(what)
    assert tried > 5
    assert not [what for what in passed if not any(re.fullmatch(given, what) for given in GIVEN)]
