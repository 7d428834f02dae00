"""Seals of messages: whose they are, and who shares the key."""

import os

import numpy as np
import pytest

from cnc_interp.core import InterpError
from cnc_interp.wire import seals
from cnc_interp.wire.seals import SILENT, WAITS, KnownSender, Place, Seal, key_in, opened_seal

PLACE = '/cell setpoints'
RANDOM = np.random.default_rng(54)


@pytest.fixture(autouse=True)
def key(tmp_path, monkeypatch):
    """A key of the test's own."""
    monkeypatch.setenv(seals.KEY_FILE, str(tmp_path / 'key'))
    yield tmp_path / 'key'
    key_in.cache_clear()


def message(size=200):
    return RANDOM.bytes(size)


def test_what_a_node_seals_is_opened_bit_for_bit():
    sender, texts = Seal(Place.of(PLACE)), [message(k) for k in (4, 8, 4096)]
    opened = [opened_seal(Place.of(PLACE), sender.on(text)) for text in texts]
    assert [text for text, _, _ in opened] == texts
    assert [number for *_, number in opened] == [0, 1, 2] and len({o[1] for o in opened}) == 1


def test_no_change_of_one_bit_is_opened():
    data = Seal(Place.of(PLACE)).on(message(40))
    for bit in range(8 * len(data)):
        forged = bytearray(data)
        forged[bit // 8] ^= 1 << bit % 8
        assert opened_seal(Place.of(PLACE), bytes(forged)) is None, bit
    for size in range(len(data)):
        assert opened_seal(Place.of(PLACE), data[:size]) is None
        assert opened_seal(Place.of(PLACE), data[size + 1 :]) is None


def test_a_seal_counts_on_its_own_topic_and_machine_only():
    """A record of executed_setpoints, sent on setpoints, would be motion."""
    data = Seal(Place.of('/cell executed_setpoints')).on(message())
    assert opened_seal(Place.of('/cell executed_setpoints'), data)
    assert opened_seal(Place.of('/cell setpoints'), data) is None
    assert opened_seal(Place.of('/other executed_setpoints'), data) is None


def test_who_has_another_key_opens_nothing_and_forges_nothing(tmp_path, monkeypatch):
    ours = Seal(Place.of(PLACE)).on(message())
    monkeypatch.setenv(seals.KEY_FILE, str(tmp_path / 'another'))
    assert opened_seal(Place.of(PLACE), ours) is None
    theirs = Seal(Place.of(PLACE)).on(message())
    monkeypatch.setenv(seals.KEY_FILE, str(tmp_path / 'key'))
    assert opened_seal(Place.of(PLACE), theirs) is None and opened_seal(Place.of(PLACE), ours)


def test_all_nodes_of_a_user_share_one_key_that_nobody_else_can_read(key):
    made = key_in(key)
    key_in.cache_clear()
    assert key_in(key) == made and len(made) == 32 and len(set(made)) > 8
    assert key.stat().st_mode & 0o777 == 0o600 and [*key.parent.iterdir()] == [key]


@pytest.mark.parametrize('spoil', ['readable', 'short', 'link', 'folder', 'pipe'])
def test_a_key_that_another_user_may_have_made_is_refused(key, spoil):
    if spoil in ('readable', 'short'):
        key.write_bytes(bytes(32 if spoil == 'readable' else 31))
        key.chmod(0o644 if spoil == 'readable' else 0o600)
    elif spoil == 'link':
        key.with_name('target').write_bytes(bytes(32))
        key.symlink_to(key.with_name('target'))
    elif spoil == 'folder':
        key.mkdir()
    else:
        os.mkfifo(key, 0o600)
    with pytest.raises(InterpError, match='the key of the nodes'):
        Seal(Place.of(PLACE))


def test_the_sender_heard_first_is_the_one_until_it_is_silent():
    known, first, second = KnownSender(), 7, 8
    assert known.fault(first, 0, 0.0) == known.fault(first, 1, 0.9) == ''
    assert known.fault(second, 0, 1.0) == WAITS
    assert known.fault(first, 2, 1.1) == '' and known.waiting  # so there are two of them
    assert known.fault(second, 5, 1.2 + SILENT) == ''  # the node was started again
    assert not known.waiting
    assert 'second' in known.fault(first, 3, 9.9)  # nobody who has ended comes back
    assert known.fault(second, 6, 10.0) == ''


def test_a_message_heard_before_does_not_count_twice():
    known, stream = KnownSender(), KnownSender(numbered=True)
    assert known.fault(7, 4, 0.0) == ''
    for number in (4, 3, 0):
        assert 'before' in known.fault(7, number, 0.1)
    assert known.fault(7, 9, 0.2) == ''
    assert [stream.fault(7, number, 0.0) for number in (4, 2, 4)] == ['', '', '']


def test_a_sealed_message_has_the_length_that_dds_delivers_to_another_process():
    for length in range(5, 13):
        data = Seal(Place.of('/cell machine_state')).on(bytes(range(length)))
        assert len(data) % 4 == 0
        message, _, _ = opened_seal(Place.of('/cell machine_state'), data)
        assert message[:length] == bytes(range(length)) and not any(message[length:])
