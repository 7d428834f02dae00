"""Proven bounds at the pole against dense samples of random segments."""

from dataclasses import replace

import numpy as np
import pytest
from tiers import examples

from cnc_interp.core.bspline import (
    bezier_values,
    derivative_bounds,
    largest,
    least_length,
    weighted_largest,
)
from cnc_interp.kinematics.pole_bounds import gap_bounds, near_pole, pole_sine, rates_of, way_to
from cnc_interp.kinematics.segment_axes import (
    FOLLOWING,
    GUIDE,
    GUIDE_BEGUN,
    GUIDE_FROM,
    GUIDE_LENGTH,
    GUIDE_TO,
    NO_GUIDE,
    SegmentRows,
    beside_of,
    guide_jet,
    pose_jets,
    shapes_of,
)
from cnc_interp.machine_model.five_axis_kernels import guided_gap
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.smoothing.segments import CORNER, LINE, SPLINE, PathSegments

COUNT = examples(24, 400)
U = np.linspace(0.0, 1.0, 401)


def leaning_head():
    """A head whose tilting axis leans by 45 deg: the latitude of the tool about it is not 0."""
    heads = Machine.load('head_head')
    direction = np.array([[0.0, 0.0, 1.0], [0.0, np.sqrt(0.5), np.sqrt(0.5)]])
    return replace(heads, rotary_direction=direction)


MACHINES = [Machine.load('xyzac'), Machine.load('head_table'), leaning_head()]


def random_segments(rng, count, pole):
    """Lines, corners and splines near the pole; some corners have a parametrization of the top."""
    height = 0.03
    tip = np.cumsum(rng.normal(0.0, rng.choice([1e-4, 3e-3, 0.02]), (count, 6, 3)), axis=1)
    spread = rng.choice([1e-4, 1e-2, 0.3], (count, 1, 1))
    tool = pole + spread * np.cumsum(rng.normal(0.0, 0.5, (count, 6, 3)), axis=1)
    kind = rng.choice([LINE, CORNER, SPLINE], count)
    spans = np.zeros((count, 2, 8))
    spans[:, 1, 0] = 0.5
    same = np.linspace(0.0, 1.0, 13)
    spans[:, 0, 1:], spans[:, 1, 1:] = same[:7], same[6:]
    bent = rng.normal(0.0, 0.02, (count, 5))
    spans[:, 0, 2:7] += bent
    if rng.random() < 0.5:
        kind[kind == CORNER], spans = SPLINE, spans[:, :0]
    if rng.random() < 0.5:
        spans = spans[:, :0]
    spans = spans.copy()
    length = np.linalg.norm(tip[:, 1] - tip[:, 0], axis=1)
    axis = tool[:, 0] / np.linalg.norm(tool[:, 0], axis=1)[:, None]
    return PathSegments(
        kind=kind,
        bottom=tip,
        top=tip + height * tool,
        connection=rng.normal(0.0, 1e-4, (count, 6, 3)) * (kind != LINE)[:, None, None],
        parametrization=spans,
        axis=axis,
        rotation=np.cross(axis, rng.normal(0.0, 0.2, (count, 3))) * spread[:, 0],
        rotary=np.full((count, 6, 2), np.nan),
        length=length,
        feed=np.ones((count, 2)),
        block=np.zeros((count, 2), dtype=np.int64),
        line_number=np.zeros(count, dtype=np.int64),
        stop=np.zeros(count, dtype=bool),
        deviation=np.zeros((count, 2)),
    )


def sampled(segments, i, u):
    """Tool axis with two derivatives and the speed of the tip with its derivative, by samples."""
    return pose_jets(segments.kind[i], shapes_of(segments)[i], segments.parametrization[i], u, u)


@pytest.mark.parametrize('seed', range(3))
def test_hulls_hold_bezier_curves(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(50, 6, 3)) + rng.normal(0.0, 4.0, (50, 1, 3))
    curve = bezier_values(points.swapaxes(1, 2)[:, None], U[None, :, None])
    size = np.linalg.norm(curve, axis=2)
    assert (size.max(axis=1) <= largest(points) + 1e-12).all()
    assert (size.max(axis=1) <= weighted_largest(points) + 1e-12).all()
    assert (size.min(axis=1) >= least_length(points) - 1e-12).all()
    for bound in derivative_bounds(points):
        curve = np.gradient(curve, U, axis=1)
        inner = np.linalg.norm(curve[:, 5:-5], axis=2).max(axis=1)
        assert (inner <= bound * (1.0 + 1e-3)).all()


@pytest.mark.parametrize('seed', range(2))
def test_rates_of_the_tool_axis_are_never_exceeded(seed):
    rng = np.random.default_rng(seed)
    segments = random_segments(rng, COUNT, np.array([0.0, 0.0, 1.0]))
    rates = rates_of(segments)
    for i in range(len(segments)):
        for u in U[::4]:
            p, o = (np.array(jet) for jet in sampled(segments, i, u))
            turn, second = o[:, 1], 2.0 * o[:, 2]
            along = second - (second @ o[:, 0]) * o[:, 0]
            speed = np.linalg.norm(p[:, 1])
            rise = abs(2.0 * p[:, 2] @ p[:, 1]) / max(speed, 1e-300)
            found = np.array([np.linalg.norm(turn), np.linalg.norm(along), speed, rise])
            assert (found <= rates[i] * (1.0 + 1e-9) + 1e-12).all(), (i, u, found, rates[i])


@pytest.mark.parametrize('machine', MACHINES, ids=lambda machine: machine.name)
def test_no_place_near_the_pole_is_missed(machine):
    transform, rng = Transform.of(machine), np.random.default_rng(5)
    segments = random_segments(rng, COUNT, transform.pole)
    shapes, limits = shapes_of(segments), rng.choice([0.0, 1e-4, 3e-3, 0.1], COUNT)
    spans, turns = segments.parametrization, rates_of(segments)[:, 0].copy()
    near, _ = near_pole(transform.packed, segments.kind, shapes, spans, turns, limits)
    for i in range(len(segments)):
        sine = np.array(
            [pole_sine(transform.packed, segments.kind[i], shapes[i], spans[i], u) for u in U]
        )
        inside = U[sine <= limits[i]]
        if np.isfinite(rates_of(segments)[i, 0]):
            assert ((inside >= near[i, 0]) & (inside <= near[i, 1])).all()
        if near[i, 0] <= 1.0:  # and the places named are near
            for u in near[i]:
                found = pole_sine(transform.packed, segments.kind[i], shapes[i], spans[i], u)
                assert found <= limits[i] * 1.001 + 1e-11


@pytest.mark.parametrize('machine', MACHINES, ids=lambda machine: machine.name)
def test_deviation_is_within_its_bound_at_every_place(machine):
    transform, rng = Transform.of(machine), np.random.default_rng(7)
    segments = random_segments(rng, COUNT, transform.pole)
    shapes, beside, spans = shapes_of(segments), beside_of(segments), segments.parametrization
    reached = 0
    for i in range(len(segments)):
        one = slice(i, i + 1)
        length = float(way_to(segments.kind[i], shapes[i], beside[i], segments.length[i], 1.0))
        guides = NO_GUIDE[None].copy()
        first, last = np.sort(rng.choice([0.0, 1.0, 0.2, 0.7], 2, replace=False))
        guides[0, GUIDE_FROM], guides[0, GUIDE_TO], guides[0, GUIDE_LENGTH] = first, last, length
        guides[0, GUIDE] = rng.normal(0.0, rng.choice([0.01, 0.5]), 8)
        slope, turning = guides[0, GUIDE], np.zeros(2)
        for order in range(2):
            slope = slope[1:] * np.arange(1, len(slope)) / length
            turning[order] = np.abs(slope).sum()  # on [0, 1] no polynomial is larger
        bound = gap_bounds(
            transform.packed,
            SegmentRows.of(segments[one], np.full(1, FOLLOWING)),
            guides,
            rates_of(segments)[one],
            turning,
            np.array([1e-5]),
        )[0]
        worst = 0.0
        for u in first + (last - first) * U[::4]:
            way = way_to(segments.kind[i], shapes[i], beside[i], segments.length[i], u)
            o = pose_jets(segments.kind[i], shapes[i], spans[i], u, u)[1]
            gap = guided_gap(transform.packed, o, guide_jet(guides[0], way, GUIDE_BEGUN)[0])
            worst = max(worst, abs(gap))
        assert worst <= bound + 1e-12
        reached += bool(bound < 1.05 * worst)
    assert reached > COUNT // 4  # the bounds are close, too
