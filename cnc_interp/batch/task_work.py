"""Carry out one task: read, plan and prove a program."""

import hashlib
import os
import resource
import signal
import tempfile
import time
import traceback
from collections.abc import Iterable
from contextlib import chdir
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.batch.task import Cost, Model, Row, Task, TaskOutcome, Verdict
from cnc_interp.core import InterpError
from cnc_interp.core.small_files import parse_yaml
from cnc_interp.machine_model.machine import Machine, from_mapping
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import JobSetup, open_program
from cnc_interp.proof.verdict import Proof
from cnc_interp.proof.verify import verify_plan
from cnc_interp.run.parallel_planner import LostProcessError
from cnc_interp.run.plan_figures import collision_text
from cnc_interp.run.planning_chain import plan_to_files
from cnc_interp.settings.options import Settings, with_texts

#: A line, a corner and an exact stop, planned once to load what every task needs.
TINY = b'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A10 C0\nG1 X3 C5 F3000\nY4\nM30\n'
#: Figures that a row takes from the summary of the plan.
SAME = ('blocks', 'path_length', 'cycle_time', 'time_bound', 'standstill')
#: Plan files that are part of the hash of a plan.
PLAN = ('blocks.npz', 'segments.npz', 'path.npz', 'setpoints.npz')


def carry_out(task: Task, processes: int = 1) -> TaskOutcome:
    """Plan and prove a program; every failure becomes the verdict of the row."""
    began, used = time.perf_counter(), _processor_time()
    try:
        row = _planned(task, processes)
    except LostProcessError:
        os.kill(os.getpid(), signal.SIGKILL)  # so that this task is restarted, as after a kill
        raise
    except InterpError as problem:
        row = Row(Verdict.REFUSED, str(problem))
    except MemoryError:
        row = Row(
            Verdict.TOO_LARGE, 'a worker has too little memory for this program; see --memory'
        )
    except Exception as problem:
        at = traceback.extract_tb(problem.__traceback__)[-1]
        place = f'{Path(at.filename).name}:{at.lineno}'
        row = Row(Verdict.CRASHED, f'{type(problem).__name__} in {place}: {problem}; report it')
    memory = max(usage.ru_maxrss for usage in _usages()) * 1024.0
    return TaskOutcome(row, Cost(time.perf_counter() - began, _processor_time() - used, memory))


def _usages() -> list[resource.struct_rusage]:
    return [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]


def _processor_time() -> float:
    return sum(usage.ru_utime + usage.ru_stime for usage in _usages())


def _planned(task: Task, processes: int) -> Row:
    machine = machine_of(task.model)
    settings = with_texts(Settings(), task.settings)
    setup = JobSetup.of_text(task.setup) if task.setup else None
    with tempfile.TemporaryDirectory(prefix='cnc_batch_') as folder, chdir(folder):
        program = Path(task.program)  # the name that messages use
        program.parent.mkdir(parents=True, exist_ok=True)
        for name, text in task.files:
            program.with_name(name).write_bytes(text)
        stream = open_program(program, Transform.of(machine), settings, setup)
        plan = Path(task.plans or 'plan files')
        summary = plan_to_files(stream, machine, plan, settings, processes=processes)
        proof = verify_plan(plan, machine)
        digest = _hash(plan / name for name in PLAN)
    uses: dict[str, Any] = {f'{kind}_use': _use(proof, kind) for kind in proof.kinds}
    return Row(
        Verdict.PROVEN if proof.ok else Verdict.NOT_PROVEN,
        '; '.join(proof.failures),
        setpoints=summary['samples'],
        **{name: summary[name] for name in SAME} | uses,
        contour_used=proof.largest('contour deviation').ratio,
        orientation_used=proof.largest('orientation deviation').ratio,
        notices=(*stream.notices, *filter(None, (collision_text(summary), machine.guessed))),
        tools=tuple(
            {k: value for k, value in one.items() if k != 'operations'} for one in summary['tools']
        ),
        plan_hash=digest,
    )


def _use(proof: Proof, kind: str) -> float:
    return float(np.nanmax([proof.use_of(kind, axis) for axis in proof.axis_names]))


def _hash(files: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for file in files:
        with file.open('rb') as stream:
            digest.update(hashlib.file_digest(stream, 'sha256').digest())
    return digest.hexdigest()[:16]


@cache
def machine_of(model: Model) -> Machine:
    """Return the machine of a model; ``Machine.load`` has already accepted its text."""
    return replace(from_mapping(parse_yaml(model.text)), file=model.file)


def tiny_task(model: Model) -> Task:
    return Task('tiny.ngc', (('tiny.ngc', TINY),), model, ())
