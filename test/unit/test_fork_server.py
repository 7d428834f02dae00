"""The fork server: no signal is lost while it starts, or before its children are ready."""

import os
import signal
import subprocess
import sys
from pathlib import Path

PARENT = """
import os, signal, sys, time
from multiprocessing import forkserver
from cnc_interp.processes.fork_server import begin_child, begin_loading

def late():
    os.write(1, b'forked ')
    time.sleep(1.0)
    begin_child('late')
    time.sleep(60.0)

if __name__ == '__main__':
    came = []
    signal.signal(signal.SIGINT, lambda *_: came.append('SIGINT'))
    start = forkserver._forkserver.ensure_running
    def interrupted():
        os.kill(os.getpid(), signal.SIGINT)
        start()
    forkserver.ensure_running = interrupted
    context = begin_loading([])
    forkserver.ensure_running = start
    print(*came, flush=True)
    server = forkserver._forkserver._forkserver_pid
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(server, number)
    child = context.Process(target=late)
    child.start()
    time.sleep(0.5)
    child.terminate()
    child.join(30.0)
    print(child.exitcode, flush=True)
"""


def test_a_signal_that_comes_too_early_counts_later(tmp_path):
    script = tmp_path / 'parent.py'
    script.write_text(PARENT)
    told = subprocess.run(
        [sys.executable, script],
        capture_output=True,
        text=True,
        timeout=120,
        env=os.environ | {'PYTHONPATH': str(Path.cwd())},
    )
    assert told.stdout.split() == ['SIGINT', 'forked', str(-signal.SIGTERM)], told
