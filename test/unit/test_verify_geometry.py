"""The proof's distances against brute force."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from cnc_interp.core import MM
from cnc_interp.proof.completeness import VertexSearch
from cnc_interp.proof.order import Pieces
from cnc_interp.proof.programmed_path import ProgrammedPath, distances_to_vertices

HEIGHT = 30 * MM


def slerp(first, last, part):
    angle = np.arccos(np.clip(first @ last, -1, 1))
    share = np.asarray(part)[:, None]
    return (np.sin((1 - share) * angle) * first + np.sin(share * angle) * last) / np.sin(angle)


def brute_force(tip, axis, point, rounds=5):
    """Nearest distance to the locus of one block: ever finer grids around every coarse minimum."""
    best = np.inf
    part = np.linspace(0, 1, 2001)
    step = part[1]

    def distance(at):
        return np.linalg.norm(
            tip[0] + at[:, None] * (tip[1] - tip[0]) + HEIGHT * slerp(*axis, at) - point, axis=1
        )

    coarse = distance(part)
    for j in np.argsort(coarse)[:3]:
        centre, width = part[j], step
        for _ in range(rounds):
            fine = np.linspace(max(0, centre - width), min(1, centre + width), 401)
            found = distance(fine)
            centre, width = fine[np.argmin(found)], width / 100
            best = min(best, found.min())
    return best


@pytest.mark.parametrize('seed', range(30))
def test_distances_to_one_turning_block(seed):
    rng = np.random.default_rng(seed)
    tip = rng.normal(scale=10.0 ** rng.uniform(-3, -1), size=(2, 3))
    axis = rng.normal(size=(2, 3))
    axis[1] = axis[0] + 10.0 ** rng.uniform(-3, 1) * axis[1]
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    part = rng.uniform(size=4)
    pose = tip[0] + part[:, None] * (tip[1] - tip[0])
    pose = pose + rng.normal(scale=10.0 ** rng.uniform(-6, -3), size=pose.shape)
    towards = slerp(*axis, part) + rng.normal(scale=1e-3, size=(4, 3))
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    program = ProgrammedPath.of(tip, axis, np.full((2, 2), np.nan), HEIGHT)
    found = program.deviation(pose, towards, np.ones(4, dtype=np.int64))
    for i in range(4):
        best = brute_force(tip, axis, pose[i] + HEIGHT * towards[i])
        assert found.orientation[i] == pytest.approx(best, abs=1e-9)
        along = np.clip(
            (pose[i] - tip[0]) @ (tip[1] - tip[0]) / np.sum((tip[1] - tip[0]) ** 2), 0, 1
        )
        foot = tip[0] + along * (tip[1] - tip[0])
        assert found.contour[i] == pytest.approx(np.linalg.norm(pose[i] - foot), abs=1e-12)


@pytest.mark.parametrize('seed', range(60))
def test_points_of_a_locus_that_turns_and_folds_have_no_distance(seed):
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=(2, 3))
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    tip = rng.normal(scale=30 * MM, size=(2, 3))
    part = rng.uniform(size=20)
    top = tip[0] + part[:, None] * (tip[1] - tip[0]) + HEIGHT * slerp(*axis, part)
    # The same top points, reached with another tip and axis.
    upright = np.tile([0.0, 0.0, 1.0], (20, 1))
    program = ProgrammedPath.of(tip, axis, np.full((2, 2), np.nan), HEIGHT)
    found = program.deviation(top - HEIGHT * upright, upright, np.ones(20, dtype=np.int64))
    assert found.orientation.max() < 1e-9


def test_the_nearest_of_several_blocks_is_found():
    corners = np.array([[0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0.0]]) * MM
    up = np.tile([0.0, 0.0, 1.0], (4, 1))
    program = ProgrammedPath.of(corners, up, np.full((4, 2), np.nan), HEIGHT)
    tip = np.array([[9.0, 0.4, 0.0], [9.7, 5.0, 0.0]]) * MM
    found = program.deviation(tip, up[:2], np.array([1, 1]))
    assert found.contour == pytest.approx([0.4 * MM, 0.3 * MM])
    assert list(found.row) == [1, 2]
    assert found.part == pytest.approx([0.9, 0.5])
    assert found.orientation == pytest.approx(found.contour)


def test_a_vertex_is_approached_between_two_samples_of_an_arc():
    radius, step = 5 * MM, 0.05
    angle = (np.arange(20) + 0.5) * step - 10 * step
    points = radius * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    vertex = np.array([[radius + 2e-6, 0.0, 0.0]])
    nearest, where = distances_to_vertices(points, vertex, np.array([0]), np.array([19]))
    # The arc itself is 2 um away; its chords are 3.6 um away.
    assert nearest[0] == pytest.approx(2e-6, abs=2e-8)
    assert where[0] == 9


@pytest.mark.parametrize('shift', [0.0, 0.25, 0.5])
def test_a_corner_whose_acceleration_peaks_between_two_samples_passes_its_vertex(shift):
    # As through cds.ngc on xyzbc: 20 um are used to the full, the samples stand on both sides.
    jerk, period, push = np.array([50.0, -50.0, 0.0]), 1e-3, np.array([0.3, -0.3, 0.0])

    def at(t):
        acceleration = push * t[:, None] ** 2 / 2 - jerk * np.abs(t[:, None]) ** 3 / 6
        return acceleration + np.array([2e-3, 2e-3, 0.0]) * t[:, None]

    samples = at(period * (np.arange(-8, 9) + shift))
    vertex = np.array([samples[0], [-14e-6, 14e-6, 0.0], samples[-1]])
    true = np.linalg.norm(at(np.linspace(-0.01, 0.01, 20001)) - vertex[1], axis=1).min()
    plan = SimpleNamespace(
        position=samples,
        block=np.r_[np.ones(9, np.int64), np.full(8, 2)],
        blocks={'tip': vertex, 'exact_stop': np.array([False, False, True])},
    )

    def judged(tolerance):
        search = VertexSearch(plan)
        return search.nearest(lambda points: points, vertex, np.full(3, tolerance))[0][1]

    assert judged(true) <= true
    # A vertex that is really missed stays so: the bound is finer than a tenth of a micrometre.
    assert judged(true - 1e-7) > true - 1e-7


def test_the_first_sample_that_leaves_the_order_is_told():
    ends, room = np.array([[0.0], [1.0]]), np.full((2, 1), 0.1)
    pursuit = Pieces(np.zeros(1, int), ends[:1], ends[1:], room[:1], ends, room).pursuit()
    for first in (0, 3):
        reached = pursuit.follow(np.full((6, 1), 9.0), first, 6)
        assert pursuit.lost == 0 and (np.array(reached) == -1).all()


def test_a_vertex_is_passed_by_the_curve_not_by_its_chord():
    ends = np.array([[-0.5, 0.0], [1.0, 0.0], [1.5, 0.0]])
    room = np.full((3, 2), 1.0)
    x = np.array([-0.5, -0.5, -0.5, 0.5, 1.5, 1.5])
    for height, passes in ((0.0, True), (-0.1, False)):
        at_vertex = np.array([[1.0], [0.01], [1.0]]) * room
        pieces = Pieces(np.arange(2), ends[:2], ends[1:], room[:2], ends, at_vertex)
        pursuit = pieces.pursuit()
        pursuit.follow(np.c_[x, height - 0.08 * (x - 1.0) ** 2], 0, 3)
        assert (pursuit.furthest == 2) == passes
