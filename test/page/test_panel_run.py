"""`cnc-interp run --panel` as its user starts it: the page beside a run, until Ctrl-C."""

import re
import signal
import subprocess
import sys
import threading
import urllib.request

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')
pytest.importorskip(
    'nicegui', reason='needs requirements/panel.txt; run the tests with ./cnc test'
)

from nodes_under_test import clean_environment, hear_ctrl_c

PATIENCE = 300.0  # [s]; a bound, not a timing
PROGRAM = 'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A10 C0\nG1 X20 F3000\nG1 Y10\nM30\n'


def test_a_run_with_the_page_beside_it(tmp_path):
    program = tmp_path / 'short.ngc'
    program.write_text(PROGRAM)
    token_file = tmp_path / 'token'
    token_file.write_text('known to this test\n')
    command = [sys.executable, '-m', 'cnc_interp', 'run', str(program), '--panel', '--port', '0']
    run = subprocess.Popen(
        [*command, '--token-file', str(token_file)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=clean_environment(),
        preexec_fn=hear_ctrl_c,
    )
    bound = threading.Timer(PATIENCE, run.kill)
    bound.start()
    try:
        said = ''
        for line in run.stderr:  # the page may come before the end of so short a run, or after it
            said += line
            if 'view only' in said and 'the page stays open' in said:
                break
        assert 'executed to the end; the page stays open' in said
        address = re.search(r'operator page +(\S+/\?token=known%20to%20this%20test)\n', said)[1]
        with urllib.request.urlopen(address) as answer:
            assert answer.status == 200 and b'contact.js' in answer.read()
        run.send_signal(signal.SIGINT)
        out, _ = run.communicate()
        assert run.returncode == 0
        assert 'executed to the end' in out
        with pytest.raises(OSError):
            urllib.request.urlopen(address)
    finally:
        bound.cancel()
        run.kill()
        run.communicate()
