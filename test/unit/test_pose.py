"""Axis positions of a tool pose: the forward kinematics of them, and the nearest solution."""

import numpy as np
import pytest

from cnc_interp.core import BlockError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform, positions_of_pose


@pytest.mark.parametrize(
    'name', ['xyzac', 'xyzbc', 'head_head', 'bc_trunnion', 'ram_mill', 'xyzacw']
)
def test_the_pose_of_the_positions_is_the_one_that_was_asked_for(name):
    transform = Transform.of(Machine.load(name))
    low, high = np.clip(transform.machine.travel, -1.2, 1.2).T
    random = np.random.default_rng(3)
    for _ in range(100):
        stands, other = random.uniform(low, high), random.uniform(low, high)
        tip, axis = (found[0] for found in transform.forward(other[None]))
        q = positions_of_pose(transform, tip, 3.0 * axis, stands)
        again, turned = (found[0] for found in transform.forward(q[None]))
        assert np.abs(again - tip).max() < 1e-9 and np.abs(turned - axis).max() < 1e-9
        near = positions_of_pose(transform, tip, axis, q)
        assert np.abs(near - q).max() < 1e-9
        kept = positions_of_pose(transform, np.array([np.nan, 0.01, np.nan]), None, stands)
        moved = transform.forward(kept[None])[0][0] - transform.forward(stands[None])[0][0]
        assert np.abs(moved[[0, 2]]).max() < 1e-9
        assert np.array_equal(kept[3:], stands[3:])


def test_what_cannot_be_reached_is_said():
    three, five = (Transform.of(Machine.load(name)) for name in ('xyz', 'head_head'))
    here = np.zeros(3)
    with pytest.raises(ValueError, match='does not turn'):
        positions_of_pose(three, here, np.array([1.0, 0.0, 0.0]), np.zeros(3))
    assert np.array_equal(positions_of_pose(three, here, np.array([0, 0, 2.0]), here), here)
    with pytest.raises(ValueError, match='no length'):
        positions_of_pose(five, here, np.zeros(3), np.zeros(5))
    with pytest.raises(BlockError, match='within its travel'):
        positions_of_pose(five, here, np.array([0.0, 0.0, -1.0]), np.zeros(5))
