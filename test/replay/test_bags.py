"""Recorded bags: computed again, proven, reported, read by others, refused as lessons."""

import json
import random
import re
import resource
import shutil
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from ament_index_python.packages import get_package_share_directory
from cnc_interp_msgs.msg import MachineState
from mcap.reader import make_reader
from nodes_under_test import NodesUnderTest
from rclpy.serialization import deserialize_message, serialize_message
from record import PARAMETERS, record
from rosbags.rosbag2 import Reader
from tiers import few_of

from cnc_interp.client.bag import TOPICS, Bag, BagWriter, SpooledMessages, repair
from cnc_interp.client.recorded_feedback import recorded_lesson
from cnc_interp.client.recorded_run import recorded_run, write_run
from cnc_interp.client.replay import compute_again
from cnc_interp.commands.cli import main
from cnc_interp.core import InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.nodes.streams import sealed
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.run.setpoints import Setpoints

HERE = Path(__file__).parent
HELD, FAULTY = HERE / 'held', HERE / 'faulty'


@pytest.fixture(scope='module')
def recorded_now(tmp_path_factory):
    bag = tmp_path_factory.mktemp('bags') / 'now'
    record(bag, 0.0, lambda session: session.run(hold=True))
    return bag


@pytest.mark.parametrize('path', [HELD, FAULTY], ids=['held', 'faulty'])
def test_recorded_blocks_give_the_recorded_motion(path):
    """Another processor may round differently, so not bit for bit."""
    with Bag(path) as bag:
        found = list(compute_again(bag))
    assert max(c.difference for c in found) < 1e-6
    assert min(c.recorded for c in found) > 100
    assert len(found) == (2 if path == HELD else 1)  # after a hold a plan begins anew


def test_blocks_recorded_now_give_the_same_setpoints_bit_for_bit(recorded_now):
    with Bag(recorded_now) as bag:
        found = list(compute_again(bag))
    assert [c.same for c in found] == [c.recorded for c in found]
    assert min(c.recorded for c in found) > 100


@pytest.mark.parametrize('path', few_of(2, [FAULTY, HELD]), ids=['faulty', 'held'])
def test_recorded_run_is_proven_and_reported(path, tmp_path, capsys):
    assert main(['check', str(path)]) == 0
    assert 'proven' in capsys.readouterr().out
    page = tmp_path / 'page.html'
    assert main(['report', str(path), '--html', str(page)]) == 0
    assert page.stat().st_size > 100_000


def copied(source, target, change, closed=True):
    """Copy a bag with a change to each message; None leaves it out."""
    with Bag(source) as bag:
        writer = BagWriter(target)
        for name, value in bag.parameters.items():
            node, _, parameter = name.partition('.')
            writer.note(node, {parameter: value})
        for topic, stamp, data in bag.raw(*TOPICS):
            changed = change(topic, data)
            if changed is not None:
                writer.write(topic, changed, stamp)
        if closed:
            writer.close()


def test_the_bag_of_a_killed_recorder_is_repaired(tmp_path, capsys):
    killed, sound = tmp_path / 'killed', tmp_path / 'sound'
    copied(HELD, killed, lambda topic, data: data, closed=False)
    (file,) = killed.glob('*.mcap')
    file.write_bytes(file.read_bytes()[:-1000])
    assert main(['check', str(killed)]) == 2
    assert f'cnc-interp repair {killed}' in capsys.readouterr().err
    assert main(['repair', str(killed), '--out', str(sound)]) == 0
    with Bag(HELD) as bag, Bag(sound) as repaired:
        assert repaired.parameters == bag.parameters
        left, whole = list(repaired.raw(*TOPICS)), list(bag.raw(*TOPICS))
    assert 100 < len(left) < len(whole) and left == whole[: len(left)]
    file.write_bytes(file.read_bytes()[:1000])
    assert main(['repair', str(killed), '--out', str(tmp_path / 'none')]) == 2
    assert 'contains no complete message' in capsys.readouterr().err


def test_a_killed_recorder_loses_a_second_at_most(tmp_path):
    writer = BagWriter(tmp_path / 'killed')
    for k in range(10, 41):
        writer.write('blocks', b'', k * 100_000_000)
    count, span = repair(tmp_path / 'killed', tmp_path / 'sound')
    assert count < 31 and span > 2.0


def without_executed(lost, path, spoil=lambda message: None):
    """
    Copy a bag without some messages of executed setpoints.

    Return the line numbers of the program's setpoints that it keeps.
    """
    count, kept = iter(range(1000)), []

    def keep(topic, data):
        if topic != 'executed_setpoints':
            return data
        number, message = next(count), deserialize_message(data, TOPICS[topic][0])
        spoil(message)
        if number in lost:
            return None
        of_program = np.array(message.sequences) > 0  # the approach has no block
        kept.extend(np.array(message.line_numbers)[of_program])
        return serialize_message(message)

    copied(HELD, path, keep)
    return kept


@pytest.mark.parametrize(
    ('lost', 'end'),
    [
        (range(15, 1000), 'the record ends in motion, in line {}; nothing is known after {} s'),
        (range(20, 21), r'the record lacks executed setpoints \d+ to \d+, after line'),
    ],
)
def test_a_cut_record_is_proven_up_to_its_cut(tmp_path, capsys, lost, end):
    kept = without_executed(lost, tmp_path / 'cut')
    assert main(['check', str(tmp_path / 'cut')]) == 1
    told = capsys.readouterr().out
    known = len(kept) - 3  # a cut stops nothing: the jerk of its last samples is not known
    end = end.format(kept[-1], f'{known / 1000:.3f}')
    assert re.search(end, told) and 'proven as far as the record goes' in told


def test_a_fault_before_the_cut_is_one(tmp_path, capsys):
    def spoil(message):
        if message.first_sample <= 1200 < message.first_sample + len(message.sequences):
            message.positions[2] += 1e-4

    without_executed(range(15, 1000), tmp_path / 'cut', spoil)
    assert main(['check', str(tmp_path / 'cut')]) == 1
    told = capsys.readouterr().out
    assert 'jerk of Z' in told and 'NOT proven, faults' in told


def test_of_a_record_that_ends_on_the_approach_nothing_is_proven(tmp_path, capsys):
    without_executed(range(2, 1000), tmp_path / 'cut')
    assert main(['check', str(tmp_path / 'cut')]) == 2
    assert 'ends before the program begins' in capsys.readouterr().err


def test_a_full_disk_ends_the_record_and_not_the_run(tmp_path):
    writer = BagWriter(tmp_path / 'bag')
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 16, limits[1]))
    try:
        for stamp in range(100):  # the writer collects messages before it writes
            writer.write('blocks', random.randbytes(1 << 16), stamp)
        with pytest.raises(OSError, match='record of the run is not complete') as told:
            writer.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert told.value.filename == str(tmp_path / 'bag')
    assert writer.count < 100


def test_one_bit_of_one_setpoint_is_seen(recorded_now, tmp_path, capsys):
    done = []

    def spoil(topic, data):
        if topic != 'setpoints' or done:
            return data
        done.append(True)
        message = deserialize_message(data, TOPICS[topic][0])
        message.positions[-1] = np.nextafter(message.positions[-1], np.inf)
        return sealed(message)

    copied(recorded_now, tmp_path / 'spoilt', spoil)
    assert main(['replay', str(tmp_path / 'spoilt'), '--compare']) == 1
    assert 'the same up to 99, then DIFFERENT' in capsys.readouterr().out
    assert main(['replay', str(recorded_now), '--compare']) == 0


def test_an_executed_setpoint_off_the_path_is_not_proven(tmp_path, capsys):
    def shift(topic, data):
        if topic != 'executed_setpoints':
            return data
        message = deserialize_message(data, TOPICS[topic][0])
        message.positions[2] += 1e-3
        return serialize_message(message)

    copied(HELD, tmp_path / 'shifted', shift)
    assert main(['check', str(tmp_path / 'shifted')]) == 1
    assert 'NOT proven' in capsys.readouterr().out


def test_the_path_of_a_run_is_that_of_its_recorded_segments(tmp_path, capsys):
    def shift(topic, data):
        if topic != 'segments':
            return data
        message = deserialize_message(data, TOPICS[topic][0])
        for segment in message.segments:
            for k in range(0, len(segment.bottom.control_points), 3):
                segment.bottom.control_points[k] += 1e-3
        return sealed(message)

    copied(HELD, tmp_path / 'shifted', shift)
    assert main(['check', str(tmp_path / 'shifted')]) == 1
    failures = [
        line for line in capsys.readouterr().out.splitlines() if 'contour deviation' in line
    ]
    assert any('of path' in line and ' 1 mm' in line for line in failures), failures


def test_executed_setpoints_are_read_one_message_at_a_time_and_in_order():
    with Bag(HELD) as bag:
        run = recorded_run(bag)
    machine = Machine.load(run.machine)
    assert isinstance(run.chunks, SpooledMessages)
    found = Setpoints.concatenate(list(run.setpoints(machine)))
    np.testing.assert_array_equal(found.time, np.arange(len(found)) * run.period)
    assert found.block[0] >= 1 and (np.diff(found.s) >= 0.0).all()
    turned = replace(run, chunks=list(run.chunks)[::-1])
    again = Setpoints.concatenate(list(turned.setpoints(machine)))
    np.testing.assert_array_equal(again.position, found.position)


def test_plan_files_of_a_run_have_its_blocks_segments_and_feeds(tmp_path):
    with Bag(HELD) as bag:
        run = recorded_run(bag)
    summary = write_run(run, Machine.load(run.machine), tmp_path)
    plan = read_plan(tmp_path)
    assert len(plan.blocks['tip']) == len(run.blocks)
    assert summary['segments'] == len(run.segments)
    s, time = np.asarray(plan.setpoints['s']), np.asarray(plan.setpoints['time'])
    assert plan.path['s'][-1] == pytest.approx(s[-1], abs=1e-9)
    middle = s[200:-200:50]  # the feed column against differences of the executed setpoints
    k = np.searchsorted(s, middle)
    speed = (s[k + 1] - s[k - 1]) / (time[k + 1] - time[k - 1])
    moving = speed > 1e-3
    feed = np.interp(middle, plan.path['s'], plan.path['feed'])
    np.testing.assert_allclose(feed[moving], speed[moving], rtol=0.02)
    assert moving.sum() > 10


def test_what_is_missing_is_named(tmp_path, capsys):
    copied(HELD, tmp_path / 'no_blocks', lambda topic, data: data if topic != 'blocks' else None)
    assert main(['check', str(tmp_path / 'no_blocks')]) == 2
    assert 'block 0' in capsys.readouterr().err
    copied(HELD, tmp_path / 'no_path', lambda topic, data: data if topic != 'segments' else None)
    assert main(['check', str(tmp_path / 'no_path')]) == 2
    assert 'segment 0' in capsys.readouterr().err
    assert main(['record', str(HELD)]) == 2
    assert 'exists already' in capsys.readouterr().err
    shutil.copytree(HELD, tmp_path / 'cut')
    (file,) = (tmp_path / 'cut').glob('*.mcap')
    file.write_bytes(file.read_bytes()[:2000])
    assert main(['replay', str(tmp_path / 'cut'), '--compare']) == 2
    assert 'not a bag that can be read' in capsys.readouterr().err


def test_other_readers_understand_the_bag():
    """Schemas, QoS and type hashes are those of ROS; the reference library reads the file."""
    (file,) = HELD.glob('*.mcap')
    share = Path(get_package_share_directory('cnc_interp_msgs')) / 'msg'
    with file.open('rb') as stream:
        reader = make_reader(stream)
        assert reader.get_header().profile == 'ros2'
        summary = reader.get_summary()
        schemas = {schema.name: schema for schema in summary.schemas.values()}
        for channel in summary.channels.values():
            assert channel.message_encoding == 'cdr'
            assert 'reliability: reliable' in channel.metadata['offered_qos_profiles']
        assert schemas['cnc_interp_msgs/msg/PathSegmentBatch'].encoding == 'ros2msg'
        assert (
            b'MSG: cnc_interp_msgs/BSpline' in schemas['cnc_interp_msgs/msg/PathSegmentBatch'].data
        )
        counted = sum(1 for _ in reader.iter_messages())
    assert counted == summary.statistics.message_count > 50
    with Reader(HELD) as bag:
        for connection in bag.connections:
            package, _, name = connection.msgtype.split('/')
            if package == 'cnc_interp_msgs':
                told = json.loads((share / f'{name}.json').read_text(encoding='utf-8'))
                hashes = {t['type_name']: t['hash_string'] for t in told['type_hashes']}
                assert connection.digest == hashes[connection.msgtype]


def faults(messages, node):
    """What the look-ahead refused of its blocks: the kinds in their order, and how many in all."""
    statuses = [
        status
        for array in messages
        for status in array.status
        if status.name == f'{node}: blocks' and any(p.key == 'refused' for p in status.values)
    ]
    texts = (re.sub(r'\d+', '#', status.message) for status in statuses)
    # The version that recorded the bag used other words for a damaged message.
    older = 'spoilt on its way (checksum); it is sent again'
    kinds = dict.fromkeys(
        s.replace(older, 'damaged in transit (checksum); it is resent') for s in texts
    )
    counts = [int(pair.value) for s in statuses for pair in s.values if pair.key == 'refused']
    return list(kinds), max(counts, default=0)


def motion(chunks):
    """Positions of the axes, shape (n, axes) [m, rad], and on the path, shape (n,) [m]."""
    q = np.concatenate([np.reshape(m.positions, (-1, m.axis_count)) for m in chunks])
    return q, np.concatenate([m.path_positions for m in chunks])


#: Parameters of a machine on which a run teaches.
COMPENSATED = {'machine_node.machine': 'xyzac', 'machine_node.compensation': 'xyzac_tired'}


def test_a_run_that_teaches_nothing_is_refused(recorded_now, tmp_path):
    no_feedback = tmp_path / 'no_feedback'
    copied(FAULTY, no_feedback, lambda topic, data: None if topic == 'axis_feedback' else data)
    held_back = 'the run was held, stopped, or had an override; record one without'
    for path, parameters, told in (
        (recorded_now, {}, 'record a run with --compensate MODEL'),
        (recorded_now, COMPENSATED, held_back),
        (
            recorded_now,
            COMPENSATED | {'machine_node.machine': 'xyz'},
            'was recorded on a machine with other axes than xyz',
        ),
        (
            no_feedback,
            COMPENSATED,
            'feedback of setpoint 0 was not recorded; record the run again',
        ),
    ):
        with Bag(path) as bag:
            bag.parameters.update(parameters)
            with pytest.raises(InterpError) as refusal:
                recorded_lesson(bag)
        assert str(refusal.value).startswith(f'{path}: ') and told in str(refusal.value)
        assert '\n' not in str(refusal.value)


@pytest.mark.thorough
def test_recorded_faults_come_again():
    with Bag(FAULTY) as bag:
        blocks = [data for _, _, data in bag.raw('blocks')]
        expected = faults(bag.read('/diagnostics'), 'lookahead_node')
        chunks = bag.read('executed_setpoints')
    assert any('gap' in kind for kind in expected[0])
    assert any('checksum' in kind for kind in expected[0])
    running = NodesUnderTest(PARAMETERS)
    try:
        heard = running.listen('/diagnostics', *TOPICS['/diagnostics'])
        executed = running.listen('executed_setpoints', *TOPICS['executed_setpoints'])
        for data in blocks:
            running.blocks.publish(data)
        running.spin_until(lambda: running.peers.state.completed)
        assert running.next_state().state == MachineState.IDLE
        wanted, s_wanted = motion(chunks)
        running.spin_until(
            lambda: sum(len(m.sequences) for m in executed) >= running.peers.state.samples
        )
        q, s = motion(executed)
        rounding = 1e-6  # another processor rounds differently
        if running.peers.state.starvations:  # a busy computer: slower, along the same path
            assert len(q) > len(wanted) and (np.diff(s) >= 0.0).all()
            wanted = np.array([np.interp(s, s_wanted, column) for column in wanted.T]).T
            rounding = 2e-5  # straight lines between the recorded setpoints
        np.testing.assert_allclose(q, wanted, rtol=0.0, atol=rounding)
        assert executed[0].program_id == chunks[0].program_id

        def again():
            mine = [
                array
                for array in heard
                if any(status.hardware_id == running.namespace for status in array.status)
            ]
            return faults(mine, 'lookahead_node')

        running.spin_until(lambda: again()[1] >= expected[1])  # told once a second
        assert again() == expected
    finally:
        running.close()
