"""The record of a periodic thread: quantiles against NumPy's, whatever the lateness."""

import numpy as np
import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp.machine.realtime import CLASS, LATEST, Lateness


@pytest.mark.parametrize('scale', [3e-6, 1e-4, 5e-3])
def test_quantiles_are_those_of_all_wake_ups_to_one_class(scale):
    late = np.random.default_rng(1).exponential(scale, 5000)
    record = Lateness(1e-3)
    for each in late:
        record.add(float(each))
    assert record.count == 5000 and record.missed == (late > 1e-3).sum()
    assert record.largest == late.max()
    for share in (0.5, 0.99, 1.0):
        true = np.quantile(late, share, method='inverted_cdf')
        assert true <= record.quantile(share) + 1e-12 <= true + CLASS + 1e-12


def test_too_early_counts_as_in_time_and_too_late_as_the_latest():
    record = Lateness(1e-3)
    record.add(-1e-3)
    assert record.quantile(1.0) == 0.0
    record.add(10 * LATEST)
    assert record.largest == 10 * LATEST and record.missed == 1
