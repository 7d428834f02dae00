"""The record of a periodic thread: quantiles against NumPy's, whatever the lateness."""

import numpy as np
import pytest

from cnc_interp.machine.realtime import CLASS, CLASSES, RECORD, Lateness, note_lateness

NANO = 1e-9


def record_of(late):
    record = np.zeros(RECORD, dtype=np.int64)
    for each in late:
        note_lateness(record, int(each))
    return Lateness(record, 1e-3)


@pytest.mark.parametrize('scale', [3e3, 1e5, 5e6])
def test_quantiles_are_those_of_all_wake_ups_to_one_class(scale):
    late = np.random.default_rng(1).exponential(scale, 5000).astype(int)
    record = record_of(late)
    assert record.count == 5000 and record.missed == (late >= 1_000_000).sum()
    assert record.largest == late.max() * NANO
    for share in (0.5, 0.99, 0.999, 1.0):
        true = np.quantile(late, share, method='inverted_cdf') * NANO
        assert true <= record.quantile(share) + 1e-12 <= true + CLASS * NANO + 1e-12


def test_too_early_counts_as_in_time_and_too_late_as_the_latest():
    assert record_of([-1_000_000]).quantile(1.0) == 0.0
    record = record_of([-1_000_000, 10 * CLASS * CLASSES])
    assert record.largest == 10 * CLASS * CLASSES * NANO and record.missed == 1
