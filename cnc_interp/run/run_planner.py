"""Plan one run: from the segments of a program to chunks; without ROS or a clock."""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cnc_interp.core import FloatArray, IntArray, PlanningError
from cnc_interp.feedrate.limit_use import limits_at
from cnc_interp.feedrate.planner_tuning import wanted_tool
from cnc_interp.kinematics.axis_path import AxisPath, evaluate
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.blocks.functions import Functions
from cnc_interp.run.clearance_stage import LiveClearance
from cnc_interp.run.course import SAME, from_place, to_place
from cnc_interp.run.motion_plan import MotionPlan, MotionStream
from cnc_interp.run.overrides import OperatorSettings
from cnc_interp.run.setpoints import NO_FUNCTIONS, Chunk, Wait
from cnc_interp.run.start_place import approach, approach_inside
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.segments import PathSegments

ON_PATH = 1e-8  #: A machine nearer to the path than this is on it [m, rad].
#: If more source lines are stored, those of executed blocks are dropped.
LINES_KEPT = 4096

#: A plan joins another one in motion only once this much of it is planned [s]. A slow planner then
#: delays the change, but the machine does not run out of setpoints.
JOIN_RESERVE = 0.2


class Revision(NamedTuple):
    number: int
    plan: MotionPlan
    chunks: list[Chunk]


class RunPlanner:
    """The planning of one run from the top, or from path position ``continue_at`` [m].

    ``stands``: positions of the axes at rest. If ``continue_at`` is given and the axes are off the
    path, or if ``asks`` is set, the machine first waits for cycle_start.
    """

    def __init__(
        self,
        transform: Transform,
        choices: Settings,
        chunk_time: float,
        stands: FloatArray,
        continue_at: float = math.nan,
        settings: OperatorSettings | None = None,
        asks: bool = False,
    ):
        self._transform, self._choices, self._stands = transform, choices, stands
        machine, period = transform.machine, choices.interpolation_period
        self._builder = AxisPathBuilder(transform, choices.flank_height, period, stands=stands)
        self.stream = MotionStream(
            limits_at(machine, period),
            period,
            max(1, round(chunk_time / period)),
            self.line_of,
            settings,
            wanted_tool(machine, choices),
            machine.signals,
        )
        self._lines: dict[int, int] = {}
        self._lines_left = 0  # when some were last dropped
        self._enough = round(JOIN_RESERVE / period)
        self._asks = asks
        #: Check of clearances; None without a scene.
        self.clearance = LiveClearance.of(machine, choices, self.line_of)
        self._starts: tuple[float, FloatArray] | None = None  # place and axis positions
        self._continue_at = continue_at if continue_at > 0.0 else None

    def push(
        self, segments: PathSegments, pauses: dict[int, Wait], functions: Functions = NO_FUNCTIONS
    ) -> None:
        """Add segments and functions; ``pauses``: block -> wait after it (M0, M1)."""
        self._note_lines(segments)
        waits = functions.waits(self._transform.machine.signals)
        self.stream.pause_blocks |= dict.fromkeys((waits - 1).tolist(), Wait.FUNCTION) | pauses
        self.stream.functions.push(functions)
        if self.clearance is not None:
            self.clearance.call_tools(functions)
        path = self._builder.push(segments)
        if path is None:
            return
        if self._starts is None:
            found = self._begin(path)
            if found is None:
                return
            path = found
        self._check(path)
        self.stream.push(path)

    def _check(self, path: AxisPath) -> None:
        if self.clearance is not None:
            self.clearance.check(path)

    def _pass_by(self, path: AxisPath | None) -> None:
        if self.clearance is not None and path is not None:
            self.clearance.pass_by(path)

    def _begin(self, path: AxisPath) -> AxisPath | None:
        """Queue the approach; return the path after the start of the run, or None."""
        if self._continue_at is None:
            start = np.array(path.cell_left[0, 0])
            way = self._way(self._stands, start, inside=False)
            if way is not None:
                self.stream.push(way)
                self.stream.end_leg(Wait.NOTHING)
            self._starts = float(path.s[0]), start
            return path
        if path.s[-1] <= self._continue_at + SAME:
            self._pass_by(path)
            return None
        self._pass_by(to_place(path, self._continue_at))
        there = evaluate(path, np.array([self._continue_at]))[0][0]
        away = np.abs(there - self._stands).max() > ON_PATH
        if away or self._asks:
            self.stream.end_leg(Wait.APPROACH)  # the operator sees the approach before it begins
        if away and (way := self._way(self._stands, there, inside=True)) is not None:
            self.stream.push(way)
            self.stream.end_leg(Wait.NOTHING)
        self._starts = self._continue_at, there
        return from_place(path, self._continue_at)

    def _way(self, stands: FloatArray, there: FloatArray, inside: bool) -> AxisPath | None:
        """Return the approach from rest to positions ``there``; ``inside``: not at the top."""
        choices, height = self._choices, self._choices.flank_height
        if inside:
            how = choices.retract, choices.plunge_feed
            way = approach_inside(self._transform, height, stands, there, *how)
        else:
            way = approach(self._transform, height, stands, there)
        if way is not None:
            self._check(way)
        return way

    def finish(self) -> None:
        """End the path; raise PlanningError if it ends before the start of the run."""
        if self._starts is None:
            raise PlanningError(
                'the program ends before the position where the run continues; reset'
            )
        self.stream.end_leg(Wait.END)

    def work(self, plan: MotionPlan, sample: bool, executed: float) -> list[Chunk]:
        self.stream.release(executed)
        if sample and plan.can_sample:
            return plan.sample()
        if plan.can_plan:
            plan.plan()
        return []

    def resume(self, s: float, stands: FloatArray, settings: OperatorSettings) -> None:
        """Replan from rest at path position ``s`` [m]; axes moved by hand first return there."""
        rest = self.stream.course.rest_at(s)
        there = None if rest is None else rest.position[0]
        if there is not None and np.abs(there - stands).max() <= ON_PATH:
            self.stream.resume(s, settings)
            return
        inside = True
        if self._starts is not None and s <= self._starts[0]:  # the machine was on the approach
            (s, there), inside = self._starts, self._continue_at is not None
        if there is None:
            raise PlanningError('the position where the run continues is no longer known; reset')
        self.stream.resume(s, settings, self._way(stands, there, inside))

    def revise(self, number: int, settings: OperatorSettings) -> Revision | None:
        """Return a revision with other settings that joins after setpoint ``number``, or None."""
        plan, chunks, count = self.stream.revision(number, settings), [], 0
        if plan is None:
            return None
        try:
            while count < self._enough and (plan.can_sample or plan.can_plan):
                if plan.can_sample:
                    chunks += plan.sample()
                    count = sum(len(chunk.samples) for chunk in chunks)
                else:
                    plan.plan()
        except PlanningError:
            return None
        enough = count >= self._enough or (chunks and chunks[-1].wait is not Wait.NOTHING)
        return Revision(number, plan, chunks) if enough else None

    def _note_lines(self, segments: PathSegments) -> None:
        lines = self._lines
        if len(lines) > LINES_KEPT + 2 * self._lines_left:
            first = self.stream.course.first_block
            lines = {block: line for block, line in lines.items() if block >= first}
            self._lines_left = len(lines)
        for (first, last), line in zip(segments.block, segments.line_number, strict=True):
            lines.setdefault(int(first), int(line))
            lines[int(last)] = int(line)
        self._lines = lines

    def line_of(self, block: int) -> int:
        return self._lines.get(block, 0)

    def with_lines(self, chunk: Chunk) -> Chunk:
        samples, tail = (
            part.having(line=self._lines_of(part.block)) for part in (chunk.samples, chunk.tail)
        )
        return replace(chunk, samples=samples, tail=tail)

    def _lines_of(self, block: IntArray) -> IntArray:
        """Return the source line of each block of consecutive setpoints."""
        if not len(block):
            return block
        first, last = int(block[0]), int(block[-1])
        return np.array([*map(self.line_of, range(first, last + 1))])[block - first]
