"""Iso-scallop passes: closed forms, both conditions, shared scallops, and clear refusals."""

import numpy as np
import pytest
from scipy.optimize import brentq

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.gouge import gouge_depth
from cnc_interp.cam.guiding import GuidingPlanes
from cnc_interp.cam.iso_scallop import IsoScallopOptions, iso_scallop_paths
from cnc_interp.cam.passes import constant_tilt
from cnc_interp.cam.scallop import fit_postures, scallop_points
from cnc_interp.cam.shapes import Bumps, Cylinder, Plane, Torus
from cnc_interp.cam.surface import SurfaceError
from cnc_interp.core import DEG, MM, UM, InterpError

MILL = Cutter(5 * MM, 1.5 * MM)
HEIGHT = 10 * UM
X, Y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
BUMPS = Bumps((0.04, 0.03), [(0, 0, 0.003, 0.015), (0.01, 0.01, -0.002, 0.012)])


def one_pass(surface, tilt, normal=Y, yaw=0.0, count=41, mill=MILL):
    planes = GuidingPlanes(surface, mill.corner_radius, normal, 3 * MM)
    curve = planes.curve(0.5 * sum(planes.span))
    angles = constant_tilt(curve, tilt, yaw, count)
    return planes, curve, angles.postures(curve, mill, angles.s)


def half_width_on_plane(tilt, mill=MILL, height=HEIGHT):
    """Half width of a straight cut: the mill's outline along the feed is an offset ellipse."""
    R, r, s = mill.tool_radius, mill.corner_radius, np.sin(tilt)

    def point(phi):
        x, z = R * np.sin(phi), R * s * (1 - np.cos(phi))
        slope = np.array([R * np.cos(phi), R * s * np.sin(phi)])
        down = np.array([slope[1], -slope[0]]) / np.linalg.norm(slope)
        return np.array([x, z + r]) + r * down

    phi = brentq(lambda p: point(p)[1] - height, 1e-9, 1.5, xtol=1e-15)
    return point(phi)[0]


@pytest.mark.parametrize('tilt', [1.0, 3.0, 5.0, 10.0, 45.0])
def test_width_on_a_plane_is_that_of_the_offset_ellipse(tilt):
    plane = Plane((0.03, 0.02))
    _, _, postures = one_pass(plane, tilt * DEG)
    for side in (1.0, -1.0):
        found = scallop_points(plane, postures, HEIGHT, side)
        expected = half_width_on_plane(tilt * DEG)
        np.testing.assert_allclose(found.half_width(postures), expected, rtol=1e-6)
    radius = MILL.effective_radius(tilt * DEG)
    assert np.sqrt(8 * HEIGHT * radius) == pytest.approx(2 * expected, rel=0.035)


@pytest.mark.parametrize(
    ('surface', 'normal', 'curvature'),
    [
        (Cylinder(0.03, 0.8, 0.03), X, 1 / 0.03),
        (Torus(0, 0.05, 0.5, 0.4), Y, 1 / 0.05),
        (Cylinder(0.2, 0.1, 0.03, hollow=True), X, -1 / 0.2),
    ],
)
def test_width_on_curved_surfaces_follows_the_curvatures(surface, normal, curvature):
    _, _, postures = one_pass(surface, 10 * DEG, normal)
    found = scallop_points(surface, postures, HEIGHT)
    kappa = 1 / MILL.effective_radius(10 * DEG) + curvature
    np.testing.assert_allclose(postures.frames.curvature, curvature, rtol=1e-9)
    np.testing.assert_allclose(
        2 * found.half_width(postures), np.sqrt(8 * HEIGHT / kappa), rtol=0.03
    )


def test_frames_move_as_their_rates_say():
    planes = GuidingPlanes(BUMPS, MILL.corner_radius, Y, 3 * MM)
    curve = planes.curve(1.3 * MM)
    s = np.linspace(0.0, curve.length, 60)
    here, ahead, behind = (curve.frames(s + ds) for ds in (0.0, 1e-6, -1e-6))
    np.testing.assert_allclose(here.position @ Y, curve.plane, atol=1e-11)
    for name, rate in (
        ('position', here.feed),
        ('normal', here.normal_rate),
        ('feed', here.feed_rate),
        ('across', here.across_rate),
    ):
        found = (getattr(ahead, name) - getattr(behind, name)) / 2e-6
        np.testing.assert_allclose(found, rate, atol=1e-5)


@pytest.mark.parametrize('yaw', [0.0, 25.0])
def test_axis_turns_as_the_rotation_vector_says(yaw):
    _, curve, _ = one_pass(BUMPS, 5 * DEG)
    angles = constant_tilt(curve, 5 * DEG, yaw * DEG, 30)
    wavy = type(angles)(angles.s, 0.1 + 0.05 * np.sin(angles.s / (5 * MM)), angles.yaw)
    s = np.linspace(0.2, 0.8, 20) * curve.length
    here, ahead, behind = (wavy.postures(curve, MILL, s + ds) for ds in (0.0, 1e-7, -1e-7))
    turned = np.cross(here.turn, here.axis)
    np.testing.assert_allclose((ahead.axis - behind.axis) / 2e-7, turned, atol=1e-4)
    moved = here.velocity(here.centre)
    np.testing.assert_allclose((ahead.centre - behind.centre) / 2e-7, moved, atol=1e-5)


def test_scallop_points_satisfy_the_three_equations_of_the_paper():
    _, _, p = one_pass(BUMPS, 4 * DEG)
    found = scallop_points(BUMPS, p, HEIGHT)
    R, r = MILL.tool_radius, MILL.corner_radius
    # Eq. 3.2: F = (v.v + R^2 - r^2)^2 - 4 R^2 rho^2 is zero on the torus; rho across the axis.
    v = found.position - p.centre
    across = v - np.sum(v * p.axis, axis=-1, keepdims=True) * p.axis
    bracket = np.sum(v * v, axis=-1, keepdims=True) + R**2 - r**2
    implicit = bracket[..., 0] ** 2 - 4 * R**2 * np.sum(across**2, axis=-1)
    scale = 8 * R * R * r  # dF/d(distance) on the torus, about
    assert np.abs(implicit).max() / scale < 1e-12
    assert np.sum(v * p.axis, axis=-1).max() < 0.0  # on the bottom of the mill, below its circle
    moved = p.velocity(found.position)
    normal = bracket * v - 2 * R**2 * across  # the gradient of F, over 4
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    assert np.abs(np.sum(moved * normal, axis=-1)).max() < 1e-9  # Eq. 3.3
    _, _, height = BUMPS.project(found.position, p.frames.u, p.frames.v)
    np.testing.assert_allclose(height, HEIGHT, atol=2e-11)


@pytest.mark.parametrize('freedom', ['tilt', 'yaw'])
def test_next_pass_leaves_the_same_scallop(freedom):
    surface = BUMPS if freedom == 'tilt' else Plane((0.03, 0.02))
    planes, curve, p = one_pass(surface, 5 * DEG)
    right = scallop_points(surface, p, HEIGHT)
    beside = planes.curve(curve.plane + 2 * MM)
    fixed = 0.0 if freedom == 'tilt' else 2 * DEG
    fit = fit_postures(beside, MILL, right, HEIGHT, freedom, fixed)
    assert fit.found.all() and (fit.iterations < 20).all()
    kind = type(constant_tilt(beside, 0.1, 0.0, 9))
    q = kind(fit.s, fit.tilt, fit.yaw).postures(beside, MILL, fit.s)
    left = scallop_points(surface, q, HEIGHT, -1.0)
    inner = slice(2, -2)  # the ends of the spline of angles are free
    np.testing.assert_allclose(left.position[inner], right.position[inner], atol=2e-8)


def test_flat_mill_meets_the_scallop_with_its_edge():
    mill = Cutter(6 * MM, 0.0)
    planes, curve, p = one_pass(Plane((0.03, 0.02)), 5 * DEG, mill=mill)
    right = scallop_points(planes.surface, p, HEIGHT)
    np.testing.assert_allclose(right.half_width(p), half_width_on_plane(5 * DEG, mill), rtol=1e-7)
    fit = fit_postures(planes.curve(curve.plane + 2 * MM), mill, right, HEIGHT, 'tilt', 0.0)
    assert fit.found.all()
    wide = 2 * MM - right.half_width(p)[0]
    assert half_width_on_plane(fit.tilt[20], mill) == pytest.approx(wide, rel=1e-6)


def test_all_passes_cover_the_surface_and_share_their_scallops():
    options = IsoScallopOptions(stepover=2 * MM, tilt=3 * DEG)
    paths = iso_scallop_paths(BUMPS, MILL, Y, options)
    planes = np.array([p.plane for p in paths.passes])
    np.testing.assert_allclose(np.diff(planes), 2 * MM, atol=1e-9)
    assert planes[0] < -14 * MM and planes[-1] > 13 * MM
    for a, b in zip(paths.passes[:-1], paths.passes[1:], strict=True):
        left = scallop_points(BUMPS, b.postures, HEIGHT, -1.0)
        inner = slice(4, -4)
        there = [
            np.interp(left.position[inner, 0], a.right.position[::-1, 0], x[::-1])
            for x in a.right.position.T[1:]
        ]
        np.testing.assert_allclose(left.position[inner, 1], there[0], atol=20 * UM)
    assert all(gouge_depth(BUMPS, p.postures).max() < 1 * UM for p in paths.passes)


def test_constant_tilt_on_a_plane_alternates_for_ever():
    options = IsoScallopOptions(stepover=2.5 * MM, tilt=5 * DEG, start='tilt', stray=None)
    paths = iso_scallop_paths(Plane((0.03, 0.02)), MILL, Y, options)
    tilts = [float(np.median(p.postures.tilt)) / DEG for p in paths.passes]
    np.testing.assert_allclose(tilts[0::2], 5.0, rtol=1e-3)
    np.testing.assert_allclose(tilts[1::2], 2.82, rtol=2e-3)


@pytest.mark.thorough
def test_largest_distance_keeps_the_tilt():
    options = IsoScallopOptions(tilt=3 * DEG)
    paths = iso_scallop_paths(BUMPS, MILL, Y, options)
    tilt = np.concatenate([p.postures.tilt for p in paths.passes])
    assert tilt.min() > 2.9 * DEG
    fixed = iso_scallop_paths(BUMPS, MILL, Y, IsoScallopOptions(stepover=1.6 * MM))
    assert len(paths.passes) < len(fixed.passes)


@pytest.mark.parametrize(
    ('surface', 'mill', 'options', 'says'),
    [
        (Plane((0.03, 0.02)), MILL, {'stepover': 0.7 * MM}, 'too narrow .* larger plane distance'),
        (BUMPS, MILL, {'stepover': 6 * MM}, 'too wide .* smaller plane distance'),
        (
            BUMPS,
            MILL,
            {'stepover': 5 * MM, 'start': 'tilt', 'stray': None},
            r'pass 2, point \d+ at .* a plane distance of 5.000 mm does not fit',
        ),
        (
            Cylinder(0.02, 0.8, 0.03, hollow=True),
            Cutter(5 * MM, 3 * MM),
            {'stepover': 1 * MM, 'start': 'tilt', 'stray': None, 'tilt_limits': (DEG, 80 * DEG)},
            'take|enters',
        ),
        (Cylinder(0.001, 0.5, 0.03, hollow=True), MILL, {}, 'smallest concave radius is 1 mm'),
        (Plane((0.03, 0.02)), Cutter(0.0, 5 * MM), {}, 'ball mill'),
    ],
)
def test_what_does_not_fit_is_refused_with_place_and_remedy(surface, mill, options, says):
    with pytest.raises(SurfaceError, match=says):
        iso_scallop_paths(surface, mill, Y, IsoScallopOptions(**options))


HOLLOW = Cylinder(0.1, 0.4, 0.012, hollow=True)


def test_heel_in_a_hollow_is_seen():
    options = IsoScallopOptions(stepover=4 * MM, tilt_limits=(0.1 * DEG, 60 * DEG), stray=None)
    with pytest.raises(SurfaceError, match='bottom of the mill enters the surface by'):
        iso_scallop_paths(HOLLOW, MILL, Y, options)


@pytest.mark.thorough
def test_heel_in_a_hollow_raises_the_tilt_and_brings_the_planes_closer():
    options = IsoScallopOptions(stepover=4 * MM, tilt_limits=(0.1 * DEG, 60 * DEG))
    paths = iso_scallop_paths(HOLLOW, MILL, Y, options)
    planes = np.array([p.plane for p in paths.passes])
    assert 2.7 * MM < np.diff(planes).min() < 3.9 * MM
    assert all(gouge_depth(HOLLOW, p.postures)[p.kept].max() < 1 * UM for p in paths.passes)
    assert all('pass' in note and 'enters the surface' in note for note in paths.notes)
    for a, b in zip(paths.passes[:-1], paths.passes[1:], strict=True):
        assert b.plane - a.plane < a.kept_reach.min() + b.kept_reach.min() + 20 * UM


@pytest.mark.parametrize(
    'wrong', [{'tilt': 70 * DEG}, {'scallop_height': 0.0}, {'stepover': -1.0}, {'points': 3}]
)
def test_wrong_choices_are_refused(wrong):
    with pytest.raises(InterpError):
        IsoScallopOptions(**wrong)
