"""The nodes with a page beside them, once for the tests of a file, which leave them tidy."""

import pytest


@pytest.fixture(scope='module')
def running():
    from page_under_test import PanelUnderTest  # which skips where it cannot be

    panel = PanelUnderTest({'feedrate_node': {'plunge_feed': 0.05}})  # nothing waits for it
    yield panel
    panel.close()


@pytest.fixture
def panel(running):
    yield running
    running.tidy()
