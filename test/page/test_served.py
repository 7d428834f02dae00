"""The page on other addresses than the usual one, and what it refuses over the wire."""

import http.client
import re
import subprocess
import sys
import urllib.request

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')
pytest.importorskip(
    'nicegui', reason='needs requirements/panel.txt; run the tests with ./cnc test'
)

from nodes_under_test import clean_environment
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect


@pytest.fixture(
    scope='module', params=[pytest.param('::1', marks=pytest.mark.thorough), '0.0.0.0']
)
def served(request, tmp_path_factory):
    """A page without nodes on an address; host and port where it can be reached, and its words."""
    tmp_path = tmp_path_factory.mktemp('served')
    (tmp_path / 'token').write_text('a secret & much more\n')
    page = subprocess.Popen(
        [sys.executable, '-m', 'cnc_interp', 'panel', '--attach', '--host', request.param]
        + ['--port', '0', '--token-file', tmp_path / 'token'],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=clean_environment(),
    )
    line = page.stdout.readline()
    if not line and 'cannot be used' in (said := page.stderr.read()):
        pytest.skip(said)
    yield page, re.search(r'http://(\S+):(\d+)/\?token=(\S+)', line)
    page.terminate()
    page.wait()


def status(place, path, **headers):
    connection = http.client.HTTPConnection(place[1].strip('[]'), int(place[2]))
    connection.putrequest('POST' if 'content_length' in headers else 'GET', path, skip_host=True)
    for name, value in ({'host': f'{place[1]}:{place[2]}'} | headers).items():
        connection.putheader(name.replace('_', '-'), value)
    connection.endheaders()
    found = connection.getresponse().status
    connection.close()
    return found


def test_it_is_served_under_its_address_and_not_to_who_guesses(served):
    page, place = served
    command = subprocess.run(
        ['ps', '-o', 'args=', '-p', str(page.pid)], capture_output=True, text=True
    ).stdout
    assert 'panel' in command and 'secret' not in command
    assert status(place, '/') == 200
    assert status(place, f'/?token={place[3]}') == 200
    assert status(place, '/', host='attacker.example') == 400
    assert status(place, '/', content_length=str(1 << 30)) == 413
    assert status(place, '/', origin=f'http://{place[1]}:{place[2]}') == 200
    assert status(place, '/', origin='http://attacker.example') == 403
    for k in range(20):  # whoever guesses shuts nobody out
        assert status(place, f'/?token=guess{k}') == 200
    assert status(place, f'/?token={place[3]}') == status(place, '/') == 200


def socket_of(place):
    return f'ws://{place[1]}:{place[2]}/_nicegui_ws/socket.io/?EIO=4&transport=websocket'


def test_no_page_of_another_server_opens_the_websocket_or_frames_the_page(served):
    _, place = served
    with pytest.raises(InvalidStatus), connect(socket_of(place), origin='http://attacker.example'):
        pass
    own = f'http://{place[1]}:{place[2]}'
    with connect(socket_of(place), origin=own) as page:
        assert page.recv().startswith('0')
    with urllib.request.urlopen(f'{own}/') as answer:
        assert answer.headers['x-frame-options'] == 'DENY'
        assert "frame-ancestors 'none'" in answer.headers['content-security-policy']


#: Socket.IO messages that no page sends.
NONSENSE = [
    f'42["{name}",{value}]'
    for name in ('event', 'javascript_response', 'handshake', 'ack', 'log_message')
    for value in ('null', '5', '[]', '{"id":1}')
]


def test_nonsense_is_told_once_and_hurts_nobody(served):
    page, place = served
    with connect(socket_of(place)) as stranger:
        stranger.recv()
        for message in ('40', *(50 * NONSENSE)):
            stranger.send(message)
    assert status(place, '/') == 200
    page.terminate()
    said = page.communicate()[1]
    assert (
        0 < said.count('an invalid message to the page is ignored') < len(NONSENSE)
        and 'Traceback' not in said
    )
