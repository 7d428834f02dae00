"""Messages dropped, repeated, reordered and spoilt between the nodes: nothing is lost or moved."""

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from operated import Bench
from relay import ARGUMENTS, KINDS, Relay

pytestmark = pytest.mark.thorough


def test_every_block_is_executed_over_a_bad_line():
    bench = Bench(arguments=ARGUMENTS)
    relay = Relay(bench.namespace, bench.domain, np.random.default_rng(3), 0.1)
    try:
        bench.finish(bench.begin())
        assert min(relay.counts[kind] for kind in KINDS) >= 3, relay.counts
        said = {text for _, text in bench.diagnostics}
        for words in ('checksum', 'gap', 'repeat'):
            assert any(words in text for text in said), words
    finally:
        relay.close()
        bench.close()
