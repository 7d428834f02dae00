"""A limit on the error at the tool: rows, windows, revisions, command line and proof."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import whole_plans

from cnc_interp.commands.cli import main
from cnc_interp.core import MM, UM
from cnc_interp.drives.tool_error import error_series, path_and_axis_errors, tool_error
from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import FeedPlanner, PlannedPiece, plan_path
from cnc_interp.feedrate.tool_limit import FIRST_PART, RELAXED, ToolLimit
from cnc_interp.kinematics.axis_path import AxisPath, cut, evaluate
from cnc_interp.machine.simulated_drives import simulate
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_program, read_text
from cnc_interp.proof.verify import verify_plan
from cnc_interp.run.motion_plan import MotionStream
from cnc_interp.run.overrides import OperatorSettings
from cnc_interp.run.path_chain import segments_of
from cnc_interp.run.run_planner import RunPlanner
from cnc_interp.run.setpoints import Interpolator, Setpoints, Wait
from cnc_interp.settings.options import Settings

S_PATH = Path(__file__).parents[2] / 'examples' / 's_path.apt'
TIRED, IDEAL = Machine.load('xyzac_tired'), Machine.load('xyzac')
T, HEIGHT = 1e-3, 30 * MM


def wrong(machine: Machine) -> Machine:
    """A model whose gains and lags are off, up and down from axis to axis."""
    drives = {
        j: replace(
            drive,
            position_gain=drive.position_gain * (1.2 if j % 2 else 0.8),
            time_constant=drive.time_constant * (0.8 if j % 2 else 1.2),
            delay=drive.delay * (1.2 if j % 2 else 0.8),
        )
        for j, drive in machine.drives.items()
    }
    return replace(machine, drives=drives)


def frictionless(machine: Machine) -> Machine:
    """The same loops, delays and modes, without friction, backlash and steps of encoders."""
    linear = {'static': 0.0, 'stribeck_velocity': 0.0, 'backlash': 0.0, 'resolution': 0.0}
    drives = {j: replace(drive, **linear) for j, drive in machine.drives.items()}
    loads = {j: replace(load, coulomb=0.0) for j, load in machine.limits.loads.items()}
    return replace(machine, drives=drives).having(load=loads)


@pytest.mark.parametrize('compensated', [False, True])
def test_the_series_are_the_errors_of_slow_motion(compensated):
    machine = frictionless(TIRED)
    model = wrong(machine) if compensated else None
    time = np.arange(0.0, 8.0, T)
    omega, size = 2 * np.pi * 0.5, np.array([0.05, 0.04, 0.03, 0.2, 0.4])
    q = np.outer(1.0 - np.cos(omega * time), size)
    velocity, acceleration = np.gradient(q, T, axis=0), np.outer(np.cos(omega * time), size)
    acceleration *= omega**2
    x = simulate(machine, T, q, velocity, model).position
    series = error_series(machine, model)
    steady = slice(4000, 7500)
    wanted = series.by_velocity * velocity + series.by_acceleration * acceleration
    # Of all axes, one common lag is left over: the one that fits all of them best.
    left = x[steady] - q[steady] - wanted[steady]
    lag = -(left[:, 0] @ velocity[steady, 0]) / (velocity[steady, 0] @ velocity[steady, 0])
    late = np.stack([np.interp(time[steady] - lag, time, column) for column in q.T], axis=1)
    off = np.abs(x[steady] - late - wanted[steady]).max(axis=0)
    assert np.all(off < 0.08 * np.abs(wanted[steady]).max(axis=0) + 2e-4 * size)
    assert np.abs(wanted).max() > 5 * UM


@pytest.mark.parametrize('compensated', [False, True])
def test_friction_and_backlash_stay_away_in_steady_motion(compensated):
    time = np.arange(0.0, 3.0, T)
    drives = {j: replace(drive, resolution=0.0) for j, drive in TIRED.drives.items()}
    machine = replace(TIRED, drives=drives)
    q = np.outer(0.5 * time**2 / 3.0, [0.1, 0.08, 0.06, 0.3, 0.6])
    rate = np.gradient(q, T, axis=0)
    model = wrong(machine) if compensated else None
    free = simulate(frictionless(machine), T, q, rate, frictionless(model) if model else None)
    off = free.position - simulate(machine, T, q, rate, model).position
    assert off[-1] == pytest.approx(error_series(machine, model).away, rel=0.03)


def test_true_models_leave_nothing():
    series = error_series(TIRED, TIRED)
    for part in (series.by_velocity, series.by_acceleration, series.away):
        assert np.abs(part).max() < 1e-12


def s_path() -> AxisPath:
    """The S-shaped example on the tired machine."""
    transform = Transform.of(TIRED)
    program = read_program(S_PATH, transform, Settings())
    return whole_plans.path_of(program.blocks, transform, Settings())


def circle(radius: float, turns: float, feed: float, cells: int = 120) -> AxisPath:
    """X and Y on a circle with exact derivatives."""
    s = np.linspace(0.0, turns * 2 * np.pi * radius, cells + 1)
    ends = np.zeros((4, cells + 1, 5))
    for order in range(4):
        turned = s / radius + order * np.pi / 2
        ends[order, :, 0] = radius * np.cos(turned) / radius**order
        ends[order, :, 1] = radius * np.sin(turned) / radius**order
    stop = np.zeros(cells + 1, dtype=bool)
    stop[[0, -1]] = True
    return AxisPath(
        s,
        ends[:, :-1].copy(),
        ends[:, 1:].copy(),
        ends[0, :, :3].copy(),
        np.tile([0.0, 0.0, 1.0], (cells + 1, 1)),
        np.full(cells, feed),
        np.zeros(cells, dtype=np.int64),
        stop,
    )


def waving(length: float, cells: int) -> AxisPath:
    """All axes in waves along the path, of which s is not the length of the tip."""
    s = np.linspace(0.0, length, cells + 1)
    ends = np.zeros((4, cells + 1, 5))
    for order in range(4):
        for k, (size, wave) in enumerate(
            [(0.05, 12.0), (0.04, 15.0), (0.03, 9.0), (0.2, 11.0), (0.5, 8.0)]
        ):
            ends[order, :, k] = size * wave**order * np.sin(wave * s + k + order * np.pi / 2)
    ends[0, :, 3] += 0.6
    stop = np.zeros(cells + 1, dtype=bool)
    stop[[0, -1]] = True
    tip, axis = Transform.of(IDEAL).forward(ends[0])
    return AxisPath(
        s,
        ends[:, :-1].copy(),
        ends[:, 1:].copy(),
        tip,
        axis,
        np.full(cells, 0.05),
        np.zeros(cells, dtype=np.int64),
        stop,
    )


def test_the_rows_are_the_errors_of_slow_motion_at_the_tool():
    machine, path, speed = frictionless(TIRED), waving(0.6, 1200), 0.06
    tool = ToolLimit.of(machine, T, 1.0, HEIGHT)
    rows = tool.rows(path.cell_left, path.cell_right)
    predicted = np.abs(rows[:, 1] * speed**2 + rows[:, 2] * speed).reshape(2, 4, -1).max(axis=1)
    time = np.arange(0.0, 0.6 / speed, T)
    q, q_s, _, _ = evaluate(path, time * speed)
    found = tool_error(machine, T, q, q_s * speed)
    steady = np.arange(1500, 8500, 50)
    # On real paths s is the length of the tip, or the tip stands.
    moves = np.linalg.norm(np.gradient(path.tip, path.s, axis=0), axis=1) > 0.6
    steady = steady[moves[np.searchsorted(path.s, time[steady] * speed)]]
    assert len(steady) > 100
    at = np.searchsorted(path.s, time[steady] * speed)
    for row, error in zip(predicted, (found.tip, found.axis * HEIGHT), strict=True):
        # Four normals see at least cos(22.5 deg) of an error.
        shown = error[steady + round(tool.series.lag / T)]
        assert row[at] == pytest.approx(shown, rel=0.1, abs=0.06 * shown.max())
        assert shown.max() > 5 * UM


def sampled(pieces: list[PlannedPiece]) -> Setpoints:
    """Sample planned pieces."""
    interpolator = Interpolator(T)
    return Setpoints.concatenate(
        [*(interpolator.push(piece) for piece in pieces), interpolator.finish()]
    )


def error_of(found: Setpoints, machine: Machine, model: Machine | None = None) -> float:
    """Largest error of tip, and of the axis at flank height [m]."""
    error = tool_error(machine, T, found.position, found.velocity, model)
    return max(float(error.tip.max()), float(error.axis.max()) * HEIGHT)


def test_the_speed_on_a_circle_is_that_of_the_closed_form():
    # Equal loops cut a circle: x + (1 + tau kv) ... gives c2 = -tau / kv, so E = c2 v^2 / r.
    radius, largest = 20 * MM, 2 * UM
    tool = ToolLimit.of(IDEAL, T, largest, HEIGHT)
    piece = plan_path(circle(radius, 2.0, 0.5), IDEAL, tool=tool)
    speed = np.sqrt(largest * radius / 2e-5)
    assert np.median(piece.law.s_dot) == pytest.approx(speed, rel=0.05)
    assert 0.9 * largest < error_of(sampled([piece]), IDEAL) <= largest


@pytest.mark.parametrize(('model', 'largest'), [(None, 130 * UM), (wrong(TIRED), 40 * UM)])
def test_the_error_is_held_and_used_in_windows(model, largest):
    path = s_path()
    plain = error_of(sampled([plan_path(path, TIRED)]), TIRED, model)
    tool = ToolLimit.of(TIRED, T, largest, HEIGHT, model)
    found = []
    for size in (60, len(path.s)):
        planner = FeedPlanner(TIRED, PlanOptions(bound=False), tool=tool)
        pieces = []
        for first in range(0, len(path.s) - 1, size):
            pieces += planner.push(cut(path, first, min(first + size, len(path.s) - 1)))
        pieces += planner.finish()
        found.append(sampled(pieces))
    assert len(pieces) > 1
    assert found[0].position.tobytes() == found[1].position.tobytes()
    assert plain > 1.2 * largest
    assert 0.8 * largest < error_of(found[0], TIRED, model) <= 1.001 * largest


def test_windows_that_follow_keep_the_parts_of_the_limit(monkeypatch):
    """What corrections have lowered once is where the cells of the next window begin."""
    begun, stretch_rows = [], ToolLimit.stretch_rows

    def watched(self, left, right, kept):
        rows = stretch_rows(self, left, right, kept)
        if kept is not None:
            begun.append((kept, rows.part[:, : kept.shape[1]].copy()))
        return rows

    monkeypatch.setattr(ToolLimit, 'stretch_rows', watched)
    plan_path(s_path(), TIRED, tool=ToolLimit.of(TIRED, T, 150 * UM, HEIGHT))
    assert any((kept < FIRST_PART).any() for kept, _ in begun)
    for kept, part in begun:
        assert (part == np.minimum(kept + RELAXED, 1.0)).all()


@pytest.mark.thorough
def test_revisions_in_motion_hold_it():
    tool = ToolLimit.of(TIRED, T, 150 * UM, HEIGHT)
    path = s_path()
    stream = MotionStream(TIRED, T, tool=tool)
    stream.push(path)
    stream.end_leg(Wait.END)
    sent, revised, wanted = [], 0, [(100, 0.7), (200, 1.0), (300, 0.5), (400, 1.2)]
    while not sent or sent[-1].wait is not Wait.END:
        if wanted and len(sent) >= wanted[0][0]:  # chunks may come several at a time
            override = wanted.pop(0)[1]
            count = sum(len(chunk.samples) for chunk in sent)
            revision = stream.revision(count - 1, OperatorSettings(override))
            if revision is not None:
                stream.adopt(revision)
                revised += 1
        while not stream.current.can_sample and stream.current.can_plan:
            stream.current.plan()
        sent += stream.current.sample() if stream.current.can_sample else []
    assert revised == 4
    run = Setpoints.concatenate([chunk.samples for chunk in sent])
    # The drives at a revision are taken as in steady motion, so a little more is possible.
    assert error_of(run, TIRED) <= 1.15 * 150 * UM


def test_the_way_to_the_path_is_as_fast_as_without_a_limit():
    transform = Transform.of(TIRED)
    program = read_text('G21 G90\nG1 X0 Y0 F600\nX9\nM30\n', 'way.ngc', transform, Settings())
    whole = segments_of(program.blocks, transform, Settings())
    ways = []
    for error in (None, 1 * UM):
        wanted = Settings(flank_height=HEIGHT, interpolation_period=T, tool_error=error)
        stands = np.array([0.05, -0.03, 0.04, 0.2, 0.0])
        planner = RunPlanner(transform, wanted, 0.01, stands)
        planner.push(whole, {})
        planner.finish()
        chunks = []
        while not (chunks and (chunks[-1].samples.velocity[-1] == 0.0).all()):
            chunks += planner.work(planner.stream.current, True, 0.0)
        ways.append(Setpoints.concatenate([chunk.samples for chunk in chunks]))
    assert not ways[0].block.any() and (ways[0].position == ways[1].position).all()


def test_a_turn_in_place_is_compared_with_the_turn_not_with_the_way_before():
    turn = np.linspace(0.0, 0.3, 30)
    tips, axes = np.zeros((50, 3)), np.tile([0.0, 0.0, 1.0], (50, 1))
    tips[:20, 2] = np.linspace(0.02, 0.0, 20)
    axes[20:, 1], axes[20:, 2] = np.sin(turn), np.cos(turn)
    executed = np.array([[0.0, 30 * UM, 30 * UM]])  # backlash; the way down is nearer to this tip
    ((tip, axis),) = path_and_axis_errors(tips, axes, executed, axes[40:41], 49)
    assert tip == pytest.approx(30 * UM) and axis < 1e-4


def test_a_limit_below_friction_is_told_before_the_motion():
    assert ToolLimit.of(TIRED, T, 100 * UM, HEIGHT).warnings == []
    assert ToolLimit.of(TIRED, T, 20 * UM, HEIGHT, TIRED).warnings == []
    (told,) = ToolLimit.of(TIRED, T, 20 * UM, HEIGHT).warnings
    assert 'cause up to 0.048 mm at any speed, more than --tool-error 0.02 mm' in told


def test_command_line_and_proof(tmp_path, capsys):
    out = tmp_path / 'plan'
    words = ['plan', str(S_PATH), '--machine', 'xyzac_tired', '--out', str(out)]
    assert main([*words, '--tool-error', '0.15']) == 0
    assert 'tool error     tip 0.1' in capsys.readouterr().out
    summary = json.loads((out / 'summary.json').read_text())
    error = summary['tool_error']
    rows = np.load(out / 'setpoints.npz')
    seen = tool_error(TIRED, T, rows['position'], rows['velocity'])
    assert error['limit'] == pytest.approx(150 * UM)
    assert error['tip'] == pytest.approx(seen.tip.max(), rel=1e-6)
    assert error['axis'] == pytest.approx(seen.axis.max() * HEIGHT, rel=1e-6)
    assert main(['check', str(out)]) == 0
    assert 'error at the tool by the drives of xyzac_tired: tip 0.1' in capsys.readouterr().out
    # A plan that says it holds a smaller one is found out.
    summary['settings']['tool_error'] = 100 * UM
    (out / 'summary.json').write_text(json.dumps(summary))
    assert main(['check', str(out)]) == 1
    assert 'exceeded' in capsys.readouterr().out
    assert not verify_plan(out, TIRED).ok, 'the one verdict, also of a batch'
    assert main(['report', str(out)]) == 0
    assert '<span class="badge no">' in (out / 'report.html').read_text()


@pytest.mark.parametrize(
    ('words', 'said'),
    [
        (['--compensate', 'nowhere'], 'no machine'),
        (['--compensate', 'xyz'], 'other axes'),
        (['--tool-error', '-1'], 'not between'),
    ],
)
def test_what_cannot_be_planned_is_refused(words, said, tmp_path, capsys):
    words = ['plan', str(S_PATH), '--out', str(tmp_path / 'x'), '--tool-error', '0.1', *words]
    with pytest.raises(SystemExit) if '-1' in words else pytest.MonkeyPatch.context():
        assert main([*words, '--machine', 'xyzac_tired']) == 2
    assert said in capsys.readouterr().err
