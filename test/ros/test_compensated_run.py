"""A program over ROS on tired drives, with and without compensation."""

from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp.client.session import RunRequest, run_session
from cnc_interp.core.errors import InterpError

PYRAMID = Path(__file__).parents[2] / 'examples' / 'pyramid.ngc'


def test_compensation_takes_the_error_out(tmp_path):
    results = []
    for model in ('', 'xyzac_tired'):
        request = RunRequest(PYRAMID, machine='xyzac_tired', compensate=model, quiet=True)
        (result,) = run_session(request)
        assert result.ok and not result.excesses, result.message
        results.append(result.contour_error)
    assert results[1] < 0.2 * results[0]


def test_a_model_with_other_axes_is_refused():
    request = RunRequest(PYRAMID, machine='xyzac_tired', compensate='xyz', quiet=True)
    with pytest.raises(InterpError, match='machine_node cannot be configured'):
        run_session(request)
