"""Setpoints of a motion: what rounding leaves of it."""

import numpy as np

from cnc_interp.feedrate.motion_law import MotionLaw
from cnc_interp.feedrate.planning_windows import PlannedPiece
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.run.setpoints import Interpolator

T = 1e-3


def steady(begin, ratio, cells=50, cell=1e-6, speed=1e-5):
    """An axis that runs at constant speed, ``ratio`` times as far as the path, from a place on."""
    s = begin + cell * np.arange(cells + 1)
    q, slope, none = ratio * (s - begin), np.full(cells, ratio), np.zeros(cells)
    path = AxisPath(
        s=s,
        cell_left=np.array([q[:-1], slope, none, none])[:, :, None],
        cell_right=np.array([q[1:], slope, none, none])[:, :, None],
        tip=np.outer(s, [1.0, 0.0, 0.0]),
        axis=np.tile([0.0, 0.0, 1.0], (cells + 1, 1)),
        cell_feed=np.full(cells, speed),
        cell_block=np.arange(cells),
        stop=np.zeros(cells + 1, dtype=np.bool_),
    )
    duration = np.diff(s) / speed
    time = np.concatenate([[0.0], np.cumsum(duration)[:-1]])
    law = MotionLaw(
        time, duration, s[:-1].copy(), np.full(cells, speed), none, none, np.arange(cells)
    )
    return PlannedPiece(path, law)


def test_far_from_the_start_of_the_program_a_steady_axis_has_no_jerk():
    # Behind 24 m path lengths are multiples of 3.6e-15 m: 3500 times that, three differences and
    # 1 ms make 0.05 m/s3, a hundredth of an ordinary limit.
    position = Interpolator(T).push(steady(24.0, 3500.0)).position[:, 0]
    assert len(position) > 1000
    assert np.abs(np.diff(position, 3)).max() / T**3 < 5e-4
