"""One program on one machine: the task for a worker, and the table row that it returns."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any

from cnc_interp.core import InterpError
from cnc_interp.core.small_files import open_named
from cnc_interp.machine_model.machine import Machine, whole_text
from cnc_interp.program.text.source import PROGRAM_SUFFIXES, called_files
from cnc_interp.settings.options import Settings, texts_of


class Verdict(StrEnum):
    PROVEN = 'proven'
    NOT_PROVEN = 'not proven'
    REFUSED = 'refused'  # the program cannot be read, or cannot run on the machine
    CRASHED = 'crashed'  # a fault of ours, or of a library
    TOO_LARGE = 'too large'  # needs more memory than a worker may have
    TOO_LONG = 'too long'  # needs more time than a program may have
    KILLED = 'killed'  # killed repeatedly from outside


@dataclass(frozen=True)
class Model:
    name: str  #: Name given by the user.
    text: str  #: Content of its file.
    file: str  #: Path of the file; empty for a bundled machine.


@dataclass(frozen=True)
class Task:
    """The complete input of a worker, so that it opens no files of the user."""

    program: str  #: Name of the program in the table: its path relative to the batch folder.
    #: File name and content of the program, then of each subprogram that it may call.
    files: tuple[tuple[str, bytes], ...]
    model: Model  #: The machine.
    #: Every setting except ``setup`` as text, in the form of ``settings.options``.
    settings: tuple[tuple[str, str], ...]
    setup: str = ''  #: Content of the setup file, or ''.
    plans: str = ''  #: Folder in which the plan files are stored, or ''.
    scene: str = ''  #: Hash of the files of the scene, or ''.

    @property
    def key(self) -> str:
        """Key of the result: a hash of all its inputs, including the source of this package."""
        digest = hashlib.sha256(engine().encode())
        texts = (
            self.program,
            *(name for name, _ in self.files),
            self.model.text,
            self.model.file,
            json.dumps(self.settings),
            self.setup,
            self.scene,
        )
        for part in (*(text.encode() for text in texts), *(text for _, text in self.files)):
            digest.update(hashlib.sha256(part).digest())
        return digest.hexdigest()[:32]


@dataclass(frozen=True)
class Row:
    """A row of the table; it depends only on the task. Figures are None without a plan."""

    verdict: Verdict  #: Verdict about the program.
    message: str = ''  #: Why the plan is not proven, else ''.
    blocks: int | None = None
    setpoints: int | None = None
    path_length: float | None = None  #: Path length of the tool tip [m].
    #: Time of the motion, and the least time that velocities and accelerations allow [s].
    cycle_time: float | None = None
    time_bound: float | None = None
    standstill: float | None = None  #: Time for tool changes and the spindle [s].
    #: Largest use of a limit by any axis, as proven [-].
    velocity_use: float | None = None
    acceleration_use: float | None = None
    jerk_use: float | None = None
    torque_use: float | None = None
    #: Largest use of the tolerances, as proven [-].
    contour_used: float | None = None
    orientation_used: float | None = None
    #: Times of each tool as in `estimate --json`, without the operations.
    tools: tuple[dict[str, Any], ...] = ()
    notices: tuple[str, ...] = ()  #: Notices of the reader and the planner.
    plan_hash: str = ''  #: Hash of the plan files except the summary.

    @property
    def run_time(self) -> float:
        """Time of the motion and at standstill [s]; 0 without a plan."""
        return (self.cycle_time or 0.0) + (self.standstill or 0.0)


@dataclass(frozen=True)
class Cost:
    """The computing cost of a row; it differs each time the same task is carried out."""

    seconds: float = 0.0  #: Time from start to end of the worker's task [s].
    processor: float = 0.0  #: Processor time of all its processes [s].
    memory: float = 0.0  #: Largest memory of any of its processes [bytes].


@dataclass(frozen=True)
class TaskOutcome:
    row: Row
    cost: Cost = Cost()

    @staticmethod
    def of_json(content: Any) -> TaskOutcome:
        row = dict(content['row'])
        row['verdict'] = Verdict(row['verdict'])
        row['notices'], row['tools'] = tuple(row['notices']), tuple(row['tools'])
        return TaskOutcome(Row(**row), Cost(**content['cost']))


def settings_of(settings: Settings) -> tuple[tuple[tuple[str, str], ...], str]:
    texts = texts_of(settings)
    del texts['setup']
    if settings.setup is None:
        return tuple(texts.items()), ''
    try:
        setup = settings.setup.read_text(encoding='utf-8')
    except (OSError, UnicodeDecodeError) as problem:
        raise InterpError(f'{settings.setup}: cannot be read: {problem}') from None
    return tuple(texts.items()), setup


@cache
def engine() -> str:
    """Return a hash of the source text of this package, so that another version plans again."""
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parents[1].rglob('*.py')):
        digest.update(source.read_bytes())
    return digest.hexdigest()


@dataclass(frozen=True)
class BatchEntry:
    path: Path  #: File of the program.
    program: str  #: Its name in the table.
    model: Model  #: The machine.
    size: int  #: Length of the program [bytes].


class Jobs:
    """The programs of a batch on its machines; raises InterpError without a program or machine."""

    def __init__(
        self,
        programs: Sequence[Path],
        machines: Sequence[str],
        settings: Settings,
        plans: Path | None = None,
        folders: Sequence[str] | None = None,
    ):
        self._folders = folders  #: Folders from which files may be read, see ``open_named``.
        self._settings, self._setup = settings_of(settings)
        self._plans, self._scene = plans.resolve() if plans else None, _scene_hash(settings)
        models = [_model(name) for name in dict.fromkeys(machines)]
        found = [
            BatchEntry(path, name, model, path.stat().st_size)
            for path, name in programs_of(programs)
            for model in models
        ]
        if not found:
            raise InterpError(
                f'no programs here; name the files, or a folder of files that end with one of '
                f'{" ".join(sorted(PROGRAM_SUFFIXES))}'
            )
        self._jobs = found

    def __iter__(self) -> Iterator[BatchEntry]:
        return iter(self._jobs)

    def task(self, job: BatchEntry) -> Task:
        with open_named(job.path, self._folders) as stream:
            text = stream.read()
        called = called_files(job.path, text, self._folders)
        files = ((job.path.name, text), *called.items())
        plans = ''
        if self._plans:
            plans = str(self._plans / Path(job.model.name).stem / job.program)
        return Task(job.program, files, job.model, self._settings, self._setup, plans, self._scene)


def _scene_hash(settings: Settings) -> str:
    """Return the hash of a scene; raise SceneError if the scene is invalid."""
    if settings.scene is None:
        return ''
    from cnc_interp.collision.scene_file import read_scene

    return hashlib.sha256(b'\0'.join(read_scene(settings.scene).content())).hexdigest()


def programs_of(paths: Sequence[Path]) -> list[tuple[Path, str]]:
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
    return Model(name, whole_text(name), Machine.load(name).file)
