"""The error without compensation, told while a motion is executed in pieces."""

import numpy as np

from cnc_interp.drives.tool_error import ToolMotion
from cnc_interp.machine.axis_motion import ContourErrors
from cnc_interp.machine.simulated_drives import Uncompensated, simulate
from cnc_interp.machine_model.machine import Machine

T = 0.001
TIRED = Machine.load('xyzac_tired')


def test_the_error_told_in_pieces_is_that_of_the_whole_motion():
    phase = np.linspace(0.0, 4.0 * np.pi, 3000)
    start = np.array([0.0, 0.0, 0.0, 0.2, 0.0])
    positions = start + np.outer(1.0 - np.cos(phase), [0.02, 0.01, 0.0, 0.1, 0.3])
    velocities = np.gradient(positions, T, axis=0)
    whole = simulate(TIRED, T, positions, velocities).contour_error
    told = Uncompensated(TIRED, T, start)
    pieces = [
        told.contour_errors(positions[k : k + 37], velocities[k : k + 37])
        for k in range(0, len(positions), 37)
    ]
    assert np.array_equal(np.concatenate(pieces), whole)
    assert whole.max() > 4e-5
    # The planner and the report predict the same error.
    planned = ToolMotion(TIRED, T, start).push(positions, velocities)
    assert np.abs(planned.tip - whole).max() < 1e-12


def test_a_tip_ahead_of_its_setpoint_on_the_path_has_no_error():
    way = 1e-4 * np.arange(100.0)
    commanded = np.stack([way, 0.0 * way, 0.0 * way], axis=1)
    ahead = commanded + [4e-4, 1e-6, 0.0]
    errors = ContourErrors(T, 5e-3, commanded[0]).push(commanded, ahead)
    assert np.abs(errors[10:] - 1e-6).max() < 1e-12
