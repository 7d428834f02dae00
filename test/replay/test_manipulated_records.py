"""Manipulated messages of a record, on every topic: found by `check`, or by `replay --compare`."""

import copy
import json
from array import array
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import (
    FollowedSpindle,
    Function,
    G1Block,
    MachineState,
    ProbeContact,
    SetpointChunk,
)
from rclpy.serialization import serialize_message

from cnc_interp.client.bag import SEALED, TOPICS, Bag, BagWriter
from cnc_interp.client.executed_run import faults_of
from cnc_interp.client.recorded_run import recorded_run, write_run
from cnc_interp.client.replay import compute_again
from cnc_interp.commands.cli import main
from cnc_interp.core import InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import FOLLOWS
from cnc_interp.nodes.streams import sealed
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.proof.verify import verify

HELD, OVERRIDDEN = (Path(__file__).parent / name for name in ('held', 'overridden'))


class Messages(list):
    """Messages of a topic, found as those in a file are."""

    def where(self, holds):
        return Messages(filter(holds, self))


class Record:
    """A bag in memory, whose messages may be changed."""

    def __init__(self, bag):
        self.path, self.parameters = bag.path, bag.parameters
        self.order = []
        for topic, stamp, data in bag.raw(*TOPICS):
            message = bag.sound(topic, data)
            if message is not None:
                self.order.append((topic, stamp, message))

    def read(self, topic):
        return Messages(message for name, _, message in self.order if name == topic)

    messages = spooled = read

    def raw(self, *topics):
        return ((name, stamp, m) for name, stamp, m in self.order if name in topics)

    def sound(self, _topic, message):
        return message

    def machine(self, _other=None):
        return self.parameters['machine_node.machine']

    def without(self, gone):
        self.order = [(t, s, m) for t, s, m in self.order if not any(m is g for g in gone)]


@pytest.fixture(scope='module')
def held():
    with Bag(HELD) as bag:
        return Record(bag)


@pytest.fixture(scope='module')
def overridden():
    with Bag(OVERRIDDEN) as bag:
        return Record(bag)


def every(topic, change):
    """Change all messages of a topic."""

    def changed(record):
        for message in record.read(topic):
            change(message)

    return changed


def one(topic, change, share=0.5):
    """Change one message of a topic, at a share of all."""

    def changed(record):
        found = record.read(topic)
        change(found[int(share * (len(found) - 1))])

    return changed


def lost(topic, first=0.5, last=None):
    """Take out one message at a share of all of its topic, or all up to another share."""

    def changed(record):
        found = record.read(topic)
        begin = int(first * (len(found) - 1))
        record.without(found[begin : begin + 1 if last is None else int(last * len(found))])

    return changed


def adds(name, by, at=0):
    """Add to one value of a field: a number, or those of an array."""

    def change(message):
        values = getattr(message, name)
        if np.ndim(values):
            values[at] += by
        else:
            setattr(message, name, type(values)(values + by))

    return change


def sets(name, value):
    return lambda message: setattr(message, name, value)


def first_point(message):
    message.segments[0].bottom.control_points[0] += 1e-5


def of_segments(name, value):
    return lambda message: setattr(message.segments[0], name, value)


def slower(record):
    """Leave out each fifth executed setpoint: a run at F2400 becomes one at F3000."""
    chunks, count = record.read('executed_setpoints'), 0
    for chunk in chunks:
        n = len(chunk.sequences)
        keep = np.arange(n) % 5 != 0
        for field in ('positions', 'velocities', 'accelerations', 'jerks'):
            rows = np.reshape(getattr(chunk, field), (n, -1))[keep]
            setattr(chunk, field, array('d', rows.ravel().tolist()))
        for field, kind in (('sequences', 'Q'), ('line_numbers', 'I'), ('path_positions', 'd')):
            values = np.asarray(getattr(chunk, field))[keep].tolist()
            setattr(chunk, field, array(kind, values))
        chunk.first_sample, count = count, count + int(keep.sum())


def without_approach(record):
    chunks = record.read('executed_setpoints')
    gone = [chunk for chunk in chunks if not any(chunk.sequences)]
    record.without(gone)
    begin = sum(len(chunk.sequences) for chunk in gone)
    for chunk in record.read('executed_setpoints'):
        chunk.first_sample -= begin


def twice(topic, change):
    """Repeat a message of a topic in another form."""

    def changed(record):
        found = record.read(topic)
        again = copy.deepcopy(found[len(found) // 2])
        change(again)
        k = next(k for k, (_, _, m) in enumerate(record.order) if m is found[len(found) // 2])
        record.order.insert(k + 1, (topic, 0, again))

    return changed


def moved_tail(message):
    if len(message.tail_positions):
        message.tail_positions[-1] += 1e-9


def no_tail(message):
    for field in message.get_fields_and_field_types():
        if field.startswith('tail_'):
            setattr(message, field, array(getattr(message, field).typecode))


def a_stop_of_the_program(message):
    message.program_stop = G1Block.STOP


def a_function(message):
    message.functions = [Function(number=0, sequence=1, step=0, output='spindle', value=1.0)]


SENT = SetpointChunk.OPTIONAL_STOP
#: What `check` finds.
BY_CHECK = {
    'an executed position off by 0.1 nm': one('executed_setpoints', adds('positions', 1e-10)),
    'an executed velocity': one('executed_setpoints', adds('velocities', 1e-9)),
    'an executed acceleration': one('executed_setpoints', adds('accelerations', 1e-9)),
    'an executed jerk': one('executed_setpoints', adds('jerks', 1e-9)),
    'an executed place': one('executed_setpoints', adds('path_positions', 1e-12)),
    'an executed block': one('executed_setpoints', adds('sequences', 1)),
    'an executed line': one('executed_setpoints', adds('line_numbers', 1)),
    'another plan': one('executed_setpoints', adds('plan', 1), 0.2),
    'another attempt': one('executed_setpoints', adds('attempt', 1)),
    'another number': one('executed_setpoints', adds('first_sample', 1)),
    'another period': one('executed_setpoints', sets('period', 0.002)),
    'every position shifted': every('executed_setpoints', adds('positions', 1e-9, 2)),
    'executed setpoints lost': lost('executed_setpoints'),
    'the first executed setpoints lost': lost('executed_setpoints', 0.0),
    'the last executed setpoints lost': lost('executed_setpoints', 1.0),
    'no end of the program': one('executed_setpoints', sets('end_of_program', False), 1.0),
    'executed at another feed': slower,
    'the approach left out': without_approach,
    'executed twice': twice('executed_setpoints', lambda m: None),
    'a function that was not sent': one('executed_setpoints', a_function),
    'a sent position': every('setpoints', adds('positions', 1e-9)),
    'a sent jerk': every('setpoints', adds('jerks', 1e-9)),
    'a sent line': every('setpoints', adds('line_numbers', 1)),
    'a sent number': one('setpoints', adds('first_sample', 1), 0.2),
    'a sent period': every('setpoints', adds('axis_count', 1)),
    'sent setpoints lost': lost('setpoints', 0.2),
    'the first of a plan lost': lost('setpoints', 0.0),
    'all sent setpoints lost': lost('setpoints', 0.0, 1.0),
    'a function among the setpoints': one('setpoints', a_function),
    'sent twice with different values': twice('setpoints', adds('positions', 1e-6)),
    'stop tails moved': every('setpoints', moved_tail),
    'no stop tails': every('setpoints', no_tail),
    'a wait that nobody saw': every('setpoints', sets('wait', SENT)),
    'no wait at the end': one('setpoints', sets('end_of_program', False), 1.0),
    'a block lost': lost('blocks', 0.3, 0.6),
    'all blocks lost': lost('blocks', 0.0, 1.0),
    'M0 that was passed': every('blocks', a_stop_of_the_program),
    'a function in a block': one('blocks', a_function),
    'a block moved by 0.1 mm': every('blocks', adds('tip', 1e-4)),
    'another tool axis': every('blocks', sets('axis', np.array([1.0, 0.0, 0.0]))),
    'half the feed': every('blocks', lambda m: setattr(m, 'feedrate', m.feedrate / 2)),
    'a tolerance of 0.1 um': every('blocks', sets('contour_tolerance', 1e-7)),
    'other settings in block 0': every('blocks', lambda m: m.settings and m.settings.pop()),
    'all segments lost': lost('segments', 0.0, 1.0),
    'a path moved by 10 um': every('segments', first_point),
    'a function in a segment': every('segments', lambda m: a_function(m.segments[0])),
    'feedback lost': lost('axis_feedback'),
    'all feedback lost': lost('axis_feedback', 0.0, 1.0),
    'feedback of a row less': one('axis_feedback', lambda m: m.positions.pop()),
    'feedback of another number': one('axis_feedback', adds('first_sample', 1)),
    'all states lost': lost('machine_state', 0.0, 1.0),
    'a state elsewhere': every('machine_state', adds('path_position', 1e-9)),
    'a state in another block': every('machine_state', adds('sequence', 1)),
    'a state in another line': every('machine_state', adds('line_number', 1)),
    'a state with other axes': every('machine_state', adds('commanded_positions', 1e-9)),
    'a state of later': one('machine_state', adds('samples', 10), 0.2),
    'more was counted': one('machine_state', adds('samples', 1000), 1.0),
    'never completed': every('machine_state', sets('completed', False)),
    'no program': lost('loaded_program', 0.0, 1.0),
    'a program with other settings': every('loaded_program', lambda m: m.settings.pop()),
    'a program of another flank height': every('loaded_program', adds('flank_height', 1e-6)),
}
#: What only `replay --compare` finds.
BY_REPLAY = {
    'twice the feed': every('blocks', lambda m: setattr(m, 'feedrate', m.feedrate * 2)),
    'ten times the tolerance': every(
        'blocks', lambda m: setattr(m, 'contour_tolerance', m.contour_tolerance * 10)
    ),
    'another deviation': every('segments', of_segments('contour_deviation', 1e-9)),
    'another kind of segment': every('segments', of_segments('orientation_room', 1.0)),
    'a stop tail that was not played': one('setpoints', moved_tail, 0.1),
}


def unproven(record, folder):
    """Return why `check` does not prove a record; empty if it does."""
    machine = Machine.load(record.machine())
    try:
        run = recorded_run(record)
        faults = faults_of(record, run, machine)
        write_run(run, machine, folder)
        return [*faults, *verify(read_plan(folder), machine).failures]
    except InterpError as refusal:
        assert '\n' not in str(refusal)
        return [str(refusal)]


def repeated(record):
    try:
        return [(c.same, c.difference, c.segment) for c in compute_again(record)]
    except InterpError as refusal:
        return str(refusal)


def test_the_record_as_it_was_is_proven(held, tmp_path):
    assert unproven(held, tmp_path) == []


@pytest.mark.parametrize('name', BY_CHECK)
def test_check_finds(name, held, tmp_path):
    record = copy.deepcopy(held)
    BY_CHECK[name](record)
    assert unproven(record, tmp_path)


@pytest.mark.parametrize('name', BY_REPLAY)
def test_replay_finds(name, held):
    record = copy.deepcopy(held)
    BY_REPLAY[name](record)
    assert repeated(record) != repeated(held)


def test_an_override_in_one_state_does_not_switch_the_comparison_off(held):
    """A machine_state with another override made every difference an effect of it."""
    record = copy.deepcopy(held)
    one('machine_state', sets('feed_override', 1.2))(record)
    assert repeated(record) == repeated(held)
    one('setpoints', adds('positions', 1e-6), 0.2)(record)
    assert repeated(record) != repeated(held)
    assert not all(c.ok for c in compute_again(record))


def moments(record):
    """Return after how many setpoints each override was told, and a plan with it joined."""
    told, count = [], 0
    for state in record.read('machine_state'):
        if state.program_id and (not told or state.feed_override != told[-1][1]):
            told.append((int(state.samples), state.feed_override))
    plans = {m.plan: None for m in record.read('executed_setpoints')}
    for message in record.read('executed_setpoints'):
        if plans[message.plan] is None:
            plans[message.plan] = count
        count += len(message.sequences)
    return [samples for samples, _ in told], list(plans.values())


def told_between(first, last, share):
    """Have the machine tell another override in a part of the run, by its ``moments``."""

    def changed(record):
        moment = moments(record)
        begin, end = first(*moment), last(*moment)
        for state in record.read('machine_state'):
            if begin <= state.samples <= end:
                state.feed_override = share

    return changed


def planned(before, share, told=True):
    """Have a plan name another override, and the machine, too."""

    def changed(record):
        sent, states = record.read('setpoints'), record.read('machine_state')
        for message in sent + states if told else sent:
            if message.feed_override == before:
                message.feed_override = share

    return changed


#: The operator set 0.5, 1.3 and 1.0: told[1] to told[3], joined[1] to joined[3].
BY_OVERRIDE = {
    'set after it was followed': told_between(
        lambda told, joined: told[2], lambda told, joined: joined[2] + 100, 0.5
    ),
    'lowered long before it was followed': told_between(
        lambda told, joined: 1, lambda told, joined: joined[1], 0.5
    ),
    'lowered before the run': told_between(
        lambda told, joined: 0, lambda told, joined: joined[1], 0.5
    ),
    'never set': told_between(lambda told, joined: told[2], lambda told, joined: told[3] - 1, 1.0),
    'faster than the override of its plan': planned(0.5, 0.45),
    'faster than the largest override': planned(1.3, 1.25),
    'a plan for another override': planned(0.5, 1.5, told=False),
    'a plan with two overrides': one('setpoints', sets('feed_override', 0.7)),
}


def test_a_run_with_overrides_is_proven(overridden, tmp_path):
    assert unproven(overridden, tmp_path) == []
    steps = recorded_run(overridden).overrides()
    assert [step.feed for step in steps] == [1.0, 0.5, 1.3, 1.0]
    assert all(c.ok for c in compute_again(overridden))


@pytest.mark.parametrize('name', BY_OVERRIDE)
def test_an_override_that_did_not_count_then_is_found(name, overridden, tmp_path):
    """The largest override of a run was allowed in all of it."""
    record = copy.deepcopy(overridden)
    BY_OVERRIDE[name](record)
    assert unproven(record, tmp_path)


@pytest.mark.parametrize('share', [0.2, 0.5, 0.9])
def test_one_state_with_another_override_allows_nothing(share, overridden, tmp_path):
    record = copy.deepcopy(overridden)
    one('machine_state', sets('feed_override', 1.5), share)(record)
    assert recorded_run(record).overrides() == recorded_run(overridden).overrides()
    assert repeated(record) == repeated(overridden)
    planned(0.5, 0.45)(record)
    assert any('tip feed' in fault for fault in unproven(record, tmp_path))


def test_a_bag_without_the_first_setpoints_of_a_plan_is_refused_in_a_line(held):
    """It ended with KeyError: 0."""
    record = copy.deepcopy(held)
    lost('setpoints', 0.0)(record)
    with pytest.raises(InterpError, match=r'setpoints 0 to .* are not in it'):
        list(compute_again(record))


def test_m0_needs_a_wait_for_cycle_start(held):
    record = copy.deepcopy(held)
    for state in record.read('machine_state'):
        if state.state == MachineState.HELD:
            state.state = MachineState.RUNNING
    every('blocks', a_stop_of_the_program)(record)
    machine = Machine.load(record.machine())
    found = faults_of(record, recorded_run(record), machine)
    assert any('did not wait for cycle_start after line' in fault for fault in found)


def touched(record, beside):
    """Add a contact of a probe: between two rows of the feedback, or some way beside."""
    run, rows = recorded_run(record), record.read('axis_feedback')
    chunk = rows[len(rows) // 2]
    first, second = np.reshape(chunk.positions, (-1, run.chunks[0].axis_count))[:2]
    point = (first + second) / 2 + beside
    contact = ProbeContact(program_id=run.program_id, line_number=3, positions=point.tolist())
    record.order.append(('probe_contact', 0, contact))


@pytest.mark.parametrize('axis', range(5))
def test_a_contact_where_the_axes_never_were_is_found(axis, held):
    record, machine = copy.deepcopy(held), Machine.load(held.machine())
    touched(record, 0.0)
    assert faults_of(record, recorded_run(record), machine) == []
    touched(record, np.where(np.arange(5) == axis, 1e-3, 0.0))
    (fault,) = faults_of(record, recorded_run(record), machine)
    assert fault.startswith('line 3: the axes never passed the recorded')


def in_step(record, machine):
    """Let a line be in step with the spindle, as blocks, segments and setpoints say."""
    block, first = record.read('blocks')[1], machine.signals.words[FOLLOWS].start
    step = Function(number=0, sequence=block.sequence, step=first)
    segments = [s for batch in record.read('segments') for s in batch.segments]
    sent, executed = record.read('setpoints'), record.read('executed_setpoints')
    for message in (block, segments[0], sent[len(sent) // 2], executed[len(executed) // 2]):
        message.functions = [step]
    followed = FollowedSpindle(program_id=block.program_id, sequence=block.sequence)
    record.order.append(('followed_spindle', 0, followed))


def test_a_thread_without_its_spindle_is_found(held):
    record, machine = copy.deepcopy(held), Machine.load('xyzac_trt')
    in_step(record, machine)
    assert faults_of(record, recorded_run(record), machine) == []
    record.without(record.read('followed_spindle'))
    (fault,) = faults_of(record, recorded_run(record), machine)
    assert 'lacks its followed_spindle' in fault


def write_runs(folder, record, changes):
    """Write a bag with a run for each change: the record, changed and under another name."""
    writer, stamp = BagWriter(folder), 0
    writer.note('machine_node', {'machine': record.machine()})
    for k, change in enumerate(changes):
        again = copy.deepcopy(record)
        change(again)
        for topic, _, message in again.order:
            parts = [getattr(message, name, []) for name in ('blocks', 'segments')]
            for part in (message, *parts[0], *parts[1]):
                if hasattr(part, 'program_id'):
                    part.program_id = f'run_{k}'
            stamp += 1
            data = sealed(message) if topic in SEALED else serialize_message(message)
            writer.write(topic, data, stamp)
    writer.close()


@pytest.mark.parametrize('unsound', [(), (0,), (1,), (0, 1)])
def test_each_run_of_a_bag_is_judged(unsound, held, tmp_path, capsys):
    """Only the last run was judged, and nothing was said of the others."""
    forged = BY_CHECK['an executed position off by 0.1 nm']
    changes = [forged if k in unsound else lambda record: None for k in range(2)]
    write_runs(tmp_path / 'bag', held, changes)
    assert main(['check', str(tmp_path / 'bag'), '--json']) == int(bool(unsound))
    parts = json.loads(capsys.readouterr().out)['parts']
    assert [part['ok'] for part in parts] == [k not in unsound for k in range(2)]


def ended_at_the_hold(record):
    """Leave out what came after the hold, as if the operator had ended the run there."""
    of_plans = ('setpoints', 'executed_setpoints', 'axis_feedback')
    record.without([m for topic in of_plans for m in record.read(topic) if m.plan > 0])
    held = next(m.samples for m in record.read('machine_state') if m.state == MachineState.HELD)
    record.without([m for m in record.read('machine_state') if m.samples > held])


def without_the_hold(record):
    record.without([m for m in record.read('machine_state') if m.state == MachineState.HELD])


def before_the_hold(record):
    """Have the machine tell a hold where it was in motion still."""
    record.without(record.read('executed_setpoints')[-1:])
    count = sum(len(m.sequences) for m in record.read('executed_setpoints'))
    record.without([m for m in record.read('machine_state') if m.samples > count])
    record.read('machine_state')[-1].state = MachineState.HELD
    record.read('machine_state')[-1].samples = count


def counted_after(record):
    record.read('machine_state')[-1].samples += 5


@pytest.mark.parametrize(
    ('forged', 'fault'),
    [
        (None, ''),
        (without_the_hold, 'the record ends at rest'),
        (before_the_hold, 'the record ends in motion'),
        (counted_after, 'the record ends at rest'),
    ],
)
def test_a_run_that_ends_at_a_hold_needs_the_hold(forged, fault, held, tmp_path, capsys):
    def change(record):
        ended_at_the_hold(record)
        if forged is not None:
            forged(record)

    write_runs(tmp_path / 'bag', held, [change])
    assert main(['check', str(tmp_path / 'bag')]) == (forged is not None)
    told = capsys.readouterr().out
    if forged is None:
        assert 'proven as far as it goes: the operator has ended it, in line ' in told
    else:
        assert fault in told
