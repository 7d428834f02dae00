"""One program on one machine: what a worker is told, and the row of the table that it returns."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any

from cnc_interp.core.errors import InterpError
from cnc_interp.settings.choices import Settings
from cnc_interp.settings.texts import texts_of


class Verdict(StrEnum):
    """What became of a program."""

    PROVEN = 'proven'
    NOT_PROVEN = 'not proven'
    REFUSED = 'refused'  # it cannot be read, or cannot run on the machine
    CRASHED = 'crashed'  # a fault of ours, or of a library
    TOO_LARGE = 'too large'  # needs more memory than a worker may have
    TOO_LONG = 'too long'  # needs more time than a program may have
    KILLED = 'killed'  # by somebody else, again and again


@dataclass(frozen=True)
class Model:
    """
    A machine as text.

    Parameters
    ----------
    name : str
        As the user named it.
    text : str
        Content of its file.
    file : str
        Path of the file; empty for a bundled machine.

    """

    name: str
    text: str
    file: str


@dataclass(frozen=True)
class Task:
    """
    All that a worker needs; it opens no file of the user.

    Parameters
    ----------
    program : str
        Name of the program in the table: its path from the folder of the batch.
    files : tuple of (str, bytes)
        Names and contents: the program, then the subprograms beside it that it may call.
    model : Model
        The machine.
    settings : tuple of (str, str)
        Every choice as text, as ``settings.texts`` has them; ``setup`` left out.
    setup : str
        Content of the setup file, or ''.
    plans : str
        Folder in which the plan files are kept, or ''.

    """

    program: str
    files: tuple[tuple[str, bytes], ...]
    model: Model
    settings: tuple[tuple[str, str], ...]
    setup: str = ''
    plans: str = ''

    @property
    def key(self) -> str:
        """
        Return the name of the result: a hash of all that it depends on.

        These are program, machine, choices, setup, and the source text of this package.
        """
        digest = hashlib.sha256(engine().encode())
        texts = (self.program, *(name for name, _ in self.files), self.model.text,
                 self.model.file, json.dumps(self.settings), self.setup)  # fmt: skip
        for part in (*(text.encode() for text in texts), *(text for _, text in self.files)):
            digest.update(hashlib.sha256(part).digest())
        return digest.hexdigest()[:32]


@dataclass(frozen=True)
class Row:
    """
    A row of the table. It depends on the task alone, not on who computes it and when.

    Figures are None where there is no plan.

    Parameters
    ----------
    verdict : Verdict
        What became of the program.
    message : str
        Why it is not proven, else ''.
    blocks, setpoints : int, optional
        Their numbers.
    path_length : float, optional
        Way of the tool tip [m].
    cycle_time, time_bound : float, optional
        Time of the motion, and the least time that velocities and accelerations allow [s].
    velocity_use, acceleration_use, jerk_use, torque_use : float, optional
        Largest use of a limit by any axis, as proven [-].
    contour_used, orientation_used : float, optional
        Largest use of the tolerances, as proven [-].
    notices : tuple of str
        What the reader and the planner noticed.
    plan_hash : str
        Hash of the plan files, their summary left out.

    """

    verdict: Verdict
    message: str = ''
    blocks: int | None = None
    setpoints: int | None = None
    path_length: float | None = None
    cycle_time: float | None = None
    time_bound: float | None = None
    velocity_use: float | None = None
    acceleration_use: float | None = None
    jerk_use: float | None = None
    torque_use: float | None = None
    contour_used: float | None = None
    orientation_used: float | None = None
    notices: tuple[str, ...] = ()
    plan_hash: str = ''


@dataclass(frozen=True)
class Cost:
    """
    What a row has cost; another run of the same task costs something else.

    Parameters
    ----------
    seconds : float
        Time from start to end of the worker's task [s].
    processor : float
        Processor time of all its processes [s].
    memory : float
        Largest memory of any of its processes [bytes].

    """

    seconds: float = 0.0
    processor: float = 0.0
    memory: float = 0.0


@dataclass(frozen=True)
class Outcome:
    """A row and its cost."""

    row: Row
    cost: Cost = Cost()

    def to_text(self) -> str:
        """Return it as JSON."""
        return json.dumps({'row': asdict(self.row), 'cost': asdict(self.cost)}, indent=1) + '\n'

    @staticmethod
    def of_json(content: Any) -> Outcome:
        """
        Return what ``to_text`` has written.

        Raises
        ------
        ValueError, TypeError, KeyError
            If it is something else.

        """
        row = dict(content['row'])
        row['verdict'] = Verdict(row['verdict'])
        row['notices'] = tuple(row['notices'])
        return Outcome(Row(**row), Cost(**content['cost']))


def settings_of(settings: Settings) -> tuple[tuple[tuple[str, str], ...], str]:
    """
    Return settings as texts without the setup file, and the content of that file.

    Raises
    ------
    InterpError
        If the setup file cannot be read.

    """
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
    """Return a hash of the source text of this package: another version plans anew."""
    digest = hashlib.sha256()
    for source in sorted(Path(__file__).parents[1].rglob('*.py')):
        digest.update(source.read_bytes())
    return digest.hexdigest()
