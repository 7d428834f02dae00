"""Read the program of a goal, and check it to its last block before anything moves."""

import hashlib
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.core import BlockError, FloatArray, IntArray, InterpError, ProgramError
from cnc_interp.core.small_files import open_named, require_allowed
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import JobSetup, ProgramStream, open_program
from cnc_interp.program.blocks import ROUND_CORNER, STOP_CORNER, WITHIN_MOTION, Blocks, BlockSpool
from cnc_interp.program.blocks.block_modes import ModesOfBlocks
from cnc_interp.program.blocks.functions import Functions
from cnc_interp.program.blocks.targets import ProgramChange
from cnc_interp.program.motion.probing import Probe
from cnc_interp.program.notices import WARNING
from cnc_interp.program.reading import MdiLine, MdiReader
from cnc_interp.program.text.source import Source
from cnc_interp.run.path_chain import PathChain, PathPart, batches
from cnc_interp.run.plan_figures import ToleranceUse
from cnc_interp.run.planning_chain import at_fault, no_motion
from cnc_interp.run.run_phase import Code, Outcome
from cnc_interp.run.setpoints import NO_FUNCTIONS
from cnc_interp.run.start_place import StartFinder, StartPlace
from cnc_interp.settings.options import Settings
from cnc_interp.wire.run_messages import settings_of_goal

LONGEST_TEXT = 16 << 20  #: Longest program text that is stored for display [bytes].


@dataclass(frozen=True)
class Prepared:
    blocks: BlockSpool  #: Start pose, then the blocks of the program.
    notices: tuple[str, ...]  #: Notices about words that were ignored or simplified.
    text: str  #: Text of the program; empty if it is too long.
    settings: Settings  #: Settings of the run.
    path_length: float  #: Length of the smoothed path [m]; 0 for an MDI line without motion.
    #: (k,): Rows of the corners at which a stop is faster than rounding, ascending. The look-ahead
    #: therefore need not compare the two at any corner.
    stops: IntArray
    setup: JobSetup  #: Offsets and tools with which the program was read.
    is_own_setup: bool  #: Whether ``setup`` is of the goal, not of the machine.
    changes: tuple[ProgramChange, ...]  #: Changes of the setup by the program.
    used: frozenset[str]  #: Names of the used offsets and tools.
    modes: ModesOfBlocks  #: Modal state of each block.
    functions: Functions = NO_FUNCTIONS  #: Functions of the program.
    start: StartPlace | None = None  #: Where the run starts; None for the top.
    waits_first: bool = False  #: Whether M0 comes before any motion.
    line: MdiLine | None = None  #: The MDI line; None for a program.
    probe: Probe | None = None  #: Probe that ends this part of the program.
    stream: ProgramStream | None = None  #: Rest of the program, to be read after the probe.
    digest: str = ''  #: SHA-256 of the program.

    def __getitem__(self, rows: slice) -> Blocks:
        blocks = self.blocks[rows]
        first, after = np.searchsorted(self.stops, [rows.start, rows.start + len(blocks)])
        corner = np.where(blocks.corner == WITHIN_MOTION, WITHIN_MOTION, ROUND_CORNER)
        corner[self.stops[first:after] - rows.start] = STOP_CORNER
        return replace(blocks, corner=corner)


def prepare(
    goal: Any,
    transform: Transform,
    defaults: Settings,
    told: Callable[[float], None],
    folders: Sequence[str] = (),
    of_machine: Callable[[], JobSetup] = JobSetup,
) -> Prepared:
    """Read and check the program of a goal before anything moves, in constant memory."""
    machine = transform.machine
    if goal.machine and goal.machine != machine.name:
        raise InterpError(
            f"the nodes run machine '{machine.name}', not '{goal.machine}'; start them with it"
        )
    settings = settings_of_goal(goal, defaults)
    if settings.setup:
        setup = JobSetup.load(require_allowed(settings.setup, folders))
    else:
        setup = of_machine()
    text, path = goal.text, Path(goal.program)
    named = bool(goal.program) and not text
    if named:
        with open_named(path, folders) as file:
            digest = hashlib.file_digest(file, 'sha256')
            file.seek(0)
            content = file.read(LONGEST_TEXT + 1)
        text = '' if len(content) > LONGEST_TEXT else content.decode('utf-8-sig', 'replace')
    else:
        digest = hashlib.sha256(text.encode())
        text = '' if len(text) > LONGEST_TEXT else text

    def opened() -> ProgramStream:
        if named:
            return open_program(path, transform, settings, setup, folders)
        source = Source.of_text(goal.text, path.name or '<text>', folders)
        return ProgramStream(source, transform, settings, setup)

    stream = opened()
    stream.read_live()
    found = check(stream, setup, text, transform, settings, told)
    found = replace(found, digest=digest.hexdigest())
    if found.probe is None:
        return found
    try:
        for _ in opened():
            pass
    except ProgramError as problem:
        text = 'the program would be rejected if each probe answered at the end of its line'
        warning = f'{WARNING}{text}: {problem}'
        return replace(found, notices=(*found.notices, warning))
    return found


def prepare_on(
    before: Prepared,
    stands: FloatArray,
    at: FloatArray | None,
    setup: JobSetup,
    transform: Transform,
    told: Callable[[float], None],
) -> Prepared:
    """Read and check the next part of a program, which follows its probe."""
    assert before.stream is not None
    before.stream.go_on(stands, at)
    stream, settings = before.stream, before.settings
    following = check(stream, setup, before.text, transform, settings, told, True, stands)
    own, line, digest = before.is_own_setup, before.line, before.digest
    return replace(following, is_own_setup=own, line=line, digest=digest)


def prepare_line(
    goal: Any,
    reader: MdiReader,
    setup: JobSetup,
    stands: FloatArray,
    transform: Transform,
    settings: Settings,
    told: Callable[[float], None],
) -> Prepared:
    if settings_of_goal(goal, settings) != settings:
        raise InterpError(
            'an MDI line uses the settings of program_node; leave out other settings'
        )
    line = reader.line(goal.text, stands, setup)
    done = check(line, setup, goal.text, transform, settings, told, True, stands)
    return replace(done, line=line)


def check(
    stream: ProgramStream,
    setup: JobSetup,
    text: str,
    transform: Transform,
    settings: Settings,
    told: Callable[[float], None],
    may_rest: bool = False,
    stands: FloatArray | None = None,
) -> Prepared:
    """Smooth and transform a program up to its last block; raises errors like ``prepare``."""
    blocks, length = BlockSpool(), 0.0
    chain, tolerances = PathChain(transform, settings, stands=stands), ToleranceUse()
    finder = None
    if stream.start.line:
        finder = StartFinder(transform, settings.flank_height, stream.start)

    def take(done: PathPart, last: bool = False) -> None:
        nonlocal length
        tolerances.require(done.segments)
        length = length if done.path is None else float(done.path.s[-1])
        if finder is not None:
            finder.path(done.path, last)

    try:
        with at_fault(stream.source):
            for part in stream:
                blocks.append(part)
                tolerances.blocks(part)
                if finder is not None:
                    finder.blocks(part)
                for batch in batches(part):
                    take(chain.push(batch))
                    told(stream.share)
            take(chain.finish(), last=True)
            stream.note(chain.notice)
        start = finder.found() if finder is not None else None
        if not (length > 0.0 or may_rest):
            raise no_motion(stream.source)
    except OSError as problem:
        blocks.close()
        raise InterpError(
            f'the checked blocks cannot be stored: {problem.strerror}; set TMPDIR to a folder '
            'with room for 150 bytes per block'
        ) from None
    except BaseException:
        blocks.close()
        raise
    functions = stream.functions
    if start is not None:
        start = start.after(functions, transform.machine.signals)
    return Prepared(
        blocks,
        (*stream.read_as, *stream.notices),
        text,
        settings,
        length,
        np.sort(chain.stops),
        setup,
        settings.setup is not None,
        stream.changes,
        stream.used,
        stream.modes,
        functions,
        start,
        stream.waits_first,
        probe=stream.probe,
        stream=stream,
    )


class Preparation:
    def __init__(self) -> None:
        self.future: Future[Prepared] | None = None
        self.prepared: Prepared | None = None
        self.checked = 0.0  # share of the text that is read and checked
        self.cancelled = False

    def has_checked(self, share: float) -> None:
        """Store the progress of the check; raise BlockError if the user has cancelled."""
        self.checked = share
        if self.cancelled:
            raise BlockError('cancelled before anything moved')

    def look(self) -> Outcome | None:
        """Return the outcome if the program was rejected; store the program once it is checked."""
        if self.prepared is not None or self.future is None or not self.future.done():
            return None
        try:
            self.prepared = self.future.result()
        except ProgramError as problem:
            return Outcome(Code.BAD_PROGRAM, str(problem))
        except Exception as problem:
            known = isinstance(problem, InterpError)
            text = str(problem) if known else f'{type(problem).__name__}: {problem}'
            return Outcome(Code.CANCELED if self.cancelled else Code.REFUSED, text)
        return None

    def again(self, future: Future[Prepared]) -> None:
        if self.prepared is not None:
            self.prepared.blocks.close()
        self.prepared, self.future, self.checked = None, future, 0.0

    def close(self) -> None:
        self.cancelled = True
        if self.prepared is not None:
            self.prepared.blocks.close()
            if self.prepared.stream is not None:
                self.prepared.stream.close()
