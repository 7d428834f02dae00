"""Surfaces against finite differences and closed forms; unfit ones are refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from cnc_interp.cam.shapes import (
    BSplineSurface,
    Bumps,
    Cap,
    Cylinder,
    Plane,
    RationalSurface,
    Torus,
)
from cnc_interp.cam.surface import Placed, SurfaceError
from cnc_interp.cam.surface_file import read_part
from cnc_interp.core import MM

EXAMPLES = Path(__file__).parents[2] / 'examples'


def wavy(rows=9, columns=7):
    x, y = np.meshgrid(
        np.linspace(-30, 30, rows) * MM, np.linspace(-20, 20, columns) * MM, indexing='ij'
    )
    z = 2 * MM * np.sin(x / (10 * MM)) * np.cos(y / (10 * MM))
    return np.stack([x, y, z], axis=-1)


def rational():
    spline = BSplineSurface.through(wavy()).spline
    weights = np.random.default_rng(8).uniform(0.9, 1.1, spline.c.shape[:2])
    return spline.t, spline.c, weights


TURN = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]])
SURFACES = {
    'plane': Plane((0.05, 0.04)),
    'bumps': Bumps((0.05, 0.04), [(0, 0, 0.003, 0.01), (0.01, 0.01, -0.002, 0.008)]),
    'cap': Cap((0.1, 0.1), 0.03, 0.02, 0.7),
    'cylinder': Cylinder(0.03, 1.0, 0.05),
    'trough': Cylinder(0.03, 1.0, 0.05, hollow=True),
    'torus': Torus(0.05, 0.02, 1.0, 1.0),
    'sphere': Torus(0.0, 0.02, 1.0, 1.0),
    'bspline': BSplineSurface.through(wavy()),
    'rational': RationalSurface(*rational()),
    'placed': Placed(Torus(0.05, 0.02, 1.0, 1.0), TURN, np.array([0.01, 0.02, 0.03])),
}


def random_parameters(surface, count=60):
    rng = np.random.default_rng(5)
    return tuple(rng.uniform(low, high, count) for low, high in surface.domain)


@pytest.mark.parametrize('name', SURFACES)
def test_derivatives_are_those_of_differences(name):
    surface = SURFACES[name]
    u, v = random_parameters(surface)
    h, k = (2e-5 * (high - low) for low, high in surface.domain)
    s = surface.derivatives(u, v)
    by_u = [
        (a - b) / (2 * h)
        for a, b in zip(surface.derivatives(u + h, v), surface.derivatives(u - h, v), strict=True)
    ]
    by_v = [
        (a - b) / (2 * k)
        for a, b in zip(surface.derivatives(u, v + k), surface.derivatives(u, v - k), strict=True)
    ]
    second = max(np.abs(x).max() for x in s[3:]) + 1e-9
    np.testing.assert_allclose(by_u[0], s[1], atol=1e-8 * np.abs(s[1]).max())
    np.testing.assert_allclose(by_v[0], s[2], atol=1e-8 * np.abs(s[2]).max())
    for found, expected in ((by_u[1], s[3]), (by_v[1], s[4]), (by_u[2], s[4]), (by_v[2], s[5])):
        np.testing.assert_allclose(found, expected, atol=1e-6 * second)
    point = surface.at(u, v)
    turned = (surface.at(u + h, v).normal - surface.at(u - h, v).normal) / (2 * h)
    np.testing.assert_allclose(turned, point.n_u, atol=1e-6 * (np.abs(point.n_u).max() + 1.0))


@pytest.mark.parametrize('name', SURFACES)
def test_a_surface_ends_at_its_domain(name):
    low, high = np.transpose(SURFACES[name].domain)
    shares = np.array([[0.0, 1.0], [1.0, 0.0], [-0.01, 0.5], [0.5, 1.01]])
    found = SURFACES[name].contains(*(low + shares * (high - low)).T)
    assert found.tolist() == [True, True, False, False]


@pytest.mark.parametrize('name', SURFACES)
def test_foot_points_are_found(name):
    surface = SURFACES[name]
    u, v = random_parameters(surface)
    point = surface.at(u, v)
    rng = np.random.default_rng(3)
    height = rng.uniform(-0.3, 1.5, len(u)) * MM
    away = point.position + height[:, None] * point.normal
    near = [
        x + rng.uniform(-0.02, 0.02, len(x)) * (high - low)
        for x, (low, high) in zip((u, v), surface.domain, strict=True)
    ]
    found_u, found_v, found = surface.project(away, near[0], near[1])
    np.testing.assert_allclose(found, height, atol=1e-14)
    np.testing.assert_allclose(surface.at(found_u, found_v).position, point.position, atol=1e-12)


def test_curvatures_are_convex_positive():
    for surface, expected in (
        (Torus(0.0, 0.02, 1.0, 1.0), (50.0, 50.0)),
        (Cylinder(0.025, 1.0, 0.05), (0.0, 40.0)),
        (Cylinder(0.025, 1.0, 0.05, hollow=True), (-40.0, 0.0)),
    ):
        low, high = surface.at(*random_parameters(surface)).principal_curvatures()
        np.testing.assert_allclose(low, expected[0], atol=1e-5)
        np.testing.assert_allclose(high, expected[1], atol=1e-5)


def test_spline_through_points_goes_through_them():
    points = wavy()
    surface = BSplineSurface.through(points)
    u, v = (np.full(points.shape[:2], 0.5) for _ in range(2))
    foot_u, foot_v = np.meshgrid(
        np.linspace(0, 1, points.shape[0]), np.linspace(0, 1, points.shape[1]), indexing='ij'
    )
    _, _, height = surface.project(points, foot_u, foot_v)
    assert np.abs(height).max() < 1e-13 and u.shape == v.shape


def test_offset_into_a_centre_of_curvature_is_refused():
    trough = Cylinder(0.004, 1.0, 0.02, hollow=True)
    trough.check(3.9 * MM)
    with pytest.raises(
        SurfaceError, match=r'corner radius of 4.1 mm .* smallest concave .* is 4 '
    ):
        trough.check(4.1 * MM)


def test_offset_into_a_far_part_is_refused():
    # A spiral machined from outside: the next turn lies 6 mm further out.
    angle = np.linspace(0.0, 3.0 * np.pi, 90)
    radius = 10 * MM + 6 * MM * angle / (2 * np.pi)
    line = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    points = np.stack([np.insert(line, 1, y, axis=1) for y in np.linspace(0, 8, 6) * MM], axis=1)
    spiral = BSplineSurface.through(points)
    middle = spiral.at(np.array([0.1]), np.array([0.5]))
    if middle.normal[0] @ (middle.position[0] * [1, 0, 1]) < 0.0:
        spiral = BSplineSurface.through(points, flip=True)
    spiral.check(2 * MM)
    with pytest.raises(SurfaceError, match='meets another part'):
        spiral.check(4 * MM)


def test_folded_surface_is_refused():
    points = wavy()
    points[:, :, 0] = np.abs(points[:, :, 0]) + 0.02 * points[:, :, 0]
    with pytest.raises(SurfaceError, match=r'folds|degenerate'):
        BSplineSurface.through(points).check()


def test_bundled_example_is_readable():
    surface = read_part(EXAMPLES / 'bumps.json').surfaces[1]
    surface.check(1.5 * MM)
    assert surface.at(np.zeros(1), np.zeros(1)).normal[0, 2] > 0.5


def write(path, **contents):
    path.write_text(json.dumps(contents))
    return path


def test_files_of_splines_and_grids_give_the_same_surface(tmp_path):
    points = wavy()
    made = BSplineSurface.through(points)
    t = made.spline.t
    rows = (points / MM).tolist()
    first = read_part(write(tmp_path / 'g.json', kind='grid', points_mm=rows)).surfaces[1]
    second = read_part(
        write(
            tmp_path / 's.json',
            kind='bspline',
            knots_u=t[0].tolist(),
            knots_v=t[1].tolist(),
            points_mm=(made.spline.c / MM).tolist(),
        )
    ).surfaces[1]
    u, v = random_parameters(made)
    for other in (first, second):
        np.testing.assert_allclose(other.at(u, v).position, made.at(u, v).position, atol=1e-15)


@pytest.mark.parametrize(
    ('contents', 'says'),
    [
        ({'kind': 'cone'}, "kind is 'cone'; it must be one of plane"),
        ({'kind': 'plane'}, 'size_mm is missing'),
        ({'kind': 'plane', 'size_mm': [1]}, 'size_mm must hold 2 finite numbers'),
        ({'kind': 'plane', 'size_mm': [1, 'a']}, 'size_mm must hold 2 finite numbers'),
        ({'kind': 'plane', 'size_mm': [1, -2]}, 'size must be two positive lengths'),
        ({'kind': 'plane', 'size_mm': [9, 9], 'hight': 2}, 'plane has no key hight'),
        ({'kind': 'bumps', 'size_mm': [9, 9], 'bumps_mm': [[0, 0, 1, 0]]}, 'a positive width'),
        ({'kind': 'grid', 'points_mm': [[[0, 0, 0]] * 3] * 3}, 'at least 4 x 4 points'),
        (
            {
                'kind': 'bspline',
                'knots_u': [0, 1],
                'knots_v': [0, 1],
                'points_mm': [[[0, 0, 0]] * 4] * 4,
            },
            '2 knots in u for 4 control points of degree 3; there must be 8',
        ),
        (
            {'kind': 'plane', 'size_mm': [9, 9], 'placement': [1]},
            'placement must have rotation_deg',
        ),
    ],
)
def test_wrong_files_are_answered_with_file_and_key(contents, says, tmp_path):
    file = write(tmp_path / 'wrong.json', **contents)
    with pytest.raises(SurfaceError) as caught:
        read_part(file)
    assert str(caught.value).startswith(f'{file}: ') and says in str(caught.value)
