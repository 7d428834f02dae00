"""Ctrl-C while a command still loads its libraries: one line, exit code 130, nothing left."""

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from nodes_under_test import PATIENCE, hear_ctrl_c

PROGRAM = 'G21 G90 G0 X0 Y0 Z0\nG1 F1000\nX100\nM2\n'
IMPORT = b'import time:'


@pytest.mark.parametrize('words', [['run'], ['plan', '--out', 'out'], ['panel', '--port', '0']])
@pytest.mark.parametrize(
    'module',
    [
        'numpy.core.multiarray',
        'numba',
        'cnc_interp.commands.cli',
        'rclpy',
        'cnc_interp.client.session',
        'cnc_interp.client.operator_client',
        'cnc_interp.nodes.preload_nodes',
    ],
)
@pytest.mark.thorough
def test_ctrl_c_during_imports(module, words):
    if words[0] == 'plan' and ('rclpy' in module or 'client' in module or 'nodes' in module):
        pytest.skip('plan does not load it')
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / 'a.ngc').write_text(PROGRAM)
        (folder / 'tmp').mkdir()
        python = [sys.executable, '-X', 'importtime']
        run = subprocess.Popen(
            [*python, '-m', 'cnc_interp', words[0], 'a.ngc', *words[1:]],
            cwd=folder,
            env=os.environ | {'TMPDIR': str(folder / 'tmp')},
            start_new_session=True,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            preexec_fn=hear_ctrl_c,
        )
        for line in run.stderr:
            if line.startswith(IMPORT) and line.split()[-1].decode() == module:
                break
        os.killpg(run.pid, signal.SIGINT)
        out, errors = run.communicate(timeout=PATIENCE)
        # Two processes write their import times at once: parts of a line that was cut count, too.
        said = [line for line in errors.splitlines() if line.strip() and b'|' not in line]
        assert (run.returncode, out) == (130, b''), (out, said)
        assert said in ([], [b'cnc-interp: interrupted']), b'\n'.join(said).decode()
        assert list((folder / 'tmp').iterdir()) == []


def press_before_python():
    """As ./cnc starts it: Ctrl-C waits until it is unblocked."""
    hear_ctrl_c()
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    os.kill(os.getpid(), signal.SIGINT)


def test_ctrl_c_before_python_is_up():
    done = subprocess.run(
        [sys.executable, '-m', 'cnc_interp', 'check', 'none'],
        preexec_fn=press_before_python,
        capture_output=True,
        timeout=PATIENCE,
    )
    assert (done.returncode, done.stderr) == (130, b'cnc-interp: interrupted\n')
