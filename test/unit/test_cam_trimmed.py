"""Trimmed faces: what lies within the boundary, passes that end there, and neighbours."""

from types import SimpleNamespace

import numpy as np
import pytest

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.gouge import Neighbours
from cnc_interp.cam.iso_scallop import IsoScallopOptions, iso_scallop_paths
from cnc_interp.cam.nbuffer import cut_needles
from cnc_interp.cam.needles import Needles
from cnc_interp.cam.shapes import Bumps, Plane, Trimmed
from cnc_interp.cam.simulation import Motion, cross_sections
from cnc_interp.cam.spline_pass import SplinePass
from cnc_interp.cam.step_file import StepFace
from cnc_interp.cam.surface import SurfaceError
from cnc_interp.cam.tool_path import LinkOptions, ToolPath, link
from cnc_interp.core import MM, UM, InterpError

MILL = Cutter(5 * MM, 1.5 * MM)
Y = np.array([0.0, 1.0, 0.0])


def circle(radius, centre=(0.0, 0.0)):
    """A closed polyline [m]."""
    turn = np.linspace(0.0, 2.0 * np.pi, 721)
    return np.array(centre) + radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)


def ring(surface):
    """A disk of 12 mm radius with a hole of 4 mm radius beside its middle."""
    return Trimmed(surface, [circle(12 * MM), circle(4 * MM, (2 * MM, 0.0))])


def test_boundary_decides_what_is_inside():
    face = ring(Plane((0.05, 0.05)))
    u, v = face.grid(301, 301, 1 * MM)
    away = np.minimum(12 * MM - np.hypot(u, v), np.hypot(u - 2 * MM, v) - 4 * MM)
    for margin in (0.0, 0.7 * MM, -0.7 * MM):
        clear = np.abs(away + margin) > 2 * UM
        assert (face.contains(u, v, margin) == (away > -margin))[clear].all()
    np.testing.assert_allclose(face.domain, [[-12 * MM, 12 * MM]] * 2, atol=1e-12)
    with pytest.raises(SurfaceError, match='encloses nothing'):
        Trimmed(Plane((0.05, 0.05)), [np.zeros((4, 2))])
    with pytest.raises(SurfaceError, match='is not closed'):
        Trimmed(Plane((0.05, 0.05)), [circle(12 * MM)[:-40]])


def test_passes_end_at_the_boundary_and_hop_over_the_hole():
    surface = ring(Bumps((0.05, 0.05), [(0, 0, 0.001, 0.012)]))
    paths = iso_scallop_paths(surface, MILL, Y, IsoScallopOptions(stepover=2 * MM))
    parts = [SplinePass.of(p, 0.5 * MM) for p in paths.passes]
    assert max(map(len, parts)) == 2
    steps = link([p for p in parts if p], surface, MILL, LinkOptions())
    path = ToolPath.of(steps, 0.1 * UM)
    # Contact points of the passes lie within the strip and the overrun around the face.
    for made, pieces in zip(paths.passes, parts, strict=True):
        for piece in pieces:
            frames = made.curve.frames(np.linspace(*piece.ends, 200))
            assert surface.contains(frames.u, frames.v, 1.9 * MM).all()
            middle = made.curve.frames(np.array([sum(piece.ends) / 2]))
            assert surface.contains(middle.u, middle.v, 1 * MM).all()
    # What is milled has the ridges asked for; no link touches the surface.
    needles = Needles.on(surface, 0.2 * MM, 1 * MM)
    heights = cut_needles(needles, MILL, path.tip, path.axis)
    found = heights.statistics()
    assert found['uncut'] == 0.0 and found['highest'] < 10.3 * UM
    assert found['lowest'] > -0.3 * UM
    section = cross_sections(surface, MILL, Motion('programmed', path.tip, path.axis), Y, 2 * MM)
    np.testing.assert_allclose(section.ridges, 10 * UM, rtol=0.03)
    assert len(section.ridges) > 40 and np.isnan(section.height).any()
    # In the middle of the hole the plane of a pass over it is not milled at all.
    middle = surface.at(np.full((1, 2), 2 * MM), np.array([[-0.5 * MM, 0.5 * MM]]))
    hole = cut_needles(Needles(middle.position, middle.normal), MILL, path.tip, path.axis)
    assert (hole.height > 0.05 * MM).all()
    with pytest.raises(InterpError, match='inside the border; use a smaller margin'):
        Needles.on(surface, 0.2 * MM, 6 * MM)


def wall(x):
    """Points of a wall of 20 mm at right angles to the feed."""
    y, z = np.meshgrid(np.linspace(-20, 20, 161), np.linspace(0, 20, 81), indexing='ij')
    points = np.stack([np.full(y.shape, x), y * MM, z * MM], axis=-1).reshape(-1, 3)
    return Neighbours(points, np.full(len(points), 2))


def test_passes_end_before_a_wall():
    surface = Plane((0.03, 0.02))
    both = wall(15 * MM)
    paths = iso_scallop_paths(surface, MILL, Y, IsoScallopOptions(stepover=2.5 * MM))
    free = [SplinePass.of(p, 0.5 * MM, both) for p in paths.passes]
    through = [SplinePass.of(p, 0.5 * MM) for p in paths.passes]
    y, z = np.meshgrid(np.linspace(-9, 9, 91) * MM, np.linspace(0.1, 9, 46) * MM, indexing='ij')
    base = np.stack([np.full(y.shape, 15 * MM), y, z], axis=-1)
    normal = np.broadcast_to([-1.0, 0.0, 0.0], base.shape)
    lowest = []
    for parts in (free, through):
        steps = link([p for p in parts if p], surface, MILL, LinkOptions(), both)
        path = ToolPath.of(steps, 1 * UM)
        lowest.append(cut_needles(Needles(base, normal), MILL, path.tip, path.axis).height.min())
    # Points every 0.25 mm leave at most 0.18^2 / (2 r_c) unseen.
    assert lowest[0] > -12 * UM and lowest[1] < -0.5 * MM
    length = [sum(p.ends[1] - p.ends[0] for parts in x for p in parts) for x in (free, through)]
    # The wall is behind the mill: 2 R + r_c from the contact to the back, and the overrun.
    lost = (length[1] - length[0]) / len(free)
    assert lost == pytest.approx(12.2 * MM, abs=0.4 * MM)


def test_a_face_of_a_step_file_is_sampled_up_to_its_edges():
    corners = np.array([[2, 1], [6, 1], [6, 4], [2, 4], [2, 1.0]])
    plane = SimpleNamespace(
        edges=lambda: [corners[k : k + 2] for k in range(4)],
        points=lambda uv: np.c_[uv, np.zeros(len(uv))],
    )
    points = StepFace.samples(plane, 0.25, 10_000)[:, :2]
    assert np.array_equal([points.min(axis=0), points.max(axis=0)], corners[[0, 2]])
    anywhere = np.mgrid[2:6:41j, 1:4:31j].reshape(2, -1).T
    assert np.abs(anywhere[:, None] - points).max(axis=2).min(axis=1).max() <= 0.126


def test_depth_is_that_of_mill_and_shank():
    tip, axis = np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]])

    def depth(mill, *point):
        return Neighbours(np.array([point]) * MM, np.ones(1, np.int64)).depth(mill, tip, axis)[0]

    assert depth(MILL, 0, 0, -1) == pytest.approx(-1 * MM)
    assert depth(MILL, 6.5, 0, 30) == pytest.approx(0.0, abs=1e-12)
    assert depth(MILL, 5.5, 0, 30) == pytest.approx(1 * MM)
    assert depth(MILL, 5 + 1.5, 0, 0) == pytest.approx(1.5 * (1 - np.sqrt(2)) * MM)
    assert depth(Cutter(5 * MM, 0.0), 4, 0, 3) == pytest.approx(1 * MM)
    assert depth(Cutter(5 * MM, 0.0), 0, 0, 3) == pytest.approx(3 * MM)


def test_face_whose_axis_leans_too_far_is_told():
    surface = Plane((0.02, 0.012))
    paths = iso_scallop_paths(surface, MILL, Y, IsoScallopOptions(stepover=2.5 * MM))
    parts = [SplinePass.of(p, 0.5 * MM) for p in paths.passes]
    with pytest.raises(SurfaceError, match='leans too far'):
        link(parts, surface, MILL, LinkOptions(), up=np.array([1.0, 0.0, 0.0]))
