"""The blocks of a program go out in batches, each once and in order, whatever the window."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp.core.errors import StreamError
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.nodes.block_feed import MOST_QUEUED, MOST_TOGETHER, BlockFeed
from cnc_interp.program import read_text
from cnc_interp.run.run_id import RunId
from cnc_interp.settings.choices import Settings
from cnc_interp.wire.path_messages import blocks_from
from cnc_interp.wire.window_protocol import WindowedSender

RUN = RunId('run')
TEXT = 'G21 G90 G94\nG0 X0 Y0 Z0\nF600\n' + ''.join(f'G1 X{k}\n' for k in range(1, 1300)) + 'M2\n'


@pytest.fixture
def feed():
    transform, settings = Transform.of(Machine.load('xyz')), Settings()
    blocks = read_text(TEXT, 'line.ngc', transform, settings).blocks
    feed, sender = BlockFeed(), WindowedSender(1.0)
    feed.begin(SimpleNamespace(blocks=blocks, settings=settings), RUN, 0.0, sender)
    return feed, sender, blocks


@pytest.mark.parametrize('window', [1, 100, 10_000])
def test_every_block_goes_out_once_and_in_order(feed, window):
    feed, sender, blocks = feed
    received, now = [], 0.0
    while len(received) < len(blocks):
        feed.fill(sender)
        assert sender.unsent < MOST_QUEUED + MOST_TOGETHER
        for item in sender.due(now):
            assert item.first == len(received)
            batch = feed.message(item.item, item.first).blocks
            assert 0 < len(batch) <= MOST_TOGETHER
            received += batch
        now += 0.01
        sender.acknowledge(RUN, len(received), len(received) + window, now)
    assert [block.sequence for block in received] == list(range(len(blocks)))
    assert [block.end_of_program for block in received].index(True) == len(blocks) - 1
    again = blocks_from(received)
    assert np.array_equal(again.tip, blocks.tip) and np.array_equal(again.axis, blocks.axis)
    assert received[0].settings and not received[1].settings


def test_a_batch_that_was_lost_goes_out_again(feed):
    feed, sender, _ = feed
    feed.fill(sender)
    sender.acknowledge(RUN, 0, 10_000, 0.0)
    first = sender.due(0.0)
    sender.acknowledge(RUN, MOST_TOGETHER, 10_000, 1.0, gap=True)
    again = sender.due(1.0)
    assert [item.first for item in again] == [item.first for item in first[1:]]


def test_no_block_after_the_end(feed):
    feed, sender, _ = feed
    feed.end(sender)
    feed.fill(sender)
    assert not sender.due(0.0)
    with pytest.raises(StreamError):
        feed.message(slice(0, 1), 0)
