"""
The MTConnect agent beside real nodes: a long stream, many requests, and invalid ones.

``PYTHONPATH=.:test/ros:test/unit python benchmarks/mtconnect.py --minutes 30`` runs programs one
after another while a client reads a stream of samples. Every document is validated with the
schemas of ``--schemas``, the numbers of the observations must have no gap, and the agent's memory
is measured. Then clients send requests as fast as they can, and one client sends invalid requests:
each of these must get an answer of 4xx or a closed connection, and the agent must continue.

``--hours 8`` instead serves a machine with a simulated clock, without nodes: one state per
simulated second, as fast as the client reads the stream. The observations fill the buffer several
times.
"""

from __future__ import annotations

import argparse
import os
import re
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections import Counter
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path

from cnc_interp_msgs.action import RunProgram
from lxml import etree
from nodes_under_test import NodesUnderTest, hear_ctrl_c
from operated import waves

from cnc_interp.machine_model.machine import Machine
from cnc_interp.mtconnect.device import device_of, items_of
from cnc_interp.mtconnect.documents import Agent
from cnc_interp.mtconnect.server import AgentServer, Requests
from cnc_interp.mtconnect.store import Store

WRONG = (
    *('/nothing', '/current?at=-1', '/current?at=x', '/current?at=99999999999999999999'),
    *(
        '/sample?count=0',
        '/sample?from=1e9',
        '/sample?interval=-5',
        '/sample?heartbeat=0&interval=1',
    ),
    *('/current?path=//*[', '/current?path=' + 'a' * 5000, '/current?' + '&'.join('path=/' * 99)),
    *('/asset/none', '/probe/more/words', '/%00', '/sample?path=//x%00', '/..%2f..%2fetc/passwd'),
)
RAW = (
    *(
        b'POST /current HTTP/1.1\r\n\r\n',
        b'GET\r\n\r\n',
        b'\0' * 1000,
        b'GET /probe HTTP/9.9\r\n\r\n',
    ),
    *(b'GET /' + b'a' * 70_000 + b' HTTP/1.1\r\n\r\n', b'DELETE / HTTP/1.1\r\n\r\n'),
    b'GET /probe HTTP/1.1\r\n' + b'A: b\r\n' * 200 + b'\r\n',
)


class Schemas:
    def __init__(self, folder: Path):
        self._folder = folder
        parser = etree.XMLParser()
        parser.resolvers.add(self._Links(folder))
        self._known = {
            kind: etree.XMLSchema(
                etree.parse(str(folder / f'MTConnect{kind}_2.4_1.0.xsd'), parser)
            )
            for kind in ('Devices', 'Streams', 'Assets', 'Error')
        }

    class _Links(etree.Resolver):
        def __init__(self, folder: Path):
            super().__init__()
            self._folder = folder

        def resolve(self, url: str, _name: str, context: object) -> object:
            if url.endswith('xlink.xsd'):
                return self.resolve_filename(str(self._folder / 'xlink.xsd'), context)
            return None

    def valid(self, document: bytes) -> etree._Element:
        root = etree.fromstring(document)
        kind = etree.QName(root).localname.removeprefix('MTConnect')
        self._known[kind].assertValid(root)
        return root


def parts(address: str, target: str) -> Iterator[bytes]:
    """Yield the documents of a stream for as long as the agent sends it."""
    with urllib.request.urlopen(address + target, timeout=120.0) as answer:
        while True:
            line = answer.readline()
            if not line:
                return
            if line.lower().startswith(b'content-length:'):
                size = int(line.partition(b':')[2])
                answer.readline()
                yield answer.read(size)


class Reader(threading.Thread):
    """A client that reads a stream to its end, and counts what is in it."""

    def __init__(self, address: str, schemas: Schemas):
        super().__init__(daemon=True)
        self._address, self._schemas = address, schemas
        self.documents = self.observations = self.gaps = self.following = 0
        self.fault = ''

    def run(self) -> None:
        try:
            for document in parts(
                self._address, '/sample?interval=200&heartbeat=2000&count=10000'
            ):
                root = self._schemas.valid(document)
                head = root[0]
                seen = [int(one.get('sequence')) for one in root.iter() if one.get('sequence')]
                self.gaps += bool(self.following and seen and min(seen) != self.following)
                self.following = int(head.get('nextSequence'))
                self.documents += 1
                self.observations += len(seen)
            self.fault = 'the stream has ended'
        except (OSError, etree.DocumentInvalid, etree.XMLSyntaxError) as problem:
            self.fault = repr(problem)


def memory_of(process: int) -> float:
    pages = int(Path(f'/proc/{process}/statm').read_text().split()[1])
    return pages * 4096 / 1e6


def rate(address: str, target: str, clients: int, seconds: float) -> float:
    """Return how many answers per second all clients get together."""
    counts, until = Counter[int](), time.monotonic() + seconds

    def ask(number: int) -> None:
        connection = HTTPConnection(address.removeprefix('http://'), timeout=60.0)
        while time.monotonic() < until:
            connection.request('GET', target)
            answer = connection.getresponse()
            assert answer.status == 200 and answer.read()
            counts[number] += 1

    threads = [threading.Thread(target=ask, args=(k,)) for k in range(clients)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return counts.total() / seconds


def wrong(address: str, schemas: Schemas) -> Counter[str]:
    """Send requests that are wrong; return the answers by kind."""
    told: Counter[str] = Counter()
    host, _, port = address.removeprefix('http://').partition(':')
    for target in WRONG:
        connection = HTTPConnection(host, int(port), timeout=60.0)
        connection.putrequest('GET', target, skip_host=True)
        connection.endheaders()
        answer = connection.getresponse()
        schemas.valid(answer.read())
        told[f'{answer.status}'] += 1
    for text in RAW:
        with socket.create_connection((host, int(port)), timeout=60.0) as raw:
            raw.sendall(text)
            raw.shutdown(socket.SHUT_WR)
            words = raw.recv(64).split()
            told[words[1].decode() if len(words) > 1 else 'closed'] += 1
    return told


def simulated(hours: float, schemas: Schemas) -> None:
    """Serve hours of a machine whose states come faster than real ones."""
    machine, now = Machine.load('xyzac'), [1.7e9]
    device = device_of(machine, 'host')
    store = Store(items_of(device), clock=lambda: now[0])
    agent = Agent(device, store, 'host', int(now[0]))
    with AgentServer('127.0.0.1', 0, Requests(agent, dict)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        reader = Reader(f'http://127.0.0.1:{server.server_port}', schemas)
        reader.start()
        before = memory_of(os.getpid())
        for second in range(int(3600 * hours)):
            now[0] += 1.0
            place = f'{second % 9000 / 7:.4f}'
            axes = (f'{x}_{what}' for x in machine.axis_names for what in ('actual', 'commanded'))
            store.observe({'line': str(second), 'feed': place, **dict.fromkeys(axes, place)})
            while store.next_sequence > reader.following + 1000 and not reader.fault:
                time.sleep(0.01)
        while reader.following < store.next_sequence and not reader.fault:
            time.sleep(0.1)
        print(f'fault of the reader: {reader.fault or None}; gaps {reader.gaps}')
        print(f'documents {reader.documents}, all valid; observations {reader.observations}')
        print(f'memory [MB]: {before:.0f} to {memory_of(os.getpid()):.0f}')
        server.shutdown()


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument('--minutes', type=float, default=30.0)
    options.add_argument('--schemas', type=Path, default=Path('../shared/mtconnect'))
    options.add_argument('--hours', type=float, help='serve so long by a simulated clock')
    given = options.parse_args()
    schemas = Schemas(given.schemas)
    if given.hours:
        simulated(given.hours, schemas)
        return
    bench = NodesUnderTest()
    words = ['mtconnect', '--port', '0', '--namespace', bench.namespace]
    agent = subprocess.Popen(
        [sys.executable, '-m', 'cnc_interp', *words, '--domain', str(bench.domain)],
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=hear_ctrl_c,
    )
    assert agent.stdout is not None
    found = re.search(r'http://[^/]+', agent.stdout.readline())
    assert found is not None
    address = found[0]
    reader = Reader(address, schemas)
    reader.start()
    text, until, runs, underruns, looks = (
        waves(90),
        time.monotonic() + 60 * given.minutes,
        0,
        0,
        [],
    )
    while time.monotonic() < until and not reader.fault:
        result = bench.run(text=text, program='waves.ngc')
        assert result.code == RunProgram.Result.SUCCEEDED, result.message
        runs, underruns = runs + 1, underruns + result.starvations
        looks.append(memory_of(agent.pid))
    print(f'runs {runs}, underruns {underruns}, fault of the reader: {reader.fault or None}')
    print(f'documents {reader.documents}, all valid; observations {reader.observations}')
    print(f'gaps {reader.gaps}; memory of the agent [MB]: {[round(look, 1) for look in looks]}')
    for target in ('/probe', '/current', '/sample?count=100', '/assets'):
        for clients in (1, 8):
            print(f'{target}, {clients} clients: {rate(address, target, clients, 5.0):.0f} per s')
    print(f'wrong requests: {dict(wrong(address, schemas))}')
    schemas.valid(urllib.request.urlopen(f'{address}/current').read())
    print(f'memory of the agent at the end: {memory_of(agent.pid):.1f} MB')
    agent.terminate()
    bench.close()


if __name__ == '__main__':
    main()
