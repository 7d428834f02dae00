"""The N-buffer against closed forms, brute force, and the passes it is there to judge."""

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.iso_scallop import IsoScallopOptions, iso_scallop_paths
from cnc_interp.cam.make_program import across
from cnc_interp.cam.nbuffer import TOP, Heights, cut_needles
from cnc_interp.cam.needles import Needles
from cnc_interp.cam.shapes import Bumps, Cylinder, Plane, Torus
from cnc_interp.cam.simulation import Motion, cross_sections, thinned
from cnc_interp.cam.spline_pass import CLOSE, SplinePass, chord_error, sampled
from cnc_interp.cam.surface_file import read_part
from cnc_interp.cam.tool_path import LinkOptions, ToolPath, link
from cnc_interp.core import DEG, MM, UM, InterpError

EXAMPLES = Path(__file__).parents[2] / 'examples'
MILL = Cutter(5 * MM, 1.5 * MM)
Y = np.array([0.0, 1.0, 0.0])


def row_of_needles(length=4 * MM, count=401):
    """Needles on the plane z = 0, along y."""
    base = np.zeros((1, count, 3))
    base[0, :, 1] = np.linspace(0.0, length, count)
    return Needles(base, np.broadcast_to([0.0, 0.0, 1.0], base.shape).copy())


def straight(y, tilt, mill=MILL, step=0.3 * MM):
    """Poses along x whose contact runs in the plane z = 0 at y."""
    x = np.arange(-9 * MM, 9 * MM, step)
    axis = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    front = np.array([np.cos(tilt), 0.0, -np.sin(tilt)])
    K = np.column_stack([x, np.full_like(x, y), np.full_like(x, mill.corner_radius)])
    tip = K - mill.tool_radius * front - mill.corner_radius * axis
    return tip, np.broadcast_to(axis, tip.shape).copy()


def test_ball_mill_leaves_circles():
    mill = Cutter(0.0, 4 * MM)
    needles = row_of_needles(3 * MM)
    heights = [cut_needles(needles, mill, *straight(y, 0.0, mill)).height for y in (0.0, 3 * MM)]
    found = np.minimum(*heights)[0]
    y = needles.base[0, :, 1]
    away = np.minimum(y, 3 * MM - y)
    np.testing.assert_allclose(found, 4 * MM - np.sqrt((4 * MM) ** 2 - away**2), atol=1e-11)


@pytest.mark.parametrize('tilt', [2.0, 5.0, 20.0])
def test_filleted_mill_leaves_the_scallop_of_its_effective_radius(tilt):
    radius = MILL.effective_radius(tilt * DEG)
    d = np.sqrt(8 * 10 * UM * radius)
    needles = row_of_needles(0.5 * d)
    found = cut_needles(needles, MILL, *straight(0.0, tilt * DEG)).height[0]
    y = needles.base[0, :, 1]
    np.testing.assert_allclose(found, y**2 / (2 * radius), rtol=0.06, atol=1e-9)
    assert found[-1] == pytest.approx(10 * UM, rel=0.04)


def test_heights_do_not_depend_on_how_the_motion_is_cut_up():
    needles = row_of_needles()
    coarse = cut_needles(needles, MILL, *straight(1 * MM, 4 * DEG, step=6 * MM)).height
    fine = cut_needles(needles, MILL, *straight(1 * MM, 4 * DEG, step=0.02 * MM)).height
    np.testing.assert_allclose(coarse, fine, atol=1e-9)


def distance(mill, points, centre, axis):
    """Distance of points from the mill: all within r_c of the cylinder on its corner circle."""
    v = points - centre
    along = np.sum(v * axis, axis=-1)
    across = np.linalg.norm(v - along[..., None] * axis, axis=-1)
    return np.hypot(np.minimum(along, 0.0), np.maximum(across - mill.tool_radius, 0.0)) - (
        mill.corner_radius
    )


@pytest.mark.parametrize('mill', [MILL, Cutter(0.0, 3 * MM), Cutter(4 * MM, 0.0)])
def test_random_poses_against_brute_force(mill):
    rng = np.random.default_rng(2)
    base = np.column_stack([rng.uniform(-6, 6, (20, 2)) * MM, np.zeros(20)])
    normal = np.column_stack([rng.uniform(-0.9, 0.9, (20, 2)), np.ones(20)])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    tip = np.array([[-1.0, 0.3, 0.1], [1.5, -0.5, 0.05]]) * MM
    axis = np.array([[0.1, 0.05, 1.0], [0.13, 0.0, 1.0]])
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    found = cut_needles(Needles(base[:, None], normal[:, None]), mill, tip, axis).height[:, 0]
    angle = np.arccos(axis[0] @ axis[1])
    share = np.linspace(0.0, 1.0, 1501)[:, None]
    axes = np.sin((1 - share) * angle) * axis[0] + np.sin(share * angle) * axis[1]
    axes /= np.sin(angle)
    centres = tip[0] + share * (tip[1] - tip[0]) + mill.corner_radius * axes
    slack = 1e-9 if mill.corner_radius == 0.0 else 0.0
    for b, n, h in zip(base, normal, found, strict=True):

        def gap(x, b=b, n=n):
            return float(distance(mill, b + x * n, centres, axes).min()) - slack

        heights = np.linspace(-1.9 * MM, TOP, 200)
        inside = [x for x in heights if gap(x) < 0.0]
        if not inside:
            assert h > 0.98 * TOP
            continue
        first = inside[0]
        expected = brentq(gap, first - (heights[1] - heights[0]), first, xtol=1e-12)
        assert h == pytest.approx(expected, abs=3e-7 if slack else 3e-8)


@pytest.mark.parametrize(
    ('surface', 'normal', 'stepover'),
    [
        pytest.param(Plane((0.016, 0.014)), Y, 2.5 * MM, marks=pytest.mark.thorough),
        pytest.param(Cylinder(0.03, 0.5, 0.014), Y, 1.8 * MM, marks=pytest.mark.thorough),
        pytest.param(Torus(0.0, 0.05, 0.3, 0.26), Y, 1.5 * MM, marks=pytest.mark.thorough),
        (Bumps((0.02, 0.018), [(0, 0, 0.002, 0.01)]), Y, 1.8 * MM),
    ],
)
def test_iso_scallop_ridges_have_the_height_asked_for(surface, normal, stepover):
    paths = iso_scallop_paths(surface, MILL, normal, IsoScallopOptions(stepover=stepover))
    curves = [c for c in (SplinePass.of(p, 0.5 * MM) for p in paths.passes) if c]
    path = ToolPath.of(link(curves, surface, MILL, LinkOptions()), 0.1 * UM)
    section = cross_sections(
        surface, MILL, Motion('programmed', path.tip, path.axis), normal, 3 * MM
    )
    assert len(section.ridges) >= 36
    np.testing.assert_allclose(section.ridges, 10 * UM, rtol=0.03)
    assert section.height.min() > -0.15 * UM


@pytest.mark.thorough
def test_application_of_the_paper():
    """R 5, r_c 1.5, S_h 10 um, d 5 mm, first tilt 5 deg, 25 points [TL2008, section 4]."""
    surface = read_part(EXAMPLES / 'hollow.json').surfaces[1]
    options = IsoScallopOptions(stepover=5 * MM, tilt=5 * DEG, start='tilt', stray=None, points=25)
    normal = across(surface, 0.0)
    paths = iso_scallop_paths(surface, MILL, normal, options)
    planes = [p.plane for p in paths.passes]
    np.testing.assert_allclose(np.diff(planes), 5 * MM, atol=1e-9)
    np.testing.assert_allclose(paths.passes[0].postures.tilt, 5 * DEG)
    curves = [c for c in (SplinePass.of(p, 0.5 * MM) for p in paths.passes) if c]
    path = ToolPath.of(link(curves, surface, MILL, LinkOptions()), 0.05 * UM)
    motion = Motion('programmed', path.tip, path.axis)
    section = cross_sections(surface, MILL, motion, normal, 2 * MM)
    assert len(section.ridges) >= 72
    np.testing.assert_allclose(section.ridges, 10 * UM, rtol=0.03)
    assert section.height.min() > -1.0 * UM  # IsoScallopOptions.gouge


def test_gouge_and_uncut_needles_are_told():
    needles = row_of_needles(20 * MM)
    tip, axis = straight(0.0, 5 * DEG)
    heights = cut_needles(needles, MILL, tip - [0, 0, 30 * UM], axis)
    found = heights.statistics()
    assert found['lowest'] == pytest.approx(-30 * UM, abs=0.01 * UM)
    assert 0.2 < found['uncut'] < 0.9 and found['gouged'] > 0.0
    nothing = Heights(needles, np.full((1, 401), TOP))
    with pytest.raises(InterpError, match='does not cut this surface'):
        nothing.statistics()


def test_links_do_not_touch_the_surface_and_passes_keep_their_chords():
    surface = Bumps((0.02, 0.018), [(0, 0, 0.002, 0.01)])
    paths = iso_scallop_paths(surface, MILL, Y, IsoScallopOptions(stepover=1.8 * MM))
    curves = [c for c in (SplinePass.of(p, 0.5 * MM) for p in paths.passes) if c]
    needles = Needles.on(surface, 0.4 * MM)
    one_way, zigzag = (
        ToolPath.of(link(curves, surface, MILL, LinkOptions(x)), UM) for x in ('one-way', 'zigzag')
    )
    heights = [cut_needles(needles, MILL, p.tip, p.axis).height for p in (one_way, zigzag)]
    np.testing.assert_allclose(heights[0], heights[1], atol=1.5 * UM)
    assert min(h.min() for h in heights) > -1.5 * UM
    assert one_way.number.max() == zigzag.number.max() == len(curves)
    assert one_way.rapid.sum() > zigzag.rapid.sum()
    curves = [part for (part,) in curves]
    for k, curve in enumerate(curves, 1):  # every second pass runs backwards
        first = zigzag.tip[zigzag.number == k][-1 if k % 2 == 0 else 0]
        assert np.linalg.norm(first - curve.poses(np.array(curve.ends))[0][0]) < 1 * MM
    tip, axis = sampled(curves[3], 1 * UM)
    finer_tip, finer_axis = curves[3].poses(np.linspace(*curves[3].ends, 4001))
    chord = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    at = np.clip(
        np.searchsorted(
            np.r_[0, np.cumsum(chord)],
            np.r_[0, np.cumsum(np.linalg.norm(np.diff(finer_tip, axis=0), axis=1))],
        )
        - 1,
        0,
        len(chord) - 1,
    )
    pairs = [np.stack([x[at], x[at + 1]], axis=1) for x in (tip, tip + 10 * MM * axis)]
    error = chord_error(*pairs, finer_tip, finer_tip + 10 * MM * finer_axis)
    assert np.median(error) < 1 * UM and error.max() < 2 * UM


def test_knots_are_dense_only_where_the_curvature_jumps():
    """A cubic surface of 50 mm with four knot lines, and the same without them."""

    def rows(jump):
        def pose(s):
            bend = jump * sum(np.maximum(s - x * MM, 0.0) ** 2 for x in (10.1, 17.3, 29.9, 41.7))
            return np.stack([s, bend + 2.0 * s**2, *4 * [np.sin(s / 0.02) * MM]], axis=1)

        return pose

    ends = 0.0, 50 * MM
    fine = np.linspace(*ends, 20001)
    count = []
    for jump in (0.0, 10.0):
        made = SplinePass.following(rows(jump), ends)
        assert np.abs(made.spline(fine) - rows(jump)(fine)).max() < 1.5 * CLOSE
        count.append(len(made.spline.c))
    assert count[0] < 40 and 4 < count[1] - count[0] < 80
    # The knots that the jumps need lie beside them.
    knots = made.spline.t[4:-4]
    short = knots[:-1][np.diff(knots) < 0.4 * MM]
    gaps = np.abs(short[:, None] / MM - [10.1, 17.3, 29.9, 41.7]).min(axis=1)
    assert len(short) and gaps.max() < 2.0


def test_thinning_keeps_the_motion():
    tip, axis = straight(0.0, 5 * DEG, step=0.01 * MM)
    tip[:, 2] += 0.2 * MM * np.sin(tip[:, 0] / (4 * MM))
    fewer = thinned(Motion('planned', tip, axis))
    assert len(fewer.tip) < 0.3 * len(tip)
    needles = row_of_needles()
    thick = cut_needles(needles, MILL, tip, axis).height
    np.testing.assert_allclose(
        cut_needles(needles, MILL, fewer.tip, fewer.axis).height, thick, atol=20e-9
    )
