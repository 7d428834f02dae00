"""The table of promises: each is on its page and is held by tests."""

import importlib.util
from pathlib import Path

SOURCE = Path(__file__).parents[2] / 'tools' / 'promises.py'
spec = importlib.util.spec_from_file_location('promises', SOURCE)
promises = importlib.util.module_from_spec(spec)
spec.loader.exec_module(promises)


def test_each_promise_stands_there_and_has_its_tests():
    assert not promises.faults()


def test_each_promise_has_a_test_that_runs_with_every_change():
    by_turns = [
        row['means']
        for row in promises.promises()
        if not any(
            not thorough
            for test in row['tests']
            for name, thorough in promises.tiers(test.partition('::')[0]).items()
            if '::' not in test or name == test.partition('::')[2]
        )
    ]
    assert not by_turns, by_turns
