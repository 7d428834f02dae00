"""From a goal to blocks that are known to run: read, then checked to the last block."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cnc_interp.errors import BlockError, InterpError, ProgramError
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.kinematics.transform import Transform
from cnc_interp.pipeline import ChainOptions, smoothing_options
from cnc_interp.program import JobSetup, Program, ReadOptions, read_program, read_text
from cnc_interp.program.blocks import Blocks
from cnc_interp.smoothing.path_smoother import PathSmoother

#: Blocks checked together, and length up to which the text is kept for those who show it [bytes].
BATCH, LONGEST_TEXT = 512, 16 << 20


@dataclass(frozen=True)
class Prepared:
    """
    A program that can run.

    Parameters
    ----------
    blocks : Blocks
        Start pose, then the program.
    notices : tuple of str
        What was passed on or simplified.
    text : str
        The program's text; empty when it is very long.
    options : ReadOptions
        The choices it was read with.
    path_length : float
        Length of the smoothed path [m].

    """

    blocks: Blocks
    notices: tuple[str, ...]
    text: str
    options: ReadOptions
    path_length: float


def read_options(goal: Any, defaults: dict[str, Any]) -> ReadOptions:
    """Return the user's choices; zero and empty leave them to the node's parameters."""
    return ReadOptions(
        contour_tolerance=goal.contour_tolerance or defaults['contour_tolerance'],
        orientation_tolerance=goal.orientation_tolerance or defaults['orientation_tolerance'],
        force_tolerances=goal.force_tolerances,
        flank_height=goal.flank_height or defaults['flank_height'],
        feedrate=goal.feedrate or None,
        interpolation=goal.interpolation or 'auto',
        rotary_sense=defaults['rotary_sense'],
        skip_blocks=defaults['skip_blocks'],
        setup=JobSetup.load(Path(defaults['setup'])) if defaults['setup'] else JobSetup(),
    )


def prepare(
    goal: Any, transform: Transform, defaults: dict[str, Any], abandoned: Callable[[], bool]
) -> Prepared:
    """
    Read and check the program of a goal, before anything moves.

    Parameters
    ----------
    goal : RunProgram.Goal
        Program and choices.
    transform : Transform
        The machine's transformation.
    defaults : dict
        Parameters of the node.
    abandoned : callable
        Tells when the user has cancelled.

    Raises
    ------
    ProgramError
        If the program cannot be read or holds no motion.
    BlockError
        If a block cannot be executed on the machine: travel, reach, singular pose, tolerance.

    """
    machine = transform.machine
    if goal.machine and Machine.load(goal.machine).name != machine.name:
        raise InterpError(
            f"the nodes run machine '{machine.name}', not '{goal.machine}'; start them with it"
        )
    options = read_options(goal, defaults)
    program: Program
    text = goal.text
    if goal.program:
        program = read_program(Path(goal.program), transform, options)
        text = text_of(Path(goal.program))
    else:
        program = read_text(goal.text, '<text>', transform, options)
    length = checked_length(program.blocks, transform, options.flank_height, abandoned)
    if not length > 0.0:
        raise ProgramError('holds no motion; add blocks after the start pose', program.source)
    return Prepared(program.blocks, program.notices, text, options, length)


def text_of(path: Path) -> str:
    """Return the text of a program as the reader saw it; nothing when it is very long."""
    if path.stat().st_size > LONGEST_TEXT:
        return ''
    return path.read_text(encoding='utf-8-sig', errors='replace')


def checked_length(
    blocks: Blocks, transform: Transform, flank_height: float, abandoned: Callable[[], bool]
) -> float:
    """Run a program through look-ahead and kinematics and return the length of its path [m]."""
    chain_options = ChainOptions(flank_height=flank_height)
    lookahead = PathSmoother(smoothing_options(transform, chain_options))
    builder = AxisPathBuilder(transform, flank_height)
    length = 0.0
    for first in range(0, len(blocks) + BATCH, BATCH):
        batch = blocks[first : first + BATCH]
        path = builder.push(lookahead.push(batch) if len(batch) else lookahead.finish())
        length = length if path is None else float(path.s[-1])
        if abandoned():
            raise BlockError('cancelled before anything moved')
    return length
