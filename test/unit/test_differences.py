"""Shares of the limits by differences of setpoints, on polynomials whose derivatives are known."""

import numpy as np
import pytest

from cnc_interp.core.axis_limits import DriveLoad, Limits
from cnc_interp.run.setpoints import BEFORE, largest_shares, limit_shares, torque_shares

T = 2e-3
LIMITS = np.array([[0.5, 2.0], [3.0, 5.0], [40.0, 80.0]])


@pytest.mark.parametrize('order', [1, 2, 3])
def test_a_constant_derivative_is_its_share_of_the_limit_and_keeps_its_sign(order):
    time = np.arange(20) * T
    rate = np.array([-0.25, 0.5]) * LIMITS[order - 1]
    positions = time[:, None] ** order / np.prod(np.arange(1, order + 1)) * rate
    shares = limit_shares(positions, Limits.constant(*LIMITS), T)
    assert shares.shape == (3, len(time) - BEFORE, 2)
    np.testing.assert_allclose(shares[order - 1], [[-0.25, 0.5]] * 17, rtol=1e-6)
    assert np.abs(shares[order:]).max(initial=0.0) < 1e-5  # higher derivatives vanish


def test_a_jump_is_seen_in_the_row_at_which_it_ends():
    positions = np.zeros((BEFORE + 6, 2))
    positions[BEFORE + 2 :, 1] = 1e-3
    shares = limit_shares(positions, Limits.constant(*LIMITS), T)
    first = [int(np.flatnonzero(shares[k, :, 1])[0]) for k in range(3)]
    assert first == [2, 2, 2]
    assert shares[0, 2, 1] == pytest.approx(1e-3 / T / LIMITS[0, 1])
    assert shares[2, 2, 1] == pytest.approx(1e-3 / T**3 / LIMITS[2, 1])


def test_the_largest_has_no_sign_and_keeps_what_is_no_number():
    positions = np.random.default_rng(4).normal(size=(40, 2))
    limits = Limits.constant(*LIMITS)
    wanted = np.abs(limit_shares(positions, limits, T)).max(axis=1)
    assert np.array_equal(largest_shares(positions, limits, T), wanted)
    positions[20, 1] = np.nan
    largest = largest_shares(positions, limits, T)
    assert np.isnan(largest[:, 1]).all() and np.array_equal(largest[:, 0], wanted[:, 0])


def test_the_torque_is_that_of_inertia_and_both_frictions():
    limits = Limits.constant(*LIMITS).having(load={0: DriveLoad(2.0, 20.0, 1.0, 8.0)})
    time = np.arange(20) * T
    speed, push = -0.3, -2.0  # faster and faster backwards
    positions = np.zeros((20, 2))
    positions[:, 0] = speed * time + 0.5 * push * time**2
    velocity = speed + push * time[BEFORE - 1 : -1]
    wanted = np.abs(push + 4.0 * velocity - 0.5) / 10.0
    shares = torque_shares(positions, limits, T)
    np.testing.assert_allclose(shares[:, 0], wanted, rtol=1e-6)
    assert not shares[:, 1].any()
