"""Clearances of a live run and of motion by hand: both come to rest before anything is hit."""

from dataclasses import replace

import numpy as np
import pytest
from collision_cases import distance
from test_jog import Bench, beyond, use_of

from cnc_interp.collision.hits import CollisionError
from cnc_interp.collision.mesh_file import SceneError
from cnc_interp.collision.scene_file import read_scene
from cnc_interp.core import MM, StreamError
from cnc_interp.machine.jog import Jog
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.nodes.kernel_warmup import warm_clearance
from cnc_interp.program import read_text
from cnc_interp.run.clearance_stage import contact_by_hand
from cnc_interp.run.path_chain import batches, smoother_of
from cnc_interp.run.run_planner import RunPlanner
from cnc_interp.settings.options import Settings

MACHINE = Machine.load('xyzac')
TRANSFORM = Transform.of(MACHINE)
SCENE = """
bodies:
  - {name: clamp, link: workpiece, box_mm: {low: [50, -20, -20], high: [70, 20, 30]}}
tools:
  1: {diameter_mm: 6, flute_mm: 12, holder_mm: [[20, 5], [40, 15]]}
"""
PROGRAM = 'G21 G90\nG0 X0 Y0 Z20 A0 C0\nG1 X10 F3000\nG61\nX20 Y20\nX45 Y0 Z0\nX0 Z40\nM30\n'


@pytest.fixture
def settings(tmp_path):
    (tmp_path / 'scene.yaml').write_text(SCENE)
    return Settings(scene=tmp_path / 'scene.yaml')


def holder_gap(scene, q):
    bodies = {body.name: body.pieces[0] for body in read_scene(scene).bodies}
    return min(
        distance(MACHINE, (bodies[name], bodies['clamp']), ('tool_tip', 'workpiece'), q)
        for name in ('holder', 'shank', 'cutter')
    )


def segments_of_program(settings):
    blocks = read_text(PROGRAM, 'part.ngc', TRANSFORM, settings).blocks
    smoother = smoother_of(TRANSFORM, settings)
    return [*(smoother.push(batch) for batch in batches(blocks)), smoother.finish()]


def planner_of(settings, stands):
    return RunPlanner(TRANSFORM, settings, 0.01, stands)


def start_of(settings):
    blocks = read_text(PROGRAM, 'part.ngc', TRANSFORM, settings).blocks
    place = np.zeros((1, 2))
    return np.concatenate([TRANSFORM.linear(blocks.tip[:1], place)[0], np.zeros(2)])


def test_a_run_ends_before_the_line_that_hits_and_rests_on_the_path(settings):
    stands = start_of(settings)
    planner, parts = planner_of(settings, stands), segments_of_program(settings)
    singles = [part[np.array([k])] for part in parts for k in range(len(part))]
    refused = None
    for segment in singles:
        try:
            planner.push(segment, {})
        except CollisionError as problem:
            refused = problem
            break
    assert refused is not None and refused.line_number == 6
    assert 'holder and clamp' in str(refused)
    plan = planner.stream.current
    chunks = []
    while plan.can_plan or plan.can_sample:
        chunks += planner.work(plan, True, -np.inf)
    assert chunks, 'what was sound is executed'
    q = np.concatenate([chunk.samples.position for chunk in chunks])
    tail = chunks[-1].tail.position
    assert min(holder_gap(settings.scene, row) for row in [*q[::20], q[-1], *tail[::20]]) > 1e-4


def test_a_warned_run_goes_on_and_lists_the_hit(settings):
    planner = planner_of(replace(settings, collision='warn'), start_of(settings))
    for part in segments_of_program(settings):
        planner.push(part, {})
    assert [hit.line for hit in planner.clearance.hits] == [6, 7]  # line 7 leads away from it
    assert 'line 6' in planner.clearance.hits[0].text(MACHINE)


def test_the_way_to_the_start_is_checked(settings):
    start = start_of(settings)
    stands = start + np.array([100, 0, -20, 0, 0]) * MM  # the clamp lies between
    planner = planner_of(settings, stands)
    with pytest.raises(CollisionError, match='clamp'):
        for part in segments_of_program(settings):
            planner.push(part, {})


def test_a_node_reads_its_scene_before_anything_moves(settings):
    warm_clearance(MACHINE, settings, 1e-3)
    settings.scene.write_text('bodies: 3')
    with pytest.raises(SceneError, match='bodies'):
        warm_clearance(MACHINE, settings, 1e-3)


def bench_with(settings, position):
    bench = Bench(MACHINE, position)
    contact = contact_by_hand(MACHINE, settings, bench.play.spindle.commanded)
    bench.jog = Jog(bench.play, contact)
    return bench


def jogged(bench, time, **shares):
    told = ''
    for _ in range(round(time / 0.05)):
        try:
            bench.run(0.05, **shares)
        except StreamError as problem:
            told = str(problem)
            bench.now += 0.05
    return told


def test_a_tool_that_the_scene_cannot_hold_refuses_motion_by_hand_in_words(settings, tmp_path):
    table = tmp_path / 'setup.yaml'
    table.write_text('tools: {2: {length: 40.0, radius: 3.0}}\n')
    outputs = np.zeros(len(MACHINE.signals.outputs))
    contact = contact_by_hand(MACHINE, replace(settings, setup=table), outputs)
    stands = np.tile(start_of(settings), (2, 1))
    assert contact(stands) is None
    table.write_text('tools: {2: {length: 40.0, radius: 3.0, holder: fat}}\n')
    with pytest.raises(StreamError, match=r"tool 2 .* unknown holder 'fat'"):
        contact(stands)


FAT = '  2: {diameter_mm: 60, flute_mm: 12}\n'


def test_motion_by_hand_sees_the_tool_that_the_operator_has_put_in(settings):
    """On a machine without a tool changer, too: M6 sets no output there."""
    settings.scene.write_text(f'{SCENE}{FAT}tool: 1\n')
    bench = Bench(MACHINE, start_of(settings))
    outputs = bench.play.spindle.commanded
    contact = contact_by_hand(MACHINE, settings, outputs)
    # X 30, 20 mm beside the clamp and as high as it is: 17 mm are left to the thin tool.
    beside = np.tile(start_of(settings) + np.array([30, 0, -20, 0, 0]) * MM, (2, 1))
    assert contact(beside) is None
    outputs[[signal.name for signal in MACHINE.signals.outputs].index('tool')] = 2
    assert contact(beside) is not None
    outputs[:] = 0.0  # the run has ended
    assert contact(beside) is not None


@pytest.mark.parametrize('share', [0.05, 0.4])
def test_jogging_into_a_clamp_stops_before_it_within_the_limits(settings, share):
    start = start_of(settings)
    bench = bench_with(settings, start)
    told = jogged(bench, 2.0, X=share)
    bench.rest()
    assert 'stopped before a contact of' in told and 'clamp' in told
    left = holder_gap(settings.scene, bench.q[-1]) / MM
    assert float(told.split(' mm are left')[0].split()[-1]) == pytest.approx(left, rel=6e-3)
    gaps = [holder_gap(settings.scene, q) for q in bench.q[::10]]
    assert min(gaps) > 1e-4
    speed = share * MACHINE.max_velocity[0]
    stop = speed * (0.5 * speed / MACHINE.max_acceleration[0] + 0.5) + 0.07 * speed
    assert gaps[-1] < 1e-4 + stop, 'it stops no farther away than it must'
    assert max(use_of(MACHINE, bench.q)) <= 1.001 and beyond(MACHINE, bench.q) <= 1e-9
    still = bench.q[-1].copy()
    jogged(bench, 0.5)  # the key is let go
    jogged(bench, 0.5, X=-share)
    bench.rest()
    assert bench.q[-1, 0] < still[0] - MM, 'away from it is free'


def test_bodies_that_are_too_near_may_be_moved_apart_and_not_nearer(settings):
    """Axes that stand inside a clamp, as after a change of the scene, can leave it."""
    stands = start_of(settings) + np.array([46, 0, -15, 0, 0]) * MM  # the holder in the clamp
    assert holder_gap(settings.scene, stands) == 0.0
    bench = bench_with(settings, stands)
    assert 'clamp' in jogged(bench, 0.5, X=0.1)
    assert bench.q.shape[0] == 0 or np.allclose(bench.q[-1], stands)
    jogged(bench, 0.5)
    assert jogged(bench, 3.0, Z=0.2) == ''
    bench.rest()
    assert holder_gap(settings.scene, bench.q[-1]) > 1e-4


def test_a_move_through_a_clamp_ends_before_it(settings):
    bench = bench_with(settings, start_of(settings))
    bench.move(X=0.1, speed=0.1)
    assert 'clamp' in jogged(bench, 4.0)
    bench.rest()
    assert min(holder_gap(settings.scene, q) for q in bench.q[::10]) > 1e-4
