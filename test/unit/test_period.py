"""The interpolation period is an argument: differences of the setpoints hold the limits at any."""

from pathlib import Path

import numpy as np
import pytest
from programs import pyramid, zigzag
from tiers import few_of
from whole_plans import plan_program, write_plan

from cnc_interp.core import MM, MM_PER_MIN
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.machine_traits import traits_of
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import Program, read_program
from cnc_interp.proof.verify import verify_plan
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.path_smoother import PathSmoother
from cnc_interp.smoothing.segments import PathSegments

MACHINE = Machine.load('xyzac')
TRANSFORM = Transform.of(MACHINE)
PERIODS = [0.25e-3, 0.5e-3, 2e-3, 4e-3]
POCKET_CORNER = Path(__file__).parents[2] / 'examples' / 'pocket_corner.apt'


def largest_use(position, period):
    """Largest difference of each order over its limit, the axes at rest before and after."""
    held = np.pad(position, ((3, 3), (0, 0)), mode='edge')
    return [
        np.max(np.abs(np.diff(held, order, axis=0)) / (limit * period**order))
        for order, limit in enumerate(MACHINE.limits.by_order, start=1)
    ]


@pytest.mark.parametrize(('parametrization', 'period'), few_of(3, ['linear', 'paper'], PERIODS))
def test_pocket_corner_is_proven_at_the_period(parametrization, period, tmp_path):
    settings = Settings(
        feedrate=3000 * MM_PER_MIN, parametrization=parametrization, interpolation_period=period
    )
    program = read_program(POCKET_CORNER, TRANSFORM, settings)
    plan = plan_program(program, MACHINE, settings)
    assert np.allclose(np.diff(plan.setpoints.time), period)
    assert max(largest_use(plan.setpoints.position, period)) <= 1.001
    write_plan(plan, tmp_path)
    proof = verify_plan(tmp_path, MACHINE)
    assert proof.ok, proof.failures
    assert proof.period == period


@pytest.mark.parametrize('period', few_of(2, [0.25e-3, 0.5e-3]))
def test_rounding_of_short_cells_holds_the_jerk_limit_at_short_periods(period):
    # At 0.25 ms the A axis asked for 1.0014 times its jerk limit where two cells join.
    blocks = zigzag(1)
    program = Program(blocks=blocks, notices=(), source='zigzag', dialect='gcode')
    settings = Settings(compress=False, interpolation_period=period)
    plan = plan_program(program, MACHINE, settings)
    assert max(largest_use(plan.setpoints.position, period)) <= 1.001


def corners_with_kinks():
    settings = Settings(compress=False, parametrization='linear')
    smoother = PathSmoother(settings, traits_of(TRANSFORM))
    return PathSegments.concatenate([smoother.push(pyramid()), smoother.finish()])


def test_a_kink_is_a_stop_where_it_shows_within_the_period():
    segments = corners_with_kinks()
    stops = [
        int(AxisPathBuilder(TRANSFORM, 30 * MM, period).push(segments).stop.sum())
        for period in (0.25e-3, 1e-3, 4e-3)
    ]
    assert stops == sorted(stops, reverse=True)
    assert stops[0] > stops[1]
