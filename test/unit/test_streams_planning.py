"""A run that goes on from where the machine rests: at any place of its path."""

from dataclasses import replace

import numpy as np
import pytest
from tiers import few_of

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from limit_use import limit_use

from cnc_interp.kinematics.axis_path import AxisPath, evaluate
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.run.overrides import OperatorSettings
from cnc_interp.run.path_chain import segments_of
from cnc_interp.run.run_planner import RunPlanner
from cnc_interp.run.setpoints import Wait
from cnc_interp.settings.options import Settings

MACHINE = Machine.load('xyzac')
TRANSFORM = Transform.of(MACHINE)
CHOICES = Settings(flank_height=0.03, retract=0.0, plunge_feed=16.0)
PROGRAM = 'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A15 C30\n' + ''.join(
    f'G1 X{10 * k} Y{8 * (k % 2)} A{14 + k % 3} F3000\n' for k in range(1, 9)
)


def segments():
    blocks = read_text(PROGRAM, 'steps.ngc', TRANSFORM, Settings()).blocks
    return segments_of(blocks, TRANSFORM, Settings())


def halves():
    """All segments in two parts."""
    whole = segments()
    return whole[: len(whole) // 2], whole[len(whole) // 2 :]


@pytest.mark.parametrize('before', few_of(2, [5e-14, 0.0, -5e-14, 2e-3]))
def test_a_run_goes_on_from_the_border_of_what_came_in_one_piece(before):
    first, second = halves()
    builder = AxisPathBuilder(TRANSFORM, 0.03, 1e-3)
    parts = [builder.push(first), builder.push(second)]
    path, place = AxisPath.join(parts), float(parts[0].s[-1]) - before
    stands = evaluate(path, np.array([place]))[0][0]
    planner = RunPlanner(TRANSFORM, CHOICES, 0.01, stands, place)
    planner.push(first, {})
    planner.push(second, {})
    planner.finish()
    chunks = []
    while planner.stream.current.can_plan or planner.stream.current.can_sample:
        chunks += planner.work(planner.stream.current, True, place)
    q = np.concatenate([chunk.samples.position for chunk in chunks])
    s = np.concatenate([chunk.samples.s for chunk in chunks])
    assert abs(s[0] - place) < 1e-12 and abs(s[-1] - path.s[-1]) < 1e-12
    assert np.abs(q - evaluate(path, s)[0]).max() < 1e-9
    held = np.concatenate([q[:1].repeat(3, 0), q, q[-1:].repeat(3, 0)])
    jerk = np.abs(np.diff(held, 3, axis=0)).max(axis=0) / 1e-9
    assert (jerk <= 1.001 * MACHINE.max_jerk).all()


def sampled(planner, before=()):
    """All that the current plan gives: positions, path lengths, blocks; proven by limits."""
    chunks = [*before]
    while planner.stream.current.can_plan or planner.stream.current.can_sample:
        chunks += planner.work(planner.stream.current, True, -np.inf)
    q, s, block = (
        np.concatenate([getattr(chunk.samples, name) for chunk in chunks])
        for name in ('position', 's', 'block')
    )
    assert limit_use(q, MACHINE.limits.by_order) <= 1.001
    return q, s, block


def test_a_place_that_the_machine_cannot_have_reached_takes_no_path_away():
    """Another node may say it; a plan with other settings still joins, and holds the path."""
    whole = segments()
    path = AxisPathBuilder(TRANSFORM, 0.03, 1e-3).push(whole)
    planner = RunPlanner(TRANSFORM, CHOICES, 0.01, path.q[0])
    planner.push(whole, {})
    planner.finish()
    sent = []
    while sum(len(chunk.samples) for chunk in sent) < 300:
        sent += planner.work(planner.stream.current, True, 1e3)
    last = sum(len(chunk.samples) for chunk in sent) - 1
    revision = planner.revise(last, OperatorSettings(override=0.5))
    planner.stream.adopt(revision.plan)
    q, s, _ = sampled(planner, [*sent, *revision.chunks])
    assert np.abs(q - evaluate(path, s)[0]).max() < 1e-9 and s[-1] == path.s[-1]


@pytest.mark.parametrize(('place', 'asks'), few_of(3, [5e-14, 5e-3], [True, False]))
def test_a_start_inside_is_asked_for_where_the_machine_stands_there_too(place, asks):
    whole = segments()
    path = AxisPathBuilder(TRANSFORM, 0.03, 1e-3).push(whole)
    there = evaluate(path, np.array([place]))[0][0]
    planner = RunPlanner(TRANSFORM, CHOICES, 0.01, there, place, asks=asks)
    planner.push(whole, {})
    planner.finish()
    first = []
    while not first:
        first = planner.work(planner.stream.current, True, -np.inf)
    assert (first[0].wait is Wait.APPROACH) == asks
    if asks:
        assert np.abs(first[0].samples.position - there).max() < 1e-12
        q, s, _ = sampled(planner)
        assert abs(s[-1] - path.s[-1]) < 1e-12 and np.abs(q[-1] - path.q[-1]).max() < 1e-12


@pytest.mark.parametrize('place', few_of(4, [5e-3, -0.01, 0.0, 0.03]))
def test_moved_away_by_hand_it_goes_back_and_on_and_again_from_the_way(place):
    whole = segments()
    path = AxisPathBuilder(TRANSFORM, 0.03, 1e-3).push(whole)
    planner = RunPlanner(
        TRANSFORM,
        replace(CHOICES, retract=0.01, plunge_feed=0.05),
        0.01,
        np.array([0.1, 0.0, 0.0, 0.0, 0.0]),
    )
    planner.push(whole, {})
    planner.finish()
    sampled(planner)
    back = max(place, 0.0)
    for stands in ([0.0, 0.1, 0.05, 0.2, -3.0], [-0.3, 0.0, 0.1, 0.0, 0.5]):
        planner.resume(place, np.array(stands), OperatorSettings())
        q, s, block = sampled(planner)
        assert np.abs(q[0] - stands).max() < 1e-12 and (s[block == 0] <= 1e-12).all()
        program = np.flatnonzero(block > 0)
        assert (np.diff(block > 0) >= 0).all() and np.diff(program).max() == 1
        assert abs(s[program[0]] - back) < 1e-6 and abs(s[-1] - path.s[-1]) < 1e-12
        assert np.abs(q[program] - evaluate(path, s[program])[0]).max() < 1e-9
        if place > 0.0:  # it plunges along the tool, not faster than asked
            tip, axis = TRANSFORM.forward(q[program[0] - 150 : program[0]])
            assert np.linalg.norm(np.cross(tip - tip[-1], axis[-1]), axis=1).max() < 1e-9
            assert (np.linalg.norm(np.diff(tip, axis=0), axis=1) / 1e-3).max() <= 0.05 * 1.001
    there = evaluate(path, np.array([back]))[0][0]
    planner.resume(place, there, OperatorSettings())
    assert (sampled(planner)[2] > 0).all()


def test_the_rapid_override_scales_rapids_and_the_approach_and_the_feed_override_the_approach():
    text = PROGRAM + 'G0 X0 Y50 Z20\nG1 X10 F3000\n'
    blocks = read_text(text, 'rapids.ngc', TRANSFORM, Settings()).blocks
    whole = segments_of(blocks, TRANSFORM, Settings())
    speeds, laws = [], []
    for settings in map(
        OperatorSettings, (1.0, 1.0, 0.4, 1.2), [False] * 4, (1.0, 0.25, 1.0, 0.5)
    ):
        stands = np.array([0.1, -0.3, 0.05, 0.0, 0.0])
        planner = RunPlanner(TRANSFORM, CHOICES, 0.01, stands, settings=settings)
        planner.push(whole, {})
        planner.finish()
        q, s, block = sampled(planner)
        use = (np.abs(np.diff(q, axis=0)) / 1e-3 / MACHINE.max_velocity).max(axis=1)
        rapids = blocks.rapid[np.minimum(block[1:], len(blocks) - 1)] & (block[1:] > 0)
        speeds.append((use[block[1:] == 0].max(), use[rapids].max()))
        cut = (block > 0) & (block < int(np.argmax(blocks.rapid[1:])))
        laws.append(s[cut])
    (fast, fast_rapid), (slow, slow_rapid), (less, whole_rapid), (half, _) = speeds
    assert fast > 0.5 and fast_rapid > 0.26
    assert 0.249 < slow <= 0.25 * 1.001 and slow_rapid <= 0.25 * 1.001
    assert laws[0] == pytest.approx(laws[1], abs=1e-7)
    # The approach follows the feed override too, but no override makes it faster than a rapid.
    assert 0.399 < less <= 0.4 * 1.001 and whole_rapid == pytest.approx(fast_rapid, rel=0.01)
    assert 0.499 < half <= 0.5 * 1.001
