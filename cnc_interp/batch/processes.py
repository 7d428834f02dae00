"""Run calls in separate processes, forked from one server; a crash ends only its own call."""

import contextlib
import multiprocessing
import os
import resource
import signal
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerProcess
from typing import Generic, TypeVar

from cnc_interp.core import InterpError
from cnc_interp.processes.fork_server import SERVER_LOST, begin_child, begin_loading

#: Modules that the fork server imports for the planning of programs, and for tiles of needles.
PRELOADED = ('cnc_interp.batch.preload_tasks',)
TILES_PRELOADED = ('cnc_interp.cam.preload_tiles',)
PROCESS_NAME = 'cnc_batch'  #: Name of a working process in ``ps`` and ``top``.
LOOK = 0.2  #: Time between checks whether all processes shall end [s].
#: A call is abandoned after its process has been killed this number of times.
MOST_KILLS = 200
#: A process that ends by one of these signals was killed by another program; it did not crash.
FROM_OUTSIDE = (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT)

A = TypeVar('A')
R = TypeVar('R')


class Loss(Enum):
    CRASHED = auto()
    KILLED = auto()
    TOO_LONG = auto()


@dataclass(frozen=True)
class EndedCall(Generic[R]):
    number: int  #: Number of the call, from 0.
    result: R | Loss  #: Return value, or the kind of loss.
    kills: int = 0  #: How often the call was killed and restarted.
    why: str = ''  #: How its process ended, if there is no result.


@dataclass(frozen=True)
class _Attempt(Generic[A]):
    """A waiting call: the function that makes its argument, and its remaining time [s]."""

    number: int
    make: Callable[[], A]
    left: float
    kills: int = 0


@dataclass(frozen=True)
class _Running(Generic[A]):
    """A running call, its process, and its deadline [s]."""

    call: _Attempt[A]
    process: ForkServerProcess
    deadline: float

    def again(self) -> _Attempt[A] | None:
        """Return the call to restart after a kill; None if it may not be restarted."""
        left = self.deadline - time.monotonic()
        if left <= 0 or self.call.kills >= MOST_KILLS:
            return None
        return replace(self.call, left=left, kills=self.call.kills + 1)


def total_memory() -> float:
    return float(os.sysconf('SC_PAGE_SIZE') * os.sysconf('SC_PHYS_PAGES'))


class Processes:
    """Some processes that work at the same time, at the lowest priority.

    ``memory``: largest memory [bytes] and ``longest``: longest time [s] of a call; ``stopped``:
    returns whether all processes shall end.
    """

    def __init__(
        self,
        workers: int,
        memory: float,
        longest: float,
        stopped: Callable[[], bool] = lambda: False,
        preloaded: Sequence[str] = PRELOADED,
    ):
        self._workers, self._memory, self._longest = workers, memory, longest
        self._stopped = stopped
        self._context = begin_loading(preloaded)

    def run(
        self, function: Callable[[A], R], arguments: Iterable[Callable[[], A]]
    ) -> Iterator[EndedCall[R]]:
        killed: deque[_Attempt[A]] = deque()
        coming = (_Attempt(n, make, self._longest) for n, make in enumerate(arguments))
        running: dict[Connection, _Running[A]] = {}
        try:
            while True:
                while len(running) < self._workers:
                    call = killed.popleft() if killed else next(coming, None)
                    if call is None:
                        break
                    try:
                        self._start(function, call, running)
                    except (EOFError, ConnectionError):  # the fork server was killed meanwhile
                        if call.kills >= MOST_KILLS:
                            raise InterpError(
                                'something kills every new process; find and stop it'
                            ) from None
                        killed.append(replace(call, kills=call.kills + 1))
                if not running:
                    return
                if self._stopped():
                    raise InterpError('stopped; finished results are kept')
                for connection in self._heard(running):
                    one = running.pop(connection)
                    ended: EndedCall[R] = _end_of(connection, one)
                    again = one.again() if ended.result is Loss.KILLED else None
                    if again is not None:
                        killed.append(again)
                    else:
                        yield ended
        finally:
            for one in running.values():
                one.process.kill()
            for connection, one in running.items():
                one.process.join()
                connection.close()

    def _start(
        self, function: Callable[[A], R], call: _Attempt[A], running: dict[Connection, _Running[A]]
    ) -> None:
        ours, theirs = self._context.Pipe(duplex=False)
        process = self._context.Process(
            target=_live, args=(function, call.make(), theirs, self._memory), daemon=True
        )
        process.start()
        theirs.close()
        running[ours] = _Running(call, process, time.monotonic() + call.left)

    @staticmethod
    def _heard(running: dict[Connection, _Running[A]]) -> list[Connection]:
        """Wait until processes have ended or exceeded their time; return their connections."""
        deadline = min(one.deadline for one in running.values())
        heard = wait(list(running), min(max(0.0, deadline - time.monotonic()), LOOK))
        now = time.monotonic()
        late = [c for c, one in running.items() if now > one.deadline and c not in heard]
        return [*heard, *late]  # type: ignore[list-item]


def _end_of(connection: Connection, running: _Running[A]) -> EndedCall[R]:
    call, process = running.call, running.process
    late, sent = not connection.poll(), []
    if late:
        process.kill()
    else:
        with contextlib.suppress(EOFError, OSError):  # it died before its message was complete
            sent.append(connection.recv())
    process.join()
    connection.close()
    if sent:
        return EndedCall(call.number, sent[0], call.kills)
    if late:
        return EndedCall(call.number, Loss.KILLED if call.kills else Loss.TOO_LONG, call.kills)
    code = process.exitcode or 0
    if -code in FROM_OUTSIDE or code == SERVER_LOST:
        return EndedCall(call.number, Loss.KILLED, call.kills)
    why = signal.Signals(-code).name if code < 0 else f'exit code {code}'
    return EndedCall(call.number, Loss.CRASHED, call.kills, why)


def _live(function: Callable[[A], R], argument: A, result: Connection, memory: float) -> None:
    begin_child(PROCESS_NAME)
    # A long program is planned by further processes, which multiprocessing forbids to a daemon.
    multiprocessing.current_process()._config['daemon'] = False  # type: ignore[attr-defined]
    os.nice(19)
    resource.setrlimit(resource.RLIMIT_DATA, (int(memory), int(memory)))
    result.send(function(argument))
    result.close()
