"""Which programs on which machines: the tasks of a batch, each made when it is needed."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from cnc_interp.batch.task import Model, Task, settings_of
from cnc_interp.core.errors import InterpError
from cnc_interp.machine_model.machine import Machine, find_machine_file
from cnc_interp.program.files import PROGRAM_SUFFIXES, called_files
from cnc_interp.settings.choices import Settings


@dataclass(frozen=True)
class Job:
    """One program on one machine."""

    path: Path  #: File of the program.
    program: str  #: Its name in the table.
    model: Model  #: The machine.
    size: int  #: Length of the program [bytes].


class Jobs:
    """
    The programs of a batch on its machines.

    Parameters
    ----------
    programs : sequence of Path
        Files, and folders that are searched for programs.
    machines : sequence of str
        Bundled machines, or their files.
    settings : Settings
        The choices of all tasks.
    plans : Path, optional
        Folder in which plan files are kept.

    Raises
    ------
    InterpError
        If there is no program, or a machine or the setup file cannot be read.

    """

    def __init__(
        self,
        programs: Sequence[Path],
        machines: Sequence[str],
        settings: Settings,
        plans: Path | None = None,
    ):
        self._settings, self._setup = settings_of(settings)
        self._plans = plans.resolve() if plans else None
        models = [_model(name) for name in dict.fromkeys(machines)]
        found = [
            Job(path, name, model, path.stat().st_size)
            for path, name in programs_of(programs)
            for model in models
        ]
        if not found:
            raise InterpError(
                f'no programs here; files are found by {" ".join(sorted(PROGRAM_SUFFIXES))}, '
                'others when they are named'
            )
        self._jobs = found

    def __len__(self) -> int:
        return len(self._jobs)

    def __iter__(self) -> Iterator[Job]:
        return iter(self._jobs)

    def task(self, job: Job) -> Task:
        """Return the task of a job; its files are read now."""
        text = job.path.read_bytes()
        files = ((job.path.name, text), *called_files(job.path, text).items())
        plans = ''
        if self._plans:
            plans = str(self._plans / Path(job.model.name).stem / job.program)
        return Task(job.program, files, job.model, self._settings, self._setup, plans)


def programs_of(paths: Sequence[Path]) -> list[tuple[Path, str]]:
    """
    Return files of programs, and their names in the table.

    A name is the path below the folder that all have in common.
    """
    files: dict[Path, None] = {}
    for path in paths:
        if path.is_dir():
            found = (p for p in path.rglob('*') if p.suffix.lower() in PROGRAM_SUFFIXES)
            files |= dict.fromkeys(p.resolve() for p in sorted(found) if p.is_file())
        elif path.is_file():
            files[path.resolve()] = None
        else:
            raise InterpError(f'{path}: there is no such file or folder')
    if not files:
        return []
    top = Path(os.path.commonpath([file.parent for file in files]))
    return [(file, str(file.relative_to(top))) for file in files]


def _model(name: str) -> Model:
    """Return a machine as text; it is sound."""
    machine = Machine.load(name)
    text = find_machine_file(name).read_text(encoding='utf-8')
    return Model(name, text, machine.file)
