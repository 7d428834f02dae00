"""Contact with a page: who may command. No stop is lost, and no late command is executed.

The page resends a stop until it is answered (``contact.js``). All other commands are executed only
for a page that has heard the server recently: the page answers each beat, and its messages arrive
in order. After an interruption the server does not know new texts of fields, so a key that needs
fields sends their texts.
"""

import asyncio
import hmac
import json
import secrets
import time
from collections import Counter, deque
from collections.abc import Awaitable, Callable, Iterable
from concurrent.futures import Future
from functools import partial
from ipaddress import ip_address
from typing import Any
from urllib.parse import urlsplit

from nicegui import events, ui
from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse

from cnc_interp.client.operator_client import STOPS, Answer

#: The action of a key, and the function that executes it if the page may command.
Act = Callable[[], Awaitable[Answer]]
Command = Callable[[Act], Awaitable[None]]

#: Message if a key had no effect because the connection was interrupted.
INTERRUPTED = 'the connection was interrupted'
AGAIN = f'{INTERRUPTED}: look at the machine, then press again'
VIEW_ONLY = 'view only: press "take over" first'  #: Message of a page that may not command.
#: Message of a page that was opened with a wrong token.
WRONG_TOKEN = (
    'the token in the address is not that of this server, which may have been started again: '
    'open the address that it printed at start'
)
NO_TOKEN = 'to command, open the page with the address that was printed at start'
#: Time between beats, and largest age of the last answered beat of a page that is up to date [s].
BEAT, LATE = 0.5, 5.0
#: If the last answer of a page is older, the page gets no updates until it has caught up [s].
LAGS = 1.5
REMEMBERED = round(2 * LATE / BEAT)  #: Number of beats whose answers are accepted.


class Contact:
    def __init__(self, on_stop: Callable[[str], Awaitable[None]]):
        self._on_stop = on_stop
        self._heard = time.monotonic()
        self._seen = True
        self._sent: deque[float] = deque(maxlen=REMEMBERED)
        self._done: dict[str, bool] = {}
        ui.on('heard', self._hear)
        ui.on('stop', self._stop)
        ui.timer(BEAT, self._beat)

    @property
    def age(self) -> float:
        return time.monotonic() - self._heard

    @property
    def is_followed(self) -> bool:
        return self._seen and self.age <= LAGS

    def _beat(self) -> None:
        self._sent.append(time.monotonic())
        ui.run_javascript(f'contact.hear({self._sent[-1]!r}, {self.age!r})')

    def _hear(self, event: events.GenericEventArguments) -> None:
        beat, seen = event.args
        if beat in self._sent:
            self._heard, self._seen = max(self._heard, beat), bool(seen)

    async def _stop(self, event: events.GenericEventArguments) -> None:
        """Execute a stop at its first request; answer all its requests once it is done."""
        name, number = event.args['name'], str(event.args['number'])
        if name not in STOPS:
            return
        if number not in self._done:
            self._done[number] = False
            await self._on_stop(name)
            self._done[number] = True
        if self._done[number]:
            ui.run_javascript(f'contact.answered({json.dumps(number)})')


def asked(ask: Callable[..., Future[Answer]], *words: Any, **named: Any) -> Act:
    async def answered() -> Answer:
        return await asyncio.wrap_future(ask(*words, **named))

    return answered


def key(
    text: str,
    mark: str = '',
    act: Any = None,
    colour: str = 'blue-grey-8',
    look: str = 'dense unelevated',
) -> Any:
    button = ui.button(text, on_click=act, color=colour)
    return button.props(f'{look} no-caps data-mark="{mark or text}"')


def pressing(name: str) -> dict[str, Any]:
    return {'type': 'click', 'js_handler': f'() => contact.stop({json.dumps(name)})'}


def act_on_shown(
    element: Any, kind: str, fields: Iterable[Any], act: Callable[[], Awaitable[None]]
) -> None:
    """On an event, set the fields to the texts shown on the page, then call ``act``."""

    async def acted(event: events.GenericEventArguments) -> None:
        shown = event.args if isinstance(event.args, dict) else {}
        for field in fields:
            text = shown.get(field.props['data-mark'])
            if isinstance(field, ui.input) and isinstance(text, str):
                field.set_value(text)
        await act()

    element.on(kind, acted, js_handler='() => emit(shown())')


#: Headers that forbid browsers to show the page in a frame of another page.
UNFRAMED = (
    (b'x-frame-options', b'DENY'),
    (b'content-security-policy', b"frame-ancestors 'none'"),
)
FORM = 1 << 16  #: Allowance for the data that a form adds to an uploaded file [bytes].


class Gate:
    """Admits only requests that name this computer and whose bodies are short enough.

    A page of another origin can neither send requests or open websockets, nor frame this page.
    """

    def __init__(self, app: Any, host: str, longest: int):
        self._app, self._host, self._longest = app, host, longest + FORM

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope['type'] in ('http', 'websocket'):
            refusal = self._refusal(Headers(scope=scope))
            if refusal is not None:
                await refusal(scope, receive, send)
                return
        await self._app(scope, receive, partial(send_unframed, send))

    def _refusal(self, headers: Headers) -> PlainTextResponse | None:
        if not names_this_host(headers.get('host', ''), self._host):
            return PlainTextResponse('this page is not served under that name', 400)
        origin = headers.get('origin')
        if origin is not None and urlsplit(origin).netloc.lower() != headers['host'].lower():
            return PlainTextResponse('a page of another server may not use this one', 403)
        if 'transfer-encoding' in headers:
            return PlainTextResponse('a request needs a Content-Length header', 411)
        length = headers.get('content-length', '0')
        if not length.isdigit() or int(length) > self._longest:
            return PlainTextResponse('the file is too long', 413)
        return None


async def send_unframed(send: Any, message: Any) -> None:
    if message['type'] == 'http.response.start':
        message = {**message, 'headers': [*message['headers'], *UNFRAMED]}
    await send(message)


def names_this_host(header: str, host: str) -> bool:
    """Return whether the Host header is an address, ``localhost`` or the name of the server.

    Another name may be pointed at this computer by an attacker, whose page would then have the
    same origin.
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
    """The token, and the page in charge; a browser tab stays in charge when it is refreshed.

    Any page with the token may take over control, and may always stop the machine.
    """

    def __init__(self, token: str = ''):
        self.token = token or secrets.token_urlsafe(16)
        self._holder = ''
        self._pages: Counter[str] = Counter()

    def knows(self, token: str) -> bool:
        return hmac.compare_digest(token.encode(), self.token.encode())

    def enter(self, tab: str, trusted: bool) -> None:
        """Admit a page; with the token it takes charge, unless another page is in charge."""
        self._pages[tab] += 1
        if trusted and not self._holder:
            self._holder = tab

    def leave(self, tab: str) -> None:
        """Remove a page; a refreshed tab opens its new page before the old one closes."""
        self._pages[tab] -= 1
        if self._pages[tab] <= 0:
            del self._pages[tab]
            if self._holder == tab:
                self._holder = ''

    def take_over(self, tab: str) -> None:
        self._holder = tab

    def is_in_charge(self, tab: str) -> bool:
        return tab == self._holder
