"""A hundred thousand random corners: tolerance and continuity recomputed from the curves."""

import numpy as np
import pytest
from scipy.interpolate import BPoly, BSpline

from cnc_interp.smoothing.corner import Corners, Style, first_lengths, fit
from cnc_interp.smoothing.curves import poses
from cnc_interp.smoothing.orientation import cross, dot, norm, rotations_between, turned_by
from cnc_interp.smoothing.ratio import ratios_at
from cnc_interp.units import DEG, MM, UM

HEIGHT = 30 * MM
COUNT = 50000
KNOTS = [0.0] * 4 + [0.5] + [1.0] * 4


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


def axis_derivatives(curves, side):
    """o, o_s and o_ss where a corner begins (side 0) or ends (1), from its control points."""
    forward = slice(None) if side == 0 else slice(None, None, -1)
    p, t = curves.bottom[:, forward], curves.top[:, forward]
    e, n = curves.connection[:, forward], curves.connection.shape[1] - 1
    d0 = t[:, 0] - p[:, 0]
    first = [6 * (x[:, 1] - x[:, 0]) for x in (p, t)]
    second = [24 * x[:, 0] - 36 * x[:, 1] + 12 * x[:, 2] for x in (p, t)]
    d1 = first[1] - first[0] + n * e[:, 1]
    d2 = second[1] - second[0] + n * (n - 1) * (e[:, 2] - 2 * e[:, 1])
    size = norm(d0)[:, None]
    o = d0 / size
    along = dot(d1, o)[:, None]
    o1 = (d1 - along * o) / size
    grow = (dot(d1, d1)[:, None] + dot(d0, d2)[:, None]) / size - along**2 / size
    o2 = (d2 - 2 * along * o1 - grow * o) / size
    v = norm(first[0])[:, None]
    v1 = dot(first[0], second[0])[:, None] / v
    return o, o1 / v, (o2 - o1 / v * v1) / v**2


def fitted(seed, count, method, in_step, septic):
    """Random corners within their tolerances: what is programmed, L2, curves, deviations."""
    lengths, corners = random_corners(seed, count)
    style, ratios = Style(HEIGHT, in_step, method, septic), ratios_at(corners, HEIGHT, None)
    start = first_lengths(corners, 0.5 * lengths, ratios)
    _, outer, curves, deviation = fit(corners, *start, style, ratios)
    return corners, outer, curves, deviation


@pytest.fixture(scope='module', params=[False, True], ids=['quintic', 'septic'])
def many(request):
    return fitted(1 + request.param, COUNT, 'exact', True, request.param)


def rounding(corners):
    """Errors that come from the last digit of coordinates up to 0.2 m [m]."""
    return 1e-13 + 3e-16 * HEIGHT * norm(corners.rates).max(axis=1)


def test_tool_axis_continues_to_the_second_derivative(many):
    corners, outer, curves, _ = many
    for side, sense in ((0, 1.0), (1, -1.0)):  # seen inward from each end
        rate = corners.rates[:, side] * sense
        o, o_s, o_ss = axis_derivatives(curves, side)
        expected = corners.axis_at(side, outer[:, side])
        turn = cross(rate, expected)
        bend = -dot(rate, rate)[:, None] * expected
        size = outer[:, side, None]
        swing = norm(rate)[:, None] * size
        # Relative to the corner's own swing; unit vectors carry rounding of their own.
        assert (np.abs(o - expected) < 1e-13).all()
        assert (np.abs(o_s - turn) * size < 1e-9 * swing + 3e-14).all()
        assert (np.abs(o_ss - bend) * size**2 < 1e-9 * swing + 3e-13).all()


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


@pytest.mark.parametrize('method, in_step, septic', WAYS)
def test_no_sample_of_a_corner_is_beyond_the_bound_and_the_bound_is_close(method, in_step, septic):
    u = np.linspace(0.0, 1.0, 20001)
    corners, outer, curves, deviation = fitted(4, 60, method, in_step, septic)
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


def test_great_circles_between_axes_end_where_they_should():
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, 1000, 3))
    a, b = a / norm(a)[:, None], b / norm(b)[:, None]
    assert np.abs(turned_by(a, rotations_between(a, b), 1.0) - b).max() < 1e-14
