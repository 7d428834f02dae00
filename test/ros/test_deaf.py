"""ROS stands in the process of a command, as a deadlock inside of it does: the command ends."""

import subprocess
import sys
import time
from math import nan
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp.client import run_console
from cnc_interp.client.operator_client import SPIN, OperatorClient
from cnc_interp.client.run_request import RunRequest
from cnc_interp.client.session import run_session
from cnc_interp.core import InterpError

EXAMPLE = Path(__file__).parents[2] / 'examples' / 'pyramid.ngc'
#: What stands with the lock of the interpreter, as a wait inside of ROS does.
STANDS = """
import ctypes
from cnc_interp.client import operator_client
operator_client.LAST_WAIT = 1.0
client = operator_client.OperatorClient('stands', '/stands', 87)
client._action.destroy = ctypes.PyDLL(None).pause
client.close()
"""


def test_a_run_that_hears_nothing_any_more_ends(monkeypatch):
    serve = OperatorClient.serve

    def serve_until_motion(self, timeout=SPIN):
        if self.state is not None and self.state.samples:
            time.sleep(timeout)
        else:
            serve(self, timeout)

    monkeypatch.setattr(run_console, 'DEAF', 1.5)
    monkeypatch.setattr(OperatorClient, 'serve', serve_until_motion)
    with pytest.raises(InterpError, match=r'the nodes have sent nothing for 1\.5 s'):
        run_session(RunRequest(EXAMPLE, quiet=True))


def test_the_first_motion_was_a_period_per_setpoint_ago(monkeypatch):
    state = SimpleNamespace(samples=300, interpolation_period=2e-3)
    console = SimpleNamespace(_client=SimpleNamespace(state=state), _first_motion=nan)
    monkeypatch.setattr(run_console.time, 'monotonic', lambda: 50.0)
    for _ in range(2):  # what came first counts
        run_console.RunConsole._see_motion(console)
        state.samples += 100
    assert console._first_motion == pytest.approx(49.4)


@pytest.mark.thorough
def test_a_client_whose_ros_stands_at_its_end_leaves():
    done = subprocess.run([sys.executable, '-c', STANDS], capture_output=True, timeout=60)
    assert done.returncode == 1 and b'in close' in done.stderr
