"""Two tiers of tests, thorough ones by turns, and what runs side by side."""

import gc
import os
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import pytest
import tiers
from hypothesis import HealthCheck, settings

from cnc_interp.processes.one_thread import use_one_thread

#: Thorough tests run in so many turns; a prime, so that no rhythm of pushing leaves one out.
TURNS = 13
ROOT = Path(__file__).parents[1]
use_one_thread()  # before NumPy is loaded
#: Tests that start nodes or a browser: one lane, in which a second process helps at the end.
LIVE = 'test/ros/', 'test/page/', 'test/replay/test_bags.py'
#: Files that name one of them run one after the other: one set of nodes, one session of HAL.
SHARED = 'shared_nodes', 'hal_session'


def pytest_addoption(parser):
    parser.addoption(
        '--all', action='store_true', help='run the thorough tests too, with many examples each'
    )
    parser.addoption(
        '--share',
        action='store_true',
        help=f'run one in {TURNS} of the thorough tests too; the number of commits says which',
    )


def pytest_configure(config):
    gc.set_threshold(200_000, 20, 100)  # what is imported and collected lives on
    config.addinivalue_line(
        'markers', 'thorough: runs with --all and where files or names are given, not every time'
    )
    tiers.thorough = config.getoption('--all')
    settings.register_profile(  # a busy computer changes no verdict
        'any speed',
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow],
        max_examples=tiers.examples(15, 100),
    )
    settings.load_profile('any speed')
    if not hasattr(config, 'workerinput'):
        state = tempfile.TemporaryDirectory()  # tests leave nothing with the user
        os.environ['XDG_STATE_HOME'] = state.name
        config.add_cleanup(state.cleanup)
        config.pluginmanager.register(Failures(config))


class Failures:
    """Tells at once which test failed, and how: a run that is cut off has no last words."""

    def __init__(self, config):
        self.config = config

    @pytest.hookimpl(trylast=True)
    def pytest_runtest_logreport(self, report):
        if report.failed:
            terminal = self.config.pluginmanager.get_plugin('terminalreporter')
            terminal.write_line(f'\n{report.nodeid}, {report.when}:\n{report.longreprtext}')


def turn():
    """Whose turn it is at this commit."""
    count = ['git', 'rev-list', '--count', 'HEAD']
    return int(subprocess.check_output(count, cwd=Path(__file__).parent)) % TURNS


def share(thorough, turn):
    """Tests of a turn: one in so many, and of live ones neighbours, which start the same nodes."""
    live = [item for item in thorough if item.nodeid.startswith(LIVE)]
    begin, end = (len(live) * k // TURNS for k in (turn, turn + 1))
    return [item for item in thorough if item not in live][turn::TURNS] + live[begin:end]


def pytest_report_header(config):
    if config.getoption('--share'):
        return f'thorough tests: share {turn() + 1} of {TURNS}, chosen by the commit'


def pytest_collection_modifyitems(config, items):
    """Leave thorough tests out of a run that names nothing."""
    whole = config.args_source is not pytest.Config.ArgsSource.ARGS
    named = config.option.keyword or config.option.markexpr
    if whole and not named and not tiers.thorough:
        thorough = [item for item in items if item.get_closest_marker('thorough')]
        left_out = set(thorough)
        if config.getoption('--share'):
            left_out -= set(share(thorough, turn()))
        config.hook.pytest_deselected(items=[item for item in items if item in left_out])
        items[:] = [item for item in items if item not in left_out]
    items.sort(key=lambda item: not item.nodeid.startswith(LIVE))  # they take longest


def pytest_collection_finish():
    gc.freeze()  # nor is it looked at again and again while the tests run
    gc.set_threshold(700, 10, 10)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config):
    """One process for each core, also where two of them are one core twice."""
    return len(os.sched_getaffinity(0))


@cache
def scope_of(file):
    """Return what runs in one process: a file, or those that use one set of nodes."""
    text = (ROOT / file).read_text()
    return next((f'test/ros/ {name}' for name in SHARED if name in text), file)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Let one process run the live files, then pure ones; the second takes them the other way."""
    from xdist.scheduler import LoadScopeScheduling

    config.option.loadscopereorder = False

    class Files(LoadScopeScheduling):
        @property
        def tests_finished(self):  # those of a process that died wait for the next one
            return not self.workqueue and super().tests_finished

        def _split_scope(self, nodeid):
            return scope_of(nodeid.split('::')[0])

        def _assign_work_unit(self, node):
            queue = self.workqueue
            for done in [scope for scope, tests in queue.items() if all(tests.values())]:
                del queue[done]  # of a process that died
            living = [one for one in self.nodes if not one.shutting_down]
            live = [scope for scope in queue if scope.startswith(LIVE)]
            pure = [scope for scope in queue if not scope.startswith(LIVE)]
            fitting = live + pure if node is living[0] else pure + live * (node in living[1:2])
            if fitting:
                queue.move_to_end(fitting[0], last=False)
                super()._assign_work_unit(node)
            else:
                node.shutdown()  # it must not wait for what it does not get

    return Files(config, log)
