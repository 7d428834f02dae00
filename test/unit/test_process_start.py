"""When a process was started, as the time to the first motion counts from there."""

import subprocess
import sys
import time

ASK = (
    'import time; time.sleep(0.3)\n'
    'from cnc_interp.processes.node_processes import process_start as s'
)


def test_it_is_the_moment_of_the_command():
    before = time.monotonic()
    told = subprocess.run(
        [sys.executable, '-c', f'{ASK}; print(s())'], capture_output=True, text=True, check=True
    )
    assert before - 0.02 <= float(told.stdout) <= time.monotonic() - 0.3
