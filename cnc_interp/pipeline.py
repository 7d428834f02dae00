"""
The whole chain without ROS: blocks -> segments -> axes -> motion law -> setpoints -> plan files.

The ROS nodes run the same rooms in the same order, one room per node; see ``docs/data_flow.md``.
"""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp import __version__
from cnc_interp.errors import BlockError, ProgramError
from cnc_interp.feedrate.limits import feed_limit
from cnc_interp.feedrate.window import FeedPlanner, PlannedPiece
from cnc_interp.interpolator import Interpolator, Setpoints
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.kinematics.axis_rates import jerk_rates
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.kinematics.transform import Transform
from cnc_interp.program import Program
from cnc_interp.program.blocks import Blocks, FloatArray
from cnc_interp.smoothing.lookahead import SmoothingOptions
from cnc_interp.smoothing.path_smoother import PathSmoother
from cnc_interp.smoothing.segments import PathSegments
from cnc_interp.units import MM, MS

#: Blocks that go through the chain together.
BATCH = 512


@dataclass(frozen=True)
class ChainOptions:
    """
    What the user may choose about the chain.

    Parameters
    ----------
    flank_height : float
        Height at which the orientation tolerance is measured [m].
    ratio : float, optional
        L2/L1 of all corners [-]; None: chosen for each.
    parametrization, top, septic
        How corners are made; see SmoothingOptions.
    period : float
        Interpolation period [s].

    """

    flank_height: float = 30.0 * MM
    ratio: float | None = None
    parametrization: str = 'exact'
    top: str = 'in_step'
    septic: bool = False
    period: float = 1.0 * MS


@dataclass(frozen=True)
class Plan:
    """A planned program: everything from blocks to setpoints, and how long planning took."""

    program: Program
    machine: Machine
    options: ChainOptions
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
    options : ChainOptions
        The user's choices.

    """

    def __init__(self, machine: Machine, options: ChainOptions):
        transform = Transform.of(machine)
        self.lookahead = PathSmoother(smoothing_options(transform, options))
        self.builder = AxisPathBuilder(transform, options.flank_height)
        self.planner = FeedPlanner(machine)
        self.interpolator = Interpolator(options.period)
        self.seconds = {'smoothing': 0.0, 'kinematics': 0.0, 'feedrate': 0.0, 'interpolation': 0.0}
        self.segments: list[PathSegments] = []
        self.pieces: list[PlannedPiece] = []
        self.setpoints: list[Setpoints] = []

    def push(self, blocks: Blocks) -> None:
        """Send further blocks through all rooms."""
        self._through(self._timed('smoothing', self.lookahead.push, blocks))

    def finish(self) -> None:
        """Bring the motion to its end."""
        self._through(self._timed('smoothing', self.lookahead.finish))
        self._sample(self._timed('feedrate', self.planner.finish))
        if self.pieces:
            self.setpoints.append(self.interpolator.finish())

    def _through(self, segments: PathSegments) -> None:
        """Pass final segments on."""
        self.segments.append(segments)
        path = self._timed('kinematics', self.builder.push, segments)
        if path is not None:
            self._sample(self._timed('feedrate', self.planner.push, path))

    def _sample(self, pieces: list[PlannedPiece]) -> None:
        """Interpolate what the planner committed."""
        for piece in pieces:
            self.pieces.append(piece)
            self.setpoints.append(self._timed('interpolation', self.interpolator.push, piece))

    def _timed(self, room: str, work: Callable[..., Any], *arguments: Any) -> Any:
        """Run one room and add up its time."""
        start = time.perf_counter()
        try:
            return work(*arguments)
        finally:
            self.seconds[room] += time.perf_counter() - start


def smoothing_options(transform: Transform, options: ChainOptions) -> SmoothingOptions:
    """Return the look-ahead's options for a machine (pole, axes) and the user's choices."""
    machine = transform.machine
    pole = tuple(float(x) for x in transform.pole) if machine.has_rotary else None
    return SmoothingOptions(
        flank_height=options.flank_height,
        ratio=options.ratio,
        axis_rates=partial(jerk_rates, transform),
        parametrization=options.parametrization,
        top=options.top,
        septic=options.septic,
        pole=pole,  # type: ignore[arg-type]
        pole_cone=machine.singular_cone,
    )


def plan_program(
    program: Program,
    machine: Machine,
    options: ChainOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> Plan:
    """
    Plan a whole program, as fast as possible.

    Parameters
    ----------
    program : Program
        What was read.
    machine : Machine
        The machine it shall run on.
    options : ChainOptions, optional
        The user's choices.
    progress : callable, optional
        Told the share done, 0 to 1.

    Returns
    -------
    Plan
        Setpoints and all that led to them.

    Raises
    ------
    InterpError
        If the program cannot run on the machine; the message names line, axis and value.

    """
    options = options or ChainOptions()
    chain = Chain(machine, options)
    blocks = program.blocks
    try:
        for first in range(0, len(blocks), BATCH):
            chain.push(blocks[first : first + BATCH])
            if progress:
                progress(min(1.0, (first + BATCH) / len(blocks)))
        chain.finish()
    except BlockError as problem:
        problem.source = program.source
        raise
    if not chain.pieces:
        raise ProgramError('holds no motion; add blocks after the start pose', program.source)
    return Plan(
        program=program,
        machine=machine,
        options=options,
        segments=PathSegments.concatenate(chain.segments),
        pieces=chain.pieces,
        setpoints=Setpoints.concatenate(chain.setpoints),
        planning_time=chain.seconds,
    )


def summary_of(plan: Plan) -> dict[str, Any]:
    """Return the plan's summary as written to ``summary.json``; SI units."""
    machine, samples, period = plan.machine, plan.setpoints, plan.options.period
    use = {}
    for order, (name, limit) in enumerate(
        (
            ('velocity', machine.max_velocity),
            ('acceleration', machine.max_acceleration),
            ('jerk', machine.max_jerk),
        ),
        start=1,
    ):
        held = np.concatenate(
            [samples.position[:1]] * order + [samples.position] + [samples.position[-1:]] * order
        )
        ratio = np.abs(np.diff(held, order, axis=0)).max(axis=0) / (limit * period**order)
        use[name] = dict(zip(machine.axis_names, ratio.tolist(), strict=True))
    return {
        'program': plan.program.source,
        'machine': machine.file or machine.name,
        'cycle_time': plan.pieces[-1].law.end_time,
        'interpolation_period': period,
        'flank_height': plan.options.flank_height,
        'samples': len(samples),
        'blocks': len(plan.program.blocks) - 1,
        'segments': len(plan.segments),
        'path_length': float(samples.s[-1]),
        'planning_time': sum(plan.planning_time.values()),
        'planning_time_by_room': plan.planning_time,
        'largest_use': use,
        'largest_contour_error': float(plan.segments.deviation[:, 0].max(initial=0.0)),
        'largest_orientation_error': float(plan.segments.deviation[:, 1].max(initial=0.0)),
        'versions': versions(),
    }


def versions() -> dict[str, str]:
    """Return the versions of what made the plan."""
    found = {'cnc_interp': __version__, 'python': platform.python_version()}
    for name in ('numpy', 'numba', 'scipy', 'toppra', 'ruckig'):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


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
    directory.mkdir(parents=True, exist_ok=True)
    samples = plan.setpoints
    np.savez(
        directory / 'setpoints.npz',
        time=samples.time, position=samples.position, velocity=samples.velocity,
        acceleration=samples.acceleration, jerk=samples.jerk, block=samples.block, s=samples.s,
    )  # fmt: skip
    np.savez(directory / 'path.npz', **path_columns(plan))
    columns = {field.name: getattr(plan.segments, field.name) for field in fields(plan.segments)}
    np.savez(directory / 'segments.npz', **columns)
    blocks = plan.program.blocks
    np.savez(
        directory / 'blocks.npz',
        tip=blocks.tip, axis=blocks.axis, feed=effective_feed(blocks, plan.options.flank_height),
        line=blocks.line_number, contour_tolerance=blocks.contour_tolerance,
        orientation_tolerance=blocks.orientation_tolerance, rapid=blocks.rapid,
        rotary=blocks.rotary, duration=blocks.duration, exact_stop=blocks.exact_stop,
        top=blocks.top, knot_interval=blocks.knot_interval,
    )  # fmt: skip
    text = json.dumps(summary_of(plan), indent=2)
    (directory / 'summary.json').write_text(text + '\n', encoding='utf-8')


def effective_feed(blocks: Blocks, flank_height: float) -> FloatArray:
    """
    Return the programmed speed of each row [m/s].

    Inverse-time feeds become length / duration; rotations of the resting tip have none (infinite).
    """
    length = np.concatenate([[0.0], np.sqrt((np.diff(blocks.tip, axis=0) ** 2).sum(axis=1))])
    timed = np.isfinite(blocks.duration) & (length > 0.0)
    feed = np.where(timed, length / np.where(timed, blocks.duration, 1.0), blocks.feedrate)
    return np.where(np.isnan(feed), np.inf, feed)


def path_columns(plan: Plan) -> dict[str, Any]:
    """Return the columns of ``path.npz``, on the planner's grid."""
    path = AxisPath.join([piece.path for piece in plan.pieces])
    pieces = plan.pieces
    tip, axis = Transform.of(plan.machine).forward(path.q)
    feed = np.concatenate([piece.law.s_dot for piece in pieces] + [[0.0]])  # one piece a cell
    cells = path.cell_feed
    programmed = np.minimum(np.r_[cells[:1], cells], np.r_[cells, cells[-1:]])
    return {
        's': path.s,
        'tip': tip,
        'axis': axis,
        'q': path.q,
        'cell_left': path.cell_left,
        'cell_right': path.cell_right,
        'programmed_feed': programmed,
        'feed_limit': feed_limit(path, plan.machine),
        'feed': feed,
        'block': np.r_[path.cell_block, path.cell_block[-1:]],
        'stop': path.stop,
    }


def describe(summary: dict[str, Any]) -> str:
    """Return the summary in words and shop units."""
    lines = [
        f'program        {summary["program"]} on {summary["machine"]}',
        f'blocks         {summary["blocks"]} in {summary["segments"]} segments, '
        f'{summary["path_length"] / MM:.1f} mm',
        f'cycle time     {summary["cycle_time"]:.3f} s',
        f'planning time  {summary["planning_time"]:.3f} s '
        f'({summary["cycle_time"] / max(summary["planning_time"], 1e-9):.0f} times faster '
        'than the motion)',
    ]
    for name, use in summary['largest_use'].items():
        values = '  '.join(f'{axis} {ratio:6.1%}' for axis, ratio in use.items())
        lines.append(f'{name:<15}{values}')
    contour, orientation, height = (
        summary[key] / MM
        for key in ('largest_contour_error', 'largest_orientation_error', 'flank_height')
    )
    lines.append(
        f'deviation      contour {contour:.4f} mm, orientation {orientation:.4f} mm at '
        f'{height:g} mm'
    )
    return '\n'.join(lines)
