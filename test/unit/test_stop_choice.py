"""Corners where a stop is faster, runs where lines are: found however the blocks arrive."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from programs import blocks_of
from tiers import few_of
from whole_plans import path_of

from cnc_interp.core import DEG, MM, MM_PER_MIN, UM
from cnc_interp.feedrate.planning_windows import plan_path
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.machine_traits import traits_of
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.program.blocks import ROUND_CORNER, STOP_CORNER
from cnc_interp.run import path_chain
from cnc_interp.run.path_chain import PathChain, is_faster, segments_of, way_time
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.dense.thinning import longest_chord
from cnc_interp.smoothing.lookahead import LookAhead
from cnc_interp.smoothing.segments import SPLINE, PathSegments
from cnc_interp.smoothing.stop_choice import Way

XYZAC = Machine.load('xyzac')
TRANSFORM = Transform.of(XYZAC)


def tools(*tilt_and_heading):
    """Tool axes from tilt and heading [deg]."""
    tilt, heading = np.array(tilt_and_heading).T * DEG
    return np.c_[np.sin(tilt) * np.sin(heading), np.sin(tilt) * np.cos(heading), np.cos(tilt)]


def beside_the_pole():
    """Two corners where the tool rests farther beside the pole than it may wander."""
    tips = [[0, 0, 0], [3, 1, 0.5], [3.02, 1.02, 0.5], [2.0, 3.2, 0.7], [4, 4, 0.7]]
    axes = tools((3.5, 20), (0.04, 200), (0.04, 200), (0.3, 100), (0.3, 100))
    return blocks_of(np.array(tips) * MM, axes, feed=10000 * MM_PER_MIN)


def swivel():
    """A tip that moves 5 um while the tool turns by 5 deg, between two ordinary lines."""
    tips = [[0, 0, 0], [6, 0, 0], [6.004, 0.003, 0], [6.1, 8, 0]]
    axes = tools((10, 20), (10.2, 20), (15, 22), (15.1, 22))
    return blocks_of(np.array(tips) * MM, axes)


def plain():
    """Two ordinary corners far from the pole."""
    tips = [[0, 0, 0], [10, 0, 0], [10, 10, 0], [20, 10, 5]]
    return blocks_of(np.array(tips) * MM, tools((10, 20), (11, 21), (12, 22), (13, 25)))


def micrometre():
    """A line of 0.2 um between two fast ones: its corners are smaller still."""
    tips = [[0, 0, 0], [5, 0, 0], [5.0002, 0, 0.0001], [6, 5, 0]]
    return blocks_of(np.array(tips) * MM, tools(*[(10, 20)] * 4), feed=30000 * MM_PER_MIN)


def tiny_run():
    """Five blocks that are shorter together than the tolerance."""
    tips = [[0, 0, 0], [6, 0, 0], [10, 14, 0], [35, 14, 3], [40, 30, 4], [40, 30.4, 4]]
    axes = tools(
        (27.768, 20), (27.768, 20), (27.767, 20), (27.767, 20), (27.768, 20), (27.768, 20)
    )
    return blocks_of(np.array(tips) * UM, axes, feed=30000 * MM_PER_MIN, tolerance=60 * UM)


def run_beside_the_pole():
    """Three short blocks 1.5 deg from the pole, where a curve may wave by the tolerance."""
    tips = [[0, 0, 0], [2.1642, -6.3963, 0.5896], [2.6724, -7.0583, 0.8942]]
    tips += [[2.6726, -7.0585, 0.8944], [2.6751, -7.0523, 0.8931], [1.392, -10.2892, 1.5634]]
    axes = tools(
        (2, -13.8), (1.61, -14.7), (1.51, -14.9), (1.49, -15), (1.95, -11.4), (1.14, -4.7)
    )
    return blocks_of(np.array(tips) * MM, axes, feed=3000 * MM_PER_MIN, tolerance=90 * UM)


def time_of(blocks, curves=False):
    """Cycle time [s]."""
    path = path_of(blocks, TRANSFORM, Settings(compress=curves))
    return plan_path(path, XYZAC).law.end_time


MADE = [beside_the_pole, swivel, micrometre, tiny_run, run_beside_the_pole, plain]


@pytest.mark.parametrize(('make', 'curves'), few_of(5, MADE, [False, True]))
def test_is_never_slower_than_with_a_stop_at_each_block(make, curves):
    blocks = make()
    stops = replace(blocks, exact_stop=np.ones(len(blocks), dtype=bool))
    assert time_of(blocks, curves) <= time_of(stops) * (1 + 1e-4)


@pytest.mark.parametrize('make', [tiny_run, run_beside_the_pole])
def test_a_short_run_becomes_no_curve_where_lines_are_faster(make):
    blocks, settings = make(), Settings(compress=True)
    curved = LookAhead(settings, traits_of(TRANSFORM))
    assert (PathSegments.concatenate([curved.push(blocks), curved.finish()]).kind == SPLINE).any()
    assert not (segments_of(blocks, TRANSFORM, settings).kind == SPLINE).any()
    assert time_of(blocks, True) < 0.99 * way_time(TRANSFORM, settings, Way(blocks, True))


def test_a_stop_is_taken_only_where_it_is_faster():
    for make, stops in ((beside_the_pole, True), (plain, False)):
        segments = segments_of(make(), TRANSFORM, Settings(compress=False))
        assert segments.stop[:-1].any() == stops


@pytest.mark.parametrize(
    ('make', 'batch'), few_of(5, [tiny_run, beside_the_pole, run_beside_the_pole], [1, 2])
)
def test_trials_do_not_depend_on_how_the_blocks_arrive(make, batch):
    blocks, settings = make(), Settings()
    smoother = LookAhead(settings, traits_of(TRANSFORM), partial(is_faster, TRANSFORM, settings))
    parts = [smoother.push(blocks[i : i + batch]) for i in range(0, len(blocks), batch)]
    found = PathSegments.concatenate([part for part in [*parts, smoother.finish()] if len(part)])
    whole = segments_of(blocks, TRANSFORM, settings)
    assert (found.stop == whole.stop).all()
    np.testing.assert_array_equal(found.bottom, whole.bottom)


def test_the_pieces_of_one_line_are_no_corners_to_try():
    """C turns by two revolutions while the tip moves by 1 mm: 200 pieces, each with fast turns."""
    text = 'G21 G90\nM128\nG1 X0 Y0 Z0 B-12.4 C-793 F6000\nG1 X0.646 Z0.8 B-6.2 C-73\nM2\n'
    trt, settings, tried = Transform.of(Machine.load('xyzbc_trt')), Settings(), []
    blocks = read_text(text, 'turn.ngc', trt, settings).blocks
    smoother = LookAhead(settings, traits_of(trt), lambda *ways: bool(tried.append(ways)))
    smoother.push(blocks), smoother.finish()
    assert len(blocks) > 100 and len(tried) < 10


def in_a_loop(blocks, feed):
    """A program whose only line of motion is repeated with the next pose of some blocks."""
    rows = np.c_[blocks.tip / MM, blocks.axis]
    table = [
        f'#{100 * k + i + 31}={x:.9f}' for i, row in enumerate(rows) for k, x in enumerate(row)
    ]
    words = ' '.join(f'{letter}#[{100 * k + 31}+#1]' for k, letter in enumerate('XYZIJK'))
    loop = ['#1=0', f'o1 while [#1 lt {len(rows)}]', f'G1 {words} F{feed}', '#1=[#1+1]']
    return '\n'.join(['G21 G90 G43.5', *table, *loop, 'o1 endwhile', 'M2', ''])


def test_a_loop_that_repeats_one_line_has_the_stops_of_its_motions():
    """All blocks of the loop have one line number, as the pieces of an arc do."""
    settings = Settings(compress=False)
    blocks = read_text(in_a_loop(beside_the_pole(), 3000), 'loop.ngc', TRANSFORM, settings).blocks
    moves = np.flatnonzero(np.diff(blocks.line_number) == 0) + 1
    assert len(moves) == len(beside_the_pole()) - 1
    listed = replace(blocks, line_number=np.arange(len(blocks)))
    stops = [segments_of(some, TRANSFORM, settings).stop for some in (blocks, listed)]
    assert stops[0][:-1].any() and np.array_equal(*stops)


def refuse_to_choose(_ways, _others):
    raise AssertionError('nothing is to be tried')


@pytest.mark.parametrize(
    ('make', 'compress'),
    few_of(3, [plain, beside_the_pole, swivel, micrometre], [False, True]),
)
def test_corners_that_are_known_are_not_tried_again(make, compress):
    blocks, settings = make(), Settings(compress=compress)
    chain = PathChain(TRANSFORM, settings)
    tried = PathSegments.concatenate([chain.push(blocks).segments, chain.finish().segments])
    corner = np.full(len(blocks), ROUND_CORNER)
    corner[chain.stops] = STOP_CORNER
    known = LookAhead(settings, traits_of(TRANSFORM), refuse_to_choose)
    found = PathSegments.concatenate([known.push(replace(blocks, corner=corner)), known.finish()])
    assert (found.stop == tried.stop).all()
    np.testing.assert_array_equal(found.bottom, tried.bottom)


def test_a_chord_at_the_end_of_a_curve_does_not_lead_back_to_its_start():
    tip = np.array([[0, 0, 0], [20, 0, 0], [0, 0, 0]]) * UM  # aside by a fifth of the tolerance
    tolerance = np.full(2, 100 * UM)
    vertex, off, _ = longest_chord(tip, tip, tolerance, 0, 1, 2, 1 * MM, 0.3)
    assert (vertex, off) == (1, 0.0)


def test_the_fastest_way_must_save_what_a_change_is_worth(monkeypatch):
    monkeypatch.setattr(path_chain, 'way_time', lambda transform, settings, way: way)
    for ways, others, faster in (
        ([3.0, 2.0], [2.5], True),
        ([2.5], [3.0, 2.0], False),
        ([2.0], [2.0], False),
        ([2.0 - 1e-9], [2.0], False),
        ([9.0], [], True),
        ([], [9.0], False),
    ):
        assert is_faster(TRANSFORM, Settings(), ways, others) == faster
