"""The blocks of a program go out in batches, each once and in order, whatever the window."""

import numpy as np
import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import G1Block

from cnc_interp.core import StreamError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import Signals
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.nodes.program_check import Prepared
from cnc_interp.nodes.program_run import LINES_AHEAD, MOST_QUEUED, MOST_TOGETHER, BlockFeed
from cnc_interp.program import JobSetup, read_text
from cnc_interp.program.blocks.block_modes import ModesOfBlocks
from cnc_interp.run.run_state import RunId
from cnc_interp.settings.options import Settings
from cnc_interp.wire.path_messages import blocks_from
from cnc_interp.wire.window_protocol import WindowedSender

RUN = RunId('run')
#: Rows at whose ends a stop is faster, the last of a batch and the first of the next among them.
STOPS = (5, MOST_TOGETHER - 1, MOST_TOGETHER)
TEXT = 'G21 G90 G94\nG0 X0 Y0 Z0\nF600\n' + ''.join(f'G1 X{k}\n' for k in range(1, 1300)) + 'M2\n'


@pytest.fixture
def feed():
    transform, settings = Transform.of(Machine.load('xyz')), Settings()
    blocks = read_text(TEXT, 'line.ngc', transform, settings).blocks
    feed, sender = BlockFeed(Signals()), WindowedSender(1.0)
    program = Prepared(
        blocks,
        (),
        TEXT,
        settings,
        1.3,
        np.array(STOPS),
        JobSetup(),
        False,
        (),
        frozenset(),
        ModesOfBlocks(),
    )
    feed.begin(program, RUN, 0.0, sender)
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
    corners = [block.corner for block in received]
    assert {row for row, corner in enumerate(corners) if corner == G1Block.CORNER_STOP} == {*STOPS}
    assert set(corners) == {G1Block.CORNER_ROUND, G1Block.CORNER_STOP}


def test_a_batch_that_was_lost_goes_out_again(feed):
    feed, sender, _ = feed
    feed.fill(sender)
    sender.acknowledge(RUN, 0, 10_000, 0.0)
    first = sender.due(0.0)
    sender.acknowledge(RUN, MOST_TOGETHER, 10_000, 1.0, gap=True)
    assert [item.first for item in sender.due(1.0)] == [first[1].first]
    sender.acknowledge(RUN, 2 * MOST_TOGETHER, 10_000, 1.1)  # the receiver may lack the others
    assert [item.first for item in sender.due(1.1)] == [item.first for item in first[2:4]]


def test_single_block_adds_exact_stops_to_the_lines_that_it_sends(feed):
    """Few lines ahead of the machine; once sent, a line has its stop in each attempt."""
    feed, sender, _ = feed
    feed.fill(sender, single_block=True)
    assert feed.holds_back and sender.next_number == LINES_AHEAD + 1
    feed.fill(sender, single_block=True, executed=2)
    feed.fill(sender, single_block=True, executed=2)
    assert feed.holds_back and sender.next_number == LINES_AHEAD + 3
    for attempt in range(2):
        feed.fill(sender)  # it is switched off
        assert not feed.holds_back
        sender.acknowledge(RUN, 0, 10_000, 0.0)
        sent = [block for item in sender.due(0.0) for block in feed.message(*item_of(item)).blocks]
        stops = [block.sequence for block in sent if block.exact_stop]
        assert stops == list(range(1, LINES_AHEAD + 3)), attempt
        feed.begin(feed._prepared, RUN, 0.0, sender)
        feed.fill(sender, single_block=True, executed=4)  # and on again: nothing changes before


def item_of(item):
    return item.item, item.first


def test_no_block_after_the_end(feed):
    feed, sender, _ = feed
    feed.end(sender)
    feed.fill(sender)
    assert not sender.due(0.0)
    with pytest.raises(StreamError):
        feed.message(slice(0, 1), 0)
