"""Convert blocks to smooth segments and the path in machine axes; choose stops at corners."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import ParamSpec, TypeVar

import numpy as np

from cnc_interp.core import FloatArray, IntArray, InterpError
from cnc_interp.core.compile_time import working_time
from cnc_interp.feedrate.limit_use import limits_at
from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import plan_path
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.machine_model.machine_traits import traits_of
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.blocks import Blocks
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.path_smoother import PathSmoother
from cnc_interp.smoothing.segments import PathSegments
from cnc_interp.smoothing.stop_choice import Way

Arguments = ParamSpec('Arguments')
Made = TypeVar('Made')

#: Number of blocks per call; the samples of their corners need up to 3 MB.
BATCH = 1024
#: A stop, or lines instead of a curve, must save at least this share of the time [-].
WORTH = 5e-5


class Stopwatch:
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
        start = self._clock()
        try:
            return work(*arguments, **named)
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + self._clock() - start


@dataclass(frozen=True)
class PathPart:
    segments: PathSegments  #: Segments that are final; there may be none.
    path: AxisPath | None  #: Their path in machine axes; None without segments.


class PathChain:
    """Converts blocks to segments and their path in machine axes.

    ``spun``: for an arm with chosen spins, the arm in its first configuration and the spins for
    ``AxisPathBuilder``; ``stands``: as in ``AxisPathBuilder``.
    """

    def __init__(
        self,
        transform: Transform,
        settings: Settings,
        watch: Stopwatch | None = None,
        spun: tuple[Transform, FloatArray] | None = None,
        stands: FloatArray | None = None,
    ):
        height, period = settings.flank_height, settings.interpolation_period
        leads, spins = spun or (transform, None)
        self._smoother = smoother_of(leads, settings)
        self._builder = AxisPathBuilder(leads, height, period, spins, stands)
        self._watch = watch or Stopwatch()

    @property
    def stops(self) -> IntArray:
        """Rows of all corners so far at which a stop is faster than rounding."""
        return np.array(self._smoother.stops, dtype=np.int64)

    @property
    def notice(self) -> tuple[int, str] | None:
        return self._builder.notice

    def push(self, blocks: Blocks) -> PathPart:
        return self._in_axes(self._watch.timed('smoothing', self._smoother.push, blocks))

    def finish(self) -> PathPart:
        return self._in_axes(self._watch.timed('smoothing', self._smoother.finish))

    def _in_axes(self, segments: PathSegments) -> PathPart:
        path = self._watch.timed('kinematics', self._builder.push, segments)
        done = self._builder.done
        return PathPart(segments if done is None else done, path)


def smoother_of(transform: Transform, settings: Settings) -> PathSmoother:
    return PathSmoother(settings, traits_of(transform), partial(is_faster, transform, settings))


def is_faster(
    transform: Transform, settings: Settings, ways: Sequence[Way], others: Sequence[Way]
) -> bool:
    """Return whether the fastest of ``ways`` is faster than the fastest of ``others``."""
    first, second = (
        min((way_time(transform, settings, way) for way in some), default=np.inf)
        for some in (ways, others)
    )
    return first < (1.0 - WORTH) * second


def way_time(transform: Transform, settings: Settings, way: Way) -> float:
    """Return the motion time of a ``Way`` [s]; infinite if the machine cannot execute it."""
    # Every corner is rounded, and every run of short blocks becomes a curve.
    smoother = PathSmoother(_with_curves(settings, way.curves), traits_of(transform))
    period = settings.interpolation_period
    builder, limits = (
        AxisPathBuilder(transform, settings.flank_height, period),
        limits_at(transform.machine, period),
    )
    try:
        path = builder.push(smoother.whole(way.blocks))
        assert path is not None, 'a way moves'
        return plan_path(path, limits, PlanOptions(bound=False)).law.end_time
    except InterpError:
        return np.inf


@cache
def _with_curves(settings: Settings, curves: bool) -> Settings:
    return replace(settings, compress=curves)


def batches(blocks: Blocks) -> Iterator[Blocks]:
    for first in range(0, len(blocks), BATCH):
        yield blocks[first : first + BATCH]


def segments_of(blocks: Blocks, transform: Transform, settings: Settings) -> PathSegments:
    smoother = smoother_of(transform, settings)
    parts = [smoother.push(batch) for batch in batches(blocks)]
    return PathSegments.concatenate([part for part in [*parts, smoother.finish()] if len(part)])
