"""
The whole chain without ROS: blocks -> segments -> axes -> motion law -> setpoints -> plan files.

The ROS nodes run the same rooms in the same order, one room per node; see ``data_flow.md``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cnc_interp.core.errors import BlockError, ProgramError
from cnc_interp.core.units import MM
from cnc_interp.feedrate.limits import limits_at
from cnc_interp.feedrate.window import FeedPlanner, PlannedPiece
from cnc_interp.kinematics.axis_rates import traits_of
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.kinematics.transform import Transform
from cnc_interp.program import Program, ProgramStream
from cnc_interp.program.blocks import Blocks
from cnc_interp.run.interpolator import Interpolator, Setpoints
from cnc_interp.run.plan_writer import PlanFigures, PlanWriter
from cnc_interp.settings.choices import Settings
from cnc_interp.smoothing.path_smoother import PathSmoother
from cnc_interp.smoothing.segments import PathSegments

#: Blocks that go through the chain together: up to 0.7 MB each, for the samples of their corners.
BATCH = 256


@dataclass(frozen=True)
class Plan:
    """A planned program: everything from blocks to setpoints, and how long planning took."""

    program: Program
    machine: Machine
    settings: Settings
    segments: PathSegments
    pieces: list[PlannedPiece]
    setpoints: Setpoints
    planning_time: dict[str, float]


class Chain:
    """
    Rooms from look-ahead to interpolator, fed with blocks.

    Parameters
    ----------
    machine : Machine
        The machine.
    settings : Settings
        The user's choices.

    """

    def __init__(self, machine: Machine, settings: Settings):
        transform = Transform.of(machine)
        self.lookahead = PathSmoother(settings, traits_of(transform))
        self.builder = AxisPathBuilder(
            transform, settings.flank_height, settings.interpolation_period
        )
        self.planner = FeedPlanner(limits_at(machine, settings.interpolation_period))
        self.interpolator = Interpolator(settings.interpolation_period)
        self.seconds = {'smoothing': 0.0, 'kinematics': 0.0, 'feedrate': 0.0, 'interpolation': 0.0}
        self.segments: list[PathSegments] = []
        self.pieces: list[PlannedPiece] = []
        self.setpoints: list[Setpoints] = []
        self.moved = False

    def push(self, blocks: Blocks) -> None:
        """Send further blocks through all rooms."""
        self._through(self._timed('smoothing', self.lookahead.push, blocks))

    def finish(self) -> None:
        """Bring the motion to its end."""
        self._through(self._timed('smoothing', self.lookahead.finish))
        self._sample(self._timed('feedrate', self.planner.finish))
        if self.moved:
            self.setpoints.append(self.interpolator.finish())

    def drain(self, writer: PlanWriter) -> None:
        """Write what has come out so far, and forget it."""
        for segments in self.segments:
            writer.segments(segments)
        for piece in self.pieces:
            writer.piece(piece)
        for samples in self.setpoints:
            writer.setpoints(samples)
        self.segments, self.pieces, self.setpoints = [], [], []

    def _through(self, segments: PathSegments) -> None:
        """Pass final segments on."""
        self.segments.append(segments)
        path = self._timed('kinematics', self.builder.push, segments)
        if path is not None:
            self._sample(self._timed('feedrate', self.planner.push, path))

    def _sample(self, pieces: list[PlannedPiece]) -> None:
        """Interpolate what the planner committed."""
        for piece in pieces:
            self.moved = True
            self.pieces.append(piece)
            self.setpoints.append(self._timed('interpolation', self.interpolator.push, piece))

    def _timed(self, room: str, work: Callable[..., Any], *arguments: Any) -> Any:
        """Run one room and add up its time."""
        start = time.perf_counter()
        try:
            return work(*arguments)
        finally:
            self.seconds[room] += time.perf_counter() - start


def plan_program(
    program: Program,
    machine: Machine,
    settings: Settings | None = None,
) -> Plan:
    """
    Plan a whole program and keep everything; ``plan_to_files`` keeps nothing.

    Parameters
    ----------
    program : Program
        What was read.
    machine : Machine
        The machine it shall run on.
    settings : Settings, optional
        The user's choices.

    Returns
    -------
    Plan
        Setpoints and all that led to them.

    Raises
    ------
    InterpError
        If the program cannot run on the machine; the message names line, axis and value.

    """
    settings = settings or Settings()
    chain = Chain(machine, settings)
    blocks = program.blocks
    with at_fault(program.source):
        for first in range(0, len(blocks), BATCH):
            chain.push(blocks[first : first + BATCH])
        chain.finish()
    if not chain.moved:
        raise no_motion(program.source)
    return Plan(
        program=program,
        machine=machine,
        settings=settings,
        segments=PathSegments.concatenate(chain.segments),
        pieces=chain.pieces,
        setpoints=Setpoints.concatenate(chain.setpoints),
        planning_time=chain.seconds,
    )


def plan_to_files(
    stream: ProgramStream,
    machine: Machine,
    directory: Path,
    settings: Settings | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """
    Plan a program while it is read and write its plan files; memory does not grow with it.

    Parameters
    ----------
    stream : ProgramStream
        The program, not read yet.
    machine : Machine
        The machine it shall run on.
    directory : Path
        For the plan files; files in it are replaced once all is planned.
    settings : Settings, optional
        The user's choices.
    progress : callable, optional
        Told the share of the text that has been planned, 0 to 1.

    Returns
    -------
    dict
        The summary as written to ``summary.json``; SI units.

    Raises
    ------
    InterpError
        If the program cannot be read, or cannot run on the machine.

    """
    settings = settings or Settings()
    chain = Chain(machine, settings)
    with PlanWriter(directory, machine, settings) as writer:
        with at_fault(stream.source):
            for part in stream:
                writer.blocks(part)
                for first in range(0, len(part), BATCH):
                    chain.push(part[first : first + BATCH])
                    chain.drain(writer)
                if progress:
                    progress(stream.share)
            chain.finish()
            chain.drain(writer)
        if not chain.moved:
            raise no_motion(stream.source)
        return writer.finish(stream.source, chain.seconds)


@contextmanager
def at_fault(source: str) -> Iterator[None]:
    """Name the program in refusals of its blocks."""
    try:
        yield
    except BlockError as problem:
        problem.source = source
        raise


def no_motion(source: str) -> ProgramError:
    """Make the error of a program that moves nothing."""
    return ProgramError('holds no motion; add blocks after the start pose', source)


def summary_of(plan: Plan) -> dict[str, Any]:
    """Return the plan's summary as written to ``summary.json``; SI units."""
    figures = PlanFigures(plan.machine, plan.settings)
    pass_on(plan, figures)
    return figures.summary(plan.program.source, plan.planning_time)


def write_plan(plan: Plan, directory: Path) -> None:
    """
    Write the plan files (README, "Plan files"); everything in SI.

    Parameters
    ----------
    plan : Plan
        What was planned.
    directory : Path
        Created if missing; files in it are replaced.

    """
    with PlanWriter(directory, plan.machine, plan.settings) as writer:
        pass_on(plan, writer)
        writer.finish(plan.program.source, plan.planning_time)


def pass_on(plan: Plan, taker: PlanWriter | PlanFigures) -> None:
    """Hand over a whole plan."""
    taker.blocks(plan.program.blocks)
    taker.segments(plan.segments)
    for piece in plan.pieces:
        taker.piece(piece)
    taker.setpoints(plan.setpoints)


def describe(summary: dict[str, Any]) -> str:
    """Return the summary in words and shop units."""
    lines = [
        f'program        {summary["program"]} on {summary["machine"]}',
        f'blocks         {summary["blocks"]} in {summary["segments"]} segments, '
        f'{summary["path_length"] / MM:.1f} mm',
        f'cycle time     {summary["cycle_time"]:.3f} s',
        f'planning time  {summary["planning_time"]:.3f} s '
        f'(the motion takes {summary["cycle_time"] / max(summary["planning_time"], 1e-9):.3g} '
        'times as long)',
    ]
    for name, use in summary['largest_use'].items():
        values = '  '.join(f'{axis} {ratio:6.1%}' for axis, ratio in use.items())
        lines.append(f'{name:<15}{values}')
    contour, orientation, height = (
        summary[key] / MM
        for key in ('largest_contour_error', 'largest_orientation_error', 'flank_height')
    )
    used, curves = summary['tolerance_used'], summary['curves']
    lines.append(
        f'deviation      contour {contour:.4f} mm, orientation {orientation:.4f} mm at '
        f'{height:g} mm; {used["contour"]:.0%} and {used["orientation"]:.0%} of the tolerances'
    )
    if curves['blocks']:
        lines.append(
            f'curves         {curves["blocks"]} blocks as {curves["spans"]} spans, '
            f'{curves["spans"] / curves["blocks"]:.2f} a block'
        )
    return '\n'.join(lines)
