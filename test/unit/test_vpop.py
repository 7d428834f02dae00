"""VPOp, the law by steps forward: within all limits, offline only. It compiles long: by turns."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from cnc_interp_msgs.action import RunProgram
from diagnostic_msgs.msg import KeyValue
from feedrate_paths import XYZAC, line_path, polyline_path, random_polyline, sampled_ratios

from cnc_interp.commands.cli import main
from cnc_interp.commands.parser import FINE
from cnc_interp.core import SettingsError
from cnc_interp.feedrate import vpop
from cnc_interp.feedrate.plan_options import PlanOptions
from cnc_interp.feedrate.planning_windows import DIVIDED, PlannedPiece, plan_path
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.settings.options import Settings
from cnc_interp.wire.run_messages import settings_of_goal

PYRAMID = str(Path(__file__).parents[2] / 'examples' / 'pyramid.apt')
VPOP = PlanOptions(law='vpop')


def assert_sound(piece: PlannedPiece, path: AxisPath) -> None:
    """By differences within all limits, to the end of the path, at rest there."""
    assert sampled_ratios(piece.path, piece.law, XYZAC).max() <= 1.001
    s, s_dot, _, _ = piece.law.evaluate(np.array([np.inf]))
    assert abs(s[0] - path.s[-1]) < 1e-12 and s_dot[0] < 1e-12
    assert len(piece.law) == len(piece.path.s) - 1, 'plan files have one row for each cell'
    assert np.array_equal(piece.law.s, piece.path.s[:-1])
    assert piece.least_time <= piece.law.end_time


@pytest.mark.thorough
@pytest.mark.parametrize('length', [1e-6, 1e-4, 0.01, 0.3])
@pytest.mark.parametrize('feed', [0.05, np.inf])
def test_strokes_take_little_more_than_the_least_time(length, feed):
    ruckig = pytest.importorskip('ruckig')
    inp, out = ruckig.InputParameter(1), ruckig.Trajectory(1)
    inp.target_position = [length]
    inp.max_velocity = [min(feed, XYZAC.max_velocity[0])]
    inp.max_acceleration, inp.max_jerk = [XYZAC.max_acceleration[0]], [XYZAC.max_jerk[0]]
    ruckig.Ruckig(1).calculate(inp, out)
    path = line_path(length, feed)
    piece = plan_path(path, XYZAC, VPOP)
    assert_sound(piece, path)
    assert 1.0 <= piece.law.end_time / out.duration < 1.01


@pytest.mark.thorough
@pytest.mark.parametrize('seed', range(4))
def test_random_corners_are_sound_and_not_faster_than_the_optimum(seed):
    path = polyline_path(random_polyline(np.random.default_rng(seed), 3), 0.05)
    best, piece = plan_path(path, XYZAC), plan_path(path, XYZAC, VPOP)
    assert_sound(piece, path)
    assert piece.law.end_time > 0.998 * best.law.end_time


@pytest.mark.thorough
def test_a_long_curve_is_planned_in_windows():
    angle = np.linspace(0.0, 1.0, 75)
    points = np.column_stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), 1e-3 * angle])
    path = polyline_path(points, 0.05, cells=4, tolerance=1e-5, amplitude=0.5)
    assert_sound(plan_path(path, XYZAC, PlanOptions(law='vpop', window_cells=120)), path)


@pytest.mark.thorough
def test_steps_that_are_stuck_end_in_a_rest_that_is_counted(monkeypatch):
    """No way to the end is found at once, only to places less than 20 mm away."""
    path, plan = line_path(0.05, 0.05, cells=8), vpop.plan
    monkeypatch.setattr(
        vpop, 'plan', lambda path, *rest: plan(path, *rest) if np.ptp(path.s) < 0.02 else None
    )
    piece = plan_path(path, XYZAC, VPOP)
    assert_sound(piece, path)
    assert piece.solved == DIVIDED
    assert np.count_nonzero(piece.law.s_dot[1:] == 0.0) >= 2


@pytest.mark.thorough
def test_a_plan_by_vpop_is_proven_and_tells_its_law(tmp_path, capsys):
    program, summary = tmp_path / 'corner.ngc', {}
    program.write_text('G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A10 C0\nG1 X6 C4 F3000\nY6 A12\nM30\n')
    for law in ('vpop', 'optimal'):
        out = tmp_path / law
        assert main(['plan', str(program), '--law', law, '--out', str(out)]) == FINE
        summary[law] = json.loads((out / 'summary.json').read_text())
        assert summary[law]['settings']['law'] == law
    assert main(['check', str(tmp_path / 'vpop')]) == FINE
    assert capsys.readouterr().out.rstrip().endswith('proven')
    time = {law: found['cycle_time'] for law, found in summary.items()}
    assert summary['vpop']['time_bound'] < time['vpop'] < 1.1 * time['optimal']


def test_run_and_goals_do_not_offer_it(capsys):
    with pytest.raises(SystemExit, match='2'):
        main(['run', PYRAMID, '--law', 'vpop'])
    assert 'unknown option --law' in capsys.readouterr().err
    goal = RunProgram.Goal(settings=[KeyValue(key='law', value='vpop')])
    with pytest.raises(SettingsError, match='law: the nodes have only optimal; use `plan`'):
        settings_of_goal(goal, Settings())
