"""Stepper motors on the step generator of LinuxCNC's HAL follow the setpoints."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

sys.path.append(str(Path(__file__).parents[2] / 'benchmarks'))

import hal_session

from cnc_interp.client.run_request import RunRequest
from cnc_interp.client.session import run_session

pytestmark = pytest.mark.thorough

EXAMPLE = Path(__file__).parents[2] / 'examples' / 'pyramid.ngc'
#: A step of each axis in the HAL file [mm, deg].
STEP = 1.0 / np.array([16, 16, 16, 75, 75])
#: A busy computer makes pulses late by fewer periods than this.
LATE = 50


def test_steppers_follow_within_a_step(tmp_path):
    reason = hal_session.why_not()
    if not reason and os.getloadavg()[0] > 1.0:
        reason = 'needs a computer that does nothing else: its programs make the pulses'
    if reason:
        pytest.skip(reason)
    # By a high priority, else the pulses wait for other programs, and steps are late.
    with hal_session.Session('stepper_axes', priority=85) as session:
        if not session.is_preferred:
            pytest.skip('needs the right to real-time priorities')
        given = {'drives': 'hal', 'hal_depth': '300'}
        request = RunRequest(EXAMPLE, out=tmp_path / 'out', quiet=True, drives=given)
        result = run_session(request)[0]
        wanted, actual, empty, *_ = session.periods()
    assert result.ok, result.message
    setpoints = np.load(tmp_path / 'out' / 'setpoints.npz')
    last = setpoints['position'][-1] / hal_session.UNITS
    end = np.flatnonzero((wanted == last).all(axis=1))[-1]
    moves = np.flatnonzero(np.diff(wanted[: end + 1], axis=0).any(axis=1))
    assert not empty[moves[0] : moves[-1]].any()
    # Each position lies between the setpoints of the last periods, but for a step.
    recent = sliding_window_view(wanted[moves[0] : end + 1], LATE, axis=0)
    seen = actual[moves[0] + LATE - 1 : end + 1]
    assert (seen >= recent.min(axis=2) - STEP).all()
    assert (seen <= recent.max(axis=2) + STEP).all()
    # At rest it is the setpoint, but for a step; what was seen are steps.
    assert (np.abs(actual[-1] - wanted[-1]) <= STEP).all()
    assert (np.abs(actual - wanted).max(axis=0) >= 0.4 * STEP).all()
