"""What a record lacks of the streams is counted."""

from dataclasses import dataclass
from types import SimpleNamespace

import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import (
    G1Block,
    G1BlockBatch,
    MachineState,
    PathSegment,
    PathSegmentBatch,
    SetpointChunk,
)

from cnc_interp.client import run_console
from cnc_interp.client.recorder import StreamRecord, counting
from cnc_interp.machine.jog import JOG
from cnc_interp.run.run_state import RunId


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
        record.acknowledge(RunId('a'), reached)
    assert record.lost == 30
    record.add(setpoints(5, 20))
    assert record.lost == 10  # the first message of the plan, and the last
    record.add(setpoints(0, 5))
    record.add(setpoints(25, 5))
    assert record.lost == 0
    begun_before = StreamRecord('setpoints')
    begun_before.acknowledge(RunId('a'), 100)
    begun_before.add(setpoints(100, 10))
    assert begun_before.lost == 0


def test_executed_setpoints_are_missing_until_the_record_has_all_that_the_machine_counts():
    """A record ended before the last executed setpoints came; they were counted over all runs."""
    record = StreamRecord('executed_setpoints')
    record.add(setpoints(0, 500, plan=0))
    record.acknowledge(counting(MachineState(program_id='a', plan=1)), 490)
    assert record.lost == 0
    for attempt in (1, 2):  # each motion by hand counts from 0
        by_hand = MachineState(program_id=JOG, attempt=attempt, samples=1000)
        record.acknowledge(counting(by_hand), by_hand.samples)
        moved = setpoints(0, 1000 if attempt == 1 else 840)
        moved.program_id, moved.attempt = JOG, attempt
        record.add(moved)
    assert record.lost == 160
    record.acknowledge(counting(MachineState(program_id='a', plan=3)), 700)
    assert record.lost == 200 + 160
    record.add(setpoints(500, 200, plan=3))
    moved.first_sample = 840
    moved.line_numbers = [1] * 160
    record.add(moved)
    assert record.lost == 0


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
