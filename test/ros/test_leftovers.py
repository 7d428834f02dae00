"""Nothing stays in temporary folders, however a run ends, and nothing is shared by memory."""

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


def sockets(process_id):
    """The sockets that a process has open, by their numbers."""
    for opened in Path(f'/proc/{process_id}/fd').glob('*'):
        with contextlib.suppress(OSError):
            yield from re.findall(r'socket:\[([0-9]+)\]', str(opened.readlink()))


def participants(run):
    """How many processes of a run take part in DDS: they listen to UDP on this computer only."""
    bound = {
        row.split()[9]
        for row in Path('/proc/net/udp').read_text().splitlines()
        if row.split()[1].startswith('0100007F:')
    }
    return sum(not bound.isdisjoint(sockets(member)) for member in family(run.pid))


def shared(run):
    """Files of DDS in shared memory that the processes of a run use."""
    found = set()
    for member in family(run.pid):
        with contextlib.suppress(OSError):
            maps = Path(f'/proc/{member}/maps').read_text(errors='replace')
            found.update(re.findall(r'/dev/shm/\S*fastrtps\S*', maps))
    return found


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


def live_until_all_take_part(run):
    deadline = time.monotonic() + PATIENCE
    while participants(run) < PARTICIPANTS:
        assert run.poll() is None and time.monotonic() < deadline
        time.sleep(0.1)


@pytest.mark.thorough
@pytest.mark.parametrize('how', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_nothing_stays_of_a_run_that_is_ended(how, folder):
    run = started(folder)
    live_until_all_take_part(run)
    assert shared(run) == set()
    run.send_signal(how)
    run.wait(PATIENCE)
    assert list((folder / 'tmp').iterdir()) == []


@pytest.mark.thorough
def test_the_next_run_removes_what_a_killed_one_has_left(folder):
    run = started(folder)
    live_until_all_take_part(run)
    members = family(run.pid) - {run.pid}
    run.kill()
    run.wait(PATIENCE)
    deadline = time.monotonic() + PATIENCE
    while any(Path(f'/proc/{member}').exists() for member in members):  # the nodes end, too
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert list((folder / 'tmp').iterdir())
    started(folder).wait(PATIENCE)
    assert list((folder / 'tmp').iterdir()) == []
