"""Nothing stays in shared memory or in temporary folders, however a run ends."""

import contextlib
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from nodes_under_test import PATIENCE

from cnc_interp.processes.shared_memory import FIRST_OF_DOMAINS

#: Runs 6 s.
LONG = 'G21 G90 G0 X0 Y0 Z0\nG1 F1000\nX100\nM2\n'
#: Participants of a run: four nodes and the run itself.
PARTICIPANTS = 5


def family(process_id):
    """A process and all that descend from it."""
    parents = {}
    for stat in Path('/proc').glob('[0-9]*/stat'):
        try:
            parents[int(stat.parent.name)] = int(stat.read_text().rpartition(')')[2].split()[1])
        except OSError:
            continue
    found = {process_id}
    while len(found) < len(found := found | {c for c, p in parents.items() if p in found}):
        pass
    return found


def shared(process_id):
    """
    Names in shared memory that a process and its descendants have made, but common ports.

    They hold the locks of these. What else they have open may be another run's: DDS reads what
    comes to a port that a process of another run had before.
    """
    locks = set()
    for member in family(process_id):
        for opened in Path(f'/proc/{member}/fd').glob('*'):
            with contextlib.suppress(OSError):
                locks.update(re.findall(r'^/dev/shm/(fastrtps_\w+_el)$', str(opened.readlink())))
    names = locks | {lock.removesuffix('_el') for lock in locks}
    ports = {name: re.search(r'port([0-9]+)', name) for name in names}
    return {n for n in names if not ports[n] or int(ports[n][1]) >= FIRST_OF_DOMAINS}


@pytest.fixture
def folder():
    """A folder with a short path, because it will hold sockets."""
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


def started(folder, text=LONG, *words):
    """Start a run whose temporary files lie in a folder; nothing is sourced."""
    program = folder / 'program.ngc'
    program.write_text(text)
    (folder / 'tmp').mkdir(exist_ok=True)
    sourced = ('AMENT_PREFIX_PATH', 'RMW_IMPLEMENTATION')
    plain = {name: value for name, value in os.environ.items() if name not in sourced}
    return subprocess.Popen(
        [sys.executable, '-m', 'cnc_interp', 'run', program, *words],
        env=plain | {'TMPDIR': str(folder / 'tmp')},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def seen_until(run, done):
    """What a run has in shared memory, until something is done or the run has ended."""
    names, deadline = set(), time.monotonic() + PATIENCE
    while run.poll() is None and not done(names):
        assert time.monotonic() < deadline
        names |= shared(run.pid)
        time.sleep(0.5)
    return names


def segments(names):
    return [name for name in names if re.fullmatch('fastrtps_[0-9a-f]{16}', name)]


def left(names):
    """What of the names is still there, and the command lines of those who have it open."""
    there = {name: [] for name in names if (Path('/dev/shm') / name).exists()}
    for maps in Path('/proc').glob('[0-9]*/maps'):
        with contextlib.suppress(OSError):
            text = maps.read_text(errors='replace')
            command = maps.with_name('cmdline').read_text().replace('\0', ' ')
            for name in there:
                if f'/{name}\n' in text:
                    there[name].append(f'{maps.parent.name}: {command}')
    return there


@pytest.mark.thorough
@pytest.mark.parametrize('how', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_nothing_stays_of_a_run_that_is_ended(how, folder):
    run = started(folder)
    names = seen_until(run, lambda found: len(segments(found)) == PARTICIPANTS)
    assert len(segments(names)) >= PARTICIPANTS
    run.send_signal(how)
    run.wait(PATIENCE)
    assert not left(names)
    assert list((folder / 'tmp').iterdir()) == []


@pytest.mark.thorough
def test_the_next_run_removes_what_a_killed_one_has_left(folder):
    run = started(folder)
    names = seen_until(run, lambda found: len(segments(found)) == PARTICIPANTS)
    members = family(run.pid) - {run.pid}
    run.kill()
    run.wait(PATIENCE)
    assert left(names)  # later, the end of a run of another test may have removed them
    deadline = time.monotonic() + PATIENCE
    while any(Path(f'/proc/{member}').exists() for member in members):  # the nodes end, too
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert list((folder / 'tmp').iterdir())
    started(folder).wait(PATIENCE)
    assert not left(names)
    assert list((folder / 'tmp').iterdir()) == []
