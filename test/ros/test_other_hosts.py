"""Another computer that knows our address reaches nothing; tried in network namespaces."""

import contextlib
import json
import operator
import os
import shutil
import struct
import subprocess
import sys
import time
from ipaddress import ip_address
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from nodes_under_test import PATIENCE

OURS, THEIRS = '10.77.0.1', '10.77.0.2'
DOMAIN = 42
NODES = {'program_node', 'lookahead_node', 'feedrate_node', 'machine_node'}
STRANGER = Path(__file__).with_name('stranger.py')
TEXT = 'G21 G90 G94 G1 F60 X0 Y0 Z0\nX100 (nobody else shall read this)\nM30\n'
#: Tables of sockets in /proc, each with the form of its addresses, and the state of a server's.
KINDS, LISTENS = {'udp': '=I', 'udp6': '=4I', 'tcp': '=I', 'tcp6': '=4I'}, '0A'
#: Variables that say who may reach the nodes.
RANGES = ('ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_STATIC_PEERS', 'FASTRTPS_DEFAULT_PROFILES_FILE')


def environment(**more):
    plain = {k: v for k, v in os.environ.items() if k not in RANGES and 'PYTEST' not in k}
    return plain | {'ROS_DOMAIN_ID': str(DOMAIN)} | more


class Host:
    """A computer with a network of its own: a network namespace that a sleeping process holds."""

    def __init__(self, inside=()):
        self._hidden = [] if os.geteuid() == 0 else ['--user']
        mapped = ['--user', '--map-root-user'] if self._hidden and not inside else []
        self._process = subprocess.Popen(
            [*inside, 'unshare', *mapped, '--net', 'sleep', 'infinity'], stderr=subprocess.PIPE
        )
        own = Path('/proc/self/ns/net').readlink()
        deadline = time.monotonic() + 60.0
        while self.pid is None or Path(f'/proc/{self.pid}/ns/net').readlink() == own:
            if self._process.poll() is not None or time.monotonic() > deadline:
                said = self._process.communicate()[1].decode()
                pytest.skip(f'no network namespace is permitted here: {said.strip()}')
            time.sleep(0.02)
        self.do('ip', 'link', 'set', 'lo', 'up')

    @property
    def pid(self):
        return self._process.pid

    @property
    def inside(self):
        """What comes before a command that runs on this host."""
        user = ['--user', '--preserve-credentials'] if self._hidden else []
        return ['nsenter', '--target', str(self.pid), *user, '--net']

    def do(self, *words):
        subprocess.run([*self.inside, *words], check=True, capture_output=True)

    def listening(self, kind):
        """Address, port and bytes that nobody has read yet of the sockets of one kind."""
        found = []
        for row in Path(f'/proc/{self.pid}/net/{kind}').read_text().splitlines()[1:]:
            place, state, queues = operator.itemgetter(1, 3, 4)(row.split())
            if kind.startswith('udp') or state == LISTENS:
                address, _, port = place.partition(':')
                words = struct.unpack(KINDS[kind], bytes.fromhex(address))
                packed = struct.pack(KINDS[kind].replace('=', '>'), *words)
                found.append((ip_address(packed), int(port, 16), int(queues.split(':')[1], 16)))
        return found

    def open_to_others(self, *kinds):
        """Sockets that take what other hosts send."""
        return [
            place for kind in kinds for place in self.listening(kind) if not place[0].is_loopback
        ]

    def close(self):
        self._process.kill()
        self._process.communicate()


@pytest.fixture(scope='module')
def hosts():
    """Our host and a stranger's, with a cable between them."""
    if not all(shutil.which(tool) for tool in ('ip', 'unshare', 'nsenter')):
        pytest.skip('needs ip (iproute2), unshare and nsenter (util-linux)')
    with contextlib.ExitStack() as stack:
        ours = Host()
        stack.callback(ours.close)
        theirs = Host(ours.inside[:-1] if os.geteuid() else ())
        stack.callback(theirs.close)
        try:
            cable = 'ip link add cable0 type veth peer name cable1 netns'
            ours.do(*cable.split(), str(theirs.pid))
        except subprocess.CalledProcessError as problem:
            pytest.skip(f'no virtual cable is permitted here: {problem.stderr.decode().strip()}')
        for host, end, address in ((ours, 'cable0', OURS), (theirs, 'cable1', THEIRS)):
            host.do('ip', 'address', 'add', f'{address}/24', 'dev', end)
            host.do('ip', 'link', 'set', end, 'up')
        yield ours, theirs


@pytest.fixture
def program(tmp_path):
    file = tmp_path / 'part.ngc'
    file.write_text(TEXT)
    return file


@contextlib.contextmanager
def started(host, words, **variables):
    """Run one of our commands on a host."""
    process = subprocess.Popen(
        [*host.inside, sys.executable, '-m', *map(str, words)],
        env=environment(**variables),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=PATIENCE)


def attack(hosts, words, participants, **variables):
    """
    What a stranger reaches while a command of ours runs.

    Also the TCP sockets that are open to it, and whether what it sends by UDP is never read.
    """
    ours, theirs = hosts
    deadline = time.monotonic() + PATIENCE
    with started(ours, words, **variables) as process:
        while len(ours.listening('udp')) < 2 * participants:  # one for discovery, one for data
            assert process.poll() is None, process.stderr.read()
            assert time.monotonic() < deadline
            time.sleep(0.1)
        found = subprocess.run(
            [*theirs.inside, sys.executable, str(STRANGER), OURS, str(DOMAIN)],
            env=environment(),
            check=True,
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )
        for _, port, _ in ours.open_to_others('udp', 'udp6'):
            theirs.do('bash', '-c', f'echo hello >/dev/udp/{OURS}/{port}')
        time.sleep(1.0)  # a reader would have read it
        udp, tcp = ours.open_to_others('udp', 'udp6'), ours.open_to_others('tcp', 'tcp6')
    unread = all(waiting for _, _, waiting in udp)
    return json.loads(found.stdout.splitlines()[-1]), tcp, unread


@pytest.mark.thorough
@pytest.mark.parametrize(
    ('words', 'participants'),
    [
        (['cnc_interp', 'run', 'PROGRAM'], 5),
        pytest.param(['cnc_interp', 'panel', '--port', '0'], 5, marks=pytest.mark.thorough),
        pytest.param(['cnc_interp.nodes', 'program_node'], 1, marks=pytest.mark.thorough),
    ],
)
def test_nobody_else_reaches_what_is_started_without_options(hosts, program, words, participants):
    words = [str(program) if word == 'PROGRAM' else word for word in words]
    found, tcp, unread = attack(hosts, words, participants)
    assert found == {'nodes': [], 'texts': [], 'answers': []}
    assert tcp == []
    assert unread  # Fast DDS sends from sockets of any address, and never reads them


@pytest.mark.thorough
def test_the_range_of_discovery_alone_does_not_keep_out_who_knows_the_address(
    hosts, program, tmp_path
):
    """The nodes neither hear nor say anything by multicast, and are found by address and port."""
    plain = tmp_path / 'plain.xml'
    plain.write_text('<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"/>')
    words = ['cnc_interp', 'run', program]
    found, _, unread = attack(
        hosts,
        words,
        5,
        ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST',
        FASTRTPS_DEFAULT_PROFILES_FILE=str(plain),
    )
    assert not unread
    assert 'program_node' in found['nodes'] and found['texts'] == [TEXT]


@pytest.mark.thorough
def test_a_user_opens_the_nodes_and_even_then_no_file_is_read(hosts, program):
    """The stranger of these tests does reach nodes that can be reached."""
    words = ['cnc_interp', 'run', program]
    found, _, unread = attack(hosts, words, 5, ROS_AUTOMATIC_DISCOVERY_RANGE='SUBNET')
    assert not unread
    assert set(found['nodes']) >= NODES
    assert found['texts'] == [TEXT]
    (answer,) = found['answers']
    assert 'program_folders' in answer
