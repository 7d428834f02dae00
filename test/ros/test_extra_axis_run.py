"""A sixth, linear axis over ROS: words, blocks, segments, setpoints, drives, proof."""

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp.client.run_request import RunRequest
from cnc_interp.client.session import run_session
from cnc_interp.core import MM
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.verify import verify_plan

PROGRAM = """G21 G90 G94
TRAORI
G0 X0 Y0 Z10 A10 C30
G1 Z0 F3000
X30 W10
X30 Y20 W-5
W3
X20 Y10 A15 C40 W0
TRAFOOF
G1 W4
M30
"""


@pytest.mark.thorough
def test_a_program_with_w_runs_and_what_the_machine_received_is_proven(tmp_path):
    program, out = tmp_path / 'part.ngc', tmp_path / 'received'
    program.write_text(PROGRAM)
    (result,) = run_session(RunRequest(program, machine='xyzacw', out=out, quiet=True))
    assert result.ok, result.message
    assert list(result.position) == ['X', 'Y', 'Z', 'A', 'C', 'W']
    assert result.position['W'] == pytest.approx(4 * MM, abs=1e-9)
    assert 0.0 < result.following_error['W'] < 0.05 * MM
    assert result.axis_units['W'] == 'm' and result.axis_units['A'] == 'rad'
    assert 'W ' in result.text()
    proof = verify_plan(out, Machine.load('xyzacw'))
    assert proof.ok, proof.text()
    assert proof.largest('word missed by W').ratio <= 1.0
    with np.load(out / 'setpoints.npz') as received:
        assert received['position'].shape[1] == 6
        assert received['position'][-1, 5] == pytest.approx(4 * MM, abs=1e-9)
