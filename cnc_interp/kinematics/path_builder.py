"""
Build the AxisPath of a stream of segments: branch, whole turns, travel, singular poses.

The rotary branch is chosen at the first pose and kept; rotary axes follow continuously and are
never wrapped. Where the tool axis rests on the pole the outer axis keeps its value; a line that
leaves the pole keeps the outer axis at the direction in which it leaves, and if the axis has to
turn there first, a rotation about the resting tip is inserted between two stops.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cnc_interp.errors import BlockError, SingularityError, TravelError
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.kinematics.sampling import (
    FREE,
    HELD,
    NO_ROTARY,
    PROGRAMMED,
    RADIAL,
    SINGULAR,
    UNREACHABLE,
    sample_segment,
)
from cnc_interp.kinematics.transform import Transform
from cnc_interp.program.blocks import FloatArray, IntArray
from cnc_interp.smoothing.orientation import turned_by
from cnc_interp.smoothing.segments import CORNER, ROTATION, PathSegments
from cnc_interp.units import DEG, MM

#: Cells of half a corner and of a line before refinement.
CORNER_GRID = np.linspace(0.0, 1.0, 13)
LINE_GRID = np.array([0.0, 0.5, 1.0])
#: Angle under which a tool axis counts as lying on the pole [rad].
ON_POLE = 1e-7
#: Rotary positions and tool axes that differ less are the same [rad].
SAME_ANGLE = 1e-8
#: A great circle whose normal is this perpendicular to the pole runs through it [-].
IN_PLANE = 1e-10


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
        self._rotary: FloatArray | None = None
        self._start_near = np.zeros(2) if start_near is None else np.asarray(start_near, float)
        self._branch = 1.0
        self._s = 0.0
        self._stopped = True
        self._start_programmed = False

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
            self._start_programmed = True
            self._branch = self._branch_of(axis, self._rotary)
        else:
            self._rotary = self._choose(axis, line_number)
        return self._rotary

    def _branch_of(self, axis: FloatArray, rotary: FloatArray) -> float:
        """Return the branch (sign of the tilt's sine) of given rotary positions."""
        solutions = self.transform.rotary_solutions(axis)
        gaps = [np.abs(np.sin(0.5 * (rotary - pair))).max() for pair in solutions]
        return 1.0 if not gaps or gaps[0] <= gaps[-1] else -1.0

    def _choose(self, axis: FloatArray, line_number: int) -> FloatArray:
        """Take the reachable solution nearest to where the machine starts."""
        travel = self.machine.travel[3:]
        found = []
        for branch, pair in zip((1.0, -1.0), self.transform.rotary_solutions(axis), strict=False):
            if self._pole_angle(axis) < ON_POLE:
                pair[self.transform.outer] = self._start_near[self.transform.outer]
            pair = pair + 2.0 * np.pi * np.round((self._start_near - pair) / (2.0 * np.pi))
            if (pair >= travel[:, 0]).all() and (pair <= travel[:, 1]).all():
                found.append((float(np.abs(pair - self._start_near).sum()), -branch, pair))
        if not found:
            raise BlockError(
                f'no rotary position of machine {self.machine.name} within its travel reaches '
                f'the tool axis ({axis[0]:.4f}, {axis[1]:.4f}, {axis[2]:.4f})',
                line_number,
            )
        _, minus_branch, pair = min(found, key=lambda option: option[:2])
        self._branch = -minus_branch
        return np.asarray(pair)

    def _pole_angle(self, axis: FloatArray) -> float:
        """Return the angle between a tool axis and the line of the pole [rad]."""
        pole = self.transform.pole
        across = float(np.linalg.norm(np.cross(axis, pole)))
        return float(np.arcsin(min(across, 1.0)))

    def push(self, segments: PathSegments) -> AxisPath | None:
        """
        Take further segments and return their axes; None when there are none.

        Raises
        ------
        TravelError, SingularityError, BlockError
            If an axis would leave its travel, the path meets the pole while the tool axis turns,
            or an orientation cannot be reached; the message names line, axis and value.

        """
        parts: list[Cells] = []
        for i in range(len(segments)):
            parts.extend(self._segment(segments, i))
        return self._join(parts) if parts else None

    def _segment(self, segments: PathSegments, i: int) -> list[Cells]:
        """Cut one segment into cells, an aligning rotation before it where the pole needs one."""
        line = int(segments.line_number[i])
        if self._rotary is None:
            self.start(segments.axis[i], segments.rotary[i, 0], line)
        assert self._rotary is not None
        mode, held = self._mode(segments, i)
        parts = []
        if mode == RADIAL and np.abs(held[:2] - self._rotary).max() > SAME_ANGLE:
            if self._s > 0.0 or self._start_programmed:
                parts.append(self._alignment(segments, i, held[:2].copy()))
            self._rotary = held[:2].copy()
        parts.append(self._cells(segments, i, mode, held))
        self._rotary = held[:2].copy()
        if mode in (RADIAL, PROGRAMMED):
            self._branch = self._sign_of_tilt(self._rotary)
        return parts

    def _mode(self, segments: PathSegments, i: int) -> tuple[int, FloatArray]:
        """Decide how the rotary axes of a segment are found, and from where."""
        assert self._rotary is not None
        held = np.array([*self._rotary, self._branch, 0.0])
        if not self.machine.has_rotary:
            self._refuse_tilt(segments, i)
            return NO_ROTARY, held
        if segments.kind[i] == ROTATION and np.isfinite(segments.rotary[i]).all():
            return PROGRAMMED, held
        if segments.kind[i] == CORNER:
            tool = segments.top[i] - segments.bottom[i]
            constant = np.ptp(tool, axis=0).max() < 1e-12
            return (HELD if constant else FREE), held
        angle = float(np.linalg.norm(segments.rotation[i]))
        if angle == 0.0:
            return HELD, held
        ends = np.array(
            [
                segments.axis[i],
                turned_by(segments.axis[i], segments.rotation[i], 1.0),
                turned_by(segments.axis[i], segments.rotation[i], 0.5),
            ]
        )
        if abs(segments.rotation[i] @ self.transform.pole) > IN_PLANE * angle:
            return FREE, held
        return self._radial(ends, angle, held)

    def _radial(self, ends: FloatArray, angle: float, held: FloatArray) -> tuple[int, FloatArray]:
        """Solve a great circle through the pole: the outer axis rests, the tilt runs linearly."""
        assert self._rotary is not None
        outer, inner = self.transform.outer, 1 - self.transform.outer
        far = max(range(3), key=lambda k: self._pole_angle(ends[k]))
        options = []
        for pair in self.transform.rotary_solutions(ends[far]):
            turns = np.round((self._rotary[outer] - pair[outer]) / (2.0 * np.pi))
            turn = pair[outer] + 2.0 * np.pi * turns
            for rate in (angle, -angle):
                rotary = np.empty(2)
                rotary[outer] = turn
                rotary[inner] = pair[inner] - rate * (0.0, 1.0, 0.5)[far]
                gap = np.abs(self.transform.tool_axis(rotary[None])[0] - ends[0]).max()
                end = rotary.copy()
                end[inner] += rate
                gap += np.abs(self.transform.tool_axis(end[None])[0] - ends[1]).max()
                if gap < SAME_ANGLE:
                    options.append((float(np.abs(rotary - self._rotary).sum()), rate, rotary))
        if not options:  # a machine whose tilt does not follow great circles through its pole
            return FREE, held
        _, rate, rotary = min(options, key=lambda option: option[:2])
        held[:2], held[3] = rotary, rate
        return RADIAL, held

    def _sign_of_tilt(self, rotary: FloatArray) -> float:
        """Return the branch that rotary positions lie on."""
        return self._branch_of(self.transform.tool_axis(rotary[None])[0], rotary)

    def _alignment(self, segments: PathSegments, i: int, target: FloatArray) -> Cells:
        """Return the rotation about the resting tip that brings the rotary axes to a target."""
        assert self._rotary is not None
        rotary = np.stack([self._rotary, target])
        turn = segments[i : i + 1]
        held = np.array([*self._rotary, self._branch, 0.0])
        length = self.flank_height * float(np.linalg.norm(target - self._rotary))
        still = replace(
            turn,
            kind=np.array([ROTATION]),
            rotation=np.zeros((1, 3)),
            rotary=rotary[None],
            length=np.array([length]),
            feed=np.full((1, 2), np.inf),
            block=np.repeat(turn.block[:, :1], 2, axis=1),
            stop=np.array([True]),
        )
        return self._cells(still, 0, PROGRAMMED, held)

    def _cells(self, segments: PathSegments, i: int, mode: int, held: FloatArray) -> Cells:
        """Sample one segment and check what came out."""
        kind, line = int(segments.kind[i]), int(segments.line_number[i])
        cone = float(np.sin(self.machine.singular_cone)) if mode == FREE else 0.0
        status, early, steps, left, right, tips, tools = sample_segment(
            self.transform.packed, cone, len(self.machine.axis_names), kind, mode,
            segments.bottom[i], segments.top[i], segments.connection[i], segments.axis[i],
            segments.rotation[i], segments.rotary[i], segments.length[i], held,
            CORNER_GRID if kind == CORNER else LINE_GRID,
        )  # fmt: skip
        if status == UNREACHABLE:
            raise BlockError(
                f'machine {self.machine.name} cannot reach the tool axis of this block', line
            )
        if status == SINGULAR:
            name = self.machine.axis_names[3 + self.transform.outer]
            raise SingularityError(
                f'the turning tool axis comes closer than '
                f'{self.machine.singular_cone / DEG:g} deg to the direction where axis {name} is '
                f'undefined; tilt the workpiece or the path',
                line,
                name,
            )
        q = np.concatenate([left[0], right[0, -1:]])
        self._check_travel(q, line)
        if mode == PROGRAMMED:  # the tool axis follows the rotary words
            tools = self.transform.tool_axis(q[:, 3:])
        half = (np.arange(len(steps)) >= early).astype(int) if kind == CORNER else 1
        return Cells(
            steps, left, right, tips, tools,
            np.broadcast_to(segments.feed[i, half], len(steps)),
            np.broadcast_to(segments.block[i, half], len(steps)),
            bool(segments.stop[i]),
        )  # fmt: skip

    def _refuse_tilt(self, segments: PathSegments, i: int) -> None:
        """Refuse a tilted tool on a machine without rotary axes."""
        if segments.axis[i, 2] < 1.0 - 1e-12 or np.abs(segments.rotation[i]).max() > 1e-12:
            raise BlockError(
                f'a tilted tool needs rotary axes, and machine {self.machine.name} has none; '
                'choose a 5-axis machine',
                int(segments.line_number[i]),
            )

    def _check_travel(self, q: FloatArray, line: int) -> None:
        """Refuse positions outside the travel of an axis."""
        low, high = self.machine.travel[:, 0], self.machine.travel[:, 1]
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

    def _join(self, parts: list[Cells]) -> AxisPath:
        """Put the parts together into one piece of path that begins where the last one ended."""
        steps = np.concatenate([part.steps for part in parts])
        s = self._s + np.concatenate([[0.0], np.cumsum(steps)])
        stop = np.zeros(len(s), dtype=bool)
        stop[0] = self._stopped
        stop[np.cumsum([len(part.steps) for part in parts])] = [part.stop for part in parts]
        self._s, self._stopped = float(s[-1]), bool(stop[-1])
        return AxisPath(
            s=s,
            cell_left=np.concatenate([part.left for part in parts], axis=1),
            cell_right=np.concatenate([part.right for part in parts], axis=1),
            tip=np.concatenate([parts[0].tips[:1]] + [part.tips[1:] for part in parts]),
            axis=np.concatenate([parts[0].tools[:1]] + [part.tools[1:] for part in parts]),
            cell_feed=np.concatenate([part.feed for part in parts]),
            cell_block=np.concatenate([part.block for part in parts]),
            stop=stop,
        )
