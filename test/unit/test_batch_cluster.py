"""A batch over a cluster: the same table as here, also when a worker is lost."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from cnc_interp.commands.cli import main
from cnc_interp.commands.parser import BAD_INPUT, FAILED, FINE

pytest.importorskip('distributed', reason='needs the optional part batch')

ROOT = Path(__file__).parents[2]
LINE = 'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A10 C0\nG1 F3000 X{}\nM30\n'


class Part:
    """A process of `cnc-interp cluster`."""

    def __init__(self, *words):
        command = [sys.executable, '-m', 'cnc_interp', 'cluster', '--workers', '1', *words]
        self.process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        self.line = self.process.stdout.readline()  # said once it is ready

    def end(self, number):
        """Send a signal; return the exit code."""
        self.process.send_signal(number)
        self.process.communicate()
        return self.process.returncode


@pytest.fixture
def scheduler():
    part = Part('--port', '0', '--dashboard', '0')
    yield part, part.line.split()[1].rstrip(',')
    if part.process.poll() is None:
        part.end(signal.SIGKILL)


@pytest.mark.thorough
def test_a_cluster_makes_the_same_table_though_a_worker_is_lost(scheduler, tmp_path):
    part, address = scheduler
    other = Part('--join', address)
    assert address in other.line
    programs = tmp_path / 'programs'
    programs.mkdir()
    for k in range(30):
        (programs / f'{k}.ngc').write_text(LINE.format(f'{k}\nY{k + 1}\nX0'))
    (programs / 'wrong.ngc').write_text('G1 X\n')
    outs = tmp_path / 'here', tmp_path / 'there'
    assert main(['batch', str(programs), '--out', str(outs[0])]) == FAILED

    def lose_the_other():
        while len(list((outs[1] / 'results').glob('[0-9a-f]*.json'))) < 4:
            time.sleep(0.01)
        os.kill(other.process.pid, signal.SIGKILL)

    loss = threading.Thread(target=lose_the_other)
    loss.start()
    words = ['batch', str(programs), '--out', str(outs[1]), '--scheduler', address]
    assert main(words) == FAILED
    loss.join()
    assert (outs[0] / 'table.csv').read_bytes() == (outs[1] / 'table.csv').read_bytes()
    assert other.end(signal.SIGKILL) == -signal.SIGKILL
    assert part.end(signal.SIGINT) == FINE


@pytest.mark.thorough
def test_a_lost_scheduler_ends_the_batch_in_one_line(scheduler, tmp_path):
    part, address = scheduler
    for k in range(30):
        (tmp_path / f'{k}.ngc').write_text(LINE.format(f'{k}\nY{k + 1}\nX0'))
    words = ['batch', str(tmp_path), '--out', str(tmp_path / 'out'), '--scheduler', address]
    batch = subprocess.Popen(
        [sys.executable, '-m', 'cnc_interp', *words, '--json'],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    while len(list((tmp_path / 'out/results').glob('[0-9a-f]*.json'))) < 2:
        assert batch.poll() is None
        time.sleep(0.01)
    part.end(signal.SIGKILL)
    told = batch.communicate()[1]
    assert batch.returncode == BAD_INPUT
    assert told.count('\n') == 1 and 'the scheduler was lost' in told, told


@pytest.mark.thorough
def test_a_cluster_cuts_needles_with_the_same_bits(scheduler, tmp_path, capsys):
    pytest.importorskip('zarr', reason='needs the optional part tiles')
    _, address = scheduler
    (tmp_path / 'plane.json').write_text('{"kind": "plane", "size_mm": [12, 9]}')
    (tmp_path / 'line.ngc').write_text('G21 G90 G94\nG0 X-7 Y0 Z0.01\nG1 X7 F1000\nM30\n')
    words = ['cam', 'simulate', str(tmp_path / 'line.ngc'), '--surface']
    words += [str(tmp_path / 'plane.json'), '--spacing', '0.03']
    chunks = []
    for where in (['--workers', '1'], ['--scheduler', address]):
        out = tmp_path / where[0]
        assert main([*words, '--tiles', str(out), *where]) == FINE
        files = sorted((out / 'heights.zarr' / 'height').rglob('*'))
        chunks.append([file.read_bytes() for file in files if file.is_file()])
    assert len(chunks[0]) == 3 and chunks[0] == chunks[1]  # 267 x 167 needles, and their shape
    assert '2 tiles' in capsys.readouterr().out


@pytest.mark.thorough
def test_what_cannot_be_is_said(scheduler, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr('cnc_interp.batch.dask_workers.PATIENCE', 2)
    part, address = scheduler
    port = address.rpartition(':')[2]
    (tmp_path / 'a.ngc').write_text(LINE.format(3))
    assert main(['cluster', '--port', port, '--dashboard', '0']) == BAD_INPUT
    assert 'Address already in use' in capsys.readouterr().err
    assert part.end(signal.SIGTERM) == FINE
    words = ['batch', str(tmp_path / 'a.ngc'), '--out', str(tmp_path / 'out')]
    assert main([*words, '--scheduler', address]) == BAD_INPUT
    assert 'no scheduler answers; start one: cnc-interp cluster' in capsys.readouterr().err
    assert main(['cluster', '--join', address]) == BAD_INPUT
    assert f'{address}: no scheduler answers' in capsys.readouterr().err
