"""Raised tilts, and the part of a pass that is milled."""

import numpy as np
import pytest

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.gouge import finely, gouge_depth, smooth_cover
from cnc_interp.cam.guiding import GuidingPlanes
from cnc_interp.cam.iso_scallop import HeelError, IsoScallopOptions, PassRecursion
from cnc_interp.cam.passes import constant_tilt, kept_places, kept_ranges, places_around
from cnc_interp.cam.shapes import BSplineSurface, Bumps, Plane
from cnc_interp.cam.surface import SurfaceError
from cnc_interp.core import DEG, MM, UM

Y = np.array([0.0, 1.0, 0.0])


def test_cover_of_a_raised_tilt_is_smooth_and_nowhere_smaller():
    s = np.linspace(0.0, 40 * MM, 201)
    values = np.where(np.abs(s - 15 * MM) < 0.15 * MM, 0.1, 0.0)
    cover = smooth_cover(s, values, 4 * MM, s)
    assert np.all(cover >= values - 1e-12) and cover.max() == pytest.approx(0.1)
    assert np.all(cover[np.abs(s - 15 * MM) > 8.3 * MM] == 0.0)
    assert np.abs(np.diff(cover)).max() < 0.1 * 0.2 / 3.9
    end = smooth_cover(s, np.where(s < 0.1 * MM, 0.1, 0.0), 4 * MM, s)
    assert end[0] == pytest.approx(0.1) and np.all(np.diff(end) <= 1e-12)


def test_milled_part_ends_with_the_overrun():
    surface = Plane((0.03, 0.02))
    curve = GuidingPlanes(surface, 1.5 * MM, Y, 6 * MM).curve(0.0)
    s = np.linspace(0.0, curve.length, 400)
    reach = np.full(400, 1 * MM)
    ((low, high),) = kept_ranges(curve, s, reach, 0.5 * MM)
    x = curve.frames(np.array([low, high])).position[:, 0]
    np.testing.assert_allclose(np.sort(x), [-15.5 * MM, 15.5 * MM], atol=0.41 * MM)
    kept = kept_places(curve, s, reach, 0.5 * MM)
    assert s[kept][0] >= low and s[kept][-1] <= high and not kept[0] and not kept[-1]
    fine = finely(s, [(low, high)])
    assert fine[0] == low and fine[-1] == high and np.diff(fine).max() < 0.03 * MM


def test_places_around_hold_what_is_milled_and_bridge_a_hole():
    good = np.array([1, 1, 1, 0, 1, 1, 0, 1, 1], bool)
    kept = np.array([0, 0, 0, 0, 1, 0, 0, 0, 0], bool)
    assert places_around(good, kept).tolist() == [4, 5]
    kept[1] = True
    assert places_around(good, kept).tolist() == [0, 1, 2, 4, 5]
    assert places_around(good, np.zeros(9, bool)).tolist() == [0, 1, 2]
    assert len(places_around(np.zeros(9, bool), np.zeros(9, bool))) == 0


def steep_beyond(edge):
    """A sheet that stands along the guiding planes where |x| reaches an edge [mm]."""
    x, y = np.meshgrid(np.linspace(-20, 20, 21), np.linspace(-10, 10, 11), indexing='ij')
    wall = np.maximum(np.abs(x) - edge, 0.0) ** 3 * np.tanh(y / 2.0)
    return BSplineSurface.through(np.stack([x, y, wall], axis=-1) * MM)


def test_plane_that_touches_the_surface_is_refused_with_the_place():
    with pytest.raises(SurfaceError, match=r'touches the surface at \(.* mm instead of cutting'):
        GuidingPlanes(steep_beyond(14.0), 1.5 * MM, Y, 2 * MM)


@pytest.mark.thorough
def test_yaw_and_tilt_together_where_each_alone_does_not_fit(monkeypatch):
    """A bump beside the pass: the yaw turns the heel away from it, the tilt lifts the rest."""
    surface = Bumps((16 * MM, 20 * MM), [(0.0, 6 * MM, 1 * MM, 3 * MM)])
    mill, highest = Cutter(5 * MM, 1.5 * MM), 10 * DEG
    choice = IsoScallopOptions(
        stepover=1.3 * MM, tilt=5 * DEG, tilt_limits=(0.5 * DEG, highest), points=25
    )
    recursion = PassRecursion(surface, mill, Y, choice)
    curve = recursion.planes.curve(-2.3 * MM)
    angles = constant_tilt(curve, highest, -40 * DEG, 25)
    before = recursion.finished(curve, angles, np.zeros(1, np.int64), fresh=True, number=1)
    # Tilt alone: even the largest leaves the heel in the bump.
    reason = HeelError('pass 2: the bottom of the mill enters the surface', 'use a smaller mill')
    assert recursion.closest(before, -1 * MM, 0.0) is None
    made = recursion.closer_pass(before, -1 * MM, 2, reason)
    yaw, tilt = made.angles.yaw, made.angles.tilt
    assert abs(yaw[0]) > 19 * DEG and f'yaw {yaw[0] / DEG:.0f} deg' in recursion.notes[-1]
    assert 5 * DEG < tilt.max() <= highest + 1e-9
    assert 0.9 * MM < made.plane - before.plane <= 1.3 * MM + 1e-9
    places = made.s[made.kept]
    assert gouge_depth(surface, made.tool(places)).max() < 1 * UM
    # Yaw alone: at the tilt that was chosen the heel enters the bump.
    alone = constant_tilt(made.curve, 5 * DEG, float(yaw[0]), 25)
    assert gouge_depth(surface, alone.postures(made.curve, mill, places)).max() > 1 * UM
    monkeypatch.setattr('cnc_interp.cam.iso_scallop.TURNS', ())
    with pytest.raises(HeelError, match='enters the surface'):
        recursion.closer_pass(before, -1 * MM, 2, reason)
