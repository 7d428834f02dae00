"""What a record lacks of the streams is counted."""

from dataclasses import dataclass
from types import SimpleNamespace

import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import (
    G1Block,
    G1BlockBatch,
    PathSegment,
    PathSegmentBatch,
    SetpointChunk,
    StreamStatus,
)

from cnc_interp.client import run_console
from cnc_interp.client.recorder import StreamRecord


def blocks(first, count):
    one = [G1Block(program_id='a', sequence=first + k) for k in range(count)]
    return G1BlockBatch(blocks=one)


def segments(first, count):
    one = [PathSegment(program_id='a', sequence=first + k) for k in range(count)]
    return PathSegmentBatch(segments=one)


def setpoints(first, count, plan=0):
    return SetpointChunk(
        program_id='a',
        plan=plan,
        first_sample=first,
        line_numbers=[1] * count,
        tail_line_numbers=[1] * 7,
    )


@pytest.mark.parametrize(
    ('topic', 'message'),
    [('block_batches', blocks), ('segments', segments), ('setpoints', setpoints)],
)
def test_what_is_missing_in_the_middle_is_counted_and_what_came_twice_is_not(topic, message):
    record = StreamRecord(topic)
    assert record.lost == 0
    for first, count in ((10, 5), (15, 5), (15, 5), (40, 10)):
        record.add(message(first, count))
    assert record.lost == 20
    record.add(message(18, 12))  # sent again, late
    assert record.lost == 10


def test_each_plan_has_its_own_numbers():
    record = StreamRecord('setpoints')
    for first, plan in ((0, 0), (10, 0), (15, 1), (25, 1), (0, 2), (20, 2)):
        record.add(setpoints(first, 10, plan))
    assert record.lost == 10


def test_what_the_receiver_has_and_the_record_has_not_is_missing():
    """On a busy computer DDS gave a recorder nothing of a second run; nothing was missing."""
    record = StreamRecord('setpoints')
    for reached in (0, 5, 30):
        record.acknowledge(StreamStatus(program_id='a', stream='setpoints', next_sequence=reached))
    assert record.lost == 30
    record.add(setpoints(5, 20))
    assert record.lost == 10  # the first message of the plan, and the last
    record.add(setpoints(0, 5))
    record.add(setpoints(25, 5))
    assert record.lost == 0
    begun_before = StreamRecord('setpoints')
    begun_before.acknowledge(StreamStatus(program_id='a', next_sequence=100))
    begun_before.add(setpoints(100, 10))
    assert begun_before.lost == 0


@dataclass(frozen=True)
class Result:
    ok: bool = True
    message: str = 'executed to the end'


def test_a_full_disk_ends_the_record_and_the_summary_is_told(tmp_path, monkeypatch):
    """Nothing was told of a run whose record did not fit the disk."""

    class FullDisk:
        def __init__(self, *_):
            pass

        def finish(self):
            raise OSError(28, 'No space left on device', str(tmp_path / 'bag'))

    class Console(FullDisk):
        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def run(self, *_):
            return [Result()]

    monkeypatch.setattr(run_console, 'RecorderProcess', FullDisk)
    monkeypatch.setattr(run_console, 'RunConsole', Console)
    monkeypatch.setattr(run_console, 'tool_warnings', lambda *_: [])
    request = SimpleNamespace(
        record=tmp_path / 'bag', out=None, settings=SimpleNamespace(tool_error=None)
    )
    client = SimpleNamespace(namespace='/run', domain=0)
    (result,) = run_console.run_recorded(request, None, client, None, 0.0)
    assert not result.ok
    assert result.message.startswith('executed to the end; ')
    assert 'No space left on device' in result.message
