"""Random corners: tolerance and continuity recomputed from the curves."""

import numpy as np
import pytest
from scipy.interpolate import BPoly, BSpline
from scipy.special import comb
from tiers import examples

from cnc_interp.core import DEG, MM, UM, cross, dot, norm
from cnc_interp.smoothing.corners.connection import poses
from cnc_interp.smoothing.corners.corner_curve import (
    PAPER_RATIO,
    Corners,
    Style,
    fit,
    initial_lengths,
    ratios_at,
)
from cnc_interp.smoothing.orientation import rotations_between, turned_by

HEIGHT = 30 * MM
COUNT = examples(1000, 50_000)
KNOTS = [0.0] * 4 + [0.5] + [1.0] * 4
#: Sum of the weights that points have in each term of a cubic's power series.
WEIGHTS = (1, 12, 48, 64)


def random_corners(seed, count):
    """Angles 1-179 deg, lines 1 um - 1 m, rotations 0-60 deg a line, tolerances 1 um - 5 mm."""
    rng = np.random.default_rng(seed)

    def spread(low, high, *shape):
        return np.exp(rng.uniform(np.log(low), np.log(high), (count, *shape)))

    def directions():
        v = rng.normal(size=(count, 3))
        return v / norm(v)[:, None]

    axis, first = directions(), directions()
    turn = rng.uniform(1 * DEG, 179 * DEG, count)
    normal = cross(first, directions())
    second = turned_by(first, normal / norm(normal)[:, None], turn)
    lengths = spread(1 * UM, 1.0, 2)
    rates = []
    for side in (0, 1):
        normal = cross(axis, directions())
        swing = rng.uniform(0.0, 60 * DEG, count) * (rng.random(count) < 0.8)
        rates.append(normal / norm(normal)[:, None] * (swing / lengths[:, side])[:, None])
    return lengths, Corners(
        tip=rng.uniform(-0.2, 0.2, (count, 3)),
        axis=axis,
        legs=np.stack([-first, second], axis=1),
        rates=np.stack(rates, axis=1),
        tolerances=spread(1 * UM, 5 * MM, 2),
    )


def product(a, b):
    """Product of two power series, the terms along axis 0."""
    return np.stack([sum(a[j] * b[k - j] for j in range(k + 1)) for k in range(len(a))])


def power(a, exponent):
    """Power series to a power, by the recurrence that r' a = exponent r a' gives."""
    r = [a[0] ** exponent]
    for k in range(1, len(a)):
        terms = ((exponent * j - (k - j)) * a[j] * r[k - j] for j in range(1, k + 1))
        r.append(sum(terms) / (k * a[0]))
    return np.stack(r)


def squared(a):
    """Power series of the square of the length of vectors, (terms, n, 1)."""
    return product(a, a).sum(axis=2, keepdims=True)


def cubic_series(points):
    """Power series by u of a corner's B-spline at its first point, (4, n, 3)."""
    a, b, c = points[:, 1], 0.5 * (points[:, 1] + points[:, 2]), points[:, 2]
    end = 0.5 * (b + 0.5 * (c + points[:, 3]))
    start = points[:, 0]
    return np.stack(
        [start, 6 * (a - start), 12 * (b - 2 * a + start), 8 * (end - 3 * b + 3 * a - start)]
    )


def bezier_series(points):
    """First four terms of the power series of a Bezier curve at its first point, (4, n, 3)."""
    n = points.shape[1] - 1
    return np.stack([comb(n, k) * np.diff(points, k, axis=1)[:, 0] for k in range(4)])


def fitted(seed, count, method, in_step, septic):
    """Random corners within their tolerances: what is programmed, L2, curves, deviations."""
    lengths, corners = random_corners(seed, count)
    style, ratios = Style(HEIGHT, in_step, method, septic), ratios_at(corners, HEIGHT, None)
    start = initial_lengths(corners, 0.5 * lengths, ratios)
    _, outer, curves, deviation = fit(corners, *start, style, ratios)
    return corners, outer, curves, deviation


@pytest.fixture(scope='module', params=[2, 3], ids=['quintic', 'septic'])
def order(request):
    """Derivatives of the tool axis that continue."""
    return request.param


@pytest.fixture(scope='module')
def many(order):
    return fitted(order - 1, COUNT, 'exact', True, order == 3)


def rounding(corners):
    """Errors that come from the last digit of coordinates up to 0.2 m [m]."""
    return 1e-13 + 3e-16 * HEIGHT * norm(corners.rates).max(axis=1)


def test_tip_and_tool_axis_continue_their_lines(many, order):
    """Tip to the second derivative, tool axis to the second or, with the septic, the third."""
    corners, outer, curves, _ = many
    for side, sense in ((0, 1.0), (1, -1.0)):  # seen inward from each end
        forward = slice(None) if side == 0 else slice(None, None, -1)
        bottom, top = (cubic_series(x[:, forward]) for x in (curves.bottom, curves.top))
        leg, size = corners.legs[:, side], outer[:, side, None]
        straight = bottom[:3] + np.zeros((3, 1, 1))
        straight[0] -= corners.tip + size * leg
        beside = straight - (straight * leg).sum(axis=2, keepdims=True) * leg
        assert (np.abs(beside) < 1e-9 * size + 1e-15).all()
        assert (np.abs(straight[0]) < 1e-9 * size + 1e-15).all()

        between = top - bottom + bezier_series(curves.connection[:, forward])
        found = product(between, power(squared(between), -0.5))
        steps = np.arange(1, 4)[:, None, None]
        way = np.concatenate([0 * size[None], power(squared(steps * bottom[1:]), 0.5) / steps])
        rate = corners.rates[:, side] * sense
        axis = corners.axis_at(side, outer[:, side])
        turn = cross(rate, axis)
        pull = -dot(rate, rate)[:, None]
        way2 = product(way, way)
        expected = turn * way + 0.5 * pull * axis * way2 + pull / 6 * turn * product(way2, way)
        expected[0] += axis
        swing = norm(rate)[:, None] * size
        # Relative to the corner's own swing; points carry the rounding of their coordinates.
        far = norm(bottom[0])[:, None]
        digit = 1e-15 * (1.0 + far / HEIGHT) + 2e-16 * far * norm(rate)[:, None]
        for k in range(order + 1):
            wrong = np.abs(found[k] - expected[k]) - 1e-9 * swing - WEIGHTS[k] * digit
            assert wrong.max() < 0.0


def top_distance(corners, top, outer, point):
    """Distance of top points from the programmed top locus, by Newton's method on both sides."""
    nearest = np.full(len(point), np.inf)
    for side in (0, 1):
        leg = corners.legs[:, side]
        chord = top[:, 4 * side] - top[:, 2]
        share = dot(point - top[:, 2], chord) / np.maximum(dot(chord, chord), 1e-300)
        x = share.clip(0.0, 1.0) * outer[:, side]
        for _ in range(3):
            axis = corners.axis_at(side, x)
            sense = 1.0 if side else -1.0
            slope = leg + sense * HEIGHT * cross(corners.rates[:, side], axis)
            gap = point - corners.tip - x[:, None] * leg - HEIGHT * axis
            x = (x + dot(gap, slope) / dot(slope, slope)).clip(0.0, outer[:, side])
        locus = corners.tip + x[:, None] * leg + HEIGHT * corners.axis_at(side, x)
        nearest = np.minimum(nearest, norm(point - locus))
    return nearest


def strayed(corners, top, outer, tip, tool, late):
    """Return how far poses in the first or second half stray: tip and top, shape (n, 2) [m]."""
    gap, swing = np.full(len(tip), np.inf), np.zeros(len(tip))
    for side in (0, 1):
        leg = corners.legs[:, side]
        x = dot(tip - corners.tip, leg).clip(0.0, outer[:, side])
        gap = np.minimum(gap, norm(tip - corners.tip - x[:, None] * leg))
        swing = np.where(late == side, norm(tool - corners.axis_at(side, x)), swing)
    away = top_distance(corners, top, outer, tip + HEIGHT * tool)
    return np.stack([gap, np.maximum(HEIGHT * swing, away)], axis=1)


def test_deviations_are_bounds_and_within_tolerance(many):
    corners, outer, curves, deviation = many
    assert (deviation <= corners.tolerances * (1 + 1e-6)).all()
    allowed = deviation * (1 + 1e-9) + rounding(corners)[:, None]
    for u in np.linspace(0.02, 0.98, 17):
        found = strayed(corners, curves.top, outer, *poses(curves, u), u > 0.5)
        assert (found <= allowed).all()


WAYS = [
    ('exact', True, False),
    ('exact', True, True),
    ('exact', False, False),
    ('exact', False, True),
    ('linear', True, False),
    ('linear', False, False),
    ('paper', True, False),
    ('paper', False, False),
]


def densely(curves, k, u):
    """Tips and tool axes of one corner at many u, by SciPy's splines."""
    tip = BSpline(KNOTS, curves.bottom[k], 3)(u)
    spans = curves.parametrization[k]
    f = BPoly(spans[:, 1:].T, [*spans[:, 0], 1.0])(u).clip(0.0, 1.0) if len(spans) else u
    lift = BPoly(curves.connection[k][:, None, :], [0.0, 1.0])(u)
    tool = BSpline(KNOTS, curves.top[k], 3)(f) + lift - tip
    return tip, tool / norm(tool)[:, None]


@pytest.mark.parametrize(
    'method, in_step, septic',
    [
        pytest.param(*way, marks=pytest.mark.thorough if k % 3 else ())
        for k, way in enumerate(WAYS)
    ],
)
def test_no_sample_of_a_corner_is_beyond_the_bound_and_the_bound_is_close(method, in_step, septic):
    u = np.linspace(0.0, 1.0, 20001)
    corners, outer, curves, deviation = fitted(4, examples(6, 60), method, in_step, septic)
    assert (deviation <= corners.tolerances * (1 + 1e-6)).all()
    for k in range(len(outer)):
        rows = np.full(len(u), k)
        tip, tool = densely(curves, k, u)
        missed = norm(tip[10000] + HEIGHT * tool[10000] - curves.top[k, 2])
        found = strayed(corners[rows], curves.top[rows], outer[rows], tip, tool, u > 0.5)
        tip, top = np.maximum(found.max(axis=0), [0.0, missed])
        assert tip <= deviation[k, 0] * (1 + 1e-9) + 1e-15
        assert top <= deviation[k, 1] * (1 + 1e-9) + rounding(corners)[k]
        assert deviation[k, 1] <= 1.02 * top + rounding(corners)[k]


LITERAL = ['paper', 'linear', 'exact']


@pytest.mark.parametrize('method', LITERAL)
def test_literal_corners_are_those_of_the_paper(method):
    """Sections 2.2 and 2.3: both polygons; Eq. 3 at both middles; each tolerance for itself."""
    lengths, corners = random_corners(5, examples(500, 20_000))
    ratios = np.full((len(lengths), 2), PAPER_RATIO)
    start = initial_lengths(corners, 0.5 * lengths, ratios, literal=True)
    style = Style(HEIGHT, False, method, False, literal=True)
    inner, outer, curves, deviation = fit(corners, *start, style, ratios)
    bottom, top = curves.bottom, curves.top
    assert np.array_equal(outer[:, 0], outer[:, 1])
    assert np.abs(outer[:, 0] / inner - 1.4).max() < 1e-12

    # The bottom: all of the tolerance, or half of the shorter line, but where the axis binds.
    cosine = dot(corners.legs[:, 0], corners.legs[:, 1])
    half_angle = 0.5 * np.arccos(cosine.clip(-1.0, 1.0))
    by_tolerance = 2.0 * corners.tolerances[:, 0] / np.cos(half_angle)
    swings = norm(corners.rates).max(axis=1) * 0.5 * lengths.min(axis=1)
    expected = np.minimum(by_tolerance, 0.5 * lengths.min(axis=1) / 1.4)
    free = (inner > 0.999 * start[0]) & (swings < 0.69)
    assert free.mean() > 0.5
    assert np.allclose(inner[free], expected[free], rtol=1e-3)
    middle = poses(curves, 0.5)[0]
    missed = norm(middle - corners.tip)
    assert np.allclose(missed, 0.5 * inner * np.cos(half_angle), rtol=1e-6, atol=1e-15)
    assert (missed <= corners.tolerances[:, 0] * (1 + 1e-9)).all()

    # The top: it begins and ends on programmed axes, and its inner points are symmetric.
    for side in (0, 1):
        end = bottom[:, 4 * side] + HEIGHT * corners.axis_at(side, outer[:, side])
        assert np.abs(top[:, 4 * side] - end).max() < 1e-14
        leg, short = (top[:, k] - top[:, 2] for k in (4 * side, 1 + 2 * side))
        assert (norm(cross(leg, short)) <= 1e-12 * norm(leg) * norm(leg) + 1e-17).all()
        assert (dot(leg, short) >= 0.0).all()
    sizes = [norm(top[:, k] - top[:, 2]) for k in (0, 1, 3, 4)]
    assert np.allclose(sizes[1], sizes[2], rtol=1e-9, atol=1e-15)
    assert (1.4 * sizes[1] <= np.minimum(sizes[0], sizes[3]) + 1e-12).all()
    bent = norm(0.25 * (top[:, 1] + top[:, 3]) - 0.5 * top[:, 2])
    assert (bent <= corners.tolerances[:, 1] * (1 + 1e-9)).all()

    # Both tolerances hold, measured at the tip and at flank height; the bounds bound.
    assert (deviation <= corners.tolerances * (1 + 1e-6)).all()
    allowed = deviation * (1 + 1e-9) + rounding(corners)[:, None]
    for u in np.linspace(0.02, 0.98, 17):
        tip, tool = poses(curves, u)
        away = top_distance(corners, top, outer, tip + HEIGHT * tool)
        gap = np.full(len(tip), np.inf)
        for side in (0, 1):
            x = dot(tip - corners.tip, corners.legs[:, side]).clip(0.0, outer[:, side])
            beside = tip - corners.tip - x[:, None] * corners.legs[:, side]
            gap = np.minimum(gap, norm(beside))
        assert (np.stack([gap, away], axis=1) <= allowed).all()


def test_great_circles_between_axes_end_where_they_should():
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, 1000, 3))
    a, b = a / norm(a)[:, None], b / norm(b)[:, None]
    assert np.abs(turned_by(a, rotations_between(a, b), 1.0) - b).max() < 1e-14
