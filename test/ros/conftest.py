"""One set of nodes for all files that need nothing special of it."""

import pytest

running = []


@pytest.fixture(scope='module')
def shared_nodes():
    """The nodes at rest, as they were started."""
    from operated import Bench

    if not running:
        running.append(Bench())
    running[0].tidy()
    return running[0]


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(nextitem):
    if running and 'shared_nodes' not in getattr(nextitem, 'fixturenames', ()):
        codes = running.pop().close()
        assert codes == dict.fromkeys(codes, 0), 'nodes end with exit code 0 on SIGTERM'


def pytest_collection_modifyitems(items):
    """Those that share come first, one after the other: together they take longest."""
    items.sort(key=lambda item: 'shared_nodes' not in item.fixturenames)
