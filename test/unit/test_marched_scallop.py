"""The paper's marching with three unknowns finds the scallop points of our one unknown."""

import numpy as np
import pytest
from marched_scallop import march_to_scallops

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.guiding import GuidingPlanes
from cnc_interp.cam.passes import Angles
from cnc_interp.cam.scallop import scallop_points
from cnc_interp.cam.shapes import Bumps, Torus
from cnc_interp.core import DEG, MM, UM

MILL = Cutter(5 * MM, 1.5 * MM)
Y = np.array([0.0, 1.0, 0.0])


@pytest.mark.parametrize(
    ('surface', 'yaw'),
    [
        (Bumps((0.03, 0.02), [(0, 0, -0.001, 0.012)]), 0.0),
        (Torus(0.0, 0.06, 0.4, 0.3), 12 * DEG),
    ],
)
def test_march_of_the_paper_ends_at_the_same_points(surface, yaw):
    curve = GuidingPlanes(surface, 1.5 * MM, Y, 2 * MM).curve(1 * MM)
    s = np.linspace(0.0, curve.length, 9)
    angles = Angles(s, (5 + 2 * np.sin(s / (4 * MM))) * DEG, np.full(9, yaw))
    postures = angles.postures(curve, MILL, s)
    left, right = (scallop_points(surface, postures, 10 * UM, side) for side in (-1.0, 1.0))
    marched = march_to_scallops(surface, postures, 10 * UM, left.position)
    assert marched.found.all()
    np.testing.assert_allclose(marched.position, right.position, rtol=0, atol=1e-9)
    # It starts at the other border of the strip: it has found another point.
    assert np.linalg.norm(marched.position - left.position, axis=1).min() > 1 * MM
    assert (marched.steps > 1).all() and (marched.solved > 0).all()
    assert (marched.corrections > marched.steps).all()


def test_a_start_that_leads_nowhere_is_not_found():
    surface = Torus(0.0, 0.06, 0.4, 0.3)
    curve = GuidingPlanes(surface, 1.5 * MM, Y, 2 * MM).curve(0.0)
    s = np.linspace(0.0, curve.length, 8)[2:5]
    postures = Angles(s, np.full(3, 5 * DEG), np.zeros(3)).postures(curve, MILL, s)
    away = postures.contact + [0.0, 0.0, 5 * MM]
    assert not march_to_scallops(surface, postures, 10 * UM, away).found.any()
