"""
First half of the chain: blocks -> smooth segments -> path in machine axes.

Everything that smooths a program uses these stages: `plan` (``chain.py``), the check of a program
before motion, the look-ahead node, replay, convert and the benchmarks. The nodes use them one by
one, because their segments come over the wire.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import ParamSpec, TypeVar

import numpy as np

from cnc_interp.core.arrays import IntArray
from cnc_interp.core.compile_time import working_time
from cnc_interp.core.errors import InterpError
from cnc_interp.feedrate.limits import limits_at
from cnc_interp.feedrate.plan_options import PlanOptions
from cnc_interp.feedrate.window import plan_path
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.machine_model.machine_traits import traits_of
from cnc_interp.machine_model.transform import Transform
from cnc_interp.program.blocks import Blocks
from cnc_interp.settings.choices import Settings
from cnc_interp.smoothing.path_smoother import PathSmoother
from cnc_interp.smoothing.segments import PathSegments

Arguments = ParamSpec('Arguments')
Made = TypeVar('Made')

#: Blocks that go through the chain together: up to 0.7 MB each, for the samples of their corners.
BATCH = 256


class Stopwatch:
    """Adds up the time that each stage takes."""

    def __init__(self, clock: Callable[[], float] = working_time):
        self._clock = clock
        self.seconds: dict[str, float] = {}

    def timed(
        self,
        stage: str,
        work: Callable[Arguments, Made],
        *arguments: Arguments.args,
        **named: Arguments.kwargs,
    ) -> Made:
        """Call the function of a stage and add up its time."""
        start = self._clock()
        try:
            return work(*arguments, **named)
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + self._clock() - start


@dataclass(frozen=True)
class PathPart:
    """The part of the path that became final with some blocks."""

    segments: PathSegments  #: Final segments; possibly none.
    path: AxisPath | None  #: The same in machine axes; None where there are none.


class PathChain:
    """
    Blocks in, segments and their path in machine axes out.

    Parameters
    ----------
    transform : Transform
        The machine's transformation.
    settings : Settings
        The choices of the run.
    watch : Stopwatch, optional
        Takes the time of both stages.

    """

    def __init__(self, transform: Transform, settings: Settings, watch: Stopwatch | None = None):
        self._smoother = smoother_of(transform, settings)
        self._builder = AxisPathBuilder(
            transform, settings.flank_height, settings.interpolation_period
        )
        self._watch = watch or Stopwatch()

    @property
    def stops(self) -> IntArray:
        """Program rows of the corners so far at which a stop was found to be faster."""
        return np.array(self._smoother.stops, dtype=np.int64)

    @property
    def notice(self) -> tuple[int, str] | None:
        """Notices about the path for the operator: source line and text."""
        return self._builder.passages.notice

    def push(self, blocks: Blocks) -> PathPart:
        """
        Add further blocks.

        Raises
        ------
        InterpError
            If a block cannot be executed on the machine; the message names line, axis and value.

        """
        return self._in_axes(self._watch.timed('smoothing', self._smoother.push, blocks))

    def finish(self) -> PathPart:
        """Bring the path to its end; raises as ``push``."""
        return self._in_axes(self._watch.timed('smoothing', self._smoother.finish))

    def _in_axes(self, segments: PathSegments) -> PathPart:
        """Turn final segments into the path of the axes."""
        path = self._watch.timed('kinematics', self._builder.push, segments)
        done = self._builder.done
        return PathPart(segments if done is None else done, path)


def smoother_of(transform: Transform, settings: Settings) -> PathSmoother:
    """Return the first stage: it makes smooth segments of blocks for a machine."""
    traits = replace(traits_of(transform), motion_time=partial(motion_time, transform, settings))
    return PathSmoother(settings, traits)


def motion_time(transform: Transform, settings: Settings, blocks: Blocks, curves: bool) -> float:
    """
    Plan a few blocks by themselves, each corner rounded unless it has an exact stop.

    Parameters
    ----------
    transform : Transform
        The machine's transformation.
    settings : Settings
        The choices of the run.
    blocks : Blocks
        The start pose and the blocks.
    curves : bool
        Whether runs of short blocks become curves.

    Returns
    -------
    float
        Time from rest to rest [s]; infinite if the machine cannot execute the blocks.

    """
    smoother = PathSmoother(replace(settings, compress=curves), traits_of(transform))
    builder = AxisPathBuilder(transform, settings.flank_height, settings.interpolation_period)
    limits = limits_at(transform.machine, settings.interpolation_period)
    try:
        parts = [builder.push(s) for s in (smoother.push(blocks), smoother.finish())]
        path = AxisPath.join([part for part in parts if part is not None])
        return plan_path(path, limits, PlanOptions(bound=False)).law.end_time
    except InterpError:
        return np.inf


def batches(blocks: Blocks) -> Iterator[Blocks]:
    """Cut blocks into batches for the chain."""
    for first in range(0, len(blocks), BATCH):
        yield blocks[first : first + BATCH]


def segments_of(blocks: Blocks, transform: Transform, settings: Settings) -> PathSegments:
    """Smooth a whole program."""
    smoother = smoother_of(transform, settings)
    parts = [smoother.push(batch) for batch in batches(blocks)]
    return PathSegments.concatenate([part for part in [*parts, smoother.finish()] if len(part)])


def path_of(blocks: Blocks, transform: Transform, settings: Settings) -> AxisPath:
    """Smooth a whole program and return its path in machine axes."""
    chain = PathChain(transform, settings)
    parts = [chain.push(batch).path for batch in batches(blocks)]
    return AxisPath.join([part for part in [*parts, chain.finish().path] if part is not None])
