"""Planning with several processes: the same bits, the same refusals, and nothing stays behind."""

import itertools
import json
import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from feedrate_paths import XYZAC, polyline_path, random_polyline

from cnc_interp.core import InterpError, PlanningError
from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import PlannedPiece, plan_path
from cnc_interp.kinematics.axis_path import AxisPath, cut
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import open_program
from cnc_interp.run import parallel_planner
from cnc_interp.run.parallel_planner import (
    LostProcessError,
    ParallelPlanner,
    PlannerProcess,
    Planning,
    RestSections,
)
from cnc_interp.run.planning_chain import plan_to_files
from cnc_interp.settings.options import Settings

MACHINE = Machine.load('xyzac')
FILES = ('blocks.npz', 'segments.npz', 'path.npz', 'setpoints.npz')


@pytest.fixture(autouse=True)
def small_sections(monkeypatch):
    monkeypatch.setattr(parallel_planner, 'ENOUGH', 40)


def path_with_rests(corners=24, every=3):
    points = random_polyline(np.random.default_rng(7), corners, longest=0.02)
    return polyline_path(points, stops=tuple(range(every, corners, every)))


def parts_of(path, step):
    borders = [*range(0, len(path.s) - 1, step), len(path.s) - 1]
    return [cut(path, a, b) for a, b in itertools.pairwise(borders)]


def planned(planning, parts, processes):
    """Plan with processes; return the motion and how many of them had a section."""
    planner = ParallelPlanner(planning, processes)
    try:
        pieces = [piece for part in parts for piece in planner.push(part)]
        pieces += planner.finish()
        return PlannedPiece.join(pieces), len(planner._processes)
    finally:
        planner.close()


def assert_same(one, two):
    for part in ('law', 'path'):
        for name, value in vars(getattr(one, part)).items():
            np.testing.assert_array_equal(value, getattr(getattr(two, part), name), name)
            assert not value.flags.writeable
    assert one.least_time == two.least_time


@pytest.mark.parametrize('every', [3, 100])
def test_the_same_bits_with_processes(every):
    path, options = path_with_rests(every=every), PlanOptions()
    assert path.stop[1:-1].any() == (every == 3)
    whole = plan_path(path, XYZAC, options)
    for step, processes in ((11, 2), (57, 3)):
        piece, used = planned(Planning(XYZAC, options), parts_of(path, step), processes)
        assert used == processes
        assert_same(piece, whole)


def test_stretches_between_rests_go_to_different_processes(monkeypatch):
    given = []
    give = PlannerProcess.give

    def noted(self, section):
        given.append((id(self), section))
        give(self, section)

    monkeypatch.setattr(PlannerProcess, 'give', noted)
    planned(Planning(XYZAC, PlanOptions()), [path_with_rests()], 2)
    assert len({process for process, _ in given}) == 2
    assert all(section.rests and section.path.stop[-1] for _, section in given)


@pytest.mark.parametrize('step', [1, 7, 1000])
def test_sections_are_the_path(step):
    path, cutter = path_with_rests(), RestSections()
    sections = [s for part in parts_of(path, step) for s in cutter.push(part)]
    sections += cutter.finish()
    assert len(sections) > 3
    joined = AxisPath.join([section.path for section in sections])
    for name, value in vars(path).items():
        np.testing.assert_array_equal(value, getattr(joined, name), name)
    for before, after in itertools.pairwise(sections):
        stops = before.path.stop[-1] or after.path.stop[0]
        assert stops if before.rests else before.path.s[-1] == after.path.s[0]
    assert list(cutter.finish()) == []


def test_a_path_that_cannot_be_planned_is_refused_alike():
    path = path_with_rests()
    left = path.cell_left.copy()
    left[1, 150] = np.nan
    bad = replace(path, cell_left=left)
    messages = []
    with pytest.raises(PlanningError) as problem:
        plan_path(bad, XYZAC)
    messages.append(str(problem.value))
    for step in (11, 1000):
        with pytest.raises(PlanningError) as problem:
            planned(Planning(XYZAC, PlanOptions()), parts_of(bad, step), 2)
        messages.append(str(problem.value))
    assert len(set(messages)) == 1


def test_refuse_raises_what_the_path_so_far_deserves():
    path = path_with_rests()
    left = path.cell_left.copy()
    left[1, -3] = np.nan
    for one, refused in ((path, False), (replace(path, cell_left=left), True)):
        planner = ParallelPlanner(Planning(XYZAC, PlanOptions()), 2)
        try:
            for part in parts_of(one, 30):
                planner.push(part)
            if refused:
                with pytest.raises(PlanningError, match='no finite path'):
                    planner.refuse()
            else:
                planner.refuse()
        finally:
            planner.close()


def strokes(number, end='M30'):
    lines = ['G21 G90 G94 G61 F3000', 'G0 X0 Y0 Z5']
    lines += [f'G1 X{k % 7} Y{k % 5} Z{k % 2}' for k in range(number)]
    return '\n'.join([*lines, end, ''])


def planned_files(file, folder, processes, settings):
    stream = open_program(file, Transform.of(MACHINE), settings)
    return plan_to_files(stream, MACHINE, folder, settings, processes=processes)


def test_plan_files_are_the_same_with_processes(tmp_path):
    file = tmp_path / 'strokes.ngc'
    file.write_text(strokes(60))
    sums = [planned_files(file, tmp_path / f'{n}', n, Settings()) for n in (1, 2)]
    for name in FILES:
        one, two = ((tmp_path / f'{n}' / name).read_bytes() for n in (1, 2))
        assert one == two, name
    one, two = ({k: v for k, v in s.items() if not k.startswith('planning_time')} for s in sums)
    assert one == two


def test_a_limit_of_the_error_at_the_tool_outlasts_rests(tmp_path):
    """The drives swing on while the setpoints rest, so the next stretch depends on the last."""
    file = tmp_path / 'strokes.ngc'
    file.write_text(strokes(20))
    settings = Settings(tool_error=3e-5)
    for n in (1, 2):
        planned_files(file, tmp_path / f'{n}', n, settings)
    for name in FILES:
        one, two = ((tmp_path / f'{n}' / name).read_bytes() for n in (1, 2))
        assert one == two, name


def test_the_first_refusal_of_the_program_is_told(tmp_path, monkeypatch):
    """Reading is ahead of planning; what planning refuses may stand before it."""
    file = tmp_path / 'strokes.ngc'
    file.write_text(strokes(900, 'G1 X1 Q7'))
    push = ParallelPlanner.push
    seen = []

    def spoilt(self, path):
        if not seen:
            left = path.cell_left.copy()
            left[1, -5] = np.nan
            path = replace(path, cell_left=left)
        seen.append(path)
        return push(self, path)

    monkeypatch.setattr(parallel_planner, 'ENOUGH', 10**9)  # nothing is planned before it is asked
    monkeypatch.setattr(ParallelPlanner, 'push', spoilt)
    with pytest.raises(PlanningError, match='no finite path'):
        planned_files(file, tmp_path / 'out', 2, Settings())
    monkeypatch.undo()
    with pytest.raises(InterpError, match='Q7'):
        planned_files(file, tmp_path / 'out', 2, Settings())


def test_a_killed_process_is_told_and_none_stays_behind():
    planner = ParallelPlanner(Planning(XYZAC, PlanOptions()), 2)
    parts = parts_of(path_with_rests(), 11)
    try:
        planner.push(parts[0])
        for part in parts[1:9]:
            planner.push(part)
        children = [one._process for one in planner._processes]
        assert len(children) == 2
        for child in children:
            os.kill(child.pid, signal.SIGKILL)
        with pytest.raises(LostProcessError, match='killed; start again'):
            planner.finish()
    finally:
        planner.close()
    assert all(child.exitcode is not None for child in children)
    assert not any(Path(f'/proc/{child.pid}').exists() for child in children)


def test_processes_end_with_the_one_that_started_them(tmp_path):
    """It may be killed: nobody tells them then."""
    reading, writing = os.pipe()
    parent = os.fork()
    if not parent:
        planner = ParallelPlanner(Planning(XYZAC, PlanOptions()), 2)
        planner.push(path_with_rests())
        pids = [one._process.pid for one in planner._processes]
        os.write(writing, json.dumps(pids).encode())
        os.kill(os.getpid(), signal.SIGKILL)
    os.close(writing)
    pids = json.loads(os.read(reading, 1000))
    os.close(reading)
    os.waitpid(parent, 0)
    assert len(pids) == 2
    for pid in pids:
        state = Path(f'/proc/{pid}/stat')
        while state.exists() and state.read_text().rpartition(')')[2].split()[0] not in 'ZX':
            pass
