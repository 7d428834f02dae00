"""The commands of docs/operate.md, in their order, do what the page says."""

import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from nodes_under_test import PATIENCE, clean_environment, hear_ctrl_c

ROOT = Path(__file__).parents[2]


def command_lines():
    """Return what follows `./cnc` in every command line of the page."""
    fences = re.findall(r'```\n(.*?)```', (ROOT / 'docs' / 'operate.md').read_text(), re.S)
    return [line.split()[1:] for fence in fences for line in fence.splitlines() if line]


CNC = [sys.executable, '-m', 'cnc_interp']


def serve(panel, folder, touches_off):
    """Start the page, set zero and tool by its nodes where they may, end it by Ctrl-C."""
    page = subprocess.Popen(
        [*CNC, *panel],
        cwd=folder,
        stdout=subprocess.PIPE,
        text=True,
        env=clean_environment(),
        preexec_fn=hear_ctrl_c,
    )
    try:
        said = ''
        for line in page.stdout:
            said += line
            if 'http' in line:
                break
        address = re.search(r'http://\S+', said)[0]
        assert urllib.request.urlopen(address, timeout=PATIENCE).status == 200
        if touches_off:
            domain = re.search(r'ROS domain +(\d+)', said)[1]
            for line in ('touch-off X 0 Y 0 Z 0', 'tools 1 --load'):
                subprocess.run([*CNC, *line.split(), '--domain', domain], check=True)
        page.send_signal(signal.SIGINT)
        assert page.wait(PATIENCE) == 0
    finally:
        page.kill()
        page.wait()


@pytest.mark.thorough
def test_the_commands_lead_to_a_proven_part(tmp_path):
    (tmp_path / 'examples').symlink_to(ROOT / 'examples')
    five_axes, three_axes, *others = command_lines()
    assert five_axes[0] == three_axes[0] == 'panel' and 'router' in three_axes
    assert [line[0] for line in others] == ['run', 'check', 'report']
    serve(five_axes, tmp_path, touches_off=True)
    serve(three_axes, tmp_path, touches_off=False)  # its axes must be homed before
    for line in others:
        done = subprocess.run([*CNC, *line], cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        if line[0] == 'check':
            assert 'proven' in done.stdout
    assert list((tmp_path / 'out').rglob('*.html'))


@pytest.mark.thorough
def test_a_page_whose_nodes_cannot_work_ends_with_their_last_words(tmp_path):
    """Also where Ctrl-C is ignored, as in the background of a script."""
    (tmp_path / 'file').write_text('')
    setup = tmp_path / 'file' / 'setup.yaml'
    command = [sys.executable, '-m', 'cnc_interp', 'panel', '--port', '0', '--setup', setup]
    done = subprocess.run(
        command,
        env=clean_environment(),
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
    )
    assert done.returncode == 2
    said = done.stderr.splitlines()[-1]
    assert said.startswith('cnc-interp: program_node ended: ') and str(setup) in said
