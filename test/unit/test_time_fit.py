"""Limits and times fitted to recorded runs: known ones are found, unseen parts are predicted."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from cnc_interp.commands.cli import main
from cnc_interp.core import InterpError
from cnc_interp.core.compile_time import COMPILING
from cnc_interp.machine_model.machine import Machine
from cnc_interp.report.identified import write_fitted
from cnc_interp.run import time_fit
from cnc_interp.run.time_fit import Fitted, TimedProgram, TimeFit, TracedRun, measured_override
from cnc_interp.run.time_records import Trace, cycle_times, load_traces
from cnc_interp.settings.options import Settings

SUITE = Path(__file__).parents[3] / 'shared/suites/nist-box'
LIMIT = '{{velocity_m_per_min: {}, acceleration_m_per_s2: {}, jerk_m_per_s3: {}}}'
TRUTH = f"""name: known
signals: milling
limits:
  X: {LIMIT.format(24, 2.0, 15)}
  Y: {LIMIT.format(24, 2.0, 20)}
  Z: {LIMIT.format(18, 2.0, 25)}
look_ahead: {{velocity_jump_mm_per_s: 2.5, block_time_ms: 25.0, stops_at_rapids: true}}
standstill:
  tool_change_s: 5.0
  spindle_start_s: 2.4
  spindle_stop_s: 3.6
  spindle_speed_rev_per_min: 6000
"""
GUESS = 'name: guess\nsignals: milling\nlimits: {{X: {0}, Y: {0}, Z: {0}}}\n'.format(
    LIMIT.format(20, 3.0, 40)
)


def part(tool, seed):
    """One tool: rapids, zigzags, dense circles whose chords are short or long."""
    rng = np.random.default_rng(seed)
    lines = [f'T{tool} M6', f'S{2000 * tool} M3', 'G0 X0 Y0 Z20', 'M8']
    for pocket in range(2):
        x, y = rng.uniform(-200, 200, 2).round(3)
        lines += [f'G0 Z{50 + 20 * pocket}', f'X{x} Y{y}', 'Z2', 'G1 Z0 F6000']
        for k in range(4):
            lines += [f'X{x + 20 + k} Y{y + k}', f'X{x - k} Y{y + k + 0.5}']
        count, radius = (40, 0.6) if pocket % 2 else (40, 6.0)
        for a in np.linspace(0, 4 * np.pi, count):
            lines.append(f'X{x + radius * np.cos(a):.4f} Y{y + radius * np.sin(a):.4f}')
    return [*lines, 'M5']


@pytest.fixture
def recorded(tmp_path):
    """A program, and the trace of a machine whose limits are known, at 105 % of the feed."""
    lines = ['G21 G90', *part(1, 1), *part(2, 2), *part(3, 3), 'M30', '']
    (tmp_path / 'p.ngc').write_text('\n'.join(lines))
    (tmp_path / 'truth.yaml').write_text(TRUTH)
    (tmp_path / 'guess.yaml').write_text(GUESS)
    machine = Machine.load(tmp_path / 'truth.yaml')
    program = TimedProgram.load(tmp_path / 'p.ngc', machine, Settings()).overridden(1.05)
    motion, functions = program.motion(machine), program.functions
    rest = functions.standstill(machine.signals, machine.standstill)
    numbers = np.arange(1, len(lines) + 1)
    # Every line begins when those before it, and what they wait for, are done.
    rests = np.bincount(functions.line_number, rest, len(lines) + 1)
    begins = motion.until(numbers) + np.cumsum(rests)[numbers - 1]
    rng = np.random.default_rng(7)
    told = np.arange(0.0, begins[-1], 0.17) + rng.uniform(0.0, 0.02, int(begins[-1] / 0.17) + 1)
    seen = numbers[np.searchsorted(begins, told, side='right') - 1]
    new = np.flatnonzero(np.diff(seen, prepend=0))
    start = np.repeat(begins[motion.line - 1], 1)
    inside = np.cumsum(motion.duration) - motion.until(motion.line)
    place = np.searchsorted(start + inside, told).clip(max=len(inside) - 1)
    for name, head, rows in (
        ('r_blocks.csv', ('time_s', 'block'), zip(told[new], seen[new], strict=True)),
        ('r_feed.csv', ('time_s', 'feed_mm_per_s'), zip(told, 1e3 * motion.speed[place])),
    ):
        with (tmp_path / name).open('w', newline='') as out:
            writer = csv.writer(out, lineterminator='\n')
            writer.writerow(head)
            writer.writerows(rows)
    return tmp_path


@pytest.mark.thorough
def test_known_limits_are_found_within_their_intervals(recorded, capsys):
    out = recorded / 'fitted.yaml'
    words = [str(recorded / name) for name in ('r_blocks.csv', 'p.ngc')]
    assert (
        main(['fit-limits', *words, '--machine', str(recorded / 'guess.yaml'), '--out', str(out)])
        == 0
    )
    told = capsys.readouterr().out
    assert 'feed override 105' in told
    found, truth = yaml.safe_load(out.read_text()), yaml.safe_load(TRUTH)
    guess = yaml.safe_load(GUESS)
    lines = [line for line in out.read_text().splitlines() if line[:3] == '#  ']
    intervals = {
        key.removeprefix('#').strip(): [
            float(word) for word in values.split(' unchanged')[0].split('+-')
        ]
        for key, _, values in (line.partition(': ') for line in lines)
    }
    hidden = [line.split()[1].removesuffix(':') for line in lines if 'unchanged' in line]
    checked = 0
    for key, (value, *width) in intervals.items():
        if key in hidden:
            _, axis, limit = key.split('.') if key.startswith('limits') else ('', '', '')
            assert not axis or found['limits'][axis][limit] == guess['limits'][axis][limit]
            continue
        if key == 'look_ahead.scatter_percent':
            assert 0.0 < value < 5.0
            continue
        known, written = truth, found
        for name in key.split('.'):
            known, written = known[name], written[name]
        assert written == pytest.approx(value, rel=1e-3)
        if key.startswith('limits') and 'velocity' in key:
            assert value == pytest.approx(known, rel=0.01) or value == 20.0
        elif key.startswith('limits') or 'jump' in key:
            checked += 1
            assert abs(value - known) < 1.5 * width[0] + 0.02 * known, key
    assert checked >= 3
    assert 'limits.X.jerk_m_per_s3' not in hidden, 'it moves most'
    assert 'measured' in (recorded / 'fitted.html').read_text()


@pytest.mark.parametrize(
    ('text', 'told'),
    [
        ('a,b\n1,2\n', 'r_blocks.csv:1: must begin with the line time_s,block or'),
        ('time_s,block\n1,2\nx,3\n', 'r_blocks.csv:3: x,3: must hold numbers'),
        ('time_s,block\n1,2\n\n1,2,3\n', 'r_blocks.csv:4: 1,2,3'),
        ('time_s,block\n1,2\n0.5,3\n', 'r_blocks.csv:3: times must increase'),
        ('time_s,block\n1,2\n', 'at least two rows'),
        ('time_s,block\n1,2\n1.5,3\n', 'no 3 s of motion'),
        ('time_s,number\n1,10\n2,70\n', 'r_blocks.csv:3: p.ngc has no line N70'),
        ('program,time_s\nother.ngc,3\n', 'no row has the program p.ngc'),
        ('program,time_s\np.ngc,3 s\n', 'r_blocks.csv:2: 3 s: must hold numbers'),
        (
            'program,tool,time_s\np.ngc,3,3\n',
            'r_blocks.csv:2: T3, but the next tool of p.ngc is T1',
        ),
        ('program,tool,time_s\n\np.ngc,1,3\n', 'r_blocks.csv:3: T2 of p.ngc must follow'),
    ],
)
def test_a_record_that_cannot_be_used_is_one_line(tmp_path, capsys, text, told):
    (tmp_path / 'r_blocks.csv').write_text(text)
    lines = ['G21 G90', 'N10 T1 M6', 'G0 X0 Y0 Z0', 'N20 G1 X1 F100', 'T2 M6', 'G1 X0', 'M2', '']
    (tmp_path / 'p.ngc').write_text('\n'.join(lines))
    words = [str(tmp_path / name) for name in ('r_blocks.csv', 'p.ngc')]
    assert main(['fit-limits', *words, '--machine', 'vmc', '--out', str(tmp_path / 'm')]) == 2
    (line,) = set(capsys.readouterr().err.splitlines()) - {COMPILING}
    assert told in line


PLAIN = 'G21 G90\nN10 G0 X0\nN20 G1 X1 F100\nN10 X2\nN20 X3\nN30 X4\nN10 X5\nM2\n'


def observed(*rows):
    """An MTConnect document of observations: kind, seconds, text."""
    items = ''.join(
        f'<{kind} timestamp="2026-01-01T00:00:{second:06.3f}Z" sequence="{number}" '
        f'dataItemId="x">{text}</{kind}>'
        for number, (kind, second, text) in enumerate(rows, 1)
    )
    space = 'urn:mtconnect.org:MTConnectStreams:2.4'
    return f'<?xml version="1.0"?><MTConnectStreams xmlns="{space}">{items}</MTConnectStreams>'


def traces(tmp_path, name, text):
    (tmp_path / 'p.ngc').write_text(PLAIN)
    (tmp_path / name).write_text(text)
    return load_traces(tmp_path / name, tmp_path / 'p.ngc')


def test_numbers_of_lines_that_restart_are_told_apart_by_their_order(tmp_path):
    (one,) = traces(tmp_path, 'r.csv', 'time_s,number\n0,0\n1,10\n2,20\n3,10\n4,30\n5,10\n')
    assert one.line.tolist() == [2, 3, 4, 6, 7] and one.time.tolist() == [1, 2, 3, 4, 5]
    # A record of two runs: the lines begin again.
    found = traces(tmp_path, 'r.csv', 'time_s,block\n1,2\n2,4\n3,8\n9,2\n10,5\n')
    assert [each.line.tolist() for each in found] == [[2, 4, 8], [2, 5]]
    assert found[1].time.tolist() == [9, 10]


def test_streams_of_mtconnect_and_traces_of_a_sinumerik_are_records(tmp_path):
    first = observed(
        ('Program', 0, 'other.ngc'),
        ('LineNumber', 0, '4'),
        ('Program', 1, 'p.ngc'),
        ('LineNumber', 1, '2'),
        ('PathFeedrate', 1.5, '250'),
    )
    second = observed(*[('Availability', 0, 'x')] * 5, ('LineNumber', 2.25, '3'))
    (one,) = traces(tmp_path, 'r.xml', f'{first}\r\n--part\r\nContent-length: 9\r\n\r\n{second}')
    assert one.line.tolist() == [2, 3] and one.time.tolist() == [1.0, 2.25]
    assert one.feed.tolist() == [[1.5, 0.25]]
    labels = observed(*[('LineLabel', k, f'N{n}') for k, n in enumerate((10, 20, 10, 30))])
    (one,) = traces(tmp_path, 'r.xml', labels)
    assert one.line.tolist() == [2, 3, 4, 6]
    names = '/Channel/ProgramInfo/actLineNumber[u1]', '/Channel/State/actFeedRateIpo[u1]'
    signals = ''.join(f'<dataSignal name="{name}"/>' for name in names)
    rows = (
        ('0.0', 'f1="2"'),
        ('0.5', 'f1="2" f2="600"'),
        ('1.0', 'f1="3" f2="9218868437227405312"'),
    )
    records = ''.join(f'<rec time="{time}" {values}/>' for time, values in rows)
    frame = f'<dataFrame>{signals}{records}</dataFrame>'
    (one,) = traces(tmp_path, 'r.xml', f'<trace><traceData>{frame}</traceData></trace>')
    assert one.line.tolist() == [2, 3] and one.time.tolist() == [0.0, 1.0]
    assert one.feed.tolist() == [[0.5, 0.01]]  # 600 mm/min
    for text, told in (('<a>\n<b>', ':2: no XML'), ('<a/>', 'neither MTConnectStreams nor')):
        with pytest.raises(InterpError, match=told):
            traces(tmp_path, 'r.xml', text)


def test_cycle_times_by_tool_are_windows_of_the_motion_alone(recorded, capsys):
    """Rows as `estimate` prints them, on the machine that is known: what moves is what is left."""
    words = [str(recorded / 'p.ngc'), '--machine', str(recorded / 'truth.yaml'), '--json']
    assert main(['estimate', *words, '--workers', '1']) == 0
    tools = json.loads(capsys.readouterr().out)['tools']
    rows = ''.join(f'p.ngc,{one["tool"]},{one["time_s"]}\n' for one in tools)
    (recorded / 'times.csv').write_text(f'program,tool,time_s\n{rows}')
    machine = Machine.load(recorded / 'truth.yaml')
    program = TimedProgram.load(recorded / 'p.ngc', machine, Settings())
    times = cycle_times(recorded / 'times.csv')
    (run,) = TracedRun.of_times(program, machine, times, recorded / 'times.csv')
    moving = [one['cutting_s'] + one['rapid_s'] for one in tools]
    assert run.measured == pytest.approx(moving, abs=1e-6)
    motion = program.motion(machine)
    assert run.planned(motion) == pytest.approx(moving, rel=1e-3)
    write_fitted([run], Fitted(machine, {}, [motion]), recorded / 'page.html')
    assert 'planned' in (recorded / 'page.html').read_text(), 'a page without measured feeds'


def test_parts_of_a_long_program_take_their_time_in_the_whole(tmp_path, monkeypatch):
    monkeypatch.setattr(time_fit, 'EVERY', 120)
    monkeypatch.setattr(time_fit, 'CHUNK', 60)
    monkeypatch.setattr(time_fit, 'SPAN', 1.0)
    lines = [f'X{k % 9} Y{0.7 * k:.3f}' for k in range(300)]
    (tmp_path / 'long.ngc').write_text('\n'.join(['G21 G90', 'G0 X0 Y0 Z0', 'G1 F3000', *lines]))
    machine = Machine.load('xyz')
    program = TimedProgram.load(tmp_path / 'long.ngc', machine, Settings())
    starts = np.arange(5, 295, 10)
    windows = np.column_stack([starts, starts + 10])
    covered = program.covers(windows)
    assert 0.2 < covered.mean() < 0.5
    whole, parts = (
        np.diff(program.motion(machine, rows).until(windows), axis=1)[covered]
        for rows in ([slice(0, None)], program.sample())
    )
    assert parts == pytest.approx(whole, rel=1e-3)
    # What is left out of a long program counts by the windows that are planned.
    begins = program.motion(machine).until(program.lines[1:])
    run = TracedRun.of(program, Trace('long', begins, program.lines[1:], np.zeros((0, 2))))
    kept = int(program.covers(run.trace.line[run.windows]).sum())
    assert 0 < kept < len(run.windows)
    fit = TimeFit(machine, [run], print)
    assert fit._weights(np.zeros(kept))[0].sum() == pytest.approx(len(run.windows))


@pytest.mark.thorough
@pytest.mark.skipif(not SUITE.is_dir(), reason='no shared suites beside the repository')
def test_sections_of_a_real_machine_are_predicted_from_another_part(tmp_path):
    """OP3 by a machine file fitted to OP2; see benchmarks/run_times.py for all of them."""
    setup = tmp_path / 'setup.yaml'
    offsets = 'work_offsets: {G54: {X: 400, Y: 250, Z: -400}, G58: {X: 0, Y: 0, Z: 0}}\n'
    setup.write_text(offsets)
    settings, machine = Settings(setup=setup), Machine.load('vmc')

    def recorded_runs(name, numbers):
        for number in numbers:
            (trace,) = load_traces(SUITE / f'{name}_part{number}_blocks.csv', SUITE / f'{name}.nc')
            program = TimedProgram.load(SUITE / f'{name}.nc', machine, settings)
            yield TracedRun.of(program.overridden(measured_override(program, trace)), trace)

    found = TimeFit(machine, list(recorded_runs('OP2', ('11', '12'))), print).solve()
    for run in recorded_runs('OP3', ('06', '07')):
        planned = run.planned(run.program.motion(found.machine))
        for first, last in run.stretches():
            both = (planned[first : last + 1].sum(), run.measured[first : last + 1].sum())
            assert both[0] == pytest.approx(both[1], rel=0.05)
    rests = found.machine.standstill
    assert rests.tool_change == pytest.approx(6.0, abs=0.2)
