"""Windowed streams over a line that loses, repeats and reorders."""

import random
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc_interp.core import Refusal, StreamError
from cnc_interp.run.run_state import NO_RUN, RunId
from cnc_interp.wire.window_protocol import Silence, WindowedReceiver, WindowedSender

RESEND = 0.5
P, Q, R, OTHER = (RunId(name) for name in ('p', 'q', 'r', 'other'))


def receive(receiver, program, first, count=1, end=False):
    """What an inlet does with a sound message; True when it was let in."""
    try:
        receiver.expect(program, first, first == 0)
    except StreamError:
        return False
    receiver.take(program, first, count, end)
    return True


def acknowledge(sender, receiver, now, gap=False):
    sender.acknowledge(receiver.run_id, receiver.next_number, receiver.limit, now, gap)


@pytest.mark.parametrize('count', [1, 7])
def test_perfect_line_delivers_everything_within_the_window(count):
    sender, receiver = WindowedSender(RESEND), WindowedReceiver('blocks', 20)
    sender.begin(P)
    for i in range(100):
        sender.put(i, count)
    got, now = [], 0.0
    while len(got) < 100:
        now += 0.01
        for item in sender.due(now):
            assert item.after <= receiver.consumed + 20 or item.first == 0
            assert receive(receiver, P, item.first, item.count, item.item == 99)
            got.append(item.item)
            receiver.consume(item.count)
        acknowledge(sender, receiver, now)
    assert got == list(range(100))
    assert sender.all_acknowledged and receiver.complete and sender.sent == 100 * count


@settings(max_examples=60)
@given(
    seed=st.integers(0, 10**6),
    loss=st.floats(0.0, 0.6),
    repeat=st.floats(0.0, 0.5),
    swap=st.floats(0.0, 0.5),
    window=st.integers(1, 30),
)
def test_bad_line_still_delivers_each_item_once_and_in_order(seed, loss, repeat, swap, window):
    line = random.Random(seed)
    sender, receiver = WindowedSender(RESEND), WindowedReceiver('blocks', window)
    sender.begin(P)
    total, got, waiting, early, now = 60, [], [], {}, 0.0
    for i in range(total):
        sender.put(i)
    for _ in range(20_000):
        now += 0.1
        for item in sender.due(now):
            assert item.first == 0 or item.first < receiver.consumed + window
            if line.random() >= loss:
                waiting.append(item)
                if line.random() < repeat:
                    waiting.append(item)
        if len(waiting) > 1 and line.random() < swap:
            i = line.randrange(len(waiting) - 1)
            waiting[i], waiting[i + 1] = waiting[i + 1], waiting[i]
        for item in waiting:
            early[item.first] = item
            while item := early.pop(receiver.next_number, None):
                assert receive(receiver, P, item.first, 1, item.first == total - 1)
                got.append(item.item)
        waiting = []
        receiver.consumed = line.randint(receiver.consumed, len(got))
        if line.random() >= loss:
            acknowledge(sender, receiver, now, max(early, default=0) > len(got))
        if receiver.complete:
            break
    assert got == list(range(total))


def test_nothing_goes_beyond_the_window_while_the_receiver_does_not_consume():
    sender, receiver = WindowedSender(RESEND), WindowedReceiver('setpoints', 100)
    sender.begin(P)
    for i in range(50):
        sender.put(i, 10)
    sent = []
    for now in range(20):
        for item in sender.due(0.01 * now):
            sent.append(item)
            receive(receiver, P, item.first, 10)
        acknowledge(sender, receiver, 0.01 * now)
    assert [item.first for item in sent] == list(range(0, 100, 10))
    receiver.consume(10)
    acknowledge(sender, receiver, 1.0)
    assert [item.first for item in sender.due(1.0)] == [100]


def test_only_what_was_not_acknowledged_is_sent_again_and_only_after_a_while():
    sender = WindowedSender(RESEND)
    sender.begin(P)
    for i in range(6):
        sender.put(i)
    assert [i.first for i in sender.due(0.0)] == [0]
    sender.acknowledge(P, 1, 6, 0.1)
    assert [i.first for i in sender.due(0.1)] == [1, 2, 3, 4, 5]
    sender.acknowledge(P, 3, 6, 0.2)
    assert sender.due(0.2 + 0.9 * RESEND) == []
    assert [i.first for i in sender.due(0.21 + RESEND)] == [3]
    sender.acknowledge(P, 4, 7, 0.9)  # the next may have come, too: more and more are sent
    assert [i.first for i in sender.due(0.9)] == [4, 5]
    sender.put(6)
    sender.acknowledge(P, 6, 7, 1.0)
    assert [i.first for i in sender.due(1.0)] == [6]


def test_what_is_missing_is_sent_at_once_then_ever_more_slowly_and_not_to_a_closed_window():
    sender = WindowedSender(RESEND)
    sender.begin(P)
    for i in range(6):
        sender.put(i)
    sender.due(0.0)
    again = 0
    for now in (0.01 * k for k in range(1, 200)):  # with each item that comes
        sender.acknowledge(P, 1, 6, now, gap=True)
        again += bool(sender.due(now))
    assert 4 <= again <= 8
    sender.acknowledge(P, 4, 6, 2.0, gap=True)  # it had 2 and 3, and has 5
    assert [i.first for i in sender.due(2.0)] == [4]
    assert sender.due(2.0) == []
    sender.acknowledge(P, 4, 4, 2.2, gap=True)  # its plan is over
    assert sender.due(2.2) == []


def test_a_busy_line_is_tried_again():
    sender = WindowedSender(RESEND)
    sender.begin(P)
    sender.put('a')
    assert len(sender.due(0.0)) == 1
    sender.take_back(1)
    assert len(sender.due(0.001)) == 1


def test_words_about_another_program_or_from_the_future_are_ignored():
    sender = WindowedSender(RESEND)
    sender.begin(P)
    sender.put(0)
    sender.put(1)
    sender.due(0.0)
    sender.acknowledge(OTHER, 1, 50, 0.0)
    sender.acknowledge(P, 40, 50, 0.0)
    assert sender.limit == 0 and sender.acknowledged == 0


def test_a_plan_that_joins_goes_on_with_the_numbers_of_the_plan_before():
    sender, receiver = WindowedSender(RESEND), WindowedReceiver('setpoints', 10)
    for i in range(8):
        receive(receiver, P, i)
    joins = RunId('p', plan=1)
    sender.begin(joins, 5)
    sender.put('a', 2)
    sender.put('b', 2)
    (first,) = sender.due(0.0)  # with it the receiver learns of the plan
    assert (first.first, first.item) == (5, 'a')
    with pytest.raises(StreamError, match='gap'):
        receiver.expect(joins, 7, False)
    receiver.expect(joins, 5, True)
    receiver.take(joins, 5, 2)
    assert receiver.limit == 15, 'nothing of it is executed: the window begins where it joins'
    sender.acknowledge(joins, receiver.next_number, receiver.limit, 0.0)
    assert [item.first for item in sender.due(0.0)] == [7]
    with pytest.raises(StreamError, match=r'foreign|old'):
        receiver.expect(P, 8, False)


@pytest.mark.parametrize(
    ('program', 'first', 'word'),
    [
        (P, 5, 'gap'),
        (P, 2, 'repeat'),
        (OTHER, 0, 'foreign'),
        (OTHER, 3, 'foreign'),
        (NO_RUN, 3, 'no program id'),
    ],
)
def test_receiver_names_what_is_wrong_and_stays_as_it_was(program, first, word):
    receiver = WindowedReceiver('blocks', 10)
    for i in range(3):
        receive(receiver, P, i)
    with pytest.raises(StreamError, match=word):
        receiver.expect(program, first, first == 0)
    assert (receiver.run_id, receiver.next_number) == (P, 3)
    assert receive(receiver, P, 3)


def test_a_program_begins_with_its_first_item_only():
    receiver = WindowedReceiver('blocks', 10)
    with pytest.raises(StreamError, match='unknown program'):
        receiver.expect(P, 4, False)
    assert receive(receiver, P, 0, end=True)
    with pytest.raises(StreamError, match='after the end'):
        receiver.expect(P, 1, False)
    assert receive(receiver, Q, 0)
    assert (receiver.next_number, receiver.consumed, receiver.complete) == (1, 0, False)


def test_a_closed_program_answers_all_that_still_comes_in_the_same_words():
    receiver = WindowedReceiver('setpoints', 10)
    assert receive(receiver, P, 0)
    receiver.close('came after the stop')
    said = set()
    for number in (1, 2, 9):
        with pytest.raises(StreamError) as fault:
            receiver.expect(P, number, number == 0)
        said.add(str(fault.value))
    assert said == {'came after the stop'}
    assert not receiver.active and receive(receiver, Q, 0)


def test_a_later_attempt_may_begin_while_the_one_before_is_active():
    receiver = WindowedReceiver('blocks', 10)
    assert receive(receiver, P, 0)
    assert receive(receiver, P.next_attempt(), 0) and receiver.active
    assert receiver.run_id == RunId('p', attempt=1)
    with pytest.raises(StreamError, match='foreign'):
        receiver.expect(P, 0, True)  # an earlier one may not
    sender = WindowedSender(RESEND)
    sender.begin(P.next_attempt())
    sender.put('a')
    sender.due(0.0)
    sender.acknowledge(P, 1, 20, 0.0)
    assert not sender.all_acknowledged, 'of the attempt before'
    sender.acknowledge(receiver.run_id, 1, 20, 0.0)
    assert sender.all_acknowledged


def test_another_plan_begins_only_after_the_one_before_is_closed():
    receiver = WindowedReceiver('setpoints', 10)
    assert receive(receiver, P, 0)
    with pytest.raises(StreamError, match='foreign'):
        receiver.expect(RunId('p', plan=1), 0, True)
    receiver.close('left by its stop')
    assert receive(receiver, RunId('p', plan=1), 0)


def test_old_programs_never_come_back():
    receiver = WindowedReceiver('blocks', 10)
    for program in (P, Q, R):
        assert receive(receiver, program, 0, end=True)
    with pytest.raises(StreamError, match='old program'):
        receiver.expect(P, 0, True)


def test_after_a_refusal_nothing_of_the_program_gets_in_but_another_may_begin():
    receiver = WindowedReceiver('blocks', 10)
    receive(receiver, P, 0)
    receiver.refuse(P, Refusal.BAD_MESSAGE, 'the tool axis has length 2')
    with pytest.raises(StreamError, match='length 2'):
        receiver.expect(P, 1, False)
    assert receiver.limit == 1
    assert receive(receiver, Q, 0)
    assert receiver.refused is Refusal.NONE


def test_silence_counts_from_where_something_was_wanted_and_not_heard():
    silence = Silence()
    silence.hear(1.0)
    # The window was full, or one's own work took its time: the sender could not say anything.
    assert silence.waited(False, 60.0) == 0.0
    assert silence.waited(True, 61.0) == 0.0
    assert silence.waited(True, 63.0) == 2.0
    silence.hear(63.5)
    assert silence.waited(True, 64.0) == 0.5
    assert silence.waited(False, 65.0) == 0.0
    assert silence.waited(True, 70.0) == 0.0
    assert silence.waited(True, 71.5) == 1.5


def test_a_receiver_that_answers_late_is_not_buried_in_repeats():
    """It takes a second for what it has; a sender that repeats all four times a second adds up."""
    sender = WindowedSender(RESEND)
    sender.begin(P)
    for i in range(10):
        sender.put(i)
    sender.due(0.0)
    sender.acknowledge(P, 1, 20, 0.1)
    sent = [now for now in (k * 0.01 for k in range(11, 6000)) if sender.due(now)]
    pauses = [later - now for now, later in pairwise(sent)]
    assert pauses[:4] == pytest.approx([0.5, 1.0, 2.0, 4.0], abs=0.05)
    assert max(pauses) < 16 * RESEND + 0.05
    sender.acknowledge(P, 2, 20, 60.0)
    assert [item.item for item in sender.due(60.0)] == [2, 3]
