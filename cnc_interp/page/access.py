"""Who is served and who may command: requests that name this host, pages that know the token."""

from __future__ import annotations

import hmac
import secrets
from collections import Counter
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse

FORM = 1 << 16  #: Room for what a form adds to a file [bytes].


class Gate:
    """Lets requests through that name this computer and whose bodies are short enough."""

    def __init__(self, app: Any, host: str, longest: int):
        self._app, self._host, self._longest = app, host, longest + FORM

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope['type'] in ('http', 'websocket'):
            refusal = self._refusal(Headers(scope=scope))
            if refusal is not None:
                await refusal(scope, receive, send)
                return
        await self._app(scope, receive, send)

    def _refusal(self, headers: Headers) -> PlainTextResponse | None:
        if not names_this_host(headers.get('host', ''), self._host):
            return PlainTextResponse('this page is not served under that name', 400)
        if 'transfer-encoding' in headers:
            return PlainTextResponse('a request must tell its length', 411)
        length = headers.get('content-length', '0')
        if not length.isdigit() or int(length) > self._longest:
            return PlainTextResponse('the file is too long', 413)
        return None


def names_this_host(header: str, host: str) -> bool:
    """Tell whether the Host header is an address, ``localhost`` or the name of the server.

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


class Access:
    """The token, and which page is in charge.

    Pages are told apart by their browser tab, so a refreshed page stays in charge; when the tab is
    closed they are free. Any page with the token may take them over, and may always stop the
    machine.
    """

    def __init__(self, token: str = ''):
        self.token = token or secrets.token_urlsafe(16)
        self._holder = ''
        self._pages: Counter[str] = Counter()

    def knows(self, token: str) -> bool:
        return hmac.compare_digest(token.encode(), self.token.encode())

    def enter(self, tab: str, trusted: bool) -> None:
        """Let a page in; one that knows the token takes charge if no other page is."""
        self._pages[tab] += 1
        if trusted and not self._holder:
            self._holder = tab

    def leave(self, tab: str) -> None:
        """Let a page go; a tab that is refreshed has its new page before the old one goes."""
        self._pages[tab] -= 1
        if self._pages[tab] <= 0:
            del self._pages[tab]
            if self._holder == tab:
                self._holder = ''

    def take_over(self, tab: str) -> None:
        self._holder = tab

    def is_in_charge(self, tab: str) -> bool:
        return tab == self._holder
