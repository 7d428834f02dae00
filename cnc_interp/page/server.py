"""Serve the page on loopback until Ctrl-C; its end does not affect the machine."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import sys
import time
import traceback
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from fastapi import Response
from fastapi.responses import FileResponse
from nicegui import app, ui

from cnc_interp.core import InterpError
from cnc_interp.page.contact import AGAIN, WRONG_TOKEN, Access, Gate
from cnc_interp.page.desk import Desk
from cnc_interp.page.dialogs import MARKS
from cnc_interp.page.hand_motion import ARROWS, EARLY, FILLS, LOST, STALE
from cnc_interp.page.operator_page import Page
from cnc_interp.page.origin import PARENT, Revive
from cnc_interp.page.program_folder import LONGEST_PROGRAM, program_text
from cnc_interp.processes.stop_signals import stops_later

PACKAGE = Path(__file__).resolve().parents[1]  #: Folder of this package.
#: The scripts in loading order, each with the values for its names in capitals.
SCRIPTS: Mapping[str, Mapping[str, Any]] = {
    'contact': {},
    'listing': {},
    'editor': {},
    'shortcuts': {'MARKS': MARKS},
    'hand_motion': {
        'ARROWS': ARROWS,
        'STALE': 1e3 * STALE,
        'FILLED': 1e3 * FILLS,
        'AGAIN': AGAIN,
        'LOST': LOST,
        'EARLY': EARLY,
    },
    'scene': {},
    'preferences': {},
}


def scripts() -> str:
    found = []
    for name, values in SCRIPTS.items():
        text = Path(__file__).with_name(f'{name}.js').read_text(encoding='utf-8')
        for word, value in values.items():
            text = text.replace(word, json.dumps(value))
        found.append(f'<script>{text}</script>')
    return ''.join(found)


STYLE = Path(__file__).with_name('style.css')
WATCH = 0.5  #: Time between checks of the programs when no new state arrives [s].
LOOK = 1.0  #: Time between checks for nodes that have ended [s].
#: Time within which a page can reconnect after an interruption [s].
RECONNECT = 20.0
PORTS = range(65536)


@dataclass(frozen=True)
class Served:
    host: str = '127.0.0.1'
    port: int = 8650
    token: str = ''  #: Required for commands; if empty, a random token is made.
    #: Program that is loaded at the start.
    name: str = ''
    text: str | None = None
    folder: Path = Path()  #: Folder whose programs pages list, open and save.

    @staticmethod
    def prepare(
        host: str, port: int, token: str, program: Path | None, folder: Path | None = None
    ) -> Served:
        text = program_text(program, str(program)) if program is not None else None
        folder = folder or (program.parent if program else Path())
        if not folder.is_dir():
            raise InterpError(f'{folder}: no such folder')
        name = program.name if program else ''
        return Served(host, free_port(host, port), token, name, text, folder)


def serve(served: Served, namespace: str, domain: int, revive: Revive) -> None:
    """Serve until a signal, or until ``revive``, which restarts nodes, raises InterpError."""
    access = Access(served.token)
    with ExitStack() as closing:
        with stops_later():  # an interrupt here would leave a desk that cannot be closed
            desk = Desk(namespace, domain, served.folder)
            closing.callback(desk.close)
        _serve(served, access, desk, revive)


def _serve(served: Served, access: Access, desk: Desk, revive: Revive) -> None:
    text = served.text
    lost: InterpError | None = None
    looked = -LOOK

    async def watch() -> None:
        nonlocal text, lost, looked
        if int(os.environ.get(PARENT, '0')) not in (0, os.getppid()):
            app.shutdown()  # the run that started the page is gone
        if (now := time.monotonic()) - looked >= LOOK:
            looked = now
            try:
                for name, why in (await asyncio.to_thread(revive)).items():
                    print(f'{name} {why}; it is started again', file=sys.stderr)
            except InterpError as problem:  # a node that ended by itself cannot work here
                lost = problem
                app.shutdown()
        desk.watch()
        if text is not None and desk.machine is not None:
            await desk.load(served.name, text)
            text = None

    @ui.page('/')
    async def page(token: str = '') -> None:
        trusted = access.knows(token)
        ui.add_css(STYLE)
        ui.add_head_html(scripts())
        ui.dark_mode(True)
        await ui.context.client.connected()
        await shown_when_known(desk)
        client, tab = ui.context.client, ui.context.client.tab_id or ''
        client.on_delete(lambda: access.leave(tab))
        Page(desk, access, tab, trusted, WRONG_TOKEN if token and not trusted else '')

    @app.get('/path/{number}')
    def path(number: int) -> Response:
        if number != desk.tube_number:
            return Response(status_code=404)
        return Response(desk.tube, media_type='application/octet-stream')

    @app.get('/body/{number}.stl')
    def body(number: int) -> Response:
        if number >= len(desk.bodies):
            return Response(status_code=404)
        return Response(desk.bodies[number].stl(), media_type='model/stl')

    @app.get('/stock/{number}/{stage}.stl')
    def stock(number: int, stage: int) -> Response:
        plan = desk.job.plan if desk.job is not None else None
        if plan is None or number != desk.tube_number or not 0 <= stage < len(plan.stages):
            return Response(status_code=404)
        return Response(plan.stages[stage], media_type='model/stl')

    @app.get('/program/{number}.txt')
    def program(number: int) -> Response:
        job = desk.job
        if job is None or number != job.number:
            return Response(status_code=404)
        return Response('\n'.join(job.lines), media_type='text/plain; charset=utf-8')

    @app.get('/runs.csv')
    def runs() -> Response:
        file = desk.nodes.history.file
        if not file.is_file():
            return Response(status_code=404)
        return FileResponse(file, media_type='text/csv; charset=utf-8', filename=file.name)

    app.add_middleware(Gate, host=served.host, longest=LONGEST_PROGRAM)
    app.timer(WATCH, watch)
    app.on_startup(lambda: setattr(desk, 'loop', asyncio.get_running_loop()))
    app.on_shutdown(lambda: setattr(desk, 'loop', None))
    app.on_shutdown(desk.end_planning)
    app.on_startup(lambda: asyncio.get_running_loop().set_exception_handler(FaultsOnce()))
    app.on_startup(lambda: announce(served.host, served.port, access.token))
    ui.run(
        host=served.host,
        port=served.port,
        title='cnc_interp',
        dark=True,
        reload=False,
        show=False,
        show_welcome_message=False,
        reconnect_timeout=RECONNECT,
        binding_refresh_interval=None,
        tailwind=False,
        uvicorn_logging_level='critical',
    )
    if lost is not None:
        raise lost


class FaultsOnce:
    """Reports a server fault once per place in the code, so that floods cannot fill the disk."""

    def __init__(self) -> None:
        self._told: set[str] = set()

    def __call__(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        fault = context.get('exception')
        steps = traceback.extract_tb(fault.__traceback__) if fault is not None else []
        place = f'{steps[-1].filename}:{steps[-1].lineno}' if steps else str(context['message'])
        if place in self._told:
            return
        self._told.add(place)
        if any(step.filename.startswith(str(PACKAGE)) for step in steps):
            loop.default_exception_handler(context)
        else:
            print(f'an invalid message to the page is ignored ({fault!r})', file=sys.stderr)


async def shown_when_known(desk: Desk) -> None:
    if desk.machine is None:
        waiting = ui.label('waiting for the nodes; the first start compiles for some minutes')
        waiting.classes('q-pa-lg')
        while desk.machine is None:
            await asyncio.sleep(WATCH)
        waiting.delete()


async def announce(host: str, port: int, token: str) -> None:
    connection = None
    while connection is None:
        try:
            _, connection = await asyncio.open_connection(host, port)
        except OSError:
            await asyncio.sleep(WATCH)
    connection.close()
    shown = f'[{host}]' if ':' in host else host
    print(f'operator page  http://{shown}:{port}/?token={quote(token, safe="")}', flush=True)
    print(f'view only      http://{shown}:{port}/', flush=True)


def free_port(host: str, port: int) -> int:
    """Return the port, or a free port if it is 0; reject a port that is in use."""
    if port not in PORTS:
        raise InterpError(f'--port {port}: ports are {PORTS.start} to {PORTS.stop - 1}')
    if not host:
        raise InterpError('--host: give an address; 0.0.0.0 means every address of this computer')
    family = socket.AF_INET6 if ':' in host else socket.AF_INET
    with socket.socket(family) as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            trial.bind((host, port))
        except OSError as problem:
            reason = f'{host}:{port} cannot be used: {problem.strerror}; choose another --port'
            raise InterpError(reason) from None
        found: int = trial.getsockname()[1]
        return found
