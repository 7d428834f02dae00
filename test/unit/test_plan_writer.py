"""Plan files written while a program is read: the same as from a plan kept whole; flat memory."""

import json
import shutil
import tracemalloc
from dataclasses import fields, replace

import numpy as np
import pytest
from whole_plans import plan_program, write_plan

from cnc_interp.core import MS, InterpError
from cnc_interp.feedrate.limit_use import feed_limit
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import open_program
from cnc_interp.program.blocks.functions import Functions
from cnc_interp.program.blocks.start_line import StartLine
from cnc_interp.proof.verify import verify_plan
from cnc_interp.run import path_chain
from cnc_interp.run.plan_writer import PlanWriter
from cnc_interp.run.planning_chain import plan_to_files
from cnc_interp.run.setpoints import Interpolator, Setpoints
from cnc_interp.settings.options import Settings

MACHINE = Machine.load('xyzac')
GEOMETRY = Transform.of(MACHINE)


def zigzag(rows):
    """A program of 5 mm blocks with tilting tool, arcs and stops."""
    lines = ['G21 G90 G94 M428', 'G0 X0 Y0 Z0 A10 C0', 'F6000']
    for row in range(rows):
        x = 25 * (row % 2)
        lines += [
            f'G1 X{x + 5 * (1 - 2 * (row % 2)) * k} Y{row % 9} A{10 + k % 3}' for k in range(1, 6)
        ]
        lines.append('G9 G2 I2 J0' if row % 10 == 9 else 'G93 G1 Z1 F120\nG94 F6000 Z0')
    return '\n'.join(lines)


@pytest.fixture
def program(tmp_path):
    path = tmp_path / 'zigzag.ngc'
    path.write_text(zigzag(12))
    return path


def opened(path):
    return open_program(path, GEOMETRY, Settings())


class AtOnce:
    """A stream that hands out a whole program: its batches are those of ``plan_program``."""

    def __init__(self, program):
        self.source, self.share, self.blocks = program.source, 1.0, program.blocks
        self.start, self.setup = StartLine(0, 0, program.source), ''
        self.functions, self.waits_first = Functions.none(), False

    def __iter__(self):
        yield self.blocks

    def note(self, notice):
        assert notice is None


def test_streamed_files_are_those_of_the_whole_plan(program, tmp_path):
    options = Settings(interpolation_period=4.0 * MS)
    read = opened(program).read()
    streamed = plan_to_files(AtOnce(read), MACHINE, tmp_path / 'a', options)
    plan = plan_program(read, MACHINE, options)
    write_plan(plan, tmp_path / 'b')
    for name in ('blocks', 'segments', 'path', 'setpoints'):
        with (
            np.load(tmp_path / 'a' / f'{name}.npz') as a,
            np.load(tmp_path / 'b' / f'{name}.npz') as b,
        ):
            assert a.files == b.files
            for column in a.files:
                assert a[column].dtype == b[column].dtype
                np.testing.assert_array_equal(a[column], b[column], err_msg=f'{name} {column}')
    written = json.loads((tmp_path / 'b' / 'summary.json').read_text())
    times = ('planning_time', 'planning_time_by_room')
    assert {k: v for k, v in written.items() if k not in times} == {
        k: v for k, v in streamed.items() if k not in times
    }
    assert sorted(file.name for file in (tmp_path / 'a').iterdir()) == [
        'blocks.npz',
        'path.npz',
        'segments.npz',
        'setpoints.npz',
        'summary.json',
    ]


def test_a_program_planned_while_it_is_read_is_proven(program, tmp_path):
    shares = []
    plan_to_files(opened(program), MACHINE, tmp_path, progress=shares.append)
    assert shares == sorted(shares) and 0.0 <= shares[-1] <= 1.0
    assert verify_plan(tmp_path, MACHINE).ok
    whole = plan_program(opened(program).read(), MACHINE)
    with np.load(tmp_path / 'setpoints.npz') as samples:
        assert abs(len(samples['time']) - len(whole.setpoints)) <= 1


@pytest.mark.thorough
def test_progress_counts_what_is_planned_not_what_is_read(tmp_path, monkeypatch):
    """The reader is done at once, and the path of many blocks waits for its windows."""
    path = tmp_path / 'long.ngc'
    path.write_text(zigzag(100))
    read = opened(path).read()
    planned, told = [0], []

    def piece(writer, piece):
        planned[0] = int(piece.path.cell_block[-1])
        kept(writer, piece)

    kept = PlanWriter.piece
    monkeypatch.setattr(PlanWriter, 'piece', piece)
    monkeypatch.setattr(path_chain, 'BATCH', 200)
    plan_to_files(
        AtOnce(read), MACHINE, tmp_path / 'out', progress=lambda x: told.append((x, planned[0]))
    )
    assert len(told) > 5 and told[-1][0] > 0.6
    for share, row in told:
        assert share == pytest.approx(row / len(read.blocks), abs=1e-9)


def test_written_path_and_figures_are_those_of_the_joined_pieces(program, tmp_path):
    plan = plan_program(opened(program).read(), MACHINE)
    assert len(plan.pieces) > 1
    write_plan(plan, tmp_path / 'out')
    joined = AxisPath.join([piece.path for piece in plan.pieces])
    with np.load(tmp_path / 'out' / 'path.npz') as path:
        for name in ('s', 'cell_left', 'cell_right', 'stop', 'q'):
            np.testing.assert_array_equal(path[name], getattr(joined, name))
        np.testing.assert_array_equal(path['block'][:-1], joined.cell_block)
        left = np.r_[joined.cell_feed[:1], joined.cell_feed]
        assert (path['programmed_feed'] <= left).all()
        speeds = np.concatenate([piece.law.s_dot for piece in plan.pieces])
        np.testing.assert_array_equal(path['feed'], np.r_[speeds, 0.0])
        # At every grid point the slower of both neighbours counts, across pieces too.
        np.testing.assert_array_equal(path['feed_limit'], feed_limit(joined, MACHINE.limits))
        right = np.r_[joined.cell_feed, joined.cell_feed[-1:]]
        np.testing.assert_array_equal(path['programmed_feed'], np.minimum(left, right))
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    position, period = plan.setpoints.position, summary['interpolation_period']
    still = [np.repeat(position[[k]], 3, axis=0) for k in (0, -1)]
    jerk = np.diff(np.concatenate([still[0], position, still[1]]), 3, axis=0) / period**3
    expected = np.abs(jerk).max(axis=0) / MACHINE.max_jerk
    np.testing.assert_allclose(list(summary['largest_use']['jerk'].values()), expected, rtol=1e-9)


def test_cycle_time_of_an_executed_motion_that_was_slower_than_its_plan(program, tmp_path):
    plan = plan_program(opened(program).read(), MACHINE)
    slower = tmp_path / 'slower.ngc'
    slower.write_text(program.read_text().replace('F6000', 'F600'))
    executed = plan_program(opened(slower).read(), MACHINE).setpoints
    assert len(executed) > len(plan.setpoints) + 100
    write_plan(replace(plan, setpoints=executed), tmp_path / 'out')
    summary = json.loads((tmp_path / 'out' / 'summary.json').read_text())
    assert summary['cycle_time'] == pytest.approx((len(executed) - 1) * MS)
    proof = verify_plan(tmp_path / 'out', MACHINE)
    # The path has the feeds of the plan. All else is proven.
    assert len(proof.failures) == 1 and 'feed of path against the setpoints' in proof.failures[0]


def test_a_slow_motion_is_sampled_in_parts(program):
    plan = plan_program(opened(program).read(), MACHINE)
    whole, parts = Interpolator(MS), Interpolator(MS)
    for piece in plan.pieces:
        wanted, found = whole.push(piece), list(parts.parts(piece, 100))
        assert max(map(len, found)) <= 100 and len(found) >= len(wanted) // 100
        joined = Setpoints.concatenate(found)
        for column in fields(Setpoints):
            np.testing.assert_array_equal(
                getattr(joined, column.name), getattr(wanted, column.name)
            )


def test_a_motion_that_does_not_fit_on_the_disk_is_refused(program, tmp_path, monkeypatch):
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, 'disk_usage', lambda _: usage._replace(free=10_000))
    with pytest.raises(InterpError, match=r'its setpoints need .* GB in .*; use a higher feed'):
        plan_to_files(opened(program), MACHINE, tmp_path / 'new')
    assert not (tmp_path / 'new').exists()


def test_a_refusal_leaves_what_was_there(program, tmp_path):
    bad = tmp_path / 'bad.ngc'
    bad.write_text(program.read_text() + '\nG1 X90000\n')
    with pytest.raises(InterpError, match=r'bad\.ngc:\d+: '):
        plan_to_files(opened(bad), MACHINE, tmp_path / 'new')
    assert not (tmp_path / 'new').exists()
    plan_to_files(opened(program), MACHINE, tmp_path / 'old')
    before = (tmp_path / 'old' / 'setpoints.npz').read_bytes()
    with pytest.raises(InterpError):
        plan_to_files(opened(bad), MACHINE, tmp_path / 'old')
    assert (tmp_path / 'old' / 'setpoints.npz').read_bytes() == before
    assert len(list((tmp_path / 'old').iterdir())) == 5


@pytest.mark.thorough
def test_memory_does_not_grow_with_the_program(tmp_path, monkeypatch):
    monkeypatch.setattr(path_chain, 'BATCH', 16)
    peaks = []
    for rows in (10, 10, 60):
        path = tmp_path / 'long.ngc'
        path.write_text(zigzag(rows))
        tracemalloc.start()
        summary = plan_to_files(opened(path), MACHINE, tmp_path / 'out')
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # The setpoints alone: position and three derivatives of five axes, time, block and s.
    kept = summary['samples'] * (4 * 5 + 3) * 8
    assert peaks[2] - peaks[1] < 0.3 * kept
