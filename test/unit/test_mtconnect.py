"""Documents of the MTConnect agent: valid by its schemas, and true of what was observed."""

import io
import re
import socket
import threading
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('lxml', reason='needs requirements/mtconnect.txt')

from lxml import etree

from cnc_interp.core import MM
from cnc_interp.machine_model.links import joints_of
from cnc_interp.machine_model.machine import Machine
from cnc_interp.mtconnect.device import device_of, items_of
from cnc_interp.mtconnect.documents import Agent
from cnc_interp.mtconnect.server import AgentServer, Requests
from cnc_interp.mtconnect.store import FAULT, NORMAL, WARNING, Store
from cnc_interp.program.job import Tool

SCHEMAS = Path(__file__).parents[3] / 'shared/mtconnect'
TOOLS = {3: Tool(length=60 * MM, radius=5 * MM, remark='end mill', pocket=12), 7: Tool()}


class Resolver(etree.Resolver):
    def resolve(self, url, _name, context):
        """Find the schema of links beside the others."""
        if url.endswith('xlink.xsd'):
            return self.resolve_filename(str(SCHEMAS / 'xlink.xsd'), context)
        return None


@pytest.fixture(scope='module')
def schemas():
    if not SCHEMAS.is_dir():
        pytest.skip('needs the schemas of MTConnect beside the repository')
    parser = etree.XMLParser()
    parser.resolvers.add(Resolver())
    return {
        kind: etree.XMLSchema(etree.parse(str(SCHEMAS / f'MTConnect{kind}_2.4_1.0.xsd'), parser))
        for kind in ('Devices', 'Streams', 'Assets', 'Error')
    }


class Bench:
    """An agent of a machine whose observations a test makes."""

    def __init__(self, machine='xyzac', size=64):
        self.machine, self.now = Machine.load(machine), 1.7e9
        device = device_of(self.machine, 'host')
        self.store = Store(items_of(device), size, lambda: self.now)
        self.requests = Requests(Agent(device, self.store, 'host', 1_700_000_000), lambda: TOOLS)

    def get(self, target, status=200):
        told, document = self.requests.answer(target)
        assert told == status, document
        return etree.fromstring(document)


@pytest.fixture
def bench():
    return Bench()


def test_characters_that_xml_cannot_have_spoil_no_document(bench, schemas):
    """A request with %00, or a program with a control character, closed the connection."""
    for target in ('/%00', '/sample?path=//x%00', '/asset/%01'):
        status, document = bench.requests.answer(target)
        assert status in (400, 404) and schemas['Error'].validate(etree.fromstring(document))
    bench.store.observe({'block': 'G1 X1 \x1a\x00', 'program': '\x0b.ngc'})
    bench.store.condition('logic', FAULT, 'program_node: program', 'bad word \x02')
    assert schemas['Streams'].validate(bench.get('/current'))
    assert 'G1 X1 \ufffd\ufffd' in [one.text for one in bench.get('/current').iter()]


def named(root, name):
    return root.xpath(f'//*[local-name()="{name}"]')


def test_every_document_is_valid(schemas):
    for machine in ('xyzac', 'xyzbc', 'head_head', 'xyz', 'router'):
        bench = Bench(machine)
        assert schemas['Devices'].validate(bench.get('/probe')), schemas['Devices'].error_log
        bench.store.observe({'availability': 'AVAILABLE', 'execution': 'ACTIVE', 'tip': '1 2 3'})
        bench.store.observe({'tool_asset': '', 'asset_changed': 'a_tool_1'})
        bench.store.observe({'line': '12', 'X_actual': '1.5', 'block': 'G1 X<1> & "Y"'})
        bench.store.condition('system', FAULT, 'machine_node: drives', 'limit of X')
        bench.store.condition('system', WARNING, 'machine_node: jog', 'too fast')
        bench.store.condition('logic', NORMAL)
        for target in ('/current', '/sample', '/sample?count=3', '/current?path=//Axes'):
            assert schemas['Streams'].validate(bench.get(target)), schemas['Streams'].error_log
        assert schemas['Assets'].validate(bench.get('/assets')), schemas['Assets'].error_log
        for wrong, status in (
            ('/sample?from=999', 400),
            ('/sample?count=x', 400),
            ('/sample?count=0', 400),
            ('/current?path=//[', 400),
            ('/current?colour=red', 400),
            ('/asset/none', 404),
            ('/nobody/current', 404),
            ('/probe/more/words', 404),
        ):
            error = bench.get(wrong, status)
            assert schemas['Error'].validate(error), schemas['Error'].error_log


def test_the_kinematics_are_those_of_the_machine(bench):
    """The chain that a client follows leads to the place of each joint."""
    root = bench.get('/probe')
    motions = {one.get('id'): one for one in named(root, 'Motion')}
    joints = {one.name: one for one in joints_of(bench.machine) if one.axis >= 0}
    assert set(motions) == {f'axis_{name}_motion' for name in bench.machine.axis_names}
    for name, joint in joints.items():
        motion = motions[f'axis_{name}_motion']
        numbers = {
            one.tag.rpartition('}')[2]: np.array([*map(float, one.text.split())]) for one in motion
        }
        assert np.allclose(numbers['Origin'], np.array(joint.origin) / MM)
        assert np.allclose(numbers['Axis'], joint.along)
        carriers = [one for one in joints.values() if one.child == joint.parent]
        wanted = f'axis_{carriers[0].name}_motion' if carriers else None
        assert motion.get('parentIdRef') == wanted


def test_what_counts_is_what_was_observed_last(bench):
    store = bench.store
    store.observe({'execution': 'ACTIVE', 'line': '3'})
    store.observe({'execution': 'ACTIVE', 'line': '4'})
    current = bench.get('/current')
    assert [one.text for one in named(current, 'LineNumber')] == ['4']
    assert [one.text for one in named(current, 'Execution')] == ['ACTIVE']
    lines = [one.text for one in named(bench.get('/sample?path=//Path'), 'LineNumber')]
    assert lines == ['UNAVAILABLE', '3', '4']
    executions = [one.text for one in named(bench.get('/sample'), 'Execution')]
    assert executions == ['UNAVAILABLE', 'ACTIVE'], 'what has not changed is no news'


def test_a_sample_goes_on_where_the_one_before_ended(bench):
    for number in range(40):
        bench.store.observe({'line': str(number), 'feed': str(number)})
    found, begin = [], bench.store.first_sequence
    while True:
        root = bench.get(f'/sample?path=//Path&from={begin}&count=7')
        found += [one.text for one in named(root, 'LineNumber')]
        following = int(named(root, 'Header')[0].get('nextSequence'))
        if following == begin:
            break
        begin = following
    assert found == [str(number) for number in range(8, 40)], 'the last 64 are kept'
    assert bench.get('/sample?from=1', 400) is not None
    back = named(bench.get('/sample?count=-3'), 'LineNumber')
    assert [one.text for one in back] == ['39']


def test_what_counted_earlier_can_be_asked_for(bench):
    """Also where it was observed before the oldest observation that is kept."""
    bench.store.observe({'program': 'first.ngc'})
    for number in range(80):
        bench.store.observe({'line': str(number)})
    at = bench.store.next_sequence - 10
    root = bench.get(f'/current?at={at}')
    assert [one.text for one in named(root, 'LineNumber')] == ['70']
    assert [one.text for one in named(root, 'Program')] == ['first.ngc']


def test_conditions_count_until_they_are_gone(bench):
    def told():
        root = bench.get('/current?path=//DataItem[@type="SYSTEM"]')
        return [
            (one.tag.rpartition('}')[2], one.get('nativeCode'), one.text)
            for one in named(root, 'Condition')[0]
        ]

    store = bench.store
    assert told() == [('Unavailable', None, None)]
    store.condition('system', NORMAL)
    assert told() == [('Normal', None, None)]
    store.condition('system', FAULT, 'a', 'limit of X')
    store.condition('system', WARNING, 'b', 'too fast')
    store.condition('system', NORMAL)
    assert told() == [('Fault', 'a', 'limit of X'), ('Warning', 'b', 'too fast')]
    store.condition('system', NORMAL, 'a')
    assert told() == [('Warning', 'b', 'too fast')]
    store.condition('system', NORMAL, 'b')
    assert told() == [('Normal', None, None)]
    store.lose()
    assert told() == [('Unavailable', None, None)]


def test_tools_are_assets_with_their_sizes(bench):
    root = bench.get('/assets')
    lengths = [float(one.text) for one in named(root, 'FunctionalLength')]
    diameters = [float(one.text) for one in named(root, 'CuttingDiameterMax')]
    assert lengths[0] == 60.0 and diameters[0] == 10.0
    identity = named(root, 'CuttingTool')[0].get('assetId')
    one = bench.get(f'/asset/{identity}')
    assert [tool.get('toolId') for tool in named(one, 'CuttingTool')] == ['3']


def test_a_client_that_streams_gets_each_observation_once(bench, schemas):
    """Over a real connection, with a heartbeat while nothing happens."""
    with AgentServer('127.0.0.1', 0, bench.requests) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f'http://127.0.0.1:{server.server_port}'
        first = bench.store.next_sequence
        words = f'from={first}&interval=10&heartbeat=200&path=//Path'
        with urllib.request.urlopen(f'{address}/sample?{words}') as stream:
            boundary = stream.headers['Content-Type'].partition('boundary=')[2].encode()
            bench.store.observe({'line': '0'})
            found, silent = [], 0
            for number in range(1, 400):
                head = [stream.readline() for _ in range(4)]
                assert head[0].strip() == b'--' + boundary
                size = int(re.search(rb'length: (\d+)', b''.join(head))[1])
                root = etree.parse(io.BytesIO(stream.read(size))).getroot()
                stream.readline()
                assert schemas['Streams'].validate(root)
                lines = [one.text for one in named(root, 'LineNumber')]
                found += lines
                silent += not lines
                if len(found) < 20:
                    bench.store.observe({'line': str(number)})
                elif silent > 2:
                    break
        assert [int(line) for line in found] == sorted({int(line) for line in found})
        assert len(found) >= 20 and silent > 2
        for method, target in (('POST', '/current'), ('PUT', '/probe')):
            request = urllib.request.Request(address + target, data=b'x', method=method)
            with pytest.raises(urllib.error.HTTPError, match='501'):
                urllib.request.urlopen(request)
        for text in (b'GET\r\n\r\n', b'\0' * 1000, b'GET /probe HTTP/9.9\r\n\r\n'):
            with socket.create_connection(server.server_address, timeout=60.0) as raw:
                raw.sendall(text)
                raw.shutdown(socket.SHUT_WR)
                assert re.match(rb'HTTP/1.1 (400|505) ', raw.recv(64)), text
        server.shutdown()
