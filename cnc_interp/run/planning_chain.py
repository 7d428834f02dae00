"""The whole planning without ROS: blocks, segments, axes, motion law, setpoints."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from cnc_interp.core import BlockError, FloatArray, InterpError, PlanningError, ProgramError
from cnc_interp.core.compile_time import working_time
from cnc_interp.feedrate.limit_use import limits_at
from cnc_interp.feedrate.planner_tuning import PlanOptions, wanted_tool
from cnc_interp.feedrate.planning_windows import FeedPlanner, PlannedPiece
from cnc_interp.machine_model.joint_chain import JointChain
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import ProgramStream
from cnc_interp.program.blocks import Blocks
from cnc_interp.run.clearance_stage import ClearanceStage
from cnc_interp.run.course import feed_under
from cnc_interp.run.parallel_planner import ParallelPlanner, Planning
from cnc_interp.run.path_chain import PathChain, PathPart, Stopwatch, batches
from cnc_interp.run.plan_writer import PlanWriter
from cnc_interp.run.setpoints import Interpolator, Setpoints
from cnc_interp.run.start_place import StartFinder
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.segments import PathSegments

#: Planning stages, in order; their computing times are reported.
STAGES = ('smoothing', 'kinematics', 'collision', 'feedrate', 'interpolation')


class Sink(Protocol):
    segments: Callable[[PathSegments], None]
    piece: Callable[[PlannedPiece], None]
    certificates: Callable[[Any], None]

    @property
    def setpoints(self) -> Callable[[Setpoints], None] | None:
        """Function that receives the setpoints; None if the motion is not sampled."""


class Chain:
    def __init__(
        self,
        machine: Machine,
        settings: Settings,
        sink: Sink | PlanWriter,
        clock: Callable[[], float] = working_time,
        start: StartFinder | None = None,
        processes: int = 1,
        setup: str = '',
        spun: tuple[Transform, FloatArray] | None = None,
    ):
        self._sink, self._watch, self._start = sink, Stopwatch(clock), start
        self.path = PathChain(Transform.of(machine), settings, self._watch, spun)
        period = settings.interpolation_period
        tool = wanted_tool(machine, settings)
        planning = Planning(limits_at(machine, period), PlanOptions(), tool)
        self._parallel = ParallelPlanner(planning, processes) if processes > 1 else None
        self._planner: ParallelPlanner | FeedPlanner = self._parallel or planning.planner()
        self._interpolator, self._limits = Interpolator(period), planning.limits
        self.overrides = 1.0, 1.0  #: Factors on the feed and on the speed of rapids [-].
        self.clearance = ClearanceStage.of(machine, settings, setup)
        self.moved = False
        self.row_planned = 0  # last row of the program that has been planned

    @property
    def seconds(self) -> dict[str, float]:
        return {stage: self._watch.seconds.get(stage, 0.0) for stage in STAGES}

    def close(self) -> None:
        if self._parallel is not None:
            self._parallel.close()

    @contextmanager
    def refusals_in_order(self) -> Iterator[None]:
        """Context: raise the first error in program order; reading is ahead of planning."""
        try:
            yield
        except PlanningError:
            raise
        except InterpError:
            self._planner.refuse()
            raise

    def push(self, blocks: Blocks) -> None:
        self._plan(self.path.push(blocks))

    def finish(self) -> None:
        self._plan(self.path.finish(), last=True)
        if self.clearance is not None and self.clearance.refused:
            return
        self._pass_on(self._watch.timed('feedrate', self._planner.finish))
        if self.moved and self._sink.setpoints is not None:
            self._sink.setpoints(self._interpolator.finish())

    def _plan(self, part: PathPart, last: bool = False) -> None:
        segments, path = part.segments, part.path
        if self._start is not None:
            segments, path = self._start.segments(segments), self._start.path(path, last)
            if self.clearance is not None and self._start.before is not None:
                self._watch.timed('collision', self.clearance.pass_by, self._start.before)
        self._sink.segments(segments)
        if path is not None and self.clearance is not None:
            found = self._watch.timed('collision', self.clearance.check, path)
            self._sink.certificates(found)
            self.moved |= self.clearance.refused
            path = None if self.clearance.refused else path  # only its hits are still of interest
        if path is not None:
            if self.overrides != (1.0, 1.0):
                path = replace(path, cell_feed=feed_under(path, self._limits, *self.overrides))
            self._pass_on(self._watch.timed('feedrate', self._planner.push, path))

    def _pass_on(self, pieces: list[PlannedPiece]) -> None:
        for piece in pieces:
            self._sink.piece(piece)
            if self._sink.setpoints is not None:
                parts = self._interpolator.parts(piece)
                while (found := self._watch.timed('interpolation', next, parts, None)) is not None:
                    self._sink.setpoints(found)
            self.moved, self.row_planned = True, int(piece.path.cell_block[-1])


def plan_to_files(
    stream: ProgramStream,
    machine: Machine,
    directory: Path,
    settings: Settings | None = None,
    progress: Callable[[float], None] = lambda _: None,
    processes: int = 1,
    save_stock: bool = False,
    stages: int = 0,
) -> dict[str, Any]:
    """Plan a program while it is read, and write its plan files, in constant memory.

    ``progress``: called with the planned share; ``processes``: number of planning processes, which
    does not change the files; ``save_stock``: whether to write the remaining stock; ``stages``:
    number of drawings of the stock. Returns the summary in SI units, or raises InterpError.
    """
    settings = settings or Settings()
    start, geometry = None, Transform.of(machine)
    if stream.start.line:
        start = StartFinder(geometry.five_axis, settings.flank_height, stream.start)
    with PlanWriter(directory, machine, settings) as writer:
        with planned(stream, geometry, settings, writer, start, processes, progress) as chain:
            if chain.clearance is not None:
                chain.clearance.require(stream.source)
                writer.figures.clearance = chain.clearance.summary()
                writer.stock(chain.clearance.stock_columns())
                if save_stock:
                    chain.clearance.save_stock(directory)
                chain.clearance.save_stages(directory, stages)
            writer.functions = stream.functions
            writer.figures.waits_first = stream.waits_first
            if start is not None:
                writer.figures.start = start.found().after(writer.functions, machine.signals)
                writer.functions = start.functions(writer.functions)
        return writer.finish(stream.source, chain.seconds, setup=stream.setup)


def spun_for(
    program: Blocks, transform: Transform, settings: Settings
) -> tuple[Blocks, tuple[Transform, FloatArray] | None, str]:
    """Choose the spins of an arm; return blocks, argument ``spun`` of ``Chain``, and a text.

    The blocks have chosen positions of a rail or positioner, see ``further_joints.py``.
    """
    if settings.spin == 'fixed' or not isinstance(transform, JointChain):
        return program, None, ''
    if program.extra.shape[1] > len(transform.machine.extra_names):
        return program, None, 'the poses give the spin'
    from cnc_interp.run.further_joints import placed
    from cnc_interp.run.spin_choice import SpinSearch

    blocks = placed(program, transform)
    choice = SpinSearch(transform, settings, blocks).chosen()
    return blocks, (choice.chain, choice.spins), choice.why


@contextmanager
def planned(
    stream: ProgramStream,
    transform: Transform,
    settings: Settings,
    sink: Any,
    start: StartFinder | None = None,
    processes: int = 1,
    progress: Callable[[float], None] = lambda _: None,
    overrides: tuple[float, float] = (1.0, 1.0),
) -> Iterator[Chain]:
    """Context: plan a program while it is read; ``sink`` receives the plan. Yields the chain."""
    parts = iter(stream)
    spun = None
    if settings.spin != 'fixed' and transform.machine.arm is not None:
        with at_fault(stream.source):
            program = Blocks.concatenate(list(parts))
            program, spun, why = spun_for(program, transform, settings)
        stream.note((int(program.line_number[0]), why))
        parts = iter([program])
    chain = Chain(
        transform.machine,
        settings,
        sink,
        start=start,
        processes=processes,
        setup=stream.setup,
        spun=spun,
    )
    chain.overrides = overrides
    with closing(chain), at_fault(stream.source), chain.refusals_in_order():
        rows_read, told = 0, 0.0
        for part in parts:
            own = part if start is None else start.blocks(part)
            sink.blocks(own)
            if chain.clearance is not None:
                functions = stream.functions
                if start is not None:
                    chain.clearance.program(part, functions)
                    functions = start.functions(functions)
                chain.clearance.rows(own, functions)
            rows_read += len(part)
            for batch in batches(part):
                chain.push(batch)
                # Planning takes most of the time, and reading is ahead of it.
                told = max(told, stream.share * chain.row_planned / rows_read)
                progress(told)
        chain.finish()
        stream.note(chain.path.notice)
        if not chain.moved:
            raise no_motion(stream.source)
        yield chain


@contextmanager
def at_fault(source: str) -> Iterator[None]:
    try:
        yield
    except BlockError as problem:
        problem.source = source
        raise


def no_motion(source: str) -> ProgramError:
    text = 'holds no motion: its first position is where the run starts; add a block after it'
    return ProgramError(text, source)
