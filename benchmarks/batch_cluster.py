"""
A batch on a cluster of one scheduler and two workers, each in its own network namespace.

    sudo python benchmarks/batch_cluster.py [PROGRAM ...] [--machines M ...]

Four namespaces are connected by a bridge: scheduler, two workers, and the client. The batch runs
three times: on this computer with two processes, on the cluster, and on the cluster while one of
its workers is disconnected halfway. Printed are wall times, and whether the tables are equal byte
for byte.
"""

from __future__ import annotations

import argparse
import hashlib
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[1]
BRIDGE, NET = 'cnc_batch', '10.213.77'
NAMES = ('scheduler', 'one', 'two', 'user')
PORT = 8786


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('programs', type=Path, nargs='*', default=[ROOT / 'examples'])
    parser.add_argument('--machines', nargs='+', default=['xyzac', 'xyzbc', 'xyzac_trt'])
    options = parser.parse_args()
    if not shutil.which('ip'):
        sys.exit('needs ip (iproute2) and root')
    words = ['batch', *map(str, options.programs), '--machine', *options.machines]
    hashes = []
    with tempfile.TemporaryDirectory() as folder, network():
        for name in ('here', 'cluster', 'cut off'):
            out = Path(folder) / name
            took = run(name, words, out)
            table = (out / 'table.csv').read_bytes()
            hashes.append(hashlib.sha256(table).hexdigest()[:16])
            print(f'{name:<8} {took:6.1f} s, {len(table.splitlines()) - 1} tasks, {hashes[-1]}')
    print('tables are equal' if len(set(hashes)) == 1 else 'TABLES DIFFER')


def run(name: str, words: list[str], out: Path) -> float:
    """Make the batch; return how long it took [s]."""
    if name == 'here':
        return timed([*words, '--out', str(out), '--workers', '2'])
    address = f'tcp://{NET}.{1 + NAMES.index("scheduler")}:{PORT}'
    host = address[6:].rpartition(':')[0]
    parts = [
        inside('scheduler', ['cluster', '--host', host, '--workers', '0', '--dashboard', '0'])
    ]
    parts += [
        inside(worker, ['cluster', '--join', address, '--workers', '1'])
        for worker in ('one', 'two')
    ]
    cut = threading.Thread(target=cut_off, args=('two', out / 'results'), daemon=True)
    if name == 'cut off':
        cut.start()
    try:
        return timed([*words, '--out', str(out), '--scheduler', address], 'user')
    finally:
        for part in parts:
            part.send_signal(signal.SIGKILL)
            part.wait()


def cut_off(name: str, results: Path) -> None:
    """Take a namespace off the bridge once some results are there."""
    while len(list(results.glob('[0-9a-f]*.json'))) < 3:
        time.sleep(0.05)
    ip('link', 'set', f'{BRIDGE}-{name[:3]}', 'down')
    print(f'         cut off {name}')


def command(words: list[str], namespace: str = '') -> list[str]:
    """Return a command line, in a namespace where one is named."""
    before = ['ip', 'netns', 'exec', f'{BRIDGE}-{namespace}'] if namespace else []
    return [*before, sys.executable, '-m', 'cnc_interp', *words]


def timed(words: list[str], namespace: str = '') -> float:
    """Run a command; return how long it took [s]."""
    began = time.monotonic()
    subprocess.run(command(words, namespace), cwd=ROOT, stdout=subprocess.DEVNULL, check=False)
    return time.monotonic() - began


def inside(namespace: str, words: list[str]) -> subprocess.Popen[str]:
    """Start a part of the cluster; return when it is ready."""
    process = subprocess.Popen(
        command(words, namespace), cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    process.stdout.readline()
    return process


def ip(*words: str) -> None:
    """Run ``ip``."""
    subprocess.run(['ip', *words], check=True)


@contextmanager
def network() -> Iterator[None]:
    """Make the namespaces and the bridge, and remove them."""
    ip('link', 'add', BRIDGE, 'type', 'bridge')
    ip('link', 'set', BRIDGE, 'up')
    made = []
    try:
        for number, name in enumerate(NAMES, start=1):
            space, here = f'{BRIDGE}-{name}', f'{BRIDGE}-{name[:3]}'
            ip('netns', 'add', space)
            made.append(space)
            ip('link', 'add', here, 'type', 'veth', 'peer', 'name', 'eth0', 'netns', space)
            ip('link', 'set', here, 'master', BRIDGE, 'up')
            ip('-n', space, 'addr', 'add', f'{NET}.{number}/24', 'dev', 'eth0')
            for device in ('lo', 'eth0'):
                ip('-n', space, 'link', 'set', device, 'up')
        yield
    finally:
        for space in made:
            ip('netns', 'del', space)
        ip('link', 'del', BRIDGE)


if __name__ == '__main__':
    main()
