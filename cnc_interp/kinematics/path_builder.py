"""Build the AxisPath of a stream of segments: branch, whole turns, travel, singular poses.

The branch is chosen at the first pose and kept; rotary axes rest where the tool axis rests.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cnc_interp.core import BlockError, BoolArray, FloatArray, IntArray, norm
from cnc_interp.kinematics import path_checks as checks
from cnc_interp.kinematics import segment_axes as axes
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.kinematics.pole_passage import PolePassages
from cnc_interp.kinematics.sampling import FINE, sample_segments
from cnc_interp.machine_model.joint import ARM
from cnc_interp.machine_model.joint_chain import JointChain
from cnc_interp.machine_model.transform_port import Transform, reached, start_positions
from cnc_interp.program.blocks import AXES_LINEAR, POSES
from cnc_interp.smoothing import segments as kinds
from cnc_interp.smoothing.segments import PathSegments

if TYPE_CHECKING:
    from cnc_interp.kinematics.joint_passage import JointPassages

SAME_POSE = 1e-9  #: A tool that differs from a pose by less counts as being there [m, -].
SAME_TOOL = 1e-12  #: If the tool vectors of a curve differ by less, the tool does not turn [m].
ROUNDING = 1e-14  #: Tool vectors are equal if they differ less than this share of coordinates [-].
#: A kink becomes a stop if its jerk, in one period, exceeds this share of the limit [-].
KINK_JERK = 0.02


@dataclass
class Cells:
    steps: FloatArray
    left: FloatArray
    right: FloatArray
    tips: FloatArray
    tools: FloatArray
    feed: FloatArray
    block: IntArray
    stop: BoolArray  #: Whether the motion rests at the end of each cell.
    counts: IntArray  #: Number of cells of each segment.


def _turning(one: PathSegments, start: FloatArray, end: FloatArray) -> PathSegments:
    rotary = kinds.no_rotary(1)
    rotary[0, :2] = start, end
    return replace(one, rotary=rotary)


def _spreads(segments: PathSegments) -> FloatArray:
    """Return the spread of the tool vectors of each curve, shape (n,) [m]; 0 for other kinds."""
    tool, found = segments.top - segments.bottom, np.zeros(len(segments))
    for curve, points in ((kinds.CORNER, 5), (kinds.SPLINE, 6)):
        spread = np.ptp(tool[:, :points], axis=1).max(axis=1, initial=0.0)
        bent = np.abs(segments.connection).max(axis=(1, 2), initial=0.0)
        found = np.where(segments.kind == curve, np.maximum(spread, bent), found)
    return found


class AxisPathBuilder:
    """Turns segments into machine axes, batch by batch; kinks are judged by their jerk.

    ``spins`` (n, 10): for an arm, the spin of its tool on each coming segment (``SPIN``).
    ``stands`` (n_axes,): present positions of an arm; it keeps them if its tool is in the first
    pose.
    """

    def __init__(
        self,
        transform: Transform,
        flank_height: float,
        period: float,
        spins: FloatArray | None = None,
        stands: FloatArray | None = None,
    ):
        self.transform, self.machine = transform, transform.machine
        self.flank_height, self.period = flank_height, period
        self._begun, self._branch = False, 1.0
        self._may_turn_at_once = False  # at a first pose that names no rotary positions
        self.passages: PolePassages | None = None
        self._joints: JointPassages | None = None
        self._spins, self._from = spins, stands
        if isinstance(transform, JointChain):
            self._axes = np.arange(len(self.machine.axis_names))
        else:
            extra = 5 + np.arange(len(self.machine.extra_names))
            self._axes = np.concatenate([np.arange(5 if self.machine.has_rotary else 3), extra])
            if self.machine.has_rotary:
                self.passages = PolePassages(transform.five_axis, flank_height)
        self._stands = np.zeros(max(int(self._axes[-1]) + 1, 5))  # all axes [m, rad]
        self._s = 0.0
        self._stopped = True
        self._end: tuple[FloatArray, FloatArray] | None = None
        #: The segments of the path that ``push`` returned last, with their total deviation.
        self.done: PathSegments | None = None

    @property
    def _rotary(self) -> FloatArray:
        return self._stands[3:5]

    @property
    def notice(self) -> tuple[int, str] | None:
        return None if self.passages is None else self.passages.notice

    def _start(self, segments: PathSegments) -> None:
        """Choose branch and whole turns at the first pose, unless its rotary words define them."""
        self._begun, line = True, int(segments.line_number[0])
        if isinstance(self.transform, JointChain):
            from cnc_interp.kinematics.joint_passage import JointPassages

            pose = segments.bottom[0, 0], segments.axis[0]
            beside, spin = np.split(segments.extra[0, 0], [len(self.machine.extra_names)])
            if self._from is not None:
                tip, axis = self.transform.forward(self._from[None])
                here = np.concatenate([tip[0], axis[0], self._from[ARM:]])
                if np.abs(here - np.concatenate([*pose, beside])).max() < SAME_POSE:
                    self.transform = self.transform.standing(self._from)
            if len(spin):
                self.transform = self.transform.spun(float(spin[0]) / self.flank_height)
            self._stands[:], self._branch = self.transform.start(*pose, line, beside)
            self._joints = JointPassages(self.transform, self.flank_height, self._spins)
            self._joints.begin(self._stands, self._branch)
            return
        rotary, five_axis = segments.rotary[0, 0], self.transform.five_axis
        self._rotary[:], self._branch = start_positions(
            five_axis, segments.axis[0], rotary, np.zeros(2), line
        )
        self._may_turn_at_once = not np.isfinite(rotary).all()
        if self.passages is not None:
            self.passages.begin(self._rotary, self._branch, self._may_turn_at_once)

    def push(self, segments: PathSegments) -> AxisPath | None:
        """Accept segments; return the path of those that are final, or None if none are."""
        spare = segments.extra.shape[2] - len(self.machine.extra_names)
        if len(segments) and spare not in (0, int(self.machine.arm is not None)):
            raise BlockError(
                f'the path moves {segments.extra.shape[2]} extra axes, but machine '
                f'{self.machine.name} has {len(self.machine.extra_names)}; choose another machine',
                int(segments.line_number[0]),
            )
        motion, n = self._motions(segments), len(segments)
        guides, turn_first = np.tile(axes.NO_GUIDE, (n, 1)), np.full(n, np.nan)
        if n and not self._begun:
            self._start(segments)
        passages = self.passages or self._joints
        if passages is not None and n:
            released = passages.take(segments, motion)
            segments, motion = released.segments, released.motion
            guides, turn_first = released.guides, released.turn_first
        self.done = segments
        if n and self.machine.has_rotary:
            size = np.abs([segments.top, segments.bottom]).max(axis=(0, 2, 3))
            drifts = (motion == axes.RESTING) & (_spreads(segments) >= ROUNDING * size)
            motion = np.where(drifts, axes.DRIFTING, motion)
        parts: list[Cells] = []
        first, n = 0, len(segments)
        while first < n:
            if np.isfinite(turn_first[first]):
                parts.extend(self._turn_outer(segments[first : first + 1], turn_first[first]))
            # Both together: segments that follow the tool axis, and those with rotary coordinates.
            own = segments.interpolation[first] != POSES
            changes = (segments.interpolation[first:] != POSES) != own
            changes |= (motion[first:] == axes.LINEAR) & ~own
            changes[1:] |= np.isfinite(turn_first[first + 1 :])
            ends = np.flatnonzero(changes)
            last = first + (int(ends[0]) if len(ends) else n - first)
            if last == first:
                parts.extend(self._linear(segments[first : first + 1]))
                first += 1
            else:
                run = segments[first:last]
                if own:
                    parts.extend(self._stand_at(run))
                parts.append(self._cells(run, motion[first:last], guides[first:last]))
                if own:
                    self._branch = self.transform.five_axis.branch_at(self._rotary)
                else:
                    checks.check_words(self.transform, run, parts[-1].right, parts[-1].counts)
                first = last
            self._may_turn_at_once = False
        return self._join(parts) if parts else None

    def _motions(self, segments: PathSegments) -> IntArray:
        n, kind = len(segments), segments.kind
        motion = np.full(n, axes.RESTING)
        if isinstance(self.transform, JointChain):
            return np.full(n, axes.FOLLOWING)
        if not self.machine.has_rotary:
            checks.refuse_tilt(self.machine, segments)
            return motion
        motion[_spreads(segments) >= SAME_TOOL] = axes.FOLLOWING
        angle = norm(segments.rotation)
        turning = (angle > 0.0) & ((kind == kinds.LINE) | (kind == kinds.ROTATION))
        motion[turning] = axes.FOLLOWING
        named = np.isfinite(segments.rotary[:, :2]).all(axis=(1, 2))
        motion[(kind == kinds.ROTATION) & named] = axes.LINEAR
        own = segments.interpolation
        return np.where(
            own == POSES, motion, np.where(own == AXES_LINEAR, axes.ALL_AXES, axes.LINEAR)
        )

    def _linear(self, one: PathSegments) -> list[Cells]:
        start, end = one.rotary[0, :2]
        parts = []
        if np.abs(start - self._rotary).max() > axes.SAME_ANGLE:
            if not self._may_turn_at_once:
                parts.append(self._turn_first(one, start))
            self._rotary[:] = start
        parts.append(self._cells(_turning(one, start, end), np.array([axes.LINEAR])))
        self._branch = self.transform.five_axis.branch_at(self._rotary)
        return parts

    def _turn_outer(self, one: PathSegments, turn: float) -> list[Cells]:
        outer, target = self.transform.five_axis.outer, self._rotary.copy()
        gap = turn - target[outer]
        target[outer] += gap - 2.0 * np.pi * np.round(gap / (2.0 * np.pi))
        parts = []
        if np.abs(target - self._rotary).max() > axes.SAME_ANGLE and not self._may_turn_at_once:
            parts.append(self._turn_first(one, target))
        self._rotary[:] = target
        return parts

    def _turn_first(self, one: PathSegments, target: FloatArray) -> Cells:
        turn = target - self._rotary
        still = replace(
            one,
            kind=np.array([kinds.ROTATION]),
            extra=np.repeat(one.extra[:, :1], kinds.POINTS, axis=1),
            length=np.array([self.flank_height * float(np.linalg.norm(turn))]),
            feed=np.full((1, 2), np.inf),
            stop=np.array([True]),
        )
        return self._cells(_turning(still, self._rotary, target), np.array([axes.LINEAR]))

    def _stand_at(self, run: PathSegments) -> list[Cells]:
        start = run.rotary[0, 0]
        gap = start - self._rotary
        if np.abs(gap).max() <= axes.SAME_ANGLE:
            return []
        turns = gap - 2.0 * np.pi * np.round(gap / (2.0 * np.pi))
        if np.abs(turns).max() > checks.OFF_WORDS and not self._may_turn_at_once:
            raise checks.off_words(self.machine, int(run.line_number[0]), start, self._rotary)
        parts = []
        if not self._may_turn_at_once:
            tip = run[:1]
            if run.interpolation[0] == AXES_LINEAR:
                here = np.concatenate([run.bottom[0, 0], start, run.extra[0, 0]])
                point = self.transform.forward(here[None])[0]
                tip = replace(tip, bottom=np.repeat(point[:, None], kinds.POINTS, axis=1))
            axis = self.transform.tool_axis(self._rotary[None])
            still = replace(tip, axis=axis, rotation=np.zeros((1, 3)))
            parts.append(self._turn_first(still, start))
        self._rotary[:] = start
        return parts

    def _cells(
        self, segments: PathSegments, motion: IntArray, guides: FloatArray | None = None
    ) -> Cells:
        guides = np.tile(axes.NO_GUIDE, (len(segments), 1)) if guides is None else guides
        stands = axes.Stands(self._stands, np.array([self._branch]), self.flank_height)
        status, counts, early, steps, left, right, tips, tools = sample_segments(
            self.transform.packed,
            self.transform.errors.packed,
            float(np.sin(self.machine.singular_cone)),
            self._axes,
            axes.SegmentRows.of(segments, motion),
            guides,
            stands,
        )
        self._branch = float(stands.branch[0])
        segment = np.repeat(np.arange(len(counts)), counts)
        ends = np.cumsum(counts)
        sound = slice(None if status == FINE else ends[-1] - counts[-1])
        lines = segments.line_number[segment[sound]]
        checks.check_travel(self.machine, steps[sound], left[sound], right[sound], lines)
        if status != FINE:
            line = int(segments.line_number[len(counts) - 1])
            checks.refuse(self.transform, status, line, self._stands)
        if motion[0] == axes.LINEAR and segments.kind[0] == kinds.ROTATION:
            q = np.concatenate([left[:, 0], right[-1:, 0]])
            tools = self.transform.tool_axis(q[:, 3:5])
        elif segments.interpolation[0] != POSES:
            tips, tools = reached(self.transform, np.concatenate([left[:, 0], right[-1:, 0]]))
        elif self._joints is None and (guided := guides[:, axes.GUIDE_FROM] < 1.0).any():
            q = np.concatenate([left[:, 0], right[-1:, 0]])
            there = np.append(guided[segment], guided[-1])
            there[1:] |= guided[segment]
            tools[there] = self.transform.tool_axis(q[there, 3:5])
        half = (np.arange(len(steps)) - (ends - counts)[segment] >= early[segment]).astype(int)
        stop = np.zeros(len(steps), dtype=bool)
        stop[ends[counts > 0] - 1] = segments.stop[counts > 0]
        return Cells(
            steps,
            left,
            right,
            tips,
            tools,
            segments.feed[segment, half],
            segments.block[segment, half],
            stop,
            counts,
        )

    def _join(self, parts: list[Cells]) -> AxisPath:
        steps = np.concatenate([part.steps for part in parts])
        # Added one by one, so that the bits do not depend on how the segments arrive.
        s = np.cumsum(np.concatenate([[self._s], steps]))
        stop = np.concatenate([[self._stopped], *(part.stop for part in parts)])
        left = np.concatenate([part.left for part in parts]).swapaxes(0, 1).copy()
        right = np.concatenate([part.right for part in parts]).swapaxes(0, 1).copy()
        feed = np.concatenate([part.feed for part in parts])
        before, self._end = self._end, (right[:, -1:], feed[-1:])
        if before is not None:
            stop[0] |= self._kinks(*before, left[:, :1], feed[:1])[0]
        stop[1:-1] |= self._kinks(right[:, :-1], feed[:-1], left[:, 1:], feed[1:])
        self._s, self._stopped = float(s[-1]), bool(stop[-1])
        return AxisPath(
            s=s,
            cell_left=left,
            cell_right=right,
            tip=np.concatenate([parts[0].tips[:1]] + [part.tips[1:] for part in parts]),
            axis=np.concatenate([parts[0].tools[:1]] + [part.tools[1:] for part in parts]),
            cell_feed=feed,
            cell_block=np.concatenate([part.block for part in parts]),
            stop=stop,
        )

    def _kinks(
        self, left: FloatArray, feed_left: FloatArray, right: FloatArray, feed_right: FloatArray
    ) -> BoolArray:
        """Return True for grid points where a jump of q_s or q_ss forces the tool to rest, (n,).

        In one period T at speed v, a jump of q_s is a jerk of |jump| v / T^2, and a jump of q_ss
        is a jerk of |jump| v^2 / T. At exact corners the jumps are only rounding errors.
        """
        speed = np.minimum(feed_left, feed_right)[:, None]
        speed = np.minimum(speed, self.machine.max_velocity / np.maximum(np.abs(left[1]), 1e-12))
        speed = speed.min(axis=1, keepdims=True)
        jerk = np.abs(right[1] - left[1]) * speed / self.period**2
        jerk += np.abs(right[2] - left[2]) * speed**2 / self.period
        return np.asarray((jerk > KINK_JERK * self.machine.max_jerk).any(axis=1))
