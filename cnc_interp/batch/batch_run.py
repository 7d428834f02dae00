"""Run a batch; results of an earlier start of it are reused."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, Protocol, TypeVar

from cnc_interp.batch.processes import PRELOADED, EndedCall, Loss, Processes, total_memory
from cnc_interp.batch.task import BatchEntry, Jobs, Row, Task, TaskOutcome, Verdict
from cnc_interp.batch.task_work import carry_out
from cnc_interp.core import InterpError
from cnc_interp.core.small_files import UnreadableError, read_json, write_whole

R = TypeVar('R')

#: Verdicts that may differ if the task is repeated.
UNCERTAIN = (Verdict.KILLED, Verdict.TOO_LONG, Verdict.TOO_LARGE)


class Store(Generic[R]):
    """Results by key, one file each; ``read`` converts the content of a file to a result."""

    def __init__(self, folder: Path, read: Callable[[Any], R]):
        self._folder, self._read = folder, read
        folder.mkdir(parents=True, exist_ok=True)

    def find(self, key: str) -> R | None:
        try:
            return self._read(read_json(self._file(key)))
        except (OSError, UnreadableError, ValueError, TypeError, KeyError):
            return None

    def keep(self, key: str, result: Any) -> None:
        write_whole(self._file(key), json.dumps(asdict(result), indent=1) + '\n')

    def _file(self, key: str) -> Path:
        return self._folder / f'{key}.json'


#: Verdicts of lost tasks.
LOST = {
    Loss.CRASHED: Row(Verdict.CRASHED, 'its worker crashed'),
    Loss.KILLED: Row(Verdict.KILLED, 'its worker was killed again and again'),
    Loss.TOO_LONG: Row(Verdict.TOO_LONG, 'it exceeds the longest planning time; see --longest'),
}


class Workers(Protocol):
    """Workers that carry out tasks: ``processes.Processes`` or ``dask_workers.DaskWorkers``."""

    def run(
        self, function: Callable[[Task], TaskOutcome], arguments: Iterator[Callable[[], Task]]
    ) -> Iterator[EndedCall[TaskOutcome]]: ...


@dataclass(frozen=True)
class Progress:
    #: Number of tasks with a result, including those of earlier starts, and of all tasks.
    done: int
    known: int
    total: int
    share: float  #: Finished share of the program text to be planned in this start [-].


def run_batch(
    jobs: Jobs,
    workers: Workers,
    store: Store[TaskOutcome],
    progress: Callable[[Progress], None],
    processes: int = 1,
) -> list[tuple[BatchEntry, TaskOutcome]]:
    keys: dict[int, str] = {}
    found: dict[int, TaskOutcome] = {}
    listed = list(jobs)
    for number, job in enumerate(listed):
        try:
            keys[number] = jobs.task(job).key
        except (OSError, InterpError) as problem:
            text = str(problem)
            if isinstance(problem, OSError):
                text = f'cannot be read: {problem.strerror}'
            found[number] = TaskOutcome(Row(Verdict.REFUSED, text))
            continue
        known = store.find(keys[number])
        if known is not None and known.row.verdict not in UNCERTAIN:
            found[number] = known
    known_before = len(found)
    # The longest first, so that at the end no worker waits for a long program.
    open_jobs = sorted(keys.keys() - found.keys(), key=lambda n: (-listed[n].size, n))
    size = sum(listed[number].size for number in open_jobs)
    done = 0
    progress(Progress(len(found), known_before, len(listed), 1.0 if not open_jobs else 0.0))

    def task_of(number: int) -> Task:
        task = jobs.task(listed[number])
        keys[number] = task.key  # the file may have changed since
        return task

    work = partial(carry_out, processes=processes)
    for ended in workers.run(work, (partial(task_of, number) for number in open_jobs)):
        number = open_jobs[ended.number]
        outcome = _outcome(ended)
        store.keep(keys[number], outcome)
        found[number] = outcome
        done += listed[number].size
        share = done / size if size else 1.0
        progress(Progress(len(found), known_before, len(listed), share))
    return [(job, found[number]) for number, job in enumerate(listed)]


def _outcome(ended: EndedCall[TaskOutcome]) -> TaskOutcome:
    if isinstance(ended.result, TaskOutcome):
        return ended.result
    row = LOST[ended.result]
    if ended.why:
        row = Row(row.verdict, f'{row.message} ({ended.why}); please report')
    return TaskOutcome(row)


def dask_workers() -> ModuleType:
    """Return the module of clusters; raises InterpError if Dask is not installed."""
    try:
        from cnc_interp.batch import dask_workers
    except ModuleNotFoundError as problem:
        raise InterpError(
            f'a cluster needs Dask ({problem.name} is missing): pip install distributed bokeh'
        ) from None
    return dask_workers


def workers_of(
    scheduler: str | None,
    workers: int,
    memory: float | None,
    longest: float,
    preloaded: Sequence[str] = PRELOADED,
) -> Workers:
    """Return the workers of a batch: a cluster, or processes that share this computer's memory."""
    if scheduler is not None:
        found: Workers = dask_workers().DaskWorkers(scheduler, memory, longest)
        return found
    share = memory or total_memory() / workers
    return Processes(workers, share, longest, preloaded=preloaded)
