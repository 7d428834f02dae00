"""Any path, any limits: the emitted samples keep every limit."""

from __future__ import annotations

import numpy as np
from feedrate_paths import XYZAC, Limits, polyline_path, random_polyline, sampled_ratios
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc_interp.feedrate.window import plan_path


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 2**32 - 1),
    corners=st.integers(0, 6),
    longest=st.floats(-4, -0.7),
    feed=st.one_of(st.just(np.inf), st.floats(-3, -0.3).map(lambda x: 10.0**x)),
    amplitude=st.floats(0, 1.5),
    spread=st.floats(0, 1.5),
    stop=st.booleans(),
)
def test_samples_keep_every_limit(seed, corners, longest, feed, amplitude, spread, stop):
    rng = np.random.default_rng(seed)
    factors = 10 ** rng.uniform(-spread, spread, (3, 5))
    limits = Limits(
        XYZAC.max_velocity * factors[0],
        XYZAC.max_acceleration * factors[1],
        XYZAC.max_jerk * factors[2],
    )
    points = random_polyline(rng, corners, 10.0**longest)
    stops = (1,) if stop and corners else ()
    path = polyline_path(points, feed, amplitude=amplitude, stops=stops)
    piece = plan_path(path, limits)
    assert sampled_ratios(piece.path, piece.law, limits).max() <= 1.001
    assert abs(piece.law.evaluate(np.array([np.inf]))[0][0] - path.s[-1]) < 1e-12
