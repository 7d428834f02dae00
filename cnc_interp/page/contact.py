"""Contact with a page: no stop is lost on the way, and nothing else is done late.

What is sent into a connection that breaks is gone; what waits for the next one comes late. So a
stop is sent by the page until it is answered (``contact.js``), and everything else is done only
for a page that has lately heard the server: it answers each beat, and its words come in order.
A browser too slow for all that is sent gets less of it, for what waits in between is old, and a
tab that nobody sees gets nothing but the beat.

The server has a copy of the text in each field, which is old after such a break. So a key that
reads fields sends the texts in them when pressed (``act_on_shown``).
"""

from __future__ import annotations

import asyncio
import json
import time
from collections import deque
from collections.abc import Awaitable, Callable, Iterable
from concurrent.futures import Future
from typing import Any

from nicegui import events, ui

from cnc_interp.client.operator_client import STOPS, Answer

#: What a key does, and how a page has it done: allowed or refused on the server.
Act = Callable[[], Awaitable[Answer]]
Command = Callable[[Act], Awaitable[None]]

#: What the page says when it heard nothing for a while, and a key did nothing.
INTERRUPTED = 'the connection was interrupted'
AGAIN = f'{INTERRUPTED}: look at the machine, then press again'
VIEW_ONLY = 'view only: press "take over" first'  #: What a page says that does not command.
#: Time between beats, and age of the last one answered up to which a page sees what happens [s].
BEAT, LATE = 0.5, 5.0
#: A page whose last answer is older lags: it is shown nothing until it has caught up [s].
LAGS = 1.5
REMEMBERED = round(2 * LATE / BEAT)  #: Answers to older beats do not count any more.


class Contact:
    """The server's side of the connection to one page."""

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
        """Age of what the page shows, as far as it has told [s]."""
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
        """Do it the first time; answer as often as it is asked for once it is done."""
        name, number = event.args['name'], str(event.args['number'])
        if name not in STOPS:
            return
        if number not in self._done:
            self._done[number] = False
            await self._on_stop(name)
            self._done[number] = True
        if self._done[number]:
            ui.run_javascript(f'contact.answered({json.dumps(number)})')


def asked(ask: Callable[..., Future[Answer]], *words: Any) -> Act:
    """Return what asks the nodes for something and waits for their answer."""

    async def answered() -> Answer:
        return await asyncio.wrap_future(ask(*words))

    return answered


def key(text: str, mark: str = '', act: Any = None, colour: str = 'blue-grey-8') -> Any:
    button = ui.button(text, on_click=act, color=colour)
    return button.props(f'dense unelevated no-caps data-mark="{mark or text}"')


def pressing(name: str) -> dict[str, Any]:
    """Return what makes a key send one of ``STOPS``, as keywords of its listener."""
    return {'type': 'click', 'js_handler': f'() => contact.stop({json.dumps(name)})'}


def act_on_shown(
    element: Any, kind: str, fields: Iterable[Any], act: Callable[[], Awaitable[None]]
) -> None:
    """Have an element act on an event, after its fields have got the texts that the page shows."""

    async def acted(event: events.GenericEventArguments) -> None:
        shown = event.args if isinstance(event.args, dict) else {}
        for field in fields:
            text = shown.get(field.props['data-mark'])
            if isinstance(field, ui.input) and isinstance(text, str):
                field.set_value(text)
        await act()

    element.on(kind, acted, js_handler='() => emit(shown())')
