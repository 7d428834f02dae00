"""A program over ROS on tired drives, with and without compensation."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp.client.run_request import RunRequest
from cnc_interp.client.session import run_session
from cnc_interp.commands.parser import FAILED
from cnc_interp.core import UM, InterpError
from cnc_interp.drives.tool_error import tool_error
from cnc_interp.machine_model.machine import Machine
from cnc_interp.settings.options import Settings

PYRAMID = Path(__file__).parents[2] / 'examples' / 'pyramid.ngc'


@pytest.mark.thorough
def test_compensation_takes_the_error_out(tmp_path):
    results = []
    for model in (None, 'xyzac_tired'):
        settings = Settings(compensation=model)
        request = RunRequest(PYRAMID, machine='xyzac_tired', settings=settings, quiet=True)
        (result,) = run_session(request)
        assert result.ok and not result.excesses, result.message
        results.append(result.contour_error)
    assert results[1] < 0.2 * results[0]


@pytest.mark.thorough
def test_a_model_with_other_axes_is_refused():
    settings = Settings(compensation='xyz')
    request = RunRequest(PYRAMID, machine='xyzac_tired', settings=settings, quiet=True)
    with pytest.raises(InterpError, match='machine_node cannot be configured'):
        run_session(request)


@pytest.mark.thorough
def test_a_limit_on_the_error_at_the_tool_holds_for_what_was_executed(tmp_path):
    largest, out = 100 * UM, tmp_path / 'out'
    settings = Settings(tool_error=largest)
    request = RunRequest(PYRAMID, machine='xyzac_tired', settings=settings, out=out, quiet=True)
    (result,) = run_session(request)
    assert result.ok and not result.excesses, result.message
    rows = np.load(out / 'setpoints.npz')
    error = tool_error(Machine.load('xyzac_tired'), 1e-3, rows['position'], rows['velocity'])
    assert 0.9 * largest < error.tip.max() <= 1.001 * largest


@pytest.mark.thorough
def test_the_run_and_its_plan_have_one_verdict(tmp_path):
    """Friction and backlash need more than this at any speed; the machine stands at the start."""
    program = tmp_path / 'part.ngc'
    program.write_text('G21 G90 G94\nG0 X-40 Y69.85 Z-140\nG1 X-38 F600\nY71\nX-40\nM30\n')
    words = [str(program), '--machine', 'xyzac_tired', '--tool-error', '0.02']
    verdicts = []
    for command in (['plan', *words, '--out', str(tmp_path / 'plan')], ['run', *words]):
        done = subprocess.run(
            [sys.executable, '-m', 'cnc_interp', *command],
            capture_output=True,
            text=True,
            stdin=subprocess.DEVNULL,
            check=False,
        )
        assert done.returncode == FAILED, done.stderr
        assert 'WARNING: friction and backlash of the linear axes cause up to' in done.stderr
        verdicts.append(re.findall(r'^(?:tool error|NOT proven).*', done.stdout, re.M))
    assert verdicts[0] == verdicts[1] and len(verdicts[0]) == 2
