"""A path from arrays of axis positions: smooth, through the points, planned within the limits."""

import numpy as np
import pytest

from cnc_interp import Blocks, Transform, axis_motion, plan_path, smooth_path
from cnc_interp.core import InterpError
from cnc_interp.kinematics.axis_path import evaluate
from cnc_interp.library import axis_path_from
from cnc_interp.machine_model.machine import Machine

MACHINE = Machine.load('xyzac')
WAVE = np.array([40.0, 55.0, 30.0, 25.0, 35.0])  # of each axis [1/m]


def curve(s, derivative=0):
    """Return derivatives of axis positions whose truth is known."""
    return 0.02 * WAVE**derivative * np.sin(np.outer(s, WAVE) + 0.5 * np.pi * derivative)


def test_values_and_derivatives_are_those_of_the_curve():
    dense, errors = np.linspace(0.02, 0.18, 997), []
    for count in (41, 81):
        s = np.linspace(0.0, 0.2, count)
        path = axis_path_from(curve(s), s, MACHINE)
        assert np.array_equal(path.q, curve(s))
        found = evaluate(path, dense)
        errors.append([np.abs(found[k] - curve(dense, k)).max() for k in range(4)])
        for k in range(3):  # three derivatives agree across the points
            assert np.allclose(path.cell_left[k + 1, 1:], path.cell_right[k + 1, :-1])
    # Half the distance: the error of the k-th derivative is of the order 6 - k.
    ratios = np.array(errors[0]) / np.array(errors[1])
    assert (ratios > 0.7 * 2.0 ** (6 - np.arange(4))).all()


@pytest.mark.parametrize(
    ('q', 's', 'says'),
    [
        (np.zeros((7, 5)), np.arange(8.0), r'shape \(8, 5\)'),
        (np.zeros((8, 3)), np.arange(8.0), r'shape \(8, 5\)'),
        (np.zeros((5, 5)), np.arange(5.0), '6 or more'),
        (np.zeros((8, 5)), np.r_[0.0, np.arange(7.0)], 's must increase'),
        (np.full((8, 5), np.nan), np.arange(8.0), 'finite'),
    ],
)
def test_arrays_that_are_no_path_are_refused(q, s, says):
    with pytest.raises(InterpError, match=says):
        axis_path_from(q, s, MACHINE)


@pytest.mark.parametrize(
    ('scale', 'length', 'feedrate', 'tolerance', 'says'),
    [
        (0.0, 1.0, 0.05, 1e-5, 'no motion'),
        (np.nan, 1.0, 0.05, 1e-5, 'finite'),
        (1.0, 2.0, 0.05, 1e-5, 'length 1'),
        (1.0, 0.0, 0.05, 1e-5, 'length 1'),
        (1.0, 1.0, 0.0, 1e-5, 'greater than 0'),
        (1.0, 1.0, 0.05, 0.0, 'greater than 0'),
        (1.0, 1.0, np.nan, 1e-5, 'greater than 0'),
    ],
)
def test_poses_that_make_no_path_are_refused(scale, length, feedrate, tolerance, says):
    tip, axis = 0.01 * np.eye(3), np.tile([0.0, 0.0, 1.0], (3, 1))
    with pytest.raises(InterpError, match=says):
        blocks = Blocks.of_poses(scale * tip, length * axis, feedrate, tolerance)
        smooth_path(blocks, Transform.of(MACHINE))


def test_it_is_planned_within_the_limits():
    """Its setpoints are differentiated here, from rest to rest."""
    period, s = 1e-3, np.linspace(0.0, 0.2, 81)
    piece = plan_path(axis_path_from(curve(s), s, MACHINE, feedrate=0.05), MACHINE)
    time = np.arange(0.0, piece.law.end_time + period, period)
    position = axis_motion(piece.path, piece.law, time)[0]
    held = np.pad(position, ((3, 3), (0, 0)), mode='edge')
    for order, limits in enumerate(
        (MACHINE.max_velocity, MACHINE.max_acceleration, MACHINE.max_jerk), 1
    ):
        use = np.abs(np.diff(held, order, axis=0)).max(axis=0) / period**order / limits
        assert (use <= 1.001).all()
    assert np.abs(position[[0, -1]] - curve(s)[[0, -1]]).max() < 1e-9
