"""Ports in shared memory stay while a process opens them, and go when nobody has them open."""

import mmap
import multiprocessing

import pytest

from cnc_interp.processes.shared_memory import (
    FOLDER,
    files_in_use,
    opening_locked,
    remove_dead_segments,
    semaphore_of,
)

PORT = 'fastrtps_port99999'  # of no domain


def open_port(opens, opened, ends):
    """As Fast DDS opens a port that a killed process has left: under the lock."""
    with opening_locked(PORT):
        opens.set()
        opened.wait()
        with (FOLDER / PORT).open('r+b') as file:
            memory = mmap.mmap(file.fileno(), 0)
    opens.clear()
    ends.wait()
    memory.close()


@pytest.fixture
def files():
    """A port that a killed process has left."""
    names = [PORT, f'{PORT}_el']
    for name in names:
        (FOLDER / name).write_bytes(bytes(4096))
    files = [*(FOLDER / name for name in names), semaphore_of(PORT)]
    yield files
    for file in files:
        file.unlink(missing_ok=True)


def in_use(file):
    return file.stat().st_ino in files_in_use()


@pytest.mark.skipif(not FOLDER.is_dir(), reason='no shared memory here')
@pytest.mark.parametrize('dies', [False, True])
def test_a_port_stays_while_a_process_opens_it_and_goes_after(files, dies):
    spawn = multiprocessing.get_context('spawn')
    opens, opened, ends = spawn.Event(), spawn.Event(), spawn.Event()
    process = spawn.Process(target=open_port, args=(opens, opened, ends))
    process.start()
    try:
        opens.wait()
        assert not in_use(files[0]) and in_use(semaphore_of(PORT))
        remove_dead_segments()
        assert files[0].exists(), 'it is about to be opened'
        if not dies:
            opened.set()
            while opens.is_set():
                process.join(0.01)
            assert in_use(files[0]) and not in_use(semaphore_of(PORT))
            remove_dead_segments()
            assert files[0].exists(), 'it is open'
            ends.set()
            process.join()
    finally:
        process.kill()
        process.join()
    remove_dead_segments()
    assert not any(file.exists() for file in files)
