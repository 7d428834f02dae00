"""Curves through dense blocks: tolerances, joins, what stays as it is; by independent geometry."""

import tracemalloc
from dataclasses import fields, replace

import numpy as np
import pytest
from path_samples import deviation, jumps, sampled
from programs import blocks_of
from programs import dome as dome_of
from scipy.special import comb
from tiers import examples, few_of

from cnc_interp.core import DEG, MM, MM_PER_MIN, UM, InterpError
from cnc_interp.machine_model.machine_traits import MachineTraits
from cnc_interp.program.blocks import Blocks
from cnc_interp.proof.programmed_path import ProgrammedPath
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.dense.certificate import certify
from cnc_interp.smoothing.dense.end_lines import _borders
from cnc_interp.smoothing.dense.polyline import Polyline
from cnc_interp.smoothing.dense.thinning import select_vertices
from cnc_interp.smoothing.lookahead import LookAhead
from cnc_interp.smoothing.path_smoother import PathSmoother
from cnc_interp.smoothing.segments import CORNER, LINE, ROTATION, SPLINE, PathSegments

HEIGHT = 30 * MM
TOLERANCE = 10 * UM
ANYWHERE = MachineTraits()
FEED = 3000 * MM_PER_MIN


def smooth(blocks, batch=10000, **settings):
    """All segments of some blocks."""
    lookahead = LookAhead(Settings(flank_height=HEIGHT, **settings), ANYWHERE)
    parts = [lookahead.push(blocks[i : i + batch]) for i in range(0, len(blocks), batch)]
    return PathSegments.concatenate([*parts, lookahead.finish()])


def dome(**options):
    """The dome spiral at the tolerance of these tests."""
    return dome_of(tolerance=TOLERANCE, **options)


def helix(count):
    """Blocks of 0.2 mm round and round."""
    angle = np.arange(count) * (0.2 / 60)
    tip = np.stack([np.cos(angle), np.sin(angle), 0.01 * angle], axis=1) * 60 * MM
    return replace(Blocks.concatenate([dome()[:1]] * count), tip=tip)


def straight(start, end, count):
    """Poses on the way from one pose to another, the first one left out."""
    share = np.arange(1, count + 1)[:, None] / count
    return np.asarray(start) + share * (np.asarray(end) - np.asarray(start))


def sound(segments, blocks):
    """Demand both tolerances, and that tip and tool go on smoothly."""
    forth, back = deviation(segments, blocks, HEIGHT)
    assert forth <= 1.0 + 1e-6 and back <= 1.0 + 1e-6
    assert (jumps(segments, HEIGHT) < [1e-12, 1e-12, 1e-10]).all()


@pytest.mark.parametrize(
    ('noise', 'columns'), few_of(3, [0.0, 1 * UM], [{}, {'tolerance': 50 * UM}])
)
def test_dense_blocks_become_one_curve_within_both_tolerances(noise, columns):
    blocks = dome(noise=noise)
    for name, value in columns.items():
        column = np.full(len(blocks), value)
        blocks = replace(blocks, **{f'contour_{name}': column, f'orientation_{name}': column})
    segments = smooth(blocks)
    assert (segments.kind == SPLINE).all()
    assert not segments.stop[:-1].any() and segments.stop[-1]
    sound(segments, blocks)


def test_the_bound_is_above_what_is_measured_and_not_far():
    """Span by span: the deviation in the segments bounds the measured one, here within a fifth."""
    blocks = dome(noise=1 * UM)
    segments = smooth(blocks)
    tip, axis = sampled(segments, 33)
    path = ProgrammedPath.of(blocks.tip, blocks.axis, blocks.rotary, HEIGHT)
    found = path.deviation(
        tip.reshape(-1, 3),
        axis.reshape(-1, 3),
        np.repeat(segments.block[:, 0], 33),
        np.full(tip[..., 0].size, 10 * MM),
    )
    measured = np.stack(
        [part.reshape(-1, 33).max(axis=1) for part in (found.contour, found.orientation)], axis=1
    )
    assert (measured <= segments.deviation + 1e-12).all()
    assert (segments.deviation.max(axis=0) < 1.2 * measured.max(axis=0)).all()


def test_no_random_span_is_beyond_its_certificate():
    """Random quintic spans along random vertices against 401 samples each, at the same u."""
    rng, count = np.random.default_rng(8), examples(100, 10_000)
    scale = 10.0 ** rng.uniform(-2.0, 2.0)
    a, b = np.cumsum(rng.normal(0.0, 8e-3, (2, 2 * count)), axis=1)
    axis = np.stack([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)], axis=1)
    tip = np.cumsum(rng.normal(0.2, 0.4, (2 * count, 3)), axis=0) * MM
    u = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(tip, axis=0), axis=1))])
    zero = np.zeros((2 * count - 1, 2))
    line = Polyline(
        np.hstack([tip, axis]),
        u,
        np.arange(2 * count),
        zero,
        zero + scale * UM,
        zero[:, 0].copy(),
        zero.astype(int),
    )
    knots = np.sort(np.append(rng.uniform(0.0, u[-1], count - 1), [0.0, u[-1]]))

    def programmed(at):
        pose = np.stack([np.interp(at, u, column) for column in line.pose.T], axis=-1)
        return np.concatenate([pose[..., :3], pose[..., :3] + HEIGHT * pose[..., 3:]], axis=-1)

    greville = knots[:-1, None] + np.diff(knots)[:, None] * np.linspace(0.0, 1.0, 6)
    noise = rng.normal(size=(count, 6, 6)) * 10.0 ** rng.uniform(-8.0, -4.0, (count, 1, 1))
    spans = programmed(greville) + noise
    bound, _, _ = certify(spans, knots, line, HEIGHT, True, 1.0)
    at = np.linspace(0.0, 1.0, 401)
    weights = [comb(5, k) * at**k * (1.0 - at) ** (5 - k) for k in range(6)]
    ratio = []
    for span, low, high, least in zip(spans, knots[:-1], knots[1:], bound, strict=True):
        both, wanted = np.transpose(weights) @ span, programmed(low + at * (high - low))
        tool = [x[:, 3:] - x[:, :3] for x in (both, wanted)]
        tool = [HEIGHT * x / np.linalg.norm(x, axis=1)[:, None] for x in tool]
        gap = both[:, :3] - wanted[:, :3]
        top = np.linalg.norm(gap + tool[0] - tool[1], axis=1).max()
        found = np.array([np.linalg.norm(gap, axis=1).max(), top])
        assert (found <= least * (1.0 + 1e-9) + 1e-15).all()
        ratio.append(least / found)
    assert np.median(ratio) < 1.5


@pytest.mark.parametrize(('batch', 'noise'), few_of(5, [1, 7, 64], [0.0, 2 * UM]))
def test_same_bits_however_the_blocks_arrive(batch, noise):
    blocks = dome(count=250, noise=noise)
    whole, pieces = smooth(blocks), smooth(blocks, batch)
    for field in fields(whole):
        assert getattr(whole, field.name).tobytes() == getattr(pieces, field.name).tobytes()


def test_delay_is_bounded():
    """What has come is on its way after a few millimetres, however long the run is."""
    blocks = dome(count=1500)
    lookahead = LookAhead(Settings(flank_height=HEIGHT), ANYWHERE)
    sent = 0
    for i in range(0, len(blocks), 50):
        part = lookahead.push(blocks[i : i + 50])
        sent = max(sent, int(part.block.max(initial=0)))
        assert i + 50 - sent < 300  # 60 spans of at most 1 mm, blocks of 0.5 mm, one batch


def test_memory_does_not_grow_with_a_curve_that_never_ends():
    count = 24_000
    blocks = helix(count)
    lookahead = LookAhead(Settings(flank_height=HEIGHT), ANYWHERE)
    held = []
    tracemalloc.start()
    for first in range(0, count, 500):
        assert not (lookahead.push(blocks[first : first + 500]).kind == LINE).any()
        held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    assert max(held) < max(held[:16]) + 0.5e6  # bytes; 16,000 blocks would be 8e6


def test_a_sharp_turn_of_dense_blocks_keeps_its_corner():
    corner = np.array([20.0, 0, 0]) * MM
    tips = np.vstack(
        [
            [[0, 0, 0]],
            straight([0, 0, 0], corner, 50),
            straight(corner, corner + [14 * MM, 14 * MM, 0], 50),
        ]
    )
    tips[:, 2] = 0.5 * UM * np.sin(np.arange(101))
    blocks = blocks_of(tips, [[0, 0.3, 1]] * 101, tolerance=TOLERANCE)
    segments = smooth(blocks)
    rounded = np.flatnonzero(segments.kind == CORNER)
    assert len(rounded) == 1 and segments.kind[0] == segments.kind[-1] == SPLINE
    assert np.abs(segments.bottom[rounded[0], 2] - tips[50]).max() < 1 * UM
    sound(segments, blocks)
    # 45 deg; where more is allowed the curve goes through
    through = smooth(blocks, corner_angle=60 * DEG)
    assert (through.kind == SPLINE).all()
    sound(through, blocks)


def test_what_is_not_dense_stays_as_it_is():
    """Exact stop, rapid, a rotation at rest, a long block: between them there are curves."""
    bend = 2 * MM * np.sin(np.arange(400) / 60)
    tips = np.column_stack([np.arange(400) * 0.4 * MM, bend, np.zeros(400)])
    lean = np.where(np.arange(400) < 200, 0.3, 0.5)
    tips[200:] += tips[199] - tips[200]  # the tool turns here
    tips[300:] += [30 * MM, 0, 0]
    stop, rapid = np.arange(400) == 100, np.arange(400) == 150
    blocks = blocks_of(
        tips,
        np.column_stack([np.sin(lean), np.zeros(400), np.cos(lean)]),
        tolerance=TOLERANCE,
        exact_stop=stop,
        rapid=rapid,
        feedrate=np.where(rapid, np.inf, FEED),
    )
    segments = smooth(blocks)
    sound(segments, blocks)
    kind_of = {row: set(segments.kind[segments.block[:, 1] == row]) for row in (150, 200, 300)}
    assert kind_of[150] == {LINE} or kind_of[150] == {LINE, CORNER}
    assert np.isinf(segments.feed[(segments.block[:, 1] == 150) & (segments.kind == LINE)]).all()
    assert kind_of[200] == {ROTATION} and LINE in kind_of[300]
    rests = segments.bottom[segments.stop & (segments.kind == SPLINE), 5]
    for row in (100, 199, 399):
        assert np.linalg.norm(rests - tips[row], axis=1).min() < 1e-12
    assert (segments.kind == SPLINE).sum() > 100


def test_blocks_keep_their_number_and_their_feed():
    feed = np.where(np.arange(400) < 200, FEED, 0.4 * FEED)
    segments = smooth(dome(feedrate=feed))
    assert (np.diff(segments.block.ravel()) >= 0).all()
    assert segments.block[0, 0] == 1 and segments.block[-1, 1] == 399
    for half in (0, 1):  # the feed of the block executed; slower where a span has both
        assert (segments.feed[:, half] <= feed[segments.block[:, half]] * (1 + 1e-12)).all()
    ways = np.linalg.norm(np.diff(sampled(segments, 65)[0], axis=1), axis=2).sum(axis=1)
    blocks = dome()
    programmed = (np.linalg.norm(np.diff(blocks.tip, axis=0), axis=1) / feed[1:]).sum()
    # the path may be shorter by the tolerance over its radius
    assert (ways / segments.feed[:, 0]).sum() == pytest.approx(programmed, rel=1e-3)


def test_the_motion_ends_in_the_last_block():
    for count in (300, 301, 997):
        assert smooth(helix(count)).block[-1, 1] == count - 1


def test_programmed_durations_are_kept():
    duration = np.full(400, np.nan)
    duration[1:] = np.where(np.arange(1, 400) % 50 < 25, 0.02, 0.05)
    segments = smooth(dome(feedrate=np.full(400, np.nan), duration=duration))
    ways = np.linalg.norm(np.diff(sampled(segments, 65)[0], axis=1), axis=2).sum(axis=1)
    total = (ways / segments.feed[:, 0]).sum()
    assert total == pytest.approx(duration[1:].sum(), rel=1e-3)


def test_a_native_spline_meets_the_line_before_and_after():
    """Beside a native curve the last dense block stays a line, for the curve goes on from it."""
    dense = dome(count=60)
    step = dense.tip[-1] - dense.tip[-2]
    points = dense.tip[-1] + np.array([0, 4, 12, 20, 24])[:, None] * step
    points[2:] += np.array([0.2, 0.6, 1.0])[:, None] * [0, 0, 1 * MM]
    axis = np.repeat(dense.axis[-1:], 5, axis=0)
    curve = blocks_of(points, axis, tolerance=TOLERANCE)
    curve = replace(
        curve, top=points + HEIGHT * curve.axis, knot_interval=np.array([0, 1.0, 1.0, 0, 0])
    )
    away = points[-1] - points[-2]
    after = points[-1] + straight([0, 0, 0], 12 * away / np.linalg.norm(away) * MM, 40)
    rest = blocks_of(after, np.repeat(dense.axis[-1:], 40, axis=0), tolerance=TOLERANCE)
    blocks = Blocks.concatenate([dense, curve, rest])
    smoother = PathSmoother(Settings(flank_height=HEIGHT), ANYWHERE)
    segments = PathSegments.concatenate([smoother.push(blocks), smoother.finish()])
    assert not segments.stop[:-1].any()
    own = (segments.block >= 60) & (segments.block < 65)
    first, last = np.flatnonzero(own.any(axis=1))[[0, -1]]
    assert segments.kind[first - 1] == LINE
    assert segments.kind[last + 1] == LINE
    assert segments.kind[0] == SPLINE
    assert (jumps(segments, HEIGHT) < [1e-12, 1e-8, 1e-8]).all()


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('longest_block', 0.0),
        ('corner_angle', 0.0),
        ('corner_angle', 4.0),
        ('tolerance_share', 1.2),
    ],
)
def test_impossible_choices_are_refused_by_name(name, value):
    with pytest.raises(InterpError, match=name):
        Settings(**{name: value})


def test_longest_block_decides_what_is_dense():
    blocks = dome(count=60, block=1 * MM)
    lines = smooth(blocks, longest_block=0.9 * MM)
    assert SPLINE not in lines.kind and CORNER in lines.kind
    assert (smooth(blocks).kind == SPLINE).all()


def test_share_of_the_tolerance_is_kept():
    blocks = dome(count=150, noise=2 * UM)
    segments = smooth(blocks, tolerance_share=0.5)
    assert segments.deviation.max() <= 0.5 * TOLERANCE
    sound(segments, blocks)


def test_borders_on_the_line_at_an_end_lie_apart_and_within_it():
    place = np.array([-0.2, 0.04, 0.3, 0.34, 0.6, 0.97, 1.0])
    cuts, pieces = _borders(place, np.arange(8), 0.05)
    assert cuts.tolist() == [0.3, 0.6] and pieces.tolist() == [2, 3, 5]


def test_dropped_rows_are_as_far_from_their_chord_as_is_told():
    """By trying places of the chord; tip and top of a row are compared with the same place."""
    rng, n = np.random.default_rng(3), 200
    tip = np.cumsum(rng.uniform(0.0, 4.0 * UM, (n, 3)), axis=0)
    both = np.hstack([tip, tip + np.cumsum(rng.normal(scale=UM, size=(n, 3)), axis=0)])
    top, tolerance = both[:, 3:].copy(), np.full((n, 2), 40.0 * UM)
    kept, used = select_vertices(tip, top, tolerance, np.zeros(n, dtype=bool))
    assert 3 < len(kept) < n / 4
    for a, b, told in zip([0, *kept], kept, used, strict=False):
        chord = np.linspace(0.0, 1.0, 2001)[:, None] * (both[b] - both[a])
        rest = (both[a + 1 : b] - both[a])[:, None] - chord
        nearest = rest[np.arange(b - a - 1), (rest**2).sum(axis=2).argmin(axis=1)]
        off = np.linalg.norm(nearest.reshape(-1, 2, 3), axis=2).max(axis=0)
        assert told == pytest.approx(off, abs=0.1 * UM)
