"""The classical iso-scallop path: closed forms, its scallops, and its loops."""

import numpy as np
import pytest
from classical_passes import SurfaceCurve, _Run, classical_paths, crossing

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.guiding import GuidingPlanes
from cnc_interp.cam.shapes import Bumps, Cap, Plane, Torus
from cnc_interp.cam.simulation import Motion, cross_sections
from cnc_interp.cam.spline_pass import SplinePass
from cnc_interp.cam.surface import SurfaceError
from cnc_interp.cam.tool_path import LinkOptions, ToolPath, link
from cnc_interp.core import DEG, MM, UM

MILL, BALL = Cutter(5 * MM, 1.5 * MM), Cutter(0.0, 5 * MM)
HEIGHT = 10 * UM
Y = np.array([0.0, 1.0, 0.0])
BUMPS = Bumps((0.03, 0.02), [(0, 0, 0.002, 0.01)])


def test_ball_on_a_plane_steps_as_circles_do(monkeypatch):
    solved, corrections = _Run.solved, []

    def seen(run, right, along, u, v):
        found = solved(run, right, along, u, v)
        corrections.append(np.abs(np.subtract(found[:2], (u, v))).max())
        return found

    monkeypatch.setattr(_Run, 'solved', seen)
    for normal in (0.8 * Y + [0.6, 0.0, 0.0], Y):
        paths = classical_paths(Plane((0.02, 0.01)), BALL, normal, HEIGHT, 5 * DEG)
    assert max(corrections) < 1e-9, 'the search begins where a plane has the next pass'
    rows = np.array([p.postures.contact[:, 1] for p in paths.passes])
    expected = 2 * np.sqrt((5 * MM) ** 2 - (5 * MM - HEIGHT) ** 2)
    np.testing.assert_allclose(np.diff(rows[:, 5]), expected, rtol=1e-6)
    assert not paths.loop and rows[-1, 5] > 5 * MM - expected


def test_ball_on_a_sphere_steps_by_equal_angles_in_its_middle():
    """In the symmetry plane the scallop is where two circles about the sphere's centre meet."""
    R, r = 50 * MM, 5 * MM
    paths = classical_paths(Torus(0.0, R, 0.4, 0.2), BALL, Y, HEIGHT, 5 * DEG)
    tilts = []
    for p in paths.passes:
        middle = np.argmin(np.abs(p.postures.contact[:, 0]))
        c = p.postures.contact[middle] + [0, 0, R]
        tilts.append(np.arctan2(c[1], c[2]))
    centre, top = R + r, R + HEIGHT
    half = np.arccos((centre**2 + top**2 - r**2) / (2 * centre * top))
    np.testing.assert_allclose(np.diff(tilts), 2 * half, rtol=2e-3)


def test_frames_of_any_curve_are_those_of_the_guiding_plane():
    planes = GuidingPlanes(BUMPS, MILL.corner_radius, Y, 3 * MM)
    known = planes.curve(1.3 * MM)
    s = np.linspace(0.0, known.length, 200)
    curve = SurfaceCurve.through(BUMPS, MILL.corner_radius, *known.parameters(s).T)
    inner = np.linspace(0.1, 0.9, 30)
    found, expected = curve.frames(inner * curve.length), known.frames(inner * known.length)
    for name in ('position', 'normal', 'feed', 'across'):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=1e-4)
    for name in ('normal_rate', 'feed_rate', 'across_rate'):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=2e-2)


@pytest.mark.thorough
def test_ridges_have_the_height_asked_for():
    paths = classical_paths(BUMPS, MILL, Y, HEIGHT, 6 * DEG)
    curves = [c for c in (SplinePass.of(p, 0.5 * MM) for p in paths.passes) if c]
    path = ToolPath.of(link(curves, BUMPS, MILL, LinkOptions()), 0.1 * UM)
    section = cross_sections(BUMPS, MILL, Motion('programmed', path.tip, path.axis), Y, 3 * MM)
    assert len(section.ridges) >= 36
    np.testing.assert_allclose(np.percentile(section.ridges, [5, 50, 95]), HEIGHT, rtol=0.03)
    assert section.height.min() > -0.15 * UM


def test_loops_on_the_cap_of_the_paper_are_told():
    cap = Cap((0.08, 0.08), 15 * MM, 6 * MM, 70 * DEG)
    paths = classical_paths(cap, Cutter(0.0, 4.5 * MM), Y, HEIGHT, 5 * DEG, start=0.0)
    assert 3 < len(paths.passes) < 30
    assert paths.loop.startswith(f'pass {len(paths.passes) + 1} turns back at (')


def test_crossing_lines_are_seen():
    t = np.linspace(0.0, 5.0, 40)
    assert crossing(t, np.sin(t)) == -1
    assert crossing(np.cos(1.6 * t), np.sin(1.6 * t) + 0.01 * t) >= 0


def test_mill_that_does_not_fit_is_refused():
    with pytest.raises(SurfaceError, match='smallest concave radius'):
        classical_paths(Cap((0.08, 0.08), 30 * MM, 4 * MM, 0.7), BALL, Y, HEIGHT, 5 * DEG)
