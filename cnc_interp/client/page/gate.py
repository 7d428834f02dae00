"""What the page's server refuses before anything of a request is read."""

from __future__ import annotations

from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse

#: Room for what a form adds to a file [bytes].
FORM = 1 << 16


class Gate:
    """Lets requests through that name this computer and whose bodies are short enough."""

    def __init__(self, app: Any, host: str, longest: int):
        self._app, self._host, self._longest = app, host, longest + FORM

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """Serve one connection."""
        if scope['type'] in ('http', 'websocket'):
            refusal = self._refusal(Headers(scope=scope))
            if refusal is not None:
                await refusal(scope, receive, send)
                return
        await self._app(scope, receive, send)

    def _refusal(self, headers: Headers) -> PlainTextResponse | None:
        """Return what a refused request is told."""
        if not names_this_host(headers.get('host', ''), self._host):
            return PlainTextResponse('this page is not served under that name', 400)
        if 'transfer-encoding' in headers:
            return PlainTextResponse('a request must tell its length', 411)
        length = headers.get('content-length', '0')
        if not length.isdigit() or int(length) > self._longest:
            return PlainTextResponse('the file is too long', 413)
        return None


def names_this_host(header: str, host: str) -> bool:
    """
    Tell whether the Host header is an address, ``localhost`` or the name of the server.

    Another name may have been pointed to this computer by an attacker, whose page would then be of
    the same origin as this one. An address cannot.
    """
    try:
        name = urlsplit(f'//{header}').hostname or ''
        if name in ('localhost', host.lower()):
            return True
        ip_address(name)
    except ValueError:
        return False
    return True
