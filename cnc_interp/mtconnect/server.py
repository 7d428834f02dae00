"""Answer MTConnect requests over HTTP: probe, current, sample and assets, all by GET."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import BoundedSemaphore
from typing import Any
from urllib.parse import parse_qsl, unquote, urlsplit

from cnc_interp.core import InterpError
from cnc_interp.mtconnect.documents import Agent, asset_id
from cnc_interp.mtconnect.store import RequestError
from cnc_interp.program.job import Tool

COUNT, MOST = 100, 1 << 17  #: Observations in a sample: default, and limit.
HEARTBEAT = 10_000  #: Longest silence of a stream by default [ms].
SLOWEST = 3_600_000  #: Largest interval or heartbeat in a request [ms].
FASTEST = 10  #: Shortest time between two parts of a stream [ms].
BOUNDARY = 'cnc_interp_part'
MOST_CLIENTS = 64  #: Largest number of clients at the same time.
PATIENCE = 30.0  #: Timeout for a client that neither sends nor receives [s].

#: Request -> parameters that it may have.
KNOWN = {
    'probe': (),
    'current': ('path', 'at', 'interval', 'heartbeat'),
    'sample': ('path', 'from', 'count', 'interval', 'heartbeat'),
    'assets': ('type', 'count', 'removed'),
    'asset': (),
}


class Requests:
    """Answers requests; ``tools``: function that returns the current tools by number."""

    def __init__(self, agent: Agent, tools: Callable[[], dict[int, Tool]]):
        self._agent, self._tools = agent, tools

    def answer(self, target: str) -> tuple[int, bytes | Iterator[bytes]]:
        """Return the HTTP status, and a document or the parts of a stream."""
        try:
            return 200, self._found(target)
        except RequestError as problem:
            absent = problem.code in ('NO_DEVICE', 'ASSET_NOT_FOUND', 'INVALID_URI')
            return 404 if absent else 400, self._agent.error(problem)

    def _found(self, target: str) -> bytes | Iterator[bytes]:
        parts = urlsplit(target)
        words = [unquote(word) for word in parts.path.split('/') if word]
        agent, device = self._agent, self._agent.device
        if words and words[0] not in KNOWN:
            if words[0] not in (device.name, device.uuid):
                raise RequestError('NO_DEVICE', f'{words[0]}: the device here is {device.name}')
            words = words[1:]
        kind = words[0] if words else 'probe'
        if kind not in KNOWN or len(words) > (2 if kind in ('asset', 'assets') else 1):
            wanted = ', '.join(KNOWN)
            raise RequestError('INVALID_URI', f'{parts.path}: no such request; there are {wanted}')
        try:
            given = dict(parse_qsl(parts.query, keep_blank_values=True, max_num_fields=20))
        except ValueError:
            raise RequestError('INVALID_REQUEST', 'too many parameters') from None
        if unknown := sorted(set(given) - set(KNOWN[kind])):
            raise RequestError('INVALID_REQUEST', f'{unknown[0]}: no parameter of {kind}')
        if kind == 'probe':
            return agent.devices(len(self._tools()))
        if kind in ('asset', 'assets'):
            return self._assets(words[1:], given)
        return self._streams(kind, given)

    def _assets(self, ids: list[str], given: dict[str, str]) -> bytes:
        known = self._tools()
        if ids:
            wanted = ids[0].split(';')
            named = {asset_id(self._agent.device.name, number): number for number in known}
            if missing := [one for one in wanted if one not in named]:
                raise RequestError('ASSET_NOT_FOUND', f'{missing[0]}: no such asset')
            return self._agent.assets({named[one]: known[named[one]] for one in wanted})
        if given.get('type', 'CuttingTool') != 'CuttingTool':
            known = {}
        most = _number(given, 'count', len(known) or 1, 1, MOST)
        return self._agent.assets(dict(list(known.items())[:most]))

    def _streams(self, kind: str, given: dict[str, str]) -> bytes | Iterator[bytes]:
        agent, store = self._agent, self._agent.store
        items = agent.chosen(given.get('path', ''))
        streams = 'interval' in given
        interval = max(FASTEST, _number(given, 'interval', 0, 0, SLOWEST)) / 1e3
        heartbeat = _number(given, 'heartbeat', HEARTBEAT, 1, SLOWEST) / 1e3
        if kind == 'current':
            if 'at' in given and streams:
                raise RequestError('INVALID_REQUEST', 'at and interval exclude each other')
            at = _number(given, 'at', 0, 0, 1 << 63) if 'at' in given else None

            def now() -> bytes:
                return agent.streams(store.current(items, at), store.next_sequence)

            first = now()
            return _repeated(first, now, interval) if streams else first
        begin = _number(given, 'from', 0, 0, 1 << 63) if 'from' in given else None
        count = _number(given, 'count', COUNT, -MOST, MOST)
        if not count or (count < 0 and streams):
            raise RequestError('INVALID_REQUEST', f'count is {count}; a stream needs 1 or more')
        found, following = store.sample(items, begin, count)
        document = agent.streams(found, following)
        if not streams:
            return document

        def parts() -> Iterator[bytes]:
            after = following
            yield document
            while True:
                time.sleep(interval)
                until, news = time.monotonic() + heartbeat - interval, found[:0]
                while not news:
                    left = until - time.monotonic()
                    store.wait(after, max(0.0, left))
                    news, after = store.sample(items, after, count)
                    if left <= 0.0:
                        break
                yield agent.streams(news, after)

        return parts()


def _repeated(first: bytes, now: Callable[[], bytes], interval: float) -> Iterator[bytes]:
    yield first
    while True:
        time.sleep(interval)
        yield now()


def _number(given: dict[str, str], name: str, otherwise: int, least: int, most: int) -> int:
    if name not in given:
        return otherwise
    try:
        value = int(given[name])
    except ValueError:
        value = most + 1
    if not least <= value <= most:
        raise RequestError(
            'INVALID_REQUEST', f'{name} is {given[name]!r}; a whole number from {least} to {most}'
        )
    return value


class AgentServer(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, host: str, port: int, requests: Requests):
        self.requests, self._free = requests, BoundedSemaphore(MOST_CLIENTS)
        try:
            super().__init__((host, port), Handler)
        except OSError as problem:
            text = f'{host}:{port} cannot be served: {problem.strerror}; choose another --port'
            raise InterpError(text) from None

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a separate thread; reject the request if there are too many clients."""
        if self._free.acquire(blocking=False):
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer a request, then allow another client."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, *_: Any) -> None:
        """Ignore errors, which mean that a client has disconnected."""


class Handler(BaseHTTPRequestHandler):
    server: AgentServer
    server_version, sys_version = 'cnc_interp', ''
    protocol_version, timeout = 'HTTP/1.1', PATIENCE
    default_request_version = 'HTTP/1.0'  # else invalid requests get an answer without a status
    disable_nagle_algorithm = True  # or each answer waits for an acknowledgement

    def log_message(self, *_: Any) -> None:
        """Log nothing, because clients may send many requests per second."""

    def do_GET(self) -> None:
        status, found = self.server.requests.answer(self.path)
        self.send_response(status)
        if isinstance(found, bytes):
            self._head('text/xml; charset=utf-8', len(found))
            self.wfile.write(found)
            return
        self.close_connection = True
        self.send_header('Cache-Control', 'no-store')
        self.send_header('Connection', 'close')
        self.send_header('Content-Type', f'multipart/x-mixed-replace;boundary={BOUNDARY}')
        self.end_headers()
        with contextlib.suppress(OSError, RequestError):  # the client has left, or is too slow
            for part in found:
                head = '--{}\r\nContent-type: text/xml\r\nContent-length: {}\r\n\r\n'
                told = head.format(BOUNDARY, len(part)).encode()
                self.wfile.write(told + part + b'\r\n')
                self.wfile.flush()

    def _head(self, kind: str, size: int) -> None:
        self.send_header('Content-Type', kind)
        self.send_header('Content-Length', str(size))
        self.end_headers()
