"""Blocks into segment messages: numbered, ended and marked with stops, however they come."""

import numpy as np
import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import G1Block
from programs import zigzag

from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.machine_traits import traits_of
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.nodes.lookahead_node import SmoothingRun
from cnc_interp.run.run_state import RunId
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.path_smoother import PathSmoother
from cnc_interp.wire.path_messages import block_messages, segments_from

RUN = RunId('run', attempt=1)
TRAITS = traits_of(Transform.of(Machine.load('xyzac')))


def messages(stops=()):
    found = block_messages(zigzag(0), RUN, 0, 0.03, end=True)
    found[0].continue_at = 0.01
    for block, kind in stops:
        found[block].program_stop = kind
    return found


def smoothed(blocks, at_a_time):
    """All segments of blocks that come a few at a time."""
    run, segments = SmoothingRun(blocks[0], PathSmoother(Settings(), TRAITS)), []
    for k, block in enumerate(blocks, start=1):
        run.take(block)
        if (k % at_a_time == 0 or k == len(blocks)) and run.can_smooth:
            count, found = run.smooth()
            assert count <= at_a_time
            segments += found
    assert run.complete == blocks[-1].end_of_program
    found, problem = run.end()
    assert not problem and not run.can_smooth and run.end() == ([], '')
    return segments + found


@pytest.mark.parametrize('at_a_time', [1, 3, 1000])
def test_segments_are_numbered_and_the_last_one_ends_the_program(at_a_time):
    segments = smoothed(messages(), at_a_time)
    assert [s.sequence for s in segments] == list(range(len(segments)))
    assert [s.end_of_program for s in segments] == [False] * (len(segments) - 1) + [True]
    assert {(s.program_id, s.attempt) for s in segments} == {('run', 1)}
    assert segments[0].continue_at == 0.01
    whole = segments_from(smoothed(messages(), 1000))
    assert np.array_equal(segments_from(segments).block, whole.block)


def test_the_path_ends_at_the_last_block_that_came():
    blocks = messages()
    segments = smoothed(blocks[:5], 2)
    assert segments[-1].end_of_program and segments[-1].last_block == blocks[4].sequence


def test_of_program_stops_that_meet_m0_counts():
    stops = [(3, G1Block.OPTIONAL_STOP), (4, G1Block.STOP)]
    blocks = messages(stops)
    for block in blocks[3:5]:
        block.exact_stop = True
    told = {s.last_block: s.program_stop for s in smoothed(blocks, 3) if s.program_stop}
    assert told == {3: G1Block.OPTIONAL_STOP, 4: G1Block.STOP}
    assert smoothed(messages(stops)[:5], 3)[-1].program_stop == G1Block.STOP
