"""Sweeps: every point is a command, each is run once, the best is the best."""

import csv
import json
from pathlib import Path

import pytest

from cnc_interp.batch.processes import EndedCall, Processes
from cnc_interp.batch.sweep import (
    Found,
    Point,
    Range,
    Sweep,
    front,
    run_point,
    shares_at_limits,
    without_effect,
)
from cnc_interp.commands.cli import main
from cnc_interp.commands.parser import BAD_INPUT, FAILED, FINE
from cnc_interp.core import InterpError

EXAMPLES = Path(__file__).parents[2] / 'examples'
PYRAMID = str(EXAMPLES / 'pyramid.apt')
GIGA = 1e9
WIDE = '--orientation-tolerance=1'


def sweep(out, *words):
    return main(['sweep', '--out', str(out), *words])


def zigzag(folder):
    program = folder / 'zigzag.ngc'
    lines = '\n'.join(f'X{8 * k} Y{8 * (k % 2)}' for k in range(1, 7))
    program.write_text(f'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A10 C0\nG1 F3000\n{lines}\nM30\n')
    return str(program)


def test_a_grid_runs_every_combination_and_names_the_fastest(tmp_path, capsys):
    out, program = tmp_path / 'out', zigzag(tmp_path)
    words = ['--vary', 'ratio', '1.2', '2', '--vary', 'contour-tolerance', '0.02', '0.2', '-3']
    assert sweep(out, *words, '--', 'plan', program, WIDE) == FINE
    said = capsys.readouterr().out
    rows = list(csv.DictReader((out / 'sweep.csv').open()))
    assert len(rows) == 7 and 'points         7, 5 of them give a motion' in said
    assert '-3 mm is not between' in said and ' (2 points)\n' in said
    refused = [row for row in rows if row['fault']]
    assert {row['contour-tolerance'] for row in refused} == {'-3'}
    assert all('contour-tolerance' in row['fault'] for row in refused)
    moving = {
        (r['ratio'], r['contour-tolerance']): float(r['cycle_time_s'])
        for r in rows
        if not r['fault']
    }
    assert moving['2', '0.2'] < moving['2', '0.02']  # a wider tolerance is faster
    best = min(moving, key=moving.get)
    line = next(row for row in said.splitlines() if row.startswith('command'))
    assert line.endswith(f'--ratio={best[0]} --contour-tolerance={best[1]}')
    # The command of the best gives its time again.
    again = tmp_path / 'again'
    command = line.split('cnc-interp ')[1].split()
    assert main([*command, '--out', str(again)]) == FINE
    assert json.loads((again / 'summary.json').read_text())['cycle_time'] == moving[best]
    # And its files are there.
    kept = json.loads((out / 'best' / 'summary.json').read_text())
    assert kept['cycle_time'] == moving[best]
    page = (out / 'sweep.html').read_text()
    assert '--ratio' in page and 'Not possible' in page


def test_what_is_known_is_not_run_again_unless_its_program_changes(tmp_path):
    program, told, progress = tmp_path / 'part.ngc', [], []
    program.write_text('X5')

    def tell(*counts):
        progress.append(counts)

    class Counting:
        def run(self, _, calls):
            told.append([make()[1] for make in calls])
            return [EndedCall(number, Found(1.0)) for number in range(len(calls))]

    def start():
        one = Sweep(main, ('plan', str(program)), tmp_path / 'out', Counting(), tell)
        one.grid([Range('ratio', ('1.5', '2'))])
        return list(one.found.values())

    assert start() == 3 * [Found(1.0)] and progress == [(0, 0), (1, 0), (2, 0), (3, 0)]
    progress.clear()
    assert start() == 3 * [Found(1.0)] and progress == [(0, 3)], 'known points count at once'
    program.write_text('X9')
    start()
    assert [len(calls) for calls in told] == [3, 0, 3] and told[2] == told[0]


@pytest.mark.thorough
def test_a_search_finds_what_a_grid_would_and_does_not_depend_on_workers(tmp_path):
    words = ('plan', zigzag(tmp_path), WIDE)
    found = []
    for workers in (1, 2):
        one = Sweep(
            main,
            words,
            tmp_path / f'{workers}',
            Processes(workers, 4 * GIGA, 300.0),
            lambda *_: None,
        )
        one.search([Range('contour-tolerance', ('0.01', '0.05'))], 10)
        found.append(one.found)
    assert list(found[0]) == list(found[1])
    assert found[0] == found[1]
    tried = {
        float(dict(p.values)['contour-tolerance']): f.cycle_time
        for p, f in found[0].items()
        if p.values
    }
    assert 6 <= len(tried) <= 11 and all(0.01 <= value <= 0.05 for value in tried)
    assert min(tried, key=tried.get) == max(tried)


def test_the_front_has_what_nothing_beats():
    points = [Point(('plan',), (('a', str(k)),)) for k in range(5)]
    times, errors = (3.0, 2.0, 1.0, 1.0, 2.5), (1.0, 2.0, 4.0, 3.0, None)
    found = {p: Found(t, e) for p, t, e in zip(points, times, errors, strict=True)}
    found[Point(('plan',), ())] = Found(fault='refused')
    assert front(found) == [points[3], points[1], points[4]]
    # Less than a nanometre is no gain.
    close = {p: Found(t, e) for p, t, e in zip(points[:2], (1.0, 2.0), (1e-5, 0.99999e-5))}
    assert front(close) == points[:1]
    # A slower point with a larger error is among the best if its scallop is lower.
    rough = {p: Found(t, e, scallop=1.0) for p, t, e in zip(points[:2], (1.0, 2.0), (1.0, 1.0))}
    assert front(rough) == points[:1]
    fine = rough | {points[2]: Found(3.0, 5.0, scallop=0.5)}
    assert front(fine) == [points[0], points[2]]


def test_shares_at_limits_are_those_of_the_time(tmp_path):
    program = tmp_path / 'line.ngc'
    program.write_text('G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A10 C0\nG1 F3000 X300\nM30\n')
    assert main(['plan', str(program), '--machine', 'xyzac', '--out', str(tmp_path / 'p')]) == FINE
    shares = shares_at_limits(tmp_path / 'p')
    summary = json.loads((tmp_path / 'p' / 'summary.json').read_text())
    # 300 mm at 50 mm/s: it reaches the feed, and X accelerates with its jerk limit.
    ramps = 2 * 2 * (0.05 / 5.0) ** 0.5
    assert shares['X jerk'] * summary['cycle_time'] == pytest.approx(ramps, abs=0.06)
    assert shares['feed'] * summary['cycle_time'] == pytest.approx(
        summary['cycle_time'] - ramps, abs=0.06
    )
    assert shares['Y jerk'] == 0.0


def test_bad_input_gets_a_line(tmp_path, capsys):
    for words, text in (
        (['--vary', 'ratio', '2', '--', 'check', 'x'], 'a sweep needs a command after --'),
        (['--vary', 'ratio', '2'], 'a sweep needs a command after --'),
        (['--vary', 'ratio', '--', 'plan', PYRAMID], '--vary ratio: give values'),
        (['--vary', 'ratio', '2', '--search', '5', '--', 'plan', PYRAMID], 'needs the lowest'),
        (['--vary', 'ratio', '2', '--', 'plan', PYRAMID, '--out=x'], 'leave out the --out'),
    ):
        assert sweep(tmp_path / 'out', *words) == BAD_INPUT
        assert text in capsys.readouterr().err
    surface = ['cam', 'iso-scallop', 'x.json']
    for option, words, text in (
        ('fed', ['plan', PYRAMID], 'plan: unknown option --fed; did you mean --feed?'),
        (
            'stepovr',
            surface,
            '--stepovr; did you mean --stepover?',
        ),
    ):
        assert sweep(tmp_path / 'out', '--vary', option, '2', '--', *words) == BAD_INPUT
        assert text in capsys.readouterr().err
    assert not (tmp_path / 'out' / 'sweep.csv').exists()
    missing = ['--vary', 'ratio', '2', '--', 'plan', str(tmp_path / 'none.ngc')]
    assert sweep(tmp_path / 'out', *missing) == FAILED
    with pytest.raises(InterpError, match='leave out'):
        Sweep(main, ['plan', PYRAMID, '--out', 'x'], tmp_path, None, None)


def test_each_plan_of_a_sweep_takes_one_processor(tmp_path):
    said = []
    for first in ('plan', 'cam'):
        run_point((lambda words: said.append(words) or BAD_INPUT, (first,), tmp_path, tmp_path))
    assert ['--workers=1' in words for words in said] == [True, False]


@pytest.mark.thorough
def test_a_surface_is_swept_with_its_ridges(tmp_path):

    surface = tmp_path / 'plane.json'
    surface.write_text('{"kind": "plane", "size_mm": [12, 8]}')
    words = (
        'cam',
        'iso-scallop',
        str(surface),
        '--run',
        '--stepover=2',
        '--turn-y=15',
        '--spacing=0.4',
        '--margin=1',
    )
    found = run_point((main, words, tmp_path, tmp_path / 'out'))
    assert found.fault == '' and found.cycle_time > 1.0
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert found.scallop == summary['executed']['ridge_highest'] == pytest.approx(1e-5, rel=0.3)
    assert found.error == max(0.0, -summary['executed']['lowest'])


def test_an_option_whose_values_change_nothing_is_found():
    def point(ratio, tolerance):
        return Point(('plan',), (('ratio', ratio), ('tolerance', tolerance)))

    found = {Point(('plan',), ()): Found(9.0, 1e-5)}
    found |= {point(r, t): Found(float(r), 1e-5) for r in '123' for t in '45'}
    assert without_effect(found, 'tolerance') and not without_effect(found, 'ratio')
    found[point('3', '5')] = Found(2.5, 1e-5)
    assert not without_effect(found, 'tolerance')
