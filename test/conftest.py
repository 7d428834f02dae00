"""Two tiers of tests: thorough tests run with ``--all`` and where files or names are given."""

import pytest
import tiers


def pytest_addoption(parser):
    parser.addoption(
        '--all', action='store_true', help='run the thorough tests too, with many examples each'
    )


def pytest_configure(config):
    config.addinivalue_line(
        'markers', 'thorough: runs with --all and where files or names are given, not every time'
    )
    tiers.thorough = config.getoption('--all')


def pytest_collection_modifyitems(config, items):
    """Leave thorough tests out of a run that names nothing."""
    whole = config.args_source is not pytest.Config.ArgsSource.ARGS
    named = config.option.keyword or config.option.markexpr
    if whole and not named and not tiers.thorough:
        left_out = [item for item in items if item.get_closest_marker('thorough')]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in set(left_out)]
