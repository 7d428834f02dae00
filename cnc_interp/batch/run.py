"""A batch from its jobs to all results: what is known is not computed again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Protocol

from cnc_interp.batch.jobs import Job, Jobs
from cnc_interp.batch.processes import Ended, Loss
from cnc_interp.batch.store import Store
from cnc_interp.batch.task import Outcome, Row, Task, Verdict
from cnc_interp.batch.work import carry_out

#: What a lost task becomes.
LOST = {
    Loss.CRASHED: Row(Verdict.CRASHED, 'its worker crashed'),
    Loss.KILLED: Row(Verdict.KILLED, 'its worker was killed again and again'),
    Loss.TOO_LONG: Row(Verdict.TOO_LONG, 'it takes longer than a program may; see --longest'),
}


class Workers(Protocol):
    """Who carries out the tasks: ``processes.Processes`` or ``dask_workers.DaskWorkers``."""

    def run(
        self, function: Callable[[Task], Outcome], arguments: Iterator[Callable[[], Task]]
    ) -> Iterator[Ended[Outcome]]:
        """Call a function with each argument; see ``Processes.run``."""
        ...


@dataclass(frozen=True)
class Progress:
    """How far a batch is."""

    #: Tasks with a result, those of an earlier start among them, and all.
    done: int
    known: int
    total: int
    share: float  #: Part of the text that had to be planned and is done [-].


def run_batch(
    jobs: Jobs,
    workers: Workers,
    store: Store,
    progress: Callable[[Progress], None],
    processes: int = 1,
) -> list[tuple[Job, Outcome]]:
    """
    Carry out all jobs.

    Parameters
    ----------
    jobs : Jobs
        Programs and machines.
    workers : Workers
        Who carries out.
    store : Store
        Results of this and earlier starts. Each result is written as soon as it is known.
    progress : callable
        Told after each result.
    processes : int
        How many processes plan one long program, between its exact stops; so a giant keeps no
        processor idle. A cluster asks each of its computers instead.

    Returns
    -------
    list of (Job, Outcome)
        In the order of the jobs.

    """
    keys: dict[int, str] = {}
    found: dict[int, Outcome] = {}
    listed = list(jobs)
    for number, job in enumerate(listed):
        try:
            keys[number] = jobs.task(job).key
        except OSError as problem:
            found[number] = Outcome(Row(Verdict.REFUSED, f'cannot be read: {problem.strerror}'))
            continue
        if (known := store.find(keys[number])) is not None:
            found[number] = known
    known_before = len(found)
    # The longest first: at the end no worker waits for a giant.
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


def _outcome(ended: Ended[Outcome]) -> Outcome:
    """Return the result of a task, also of one that was lost."""
    if isinstance(ended.result, Outcome):
        return ended.result
    row = LOST[ended.result]
    if ended.why:
        row = Row(row.verdict, f'{row.message} ({ended.why}); please report')
    return Outcome(row)
