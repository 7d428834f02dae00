"""From a goal to blocks that are known to run: read, then checked to the last block."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cnc_interp.core.errors import InterpError
from cnc_interp.kinematics.transform import Transform
from cnc_interp.program import ProgramStream, open_program
from cnc_interp.program.source import Source
from cnc_interp.program.spool import BlockSpool
from cnc_interp.run.chain import at_fault, no_motion
from cnc_interp.run.path_chain import PathChain, PathPart, batches
from cnc_interp.run.tolerance_use import ToleranceUse
from cnc_interp.settings.choices import Settings
from cnc_interp.wire.settings_messages import settings_of_goal

#: Largest length of a text that is kept for display [bytes].
LONGEST_TEXT = 16 << 20


@dataclass(frozen=True)
class Prepared:
    """
    A program that was checked and can run.

    Parameters
    ----------
    blocks : BlockSpool
        Start pose, then the program.
    notices : tuple of str
        What had no effect or was simplified.
    text : str
        The program's text; empty when it is very long.
    settings : Settings
        The choices of the run.
    path_length : float
        Length of the smoothed path [m].

    """

    blocks: BlockSpool
    notices: tuple[str, ...]
    text: str
    settings: Settings
    path_length: float


def prepare(
    goal: Any,
    transform: Transform,
    defaults: Settings,
    told: Callable[[float], None],
    folders: Sequence[str] = (),
) -> Prepared:
    """
    Read and check the program of a goal, before anything moves; memory does not grow with it.

    Parameters
    ----------
    goal : RunProgram.Goal
        Program and choices.
    transform : Transform
        The machine's transformation.
    defaults : Settings
        Settings of the node, for choices that the goal leaves open.
    told : callable
        Told the share of the text that is checked, 0 to 1; raises when the user has cancelled.
    folders : sequence of str, optional
        Folders and files that the goal may name; see ``require_allowed``.

    Raises
    ------
    SettingsError
        If the goal asks for a choice that is unknown or not possible.
    ProgramError
        If the program cannot be read or holds no motion.
    BlockError
        If a block cannot be executed on the machine: travel, reach, singular pose, tolerance.

    """
    machine = transform.machine
    if goal.machine and goal.machine != machine.name:
        raise InterpError(
            f"the nodes run machine '{machine.name}', not '{goal.machine}'; start them with it"
        )
    settings = settings_of_goal(goal, defaults)
    if goal.program and not goal.text:
        require_allowed(Path(goal.program), folders)
        stream = open_program(Path(goal.program), transform, settings)
        text = text_of(Path(goal.program))
    else:
        source = Source.of_text(goal.text, Path(goal.program).name or '<text>')
        stream = ProgramStream(source, transform, settings)
        text = goal.text if len(goal.text) <= LONGEST_TEXT else ''
    blocks = BlockSpool()
    try:
        length = checked_length(stream, blocks, transform, settings, told)
    except OSError as problem:
        blocks.close()
        raise InterpError(
            f'the checked blocks cannot be stored: {problem.strerror}; set TMPDIR to a folder '
            'with room for 150 bytes per block'
        ) from None
    except BaseException:
        blocks.close()
        raise
    return Prepared(blocks, stream.notices, text, settings, length)


def require_allowed(program: Path, folders: Sequence[str]) -> None:
    """
    Refuse a path that is neither one of some files nor below one of some folders.

    Nothing of the file is read, and the answer is the same whether or not it exists.

    Raises
    ------
    InterpError
        If the node was not started with a folder of this program.

    """
    wanted = program.resolve()
    if not any(wanted.is_relative_to(Path(folder).resolve()) for folder in folders if folder):
        raise InterpError(
            f'{program}: no program of a folder that program_node may read; start it with '
            'program_folders, or send the text of the program'
        )


def text_of(path: Path) -> str:
    """Return the text of a program as the reader saw it, or an empty text if it is very long."""
    with path.open('rb') as file:  # a device tells no length
        content = file.read(LONGEST_TEXT + 1)
    return '' if len(content) > LONGEST_TEXT else content.decode('utf-8-sig', errors='replace')


def checked_length(
    stream: ProgramStream,
    spool: BlockSpool,
    transform: Transform,
    settings: Settings,
    told: Callable[[float], None],
) -> float:
    """
    Run a program through look-ahead and kinematics and return the length of its path [m].

    Its blocks go into the spool on their way.
    """
    chain, tolerances = PathChain(transform, settings), ToleranceUse()
    length = 0.0
    with at_fault(stream.source):
        for part in stream:
            spool.append(part)
            tolerances.blocks(part)
            for batch in batches(part):
                length = checked(chain.push(batch), tolerances, length)
                told(stream.share)
        length = checked(chain.finish(), tolerances, length)
        stream.note(chain.notice)
    if not length > 0.0:
        raise no_motion(stream.source)
    return length


def checked(part: PathPart, tolerances: ToleranceUse, length: float) -> float:
    """Check the tolerances of a further part of the path; return the length so far [m]."""
    tolerances.require(part.segments)
    return length if part.path is None else float(part.path.s[-1])
