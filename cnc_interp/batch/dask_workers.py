"""A batch on several computers: Dask distributes the tasks, and processes carry them out."""

import asyncio
import logging
import signal
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import CancelledError
from contextlib import AsyncExitStack, suppress
from functools import partial
from typing import Any, TypeVar

import dask
from distributed import Client, Future, Scheduler, Worker, as_completed, get_worker
from distributed.comm import CommClosedError
from distributed.scheduler import KilledWorker

from cnc_interp.batch import processes
from cnc_interp.batch.task import engine
from cnc_interp.core import InterpError

PATIENCE = 10  #: Time for the scheduler to answer [s].
MOST_LOST_WORKERS = 20  #: A task is abandoned after the loss of this number of workers.
AHEAD = 2  #: Number of tasks that each thread of a worker is assigned in advance.

A = TypeVar('A')
R = TypeVar('R')


class DaskWorkers:
    """The workers of a cluster; implements ``batch_run.Workers``."""

    def __init__(self, address: str, memory: float | None, longest: float):
        self._memory, self._longest = memory, longest
        _keep_quiet()
        try:
            self._client = Client(address, timeout=PATIENCE, set_as_default=False)
        except (OSError, ValueError) as problem:
            raise InterpError(
                f'{address}: no scheduler answers; start one: cnc-interp cluster ({problem})'
            ) from None

    def run(
        self, function: Callable[[A], R], arguments: Iterator[Callable[[], A]]
    ) -> Iterator[processes.EndedCall[R]]:
        numbers: dict[Future, int] = {}
        coming = enumerate(arguments)
        ended = as_completed(loop=self._client.loop)
        try:
            while True:
                while len(numbers) < self._ahead and (more := next(coming, None)) is not None:
                    number, make = more
                    future = self._client.submit(
                        call_there,
                        function,
                        make(),
                        engine(),
                        self._memory,
                        self._longest,
                        pure=False,
                        priority=-number,
                    )
                    numbers[future] = number
                    ended.add(future)
                if not numbers:
                    return
                future = next(ended)
                if future.status in ('cancelled', 'lost'):
                    raise _lost()
                yield _end_of(future, numbers.pop(future))
        except (CommClosedError, CancelledError):
            raise _lost() from None
        finally:
            with suppress(OSError, CancelledError, TimeoutError):
                self._client.cancel(list(numbers), force=True)
                self._client.close()

    @property
    def _ahead(self) -> int:
        return AHEAD * max(1, sum(int(n) for n in self._client.nthreads().values()))


def _lost() -> InterpError:
    return InterpError('the scheduler was lost; start it again, then start the batch to continue')


def _end_of(future: Future, number: int) -> processes.EndedCall[Any]:
    if future.status == 'error':
        problem = future.exception()
        if isinstance(problem, KilledWorker):
            return processes.EndedCall(number, processes.Loss.KILLED, MOST_LOST_WORKERS)
        raise problem
    there: processes.EndedCall[Any] = future.result()
    return processes.EndedCall(number, there.result, there.kills, there.why)


def call_there(
    function: Callable[[A], R], task: A, version: str, memory: float | None, longest: float
) -> processes.EndedCall[R]:
    """Call a function in a new process on a worker; it may use all threads of the worker."""
    if engine() != version:
        raise InterpError(
            f'the worker {get_worker().address} has another version of cnc_interp; install '
            'the same everywhere'
        )
    threads = get_worker().state.nthreads
    if isinstance(function, partial) and 'processes' in function.keywords:
        function = partial(function, processes=threads)
    loaded = (*processes.PRELOADED, *processes.TILES_PRELOADED)
    memory = memory or processes.total_memory() / threads
    there = processes.Processes(1, memory, longest, preloaded=loaded)
    return next(there.run(function, [lambda: task]))


def serve(host: str, port: int, dashboard: int, workers: int, say: Callable[[str], None]) -> None:
    """Run a scheduler, and a worker if ``workers`` is not 0, until the process is interrupted."""
    dask.config.set({'distributed.scheduler.allowed-failures': MOST_LOST_WORKERS})

    async def live() -> None:
        page = f'{host}:{dashboard}'
        async with AsyncExitStack() as parts:
            try:
                scheduler = Scheduler(host=host, port=port, dashboard_address=page)
                await parts.enter_async_context(scheduler)
            except RuntimeError as problem:  # the reason is an OSError
                raise InterpError(f'{host}:{port}: {problem.__cause__ or problem}') from None
            if workers:
                await parts.enter_async_context(_worker(scheduler.address, workers, host))
            say(f'scheduler      {scheduler.address}, {workers} programs at a time here')
            say(f'dashboard      http://{host}:{scheduler.services["dashboard"].port}/status')
            await _until_interrupted(scheduler)

    _live(live())


def join(address: str, workers: int, say: Callable[[str], None]) -> None:
    """Run a worker of a scheduler elsewhere until it ends or is interrupted."""

    async def live() -> None:
        worker = _worker(address, workers)
        try:
            await asyncio.wait_for(worker, PATIENCE)
        except (OSError, ValueError, RuntimeError, TimeoutError):
            raise InterpError(f'{address}: no scheduler answers') from None
        say(f'worker         of {address}, {workers} programs at a time')
        if not await _until_interrupted(worker):
            say(f'{address}: the scheduler has ended')
        await worker.close()

    _live(live())


def _live(life: Coroutine[Any, Any, None]) -> None:
    """Run a scheduler or a worker, and suppress Dask's messages about the loss of another."""
    _keep_quiet()
    asyncio.run(life)


def _keep_quiet() -> None:
    for name in ('distributed', 'distributed.client'):
        logging.getLogger(name).setLevel(logging.CRITICAL)


async def _until_interrupted(part: Any) -> bool:
    """Wait for the end of a scheduler or worker, or a signal; return True after a signal."""
    told = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, told.set)
    waits = [asyncio.ensure_future(part.finished()), asyncio.ensure_future(told.wait())]
    await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
    return told.is_set()


def _worker(address: str, workers: int, host: str | None = None) -> Any:
    return Worker(
        address, nthreads=workers, host=host, memory_limit=0, dashboard=False, death_timeout=60
    )
