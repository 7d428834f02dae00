"""From a run over ROS to a machine file: feedback is recorded, and the drive of X found in it."""

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from packed_page import unpacked

from cnc_interp.client.bag import Bag
from cnc_interp.client.recorded_feedback import recorded_feedback
from cnc_interp.client.run_request import RunRequest
from cnc_interp.client.session import run_session
from cnc_interp.commands.cli import main
from cnc_interp.core import UM
from cnc_interp.machine_model.machine import Machine, find_machine_file

#: A vertical mill whose X is tired.
DRIVES = """
loads:
  X: {mass_kg: 400.0, force_N: 4000.0, coulomb_N: 100.0}
drives:
  X: {position_gain_per_s: 60.0, feed_forward: 0.95, velocity_lag_ms: 4.0, backlash_um: 8.0, resolution_um: 0.1}
"""  # noqa: E501
PROGRAM = (
    'G21 G94 G91\nG0 X0 Y0 Z0\n' + 'G1 X4 F1200\nX-4\nX2 F3000\nX-2\nX1 F200\nX-1\n' * 2 + 'M2\n'
)


@pytest.mark.thorough
def test_the_drive_of_an_axis_is_found_in_a_bag(tmp_path, capfd):
    tired, again = tmp_path / 'tired.yaml', tmp_path / 'again.yaml'
    tired.write_text(find_machine_file('xyz').read_text() + DRIVES)
    program, bag = tmp_path / 'part.ngc', tmp_path / 'bag'
    program.write_text(PROGRAM)
    (result,) = run_session(RunRequest(program, machine=str(tired), record=bag, quiet=True))
    assert result.ok, result.message
    with Bag(bag) as opened:
        recorded, _ = recorded_feedback(opened, str(tired))
    assert len(recorded.setpoint) >= result.samples
    off = recorded.setpoint - recorded.feedback
    assert 20 * UM < abs(off[:, 0]).max() < 500 * UM
    assert main(['identify', str(bag), '--out', str(again)]) == 0
    told = capfd.readouterr().out
    assert 'X: model off by' in told and 'Y: model' not in told  # Y stood still
    found, truth = Machine.load(again), Machine.load(tired)
    assert found.drives[0].position_gain == pytest.approx(60.0, rel=0.1)
    assert found.drives[0].backlash == pytest.approx(8 * UM, rel=0.3)
    assert found.limits.loads[0].coulomb == pytest.approx(truth.limits.loads[0].coulomb, rel=0.3)
    page = (tmp_path / 'again.html').read_text()
    assert any('measured minus modelled' in part for part in unpacked(page))
