"""Batches: the same table whoever computes it, and no program ends it."""

import contextlib
import csv
import json
import os
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from multiprocessing.context import ForkServerProcess
from pathlib import Path

import numpy as np
import pytest
from worker_calls import half, lost_with_its_server, slow_to_die, stubborn

from cnc_interp.batch import processes
from cnc_interp.batch.batch_run import Store, run_batch
from cnc_interp.batch.processes import PROCESS_NAME, Loss, Processes
from cnc_interp.batch.task import Jobs, Row, Task, TaskOutcome, Verdict, programs_of
from cnc_interp.batch.task_work import carry_out, tiny_task
from cnc_interp.commands.cli import main
from cnc_interp.commands.parser import BAD_INPUT, FAILED, FINE
from cnc_interp.core import InterpError
from cnc_interp.settings.options import Settings

GIGA = 1e9
LINE = 'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A10 C0\nG1 F3000 X{}\nM30\n'


@pytest.fixture
def programs(tmp_path):
    folder = tmp_path / 'programs'
    (folder / 'deep').mkdir(parents=True)
    for k in range(2):
        (folder / f'line {k}.ngc').write_text(LINE.format(3 + k))
    (folder / 'deep' / 'zigzag.nc').write_text(
        LINE.format('1\n' + '\n'.join(f'X{k} Y{k % 2}' for k in range(30)))
    )
    (folder / 'deep' / 'wrong.nc').write_text('G21\nG1 X1 F100 Q7\n')
    (folder / 'notes.md').write_text('no program')
    return folder


def batch(programs, out, *more):
    return main(['batch', str(programs), '--out', str(out), *more])


def table(out):
    return list(csv.DictReader((out / 'table.csv').open()))


def test_the_table_has_every_program_and_is_the_same_in_spite_of_kills(programs, tmp_path, capsys):
    outs = [tmp_path / name for name in ('out', 'killed')]
    out, words = outs[0], ('--rate', '90', '--keep-plans')
    assert batch(programs, out, *words, '--workers', '2') == FAILED
    assert '4: 3 proven, 1 refused' in capsys.readouterr().out
    rows = {row['program']: row for row in table(out)}
    assert list(rows) == ['deep/wrong.nc', 'deep/zigzag.nc', *(f'line {k}.ngc' for k in range(2))]
    assert rows['deep/wrong.nc']['message'].startswith('deep/wrong.nc:2: Q7')
    page = (out / 'batch.html').read_text()
    for name, row in rows.items():
        assert name in page
        if row['verdict'] != 'proven':
            continue
        plan = out / 'plans' / 'xyzac' / name
        assert main(['check', str(plan)]) == FINE
        summary = json.loads((plan / 'summary.json').read_text())
        assert float(row['cycle_time_s']) == summary['cycle_time']
        assert float(row['cost']) == pytest.approx(summary['cycle_time'] / 40.0)
        assert int(row['setpoints']) == len(np.load(plan / 'setpoints.npz')['time'])
        assert float(row['jerk_use']) <= 1.0

    stop, killed = threading.Event(), []

    def kill():
        while len(killed) < 3 and not stop.wait(0.1):
            killed.extend(kill_one())

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        assert batch(programs, outs[1], *words, '--workers', '1') == FAILED
    finally:
        stop.set()
        killer.join()
    assert killed
    assert len({(out / 'table.csv').read_bytes() for out in outs}) == 1


@pytest.mark.thorough
def test_a_long_program_is_planned_by_all_workers_and_has_the_same_row(tmp_path):
    """Its stretches between exact stops go to processes of the process that has the program."""
    programs = tmp_path / 'programs'
    programs.mkdir()
    strokes = '\n'.join(f'X{k % 7} Y{k % 5} Z{k % 2}' for k in range(400))
    (programs / 'giant.ngc').write_text(LINE.format('1 G61\n' + strokes))
    outs = [tmp_path / name for name in ('one', 'two', 'killed')]
    assert batch(programs, outs[0], '--workers', '1') == FINE
    stop, seen = threading.Event(), []

    def look(kill):
        while not stop.wait(0.01):
            if kill and len(seen) > 1:
                return
            seen.extend(kill_one(generation=2, number=signal.SIGKILL if kill else 0))

    for out, kill in ((outs[1], False), (outs[2], True)):
        stop.clear()
        seen.clear()
        watcher = threading.Thread(target=look, args=(kill,))
        watcher.start()
        try:
            assert batch(programs, out, '--workers', '2') == FINE
        finally:
            stop.set()
            watcher.join()
        assert seen
    assert len({(out / 'table.csv').read_bytes() for out in outs}) == 1


def kill_one(generation=1, number=signal.SIGKILL):
    """Kill a working process, a child of our fork server or a child of such; return its id."""
    for process in (int(path.name) for path in Path('/proc').glob('[0-9]*')):
        try:
            name, parent = name_and_parent(process)
            for _ in range(generation):
                parent = name_and_parent(parent)[1]
            if name == PROCESS_NAME and parent == os.getpid():
                os.kill(process, number)
                return [process]
        except OSError:
            continue
    return []


def name_and_parent(process):
    name, _, rest = Path(f'/proc/{process}/stat').read_text().partition('(')[2].rpartition(')')
    return name, int(rest.split()[1])


def test_a_second_start_plans_only_what_has_changed(programs, tmp_path):
    jobs = partial(Jobs, [programs], ['xyzac'], Settings())
    store, told = Store(tmp_path / 'results', TaskOutcome.of_json), []
    workers = Processes(2, 4 * GIGA, 300.0)

    class Counting:
        def run(self, function, arguments):
            made = [make() for make in arguments]
            told.append(sorted(task.program for task in made))
            return workers.run(function, [partial(lambda task: task, task) for task in made])

    def start():
        done = run_batch(jobs(), Counting(), store, lambda _: None)
        return {job.program: outcome.row for job, outcome in done}

    first = start()
    assert len(told[-1]) == 4
    (programs / 'line 0.ngc').write_text(LINE.format(50))
    second = start()
    assert told[-1] == ['line 0.ngc']
    assert second['line 0.ngc'].cycle_time > first['line 0.ngc'].cycle_time
    assert {k: v for k, v in second.items() if k != 'line 0.ngc'} == {
        k: v for k, v in first.items() if k != 'line 0.ngc'
    }
    last = list(jobs())[-1]
    (tmp_path / 'results' / f'{jobs().task(last).key}.json').write_text('{"row": ')
    assert start() == second
    assert told[-1] == [last.program]


def test_a_changed_subprogram_or_machine_is_another_task(programs, tmp_path):
    main_program = programs / 'main.ngc'
    main_program.write_text('G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A10 C0 F3000\nM98 P12\nM30\n')
    (programs / 'O0012.ngc').write_text('O0012\nG1 X4\nM99\n')

    def task(machine='xyzac'):
        jobs = Jobs([main_program], [machine], Settings())
        return jobs.task(next(iter(jobs)))

    first = task()
    assert [name for name, _ in first.files] == ['main.ngc', 'O0012.ngc']
    row = carry_out(first).row
    assert row.verdict is Verdict.PROVEN and row.path_length == pytest.approx(4e-3, rel=0.01)
    (programs / 'O0012.ngc').write_text('O0012\nG1 X8\nM99\n')
    assert task().key != first.key
    assert carry_out(task()).row.path_length == pytest.approx(8e-3, rel=0.01)
    machine = tmp_path / 'own.yaml'
    text = (Path(__file__).parents[2] / 'config/machines/xyzac.yaml').read_text()
    machine.write_text(text)
    before = task(str(machine)).key
    machine.write_text(text.replace('name: xyzac', 'name: other', 1))
    assert len({before, task(str(machine)).key, task().key}) == 3


@pytest.mark.thorough
def test_what_a_worker_dies_of_is_told():
    calls = [partial(int, k) for k in range(6)]
    ended = {e.number: e for e in Processes(2, 4 * GIGA, 20.0).run(half, calls)}
    assert (ended[0].result, ended[5].result) == (0.0, 2.5)
    assert (ended[1].result, ended[1].why) == (Loss.CRASHED, 'SIGSEGV')
    assert (ended[2].result, ended[2].why) == (Loss.CRASHED, 'exit code 3')
    assert ended[3].result is Loss.TOO_LONG
    assert ended[4].result is Loss.KILLED and ended[4].kills > 3


@pytest.mark.thorough
def test_a_killed_call_is_begun_again_as_long_as_it_has_time(tmp_path, monkeypatch):
    (ended,) = Processes(1, 4 * GIGA, 60.0).run(stubborn, [partial(str, tmp_path / 'calls')])
    assert (ended.result, ended.kills) == (31, 30)
    # Attempts are counted, and their time is: two of a second and more leave nothing of two.
    monkeypatch.setattr(processes, 'MOST_KILLS', 5)
    (ended,) = Processes(1, 4 * GIGA, 60.0).run(half, [partial(int, 4)])
    assert (ended.result, ended.kills) == (Loss.KILLED, 5)
    (ended,) = Processes(1, 4 * GIGA, 2.0).run(slow_to_die, [partial(float, 1.0)])
    assert isinstance(ended.result, Loss) and ended.kills <= 2


def test_a_killed_fork_server_loses_no_call(tmp_path, monkeypatch):
    work = Processes(1, 4 * GIGA, 60.0, preloaded=())
    (ended,) = work.run(lost_with_its_server, [partial(str, tmp_path / 'calls')])
    assert ended.result == 3
    start, times = ForkServerProcess.start, iter(range(9))

    def killed_at_first(process):  # what multiprocessing raises where there is no answer
        if next(times) == 0:
            raise EOFError
        start(process)

    monkeypatch.setattr(ForkServerProcess, 'start', killed_at_first)
    (ended,) = work.run(lost_with_its_server, [partial(str, tmp_path / 'calls')])
    assert (ended.result, ended.kills) == (4, 1)


def test_faults_of_a_program_are_its_row(monkeypatch, programs):
    def crash(*_, **__):
        raise ZeroDivisionError('no')

    job = next(iter(Jobs([programs / 'line 0.ngc'], ['xyzac'], Settings())))
    monkeypatch.setattr('cnc_interp.batch.task_work.plan_to_files', crash)
    row = carry_out(tiny_task(job.model)).row
    assert row.verdict is Verdict.CRASHED
    assert row.message.startswith('ZeroDivisionError in test_batch.py:')


def test_a_worker_has_no_more_memory_than_it_may(programs):
    jobs = Jobs([programs / 'line 0.ngc'], ['xyzac'], Settings())
    task = partial(jobs.task, next(iter(jobs)))
    found = [e.result for e in Processes(1, 2 * GIGA, 300.0).run(eat, [task])]
    assert found[0].row.verdict is Verdict.TOO_LARGE


def eat(task: Task) -> TaskOutcome:
    """A task that asks for more memory than its worker has."""
    from cnc_interp.batch import task_work as work

    work.plan_to_files = greedy_plan
    return work.carry_out(task)


def greedy_plan(*_, **__):
    return np.ones(10**10)


@pytest.mark.thorough
def test_interrupted_and_started_again(programs, tmp_path):
    for k in range(40):
        (programs / f'more {k}.ngc').write_text(LINE.format(f'{k}\nY{k + 1}\nX0'))
    out = tmp_path / 'out'
    words = [sys.executable, '-m', 'cnc_interp', 'batch', str(programs), '--out', str(out)]
    script = (
        f'import signal, os; signal.signal(2, signal.default_int_handler); '
        f'os.execv({sys.executable!r}, {words!r})'
    )
    process = subprocess.Popen([sys.executable, '-c', script], stderr=subprocess.PIPE, text=True)
    results = out / 'results'
    while len(list(results.glob('[0-9a-f]*.json'))) < 3:
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate()
    assert process.returncode == 130 and 'interrupted' in said
    known = {path: path.stat().st_mtime_ns for path in results.glob('*.json')}
    assert 3 <= len(known) < 44
    assert batch(programs, out) == FAILED
    assert len(table(out)) == 44
    assert all(path.stat().st_mtime_ns == time_ns for path, time_ns in known.items())


@pytest.mark.thorough
def test_nothing_runs_any_more_once_the_command_has_ended(programs, tmp_path):
    mark = f'CNC_MARK={os.getpid()}'
    words = [sys.executable, '-m', 'cnc_interp', 'batch', str(programs), '--out']
    subprocess.run(
        [*words, str(tmp_path / 'out')],
        env=os.environ | dict([mark.split('=')]),
        check=False,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )

    def left():
        for environment in Path('/proc').glob('[0-9]*/environ'):
            with contextlib.suppress(OSError):  # it has just ended
                if mark.encode() in environment.read_bytes().split(b'\0'):
                    yield environment

    deadline = time.monotonic() + 60.0  # they are ending, and a busy computer lets them wait
    while found := list(left()):
        assert time.monotonic() < deadline, found
        time.sleep(0.05)


def test_names_and_bad_input(programs, tmp_path, capsys):
    named = programs_of([programs / 'deep', programs / 'notes.md', programs / 'deep' / 'wrong.nc'])
    assert [name for _, name in named] == ['deep/wrong.nc', 'deep/zigzag.nc', 'notes.md']
    (tmp_path / 'empty').mkdir()
    with pytest.raises(InterpError, match='no programs here'):
        Jobs([tmp_path / 'empty'], ['xyzac'], Settings())
    for words, text in (
        ([str(tmp_path / 'nowhere')], 'there is no such file or folder'),
        ([str(programs), '--machine', 'xyzzz'], "no machine 'xyzzz'"),
    ):
        assert main(['batch', *words, '--out', str(tmp_path / 'out')]) == BAD_INPUT
        assert text in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(['batch', str(programs), '--workers', '0', '--out', str(tmp_path / 'out')])
    assert '--workers: must be a whole number, 1 or more' in capsys.readouterr().err
    assert not (tmp_path / 'out').exists()


def test_outcomes_survive_their_text(tmp_path):
    one = TaskOutcome(Row(Verdict.PROVEN, cycle_time=1 / 3, notices=('a', 'b')))
    store = Store(tmp_path, TaskOutcome.of_json)
    store.keep('one', one)
    assert store.find('one') == one
    for text in ('{"row": {"verdict": "fine"}, "cost": {}}', '[]', '{'):
        (tmp_path / 'other.json').write_text(text)
        assert store.find('other') is None
