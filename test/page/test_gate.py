"""What the page's server refuses, before it reads anything: names, long and endless bodies."""

import asyncio

import pytest

pytest.importorskip('nicegui', reason='needs requirements/panel.txt; run it with ./cnc test')

from cnc_interp.core import InterpError
from cnc_interp.page.command import is_loopback
from cnc_interp.page.contact import FORM, Gate, names_this_host
from cnc_interp.page.server import free_port

LONGEST = 1000


def answered(**headers):
    """Status of a request, and whether anything of it was read."""
    read, sent = [], []

    async def page(scope, receive, send):
        read.append(await receive())
        await send({'type': 'http.response.start', 'status': 200, 'headers': []})

    async def receive():
        return {'type': 'http.request', 'body': b'', 'more_body': False}

    async def send(message):
        sent.append(message)

    fields = {'host': '127.0.0.1:8650'} | {k.replace('_', '-'): v for k, v in headers.items()}
    scope = {
        'type': 'http',
        'method': 'POST',
        'path': '/',
        'headers': [(name.encode(), value.encode()) for name, value in fields.items()],
    }
    asyncio.run(Gate(page, '127.0.0.1', LONGEST)(scope, receive, send))
    return sent[0]['status'], bool(read)


@pytest.mark.parametrize(
    ('headers', 'status'),
    [
        ({}, 200),
        ({'content_length': str(LONGEST + FORM)}, 200),
        ({'content_length': str(LONGEST + FORM + 1)}, 413),
        ({'content_length': '-1'}, 413),
        ({'content_length': '1e9'}, 413),
        ({'transfer_encoding': 'chunked'}, 411),  # it would end when the disk is full
        ({'host': 'attacker.example'}, 400),
        ({'origin': 'http://127.0.0.1:8650'}, 200),
        ({'origin': 'http://127.0.0.1:8651'}, 403),
        ({'origin': 'http://attacker.example'}, 403),
        ({'origin': 'null'}, 403),
    ],
)
def test_a_refused_request_is_not_read(headers, status):
    assert answered(**headers) == (status, status == 200)


@pytest.mark.parametrize('header', ['127.0.0.1', '[::1]:8650', 'localhost:1', 'mill:8650', 'MILL'])
def test_addresses_and_the_name_of_the_server_are_served(header):
    assert names_this_host(header, 'Mill')


@pytest.mark.parametrize(
    'header', ['', 'attacker.example', 'mill.attacker.example', '[::1', '[x]']
)
def test_names_that_an_attacker_could_point_here_are_not_served(header):
    assert not names_this_host(header, 'mill')


def test_who_sees_the_page_is_known():
    assert all(map(is_loopback, ('127.0.0.1', '::1', 'localhost', '127.1.2.3')))
    assert not any(map(is_loopback, ('0.0.0.0', '::', '192.168.1.5', 'mill')))


@pytest.mark.parametrize('host', ['203.0.113.7', '2001:db8::1', 'x y'])
def test_an_address_of_another_computer_is_refused(host):
    with pytest.raises(InterpError, match='cannot be used'):
        free_port(host, 0)
