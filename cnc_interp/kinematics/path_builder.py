"""
Build the AxisPath of a stream of segments: branch, whole turns, travel, singular poses.

The rotary branch is chosen at the first pose and kept; rotary axes follow continuously and are
never wrapped. Where the tool axis rests, the rotary axes rest too, so a 3-axis path on the pole is
no singularity. A great circle through the pole tilts linearly while the outer axis rests; if that
has to turn first, a rotation about the resting tip is inserted between two stops.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cnc_interp.errors import BlockError, SingularityError, TravelError
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.kinematics.sampling import (
    BRANCH,
    FINE,
    FIRST_RATE,
    SINGULAR,
    sample_segment,
    shapes_of,
)
from cnc_interp.kinematics.transform import Transform
from cnc_interp.program.blocks import BoolArray, FloatArray, IntArray
from cnc_interp.smoothing.orientation import turned_by
from cnc_interp.smoothing.segments import CORNER, ROTATION, PathSegments, corner_breaks
from cnc_interp.units import DEG, MM, MS

#: Parameters between the cells of a corner and of a line, before refinement.
CORNER_GRID = np.linspace(0.0, 1.0, 13)
LINE_GRID = np.array([0.0, 0.5, 1.0])
#: Rotary positions and tool axes that differ less are the same [rad].
SAME_ANGLE = 1e-8
#: A kink of the path shows as jerk over this period [s]; more than this share of the limit counts.
KINK_PERIOD, KINK_JERK = 1.0 * MS, 0.02
#: A great circle whose normal is this perpendicular to the pole runs through it [-].
IN_PLANE = 1e-10


def corner_grid(parametrization: FloatArray) -> FloatArray:
    """Return the first parameters of a corner's cells, its breaks among them."""
    if not len(parametrization):
        return CORNER_GRID
    breaks = corner_breaks(parametrization)
    apart = np.abs(CORNER_GRID[:, None] - breaks).min(axis=1) > 1e-3
    return np.asarray(np.unique(np.concatenate([breaks, CORNER_GRID[apart]])))


@dataclass
class Cells:
    """One segment cut into cells, before joining."""

    steps: FloatArray
    left: FloatArray
    right: FloatArray
    tips: FloatArray
    tools: FloatArray
    feed: FloatArray
    block: IntArray
    stop: bool


class AxisPathBuilder:
    """
    Turn segments into machine axes, batch by batch.

    Parameters
    ----------
    transform : Transform
        The machine's five-axis transformation.
    flank_height : float
        Height h that measures inserted rotations [m].
    start_near : ndarray, shape (2,), optional
        Rotary positions near which the first pose is solved where the program names none [rad].

    """

    def __init__(
        self,
        transform: Transform,
        flank_height: float = 30.0 * MM,
        start_near: FloatArray | None = None,
    ):
        self.transform, self.machine = transform, transform.machine
        self.flank_height = flank_height
        self._start_near = np.zeros(2) if start_near is None else np.asarray(start_near, float)
        self._rotary: FloatArray | None = None
        self._branch = 1.0
        self._may_turn_at_once = False  # at a first pose that names no rotary positions
        self._s = 0.0
        self._stopped = True
        self._end: tuple[FloatArray, FloatArray] | None = None

    def start(self, axis: FloatArray, rotary: FloatArray, line_number: int = 0) -> FloatArray:
        """
        Choose branch and whole turns at the first pose.

        Parameters
        ----------
        axis : ndarray, shape (3,)
            Tool axis of the start pose [-].
        rotary : ndarray, shape (2,)
            Rotary positions where the program names them, else NaN [rad].
        line_number : int
            For the message.

        Returns
        -------
        ndarray, shape (2,)
            Rotary positions of the start pose [rad].

        Raises
        ------
        BlockError
            If the orientation cannot be reached within the travel.

        """
        if not self.machine.has_rotary:
            self._rotary = np.zeros(2)
        elif np.isfinite(rotary).all():
            self._rotary = np.asarray(rotary, float).copy()
            self._branch = self._branch_at(self._rotary)
        else:
            self._rotary = self._nearest_start(axis, line_number)
            self._may_turn_at_once = True
        return self._rotary

    def push(self, segments: PathSegments) -> AxisPath | None:
        """
        Take further segments and return their axes; None when there are none.

        Raises
        ------
        TravelError, SingularityError, BlockError
            If an axis would leave its travel, the tool axis turns too close to the pole, or an
            orientation cannot be reached; the message names line, axis and value.

        """
        shapes = shapes_of(segments)
        parts: list[Cells] = []
        for i in range(len(segments)):
            parts.extend(self._segment(segments, shapes, i))
        return self._join(parts) if parts else None

    def _segment(self, segments: PathSegments, shapes: FloatArray, i: int) -> list[Cells]:
        """Cut one segment into cells, with a turn of the outer axis before it if it needs one."""
        if self._rotary is None:
            self.start(segments.axis[i], segments.rotary[i, 0], int(segments.line_number[i]))
        assert self._rotary is not None
        motion = self._rotary_motion(segments, i)
        parts = []
        if motion[BRANCH] == 0.0 and np.abs(motion[:2] - self._rotary).max() > SAME_ANGLE:
            if not self._may_turn_at_once:
                parts.append(self._turn_first(segments, shapes, i, motion[:2]))
            self._rotary = motion[:2].copy()
        self._may_turn_at_once = False
        parts.append(self._cells(segments, shapes, i, motion))
        turned = bool(motion[FIRST_RATE:].any())
        self._rotary = motion[:2].copy()
        if turned:
            self._branch = self._branch_at(self._rotary)
        return parts

    def _rotary_motion(self, segments: PathSegments, i: int) -> FloatArray:
        """Decide how the rotary axes move on a segment (``rotary`` of ``sampling.sample``)."""
        assert self._rotary is not None
        resting = np.array([*self._rotary, 0.0, 0.0, 0.0])
        following = np.array([*self._rotary, self._branch, 0.0, 0.0])
        if not self.machine.has_rotary:
            self._refuse_tilt(segments, i)
            return resting
        words = segments.rotary[i]
        if segments.kind[i] == ROTATION and np.isfinite(words).all():
            return np.array([*words[0], 0.0, *(words[1] - words[0])])
        if segments.kind[i] == CORNER:
            tool = segments.top[i] - segments.bottom[i]
            return resting if np.ptp(tool, axis=0).max() < 1e-12 else following
        rotation = segments.rotation[i]
        angle = float(np.sqrt(rotation @ rotation))
        if angle == 0.0:
            return resting
        if abs(rotation @ self.transform.pole) > IN_PLANE * angle:
            return following
        through = self._through_the_pole(segments.axis[i], rotation, angle)
        return following if through is None else through

    def _through_the_pole(
        self, axis: FloatArray, rotation: FloatArray, angle: float
    ) -> FloatArray | None:
        """Solve a great circle through the pole; None where the tilt is not linear along it."""
        assert self._rotary is not None
        outer, inner = self.transform.outer, 1 - self.transform.outer
        shares = np.array([0.0, 0.5, 1.0])
        tools = np.array([turned_by(axis, rotation, share) for share in shares])
        far = int(np.argmin(np.abs(tools @ self.transform.pole)))
        best: tuple[float, FloatArray] | None = None
        for pair in self.transform.rotary_solutions(tools[far]):
            turns = np.round((self._rotary[outer] - pair[outer]) / (2.0 * np.pi))
            for rate in (angle, -angle):
                path = np.empty((3, 2))
                path[:, outer] = pair[outer] + 2.0 * np.pi * turns
                path[:, inner] = pair[inner] + rate * (shares - shares[far])
                if np.abs(self.transform.tool_axis(path) - tools).max() > SAME_ANGLE:
                    continue
                gap = float(np.abs(path[0] - self._rotary).sum())
                if best is None or gap < best[0]:
                    best = gap, np.array([*path[0], 0.0, *(path[2] - path[0])])
        return None if best is None else best[1]

    def _turn_first(
        self, segments: PathSegments, shapes: FloatArray, i: int, target: FloatArray
    ) -> Cells:
        """Turn the rotary axes about the resting tip before a segment."""
        assert self._rotary is not None
        turn = target - self._rotary
        still = replace(
            segments[i : i + 1],
            kind=np.array([ROTATION]),
            length=np.array([self.flank_height * float(np.linalg.norm(turn))]),
            feed=np.full((1, 2), np.inf),
            stop=np.array([True]),
        )
        motion = np.array([*self._rotary, 0.0, *turn])
        return self._cells(still, shapes[i : i + 1], 0, motion)

    def _cells(
        self, segments: PathSegments, shapes: FloatArray, i: int, motion: FloatArray
    ) -> Cells:
        """Sample one segment and check what came out; ``motion`` moves on to its end."""
        kind, line = int(segments.kind[i]), int(segments.line_number[i])
        linear = motion[BRANCH] == 0.0
        status, early, steps, left, right, tips, tools = sample_segment(
            self.transform.packed,
            0.0 if linear else float(np.sin(self.machine.singular_cone)),
            len(self.machine.axis_names),
            kind,
            shapes[i],
            segments.parametrization[i],
            segments.length[i],
            motion,
            corner_grid(segments.parametrization[i]) if kind == CORNER else LINE_GRID,
        )
        if status != FINE:
            self._refuse_orientation(status, line)
        q = np.concatenate([left[0], right[0, -1:]])
        self._check_travel(q, line)
        if kind == ROTATION and linear:  # the tool axis follows the rotary axes
            tools = self.transform.tool_axis(q[:, 3:])
        half = (np.arange(len(steps)) >= early).astype(int) if kind == CORNER else 1
        feed = np.broadcast_to(segments.feed[i, half], len(steps))
        block = np.broadcast_to(segments.block[i, half], len(steps))
        return Cells(steps, left, right, tips, tools, feed, block, bool(segments.stop[i]))

    def _join(self, parts: list[Cells]) -> AxisPath:
        """Put parts together into a piece of path that begins where the last one ended."""
        steps = np.concatenate([part.steps for part in parts])
        s = self._s + np.concatenate([[0.0], np.cumsum(steps)])
        stop = np.zeros(len(s), dtype=bool)
        stop[0] = self._stopped
        stop[np.cumsum([len(part.steps) for part in parts])] = [part.stop for part in parts]
        left = np.concatenate([part.left for part in parts], axis=1)
        right = np.concatenate([part.right for part in parts], axis=1)
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
        """
        Tell at which grid points q_s or q_ss jump so far that the tool must rest, shape (n,).

        Within one period a jump of q_s at speed v is a jerk of |jump| v / T^2, one of q_ss a jerk
        of |jump| v^2 / T. Exact corners jump by rounding only; ``linear`` and ``paper`` do not.
        """
        speed = np.minimum(feed_left, feed_right)[:, None]
        speed = np.minimum(speed, self.machine.max_velocity / np.maximum(np.abs(left[1]), 1e-12))
        speed = speed.min(axis=1, keepdims=True)
        jerk = np.abs(right[1] - left[1]) * speed / KINK_PERIOD**2
        jerk += np.abs(right[2] - left[2]) * speed**2 / KINK_PERIOD
        return np.asarray((jerk > KINK_JERK * self.machine.max_jerk).any(axis=1))

    def _branch_at(self, rotary: FloatArray) -> float:
        """Return the branch on which rotary positions lie."""
        axis = self.transform.tool_axis(rotary[None])[0]
        gaps = [
            np.abs(np.sin(0.5 * (rotary - pair))).max()
            for pair in self.transform.rotary_solutions(axis)
        ]
        return 1.0 if not gaps or gaps[0] <= gaps[-1] else -1.0

    def _nearest_start(self, axis: FloatArray, line_number: int) -> FloatArray:
        """Take the solution within the travel that is nearest to where the machine starts."""
        low, high = self.machine.travel[3:].T
        outer, near = self.transform.outer, self._start_near
        on_pole = 1.0 - abs(axis @ self.transform.pole) < 1e-14
        found = []
        for branch, pair in zip((1.0, -1.0), self.transform.rotary_solutions(axis), strict=False):
            if on_pole:
                pair[outer] = near[outer]
            pair = pair + 2.0 * np.pi * np.round((near - pair) / (2.0 * np.pi))
            if (pair >= low).all() and (pair <= high).all():
                found.append((float(np.abs(pair - near).sum()), -branch, pair))
        if not found:
            raise BlockError(
                f'no rotary position of machine {self.machine.name} within its travel reaches '
                f'the tool axis ({axis[0]:.4f}, {axis[1]:.4f}, {axis[2]:.4f})',
                line_number,
            )
        _, minus_branch, pair = min(found, key=lambda option: option[:2])
        self._branch = -minus_branch
        return np.asarray(pair)

    def _refuse_tilt(self, segments: PathSegments, i: int) -> None:
        """Refuse a tilted tool on a machine without rotary axes."""
        if segments.axis[i, 2] < 1.0 - 1e-12 or np.abs(segments.rotation[i]).max() > 1e-12:
            raise BlockError(
                f'a tilted tool needs rotary axes, and machine {self.machine.name} has none; '
                'choose a 5-axis machine',
                int(segments.line_number[i]),
            )

    def _refuse_orientation(self, status: int, line: int) -> None:
        """Say why the tool axis of a segment cannot be followed."""
        if status == SINGULAR:
            name = self.machine.axis_names[3 + self.transform.outer]
            raise SingularityError(
                f'the turning tool axis comes closer than {self.machine.singular_cone / DEG:g} '
                f'deg to the direction where axis {name} is undefined; tilt the workpiece or the '
                'path',
                line,
                name,
            )
        raise BlockError(f'machine {self.machine.name} cannot reach the tool axis', line)

    def _check_travel(self, q: FloatArray, line: int) -> None:
        """Refuse positions outside the travel of an axis."""
        low, high = self.machine.travel.T
        outside = np.argwhere((q < low) | (q > high))
        if not len(outside):
            return
        row, axis = outside[0]
        name, value = self.machine.axis_names[axis], float(q[row, axis])
        unit, word = (MM, 'mm') if axis < 3 else (DEG, 'deg')
        raise TravelError(
            f'axis {name} would have to go to {value / unit:.3f} {word}, outside its travel '
            f'{low[axis] / unit:g} ... {high[axis] / unit:g} {word}; move the workpiece',
            line,
            name,
            value,
        )
