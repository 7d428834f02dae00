"""Bags that are wrong on purpose: one line, in bounded memory, and no traceback."""

import resource
import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from tiers import examples

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from backports import zstd

from cnc_interp.client.bag import Bag
from cnc_interp.client.recorded_run import recorded_run
from cnc_interp.core import InterpError

HELD = Path(__file__).parent / 'held'
MUTANTS = examples(10, 5000)
#: Words that mutations put in: lengths that nothing has, and YAML.
WORDS = (b'\xff' * 8, b'\xff' * 7 + b'\x7f', b'\0' * 30, b'\0\0\0\x40', b'9' * 400, b': ', b'- *a')


@pytest.fixture
def bag(tmp_path):
    return Path(shutil.copytree(HELD, tmp_path / 'held'))


def refused(path):
    """Return the refusal of a bag in one line, '' if it is accepted; limits are as before."""
    before = resource.getrlimit(resource.RLIMIT_DATA)
    try:
        with Bag(path) as opened:
            recorded_run(opened)
    except InterpError as refusal:
        assert '\n' not in str(refusal) and len(str(refusal)) < 2000
        return str(refusal)
    finally:
        assert resource.getrlimit(resource.RLIMIT_DATA) == before
    return ''


@pytest.mark.parametrize('name', ['held.mcap', 'metadata.yaml'])
def test_mutated_bags(name, bag):
    """A mutated length of a record ended in MemoryError."""
    sound, found = (bag / name).read_bytes(), 0
    for seed in range(MUTANTS):
        rng, content = np.random.default_rng(seed), bytearray(sound)
        for _ in range(int(rng.integers(1, 5))):
            at, length = int(rng.integers(len(content))), int(rng.integers(1, 30))
            match rng.integers(0, 4):
                case 0:
                    del content[at : at + length]
                case 1:
                    word = WORDS[int(rng.integers(len(WORDS)))]
                    content[at : at + len(word)] = word
                case 2:
                    content[at] = int(rng.integers(256))
                case _:
                    del content[max(at, 1) :]
        (bag / name).write_bytes(content)
        found += bool(refused(bag))
    assert found > MUTANTS // 3


@pytest.mark.parametrize('name', ['held.mcap', 'metadata.yaml'])
def test_devices_in_a_bag(name, bag):
    (bag / name).unlink()
    (bag / name).symlink_to('/dev/zero')
    assert f'{name} is not a file' in refused(bag)


def test_metadata_that_stand_for_any_length(bag):
    text = 'a: &a [1,1,1,1,1,1,1,1,1]\nb: &b [*a,*a,*a,*a,*a,*a,*a]\nc: [*b,*b,*b,*b,*b]\n'
    (bag / 'metadata.yaml').write_text(text)
    assert 'write the value out' in refused(bag)


def test_a_bomb_is_not_unpacked(bag):
    """A bag that says it is compressed as a file: 16 GB of zeros in half a megabyte."""
    metadata = (bag / 'metadata.yaml').read_text()
    for old, new in (
        ("compression_format: ''", 'compression_format: zstd'),
        ("compression_mode: ''", 'compression_mode: file'),
    ):
        metadata = metadata.replace(old, new).replace(old.replace("''", 'none'), new)
    metadata = metadata.replace('compression_mode: storage', 'compression_mode: file')
    assert 'compression_mode: file' in metadata
    (bag / 'metadata.yaml').write_text(metadata)
    block = zstd.compress(bytes(1 << 24))
    (bag / 'held.mcap').write_bytes(block * 1024)
    assert 'not a bag that can be read' in refused(bag)


def test_a_database_that_is_none(bag):
    metadata = (bag / 'metadata.yaml').read_text().replace('held.mcap', 'held.db3')
    (bag / 'metadata.yaml').write_text(metadata.replace('identifier: mcap', 'identifier: sqlite3'))
    (bag / 'held.db3').write_bytes(b'SQLite format 3\0' + bytes(84))
    assert refused(bag)
    (bag / 'held.db3').unlink()
    with sqlite3.connect(bag / 'held.db3') as base:
        base.execute('CREATE TABLE topics (id TEXT, name BLOB)')
        base.execute('INSERT INTO topics VALUES (NULL, NULL)')
    assert refused(bag)
