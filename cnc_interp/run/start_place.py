"""The position on the path at which a run starts, and the approach to this position.

The whole program is read and smoothed, so that the path is the same as in a full run.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cnc_interp.core import MM, FloatArray, IntArray, ProgramError
from cnc_interp.kinematics.axis_path import AxisPath, cut, evaluate
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.kinematics.path_checks import check_travel
from cnc_interp.machine_model.joint import ARM
from cnc_interp.machine_model.joint_chain import JointChain
from cnc_interp.machine_model.signals import Signals
from cnc_interp.machine_model.transform_port import ToolLine, Transform, reached, tool_line
from cnc_interp.program.blocks import POSES, Blocks
from cnc_interp.program.blocks.functions import Functions
from cnc_interp.program.blocks.start_line import StartBlock, StartLine
from cnc_interp.run.course import from_place, to_place
from cnc_interp.run.path_chain import segments_of
from cnc_interp.run.setpoints import Setpoints
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.segments import PathSegments

#: Number of positions tried in a path cell, and number of divisions of the nearest interval.
TRIED, DIVIDED = 16, 8
STEP = 1.0 * MM  #: Step in which an arm's largest retract is searched [m].
THERE = 1e-9  #: Axes nearer than this to the next point do not move [m, rad].


@dataclass(frozen=True)
class StartPlace:
    block: StartBlock  #: Start block of the program.
    line: int  #: Source line of the first motion.
    s: float  #: Path position from the top of the program [m].
    position: FloatArray  #: (n_axes,): Nominal axis positions [m, rad].
    sets: tuple[str, ...] = ()  #: Texts of the outputs set before the approach.

    def after(self, functions: Functions, signals: Signals) -> StartPlace:
        """Return this start, with texts of the outputs that functions set before it."""
        first = functions[: functions.until(0)]
        acts = zip(first.step.tolist(), first.value.tolist(), strict=True)
        outputs = [(signals.steps[step].output, value) for step, value in acts]
        sets = {output: signals.text(output, value) for output, value in outputs}
        return replace(self, sets=tuple(sets.values()))

    @property
    def texts(self) -> tuple[str, ...]:
        block = self.block
        passes = f' (pass {block.which} of {block.passes})' if block.passes > 1 else ''
        told = [
            f'start at line {block.line}{passes}',
            f'cycle start sets first: {", ".join(self.sets)}'
            if self.sets
            else 'load the tool, start spindle and coolant by hand; '
            f'state there: {" ".join(block.words)}',
        ]
        if self.line != block.line:
            after = f'the next motion is that of line {self.line}'
            told.append(f'line {block.line} moves nothing; {after}')
        return tuple(told)

    def to_json(self) -> dict[str, Any]:
        block = self.block
        return {
            'line': block.line,
            'pass': block.which,
            'passes': block.passes,
            'row': block.row,
            'first_line': self.line,
            'words': list(block.words),
            'path_position': self.s,
            'position': self.position.tolist(),
            'notes': list(self.texts),
        }


class StartFinder:
    """Receives the whole program, and returns the executed part, renumbered."""

    def __init__(self, transform: Transform, flank_height: float, start: StartLine):
        self._transform, self._height, self._start = transform, flank_height, start
        self._rows = 0  # of the program, read so far
        self._before: Blocks | None = None  # the last row read
        self._vertex: Blocks | None = None  # the row before the start, and its first row
        self._kept: AxisPath | None = None
        #: The part of the latest path that lies before the start, or None.
        self.before: AxisPath | None = None
        self._s: float | None = None
        self._position = np.zeros(0)

    def blocks(self, blocks: Blocks) -> Blocks:
        first, row = self._rows, self._start.row
        self._rows += len(blocks)
        before, self._before = self._before, blocks[-1:]
        if self._vertex is not None:
            return blocks
        if row is None or row >= self._rows:
            return blocks[:0]
        if before is not None:
            blocks, first = Blocks.concatenate([before, blocks]), first - 1
        self._vertex = blocks[row - 1 - first : row + 1 - first]
        begins = int(self._vertex.line_number[1])
        if self._vertex.on_spline[1] and begins < self._start.line:
            raise ProgramError(
                f'inside the spline that begins in line {begins}; start there',
                self._start.source,
                self._start.line,
            )
        return Blocks.concatenate([start_pose(self._vertex[:1]), blocks[row - first :]])

    def segments(self, segments: PathSegments) -> PathSegments:
        row = self._start.row
        if row is None:
            return segments[:0]
        mine = segments[np.flatnonzero(segments.block[:, 1] >= row)]
        return replace(mine, block=self._own(mine.block))

    def path(self, path: AxisPath | None, last: bool = False) -> AxisPath | None:
        """Receive the next part of the path; return what will be executed of it, or None."""
        self.before = None
        if self._s is not None:
            return None if path is None else self._renumbered(path)
        parts = [part for part in (self._kept, path) if part is not None]
        if not parts:
            return None
        known, row = AxisPath.join(parts), self._start.row
        block = known.cell_block
        if row is None or block[-1] < row:
            border = int(np.searchsorted(block, block[-1]))
            self._kept = cut(known, border, len(block))
            self.before = cut(known, 0, border) if border else None
            return None
        self._kept = known
        self._s = self._place(known, row, last)
        if self._s is None:
            return None
        self._kept, self.before = None, to_place(known, self._s)
        rest = from_place(known, self._s)
        self._position = self._transform.errors.nominal(rest.cell_left[0, :1])[0].copy()
        return self._renumbered(rest)

    def functions(self, functions: Functions) -> Functions:
        rows = functions.block
        return replace(functions, block=np.where(rows > 0, self._own(rows), 0))

    def found(self) -> StartPlace:
        return self.place(self._start.found())

    def place(self, block: StartBlock) -> StartPlace:
        if self._s is None or self._vertex is None:
            why = 'no motion follows this line; start before it'
            raise ProgramError(why, self._start.source, block.line)
        return StartPlace(block, int(self._vertex.line_number[1]), self._s, self._position)

    def _place(self, path: AxisPath, row: int, last: bool) -> float | None:
        block = path.cell_block
        border = int(np.searchsorted(block, row))
        if border == 0 or self._vertex is None:
            return float(path.s[border])
        vertex = self._vertex
        room = float(vertex.contour_tolerance.min()), float(vertex.orientation_tolerance.min())
        if (self._off(path, path.s[border : border + 1])[0] <= room).all():
            return float(path.s[border])
        end = int(np.searchsorted(block, block[border], side='right'))
        if end == len(block) and not last:
            return None
        begin = int(np.searchsorted(block, block[border - 1]))
        s, step = path.s[begin : end + 1], np.linspace(0.0, 1.0, TRIED + 1)
        for _ in range(DIVIDED):
            tried = np.unique(s[:-1, None] + np.diff(s)[:, None] * step)
            off = np.hypot(*self._off(path, tried).T)
            near = int(np.argmin(off))
            s = tried[max(near - 1, 0) : near + 2]
        return float(tried[near])

    def _off(self, path: AxisPath, s: FloatArray) -> FloatArray:
        """Return distances from the start pose: tip, tool axis at flank height, (k, 2) [m]."""
        assert self._vertex is not None
        tip, axis = reached(self._transform, evaluate(path, s)[0])
        vertex = self._vertex
        turned = np.linalg.norm(axis - vertex.axis[0], axis=1) * self._height
        return np.column_stack([np.linalg.norm(tip - vertex.tip[0], axis=1), turned])

    def setpoints(self, samples: Setpoints) -> Setpoints:
        return replace(samples, block=self._own(samples.block))

    def _renumbered(self, path: AxisPath) -> AxisPath:
        return replace(path, cell_block=self._own(path.cell_block))

    def _own(self, rows: IntArray) -> IntArray:
        assert self._start.row is not None
        return np.maximum(rows - (self._start.row - 1), 1)


def start_pose(row: Blocks) -> Blocks:
    """Return the pose at the end of a row, as start pose of the next rows."""
    none = np.full(1, np.nan)
    return replace(
        row,
        feedrate=np.full(1, np.inf),
        duration=none,
        exact_stop=np.zeros(1, dtype=np.bool_),
        program_stop=np.zeros(1, dtype=np.int64),
        top=np.full((1, 3), np.nan),
        knot_interval=none.copy(),
        interpolation=np.full(1, POSES),
        rotary_from=np.full((1, 2), np.nan),
    )


def approach(
    transform: Transform, flank_height: float, start: FloatArray, end: FloatArray
) -> AxisPath | None:
    """Return the approach to the start pose: all axes move together, in a straight line."""
    return straight(transform, flank_height, np.stack([start, end]), np.array([np.inf]))


def way_inside(
    transform: Transform, stands: FloatArray, place: FloatArray, retract: float
) -> FloatArray:
    """Return the corners of the approach to ``place`` in the program, (5, n_axes) [m, rad].

    At both ends the tool is drawn back by ``retract`` [m], or by more if the other end lies
    """
    here, there = tool_line(transform, stands), tool_line(transform, place)
    plunge = min(retract, there.travel[1])
    begin = place + plunge * there.direction
    back = stands + _height(here, stands, begin, retract) * here.direction
    above = place + _height(there, place, back, plunge) * there.direction
    return np.stack([stands, back, above, begin, place])


def _height(line: ToolLine, foot: FloatArray, other: FloatArray, least: float) -> float:
    height = max(least, float(line.direction @ (other - foot)))
    return max(0.0, min(height, float(line.travel[1])))


def approach_inside(
    transform: Transform,
    flank_height: float,
    stands: FloatArray,
    place: FloatArray,
    retract: float,
    plunge_feed: float,
) -> AxisPath | None:
    if isinstance(transform, JointChain):
        return arm_inside(transform, flank_height, stands, place, retract, plunge_feed)
    corners = way_inside(transform, stands, place, retract)
    feeds = np.array([np.inf, np.inf, np.inf, plunge_feed])
    return straight(transform, flank_height, corners, feeds)


def arm_inside(
    chain: JointChain,
    flank_height: float,
    stands: FloatArray,
    place: FloatArray,
    retract: float,
    plunge_feed: float,
) -> AxisPath | None:
    """Return an arm's approach to ``place``: along the tool, by joints, along the tool."""
    if np.abs(place - stands).max() <= THERE:
        return None
    (here, there), (axis, to_axis) = chain.forward(np.stack([stands, place]))
    back = _drawn_back(chain, stands, max(retract, float((there - here) @ axis)))
    above = _drawn_back(chain, place, max(retract, float((here - there) @ to_axis)))
    begin = _drawn_back(chain, place, retract)
    ways = [(stands, back, np.inf), (above, begin, np.inf), (begin, place, plunge_feed)]
    legs = [_along_tool(chain, flank_height, *way) for way in ways]
    legs.insert(1, straight(chain, flank_height, np.stack([back, above]), np.array([np.inf])))
    found, end = list[AxisPath](), 0.0
    for leg in reversed([leg for leg in legs if leg is not None]):
        found.insert(0, replace(leg, s=leg.s + (end - leg.s[-1])))
        end = float(found[0].s[0])
    return AxisPath.join(found)


def _drawn_back(chain: JointChain, q: FloatArray, height: float) -> FloatArray:
    """Return the joints (n,) with the tool retracted by ``height`` [m], or as far as possible."""
    chain = chain.standing(q)
    tip, axis = (rows[0] for rows in chain.forward(q[None]))
    up = np.linspace(0.0, height, 2 + int(height / STEP))
    poses = tip + up[:, None] * axis, np.tile(axis, (len(up), 1))
    found, _ = chain.followed(*poses, np.tile(q[ARM:], (len(up), 1)), q)
    low, high = chain.machine.travel.T
    regular = np.abs([np.linalg.det(chain.pose_rates(row)) for row in found]) > chain.least
    sound = regular & ((found >= low) & (found <= high)).all(axis=1)
    reached = int(np.append(sound, False).argmin())
    return np.asarray(found[reached - 1] if reached else q)


def _along_tool(
    chain: JointChain, flank_height: float, start: FloatArray, end: FloatArray, feed: float
) -> AxisPath | None:
    """Return the path between joint positions (n,) on which the tool moves along its axis."""
    tip, axis = chain.forward(np.stack([start, end]))
    if np.abs(tip[1] - tip[0]).max() <= THERE:
        return None
    none = np.full(2, np.nan)
    blocks = Blocks(
        tip=tip,
        axis=axis[[0, 0]],
        rotary=np.full((2, 2), np.nan),
        feedrate=np.full(2, feed),
        duration=none,
        rapid=np.full(2, not np.isfinite(feed)),
        exact_stop=np.ones(2, dtype=np.bool_),
        contour_tolerance=np.full(2, THERE),
        orientation_tolerance=np.full(2, THERE),
        line_number=np.zeros(2, dtype=np.int64),
        extra=np.tile(start[ARM:], (2, 1)),
    )
    settings = Settings(flank_height=flank_height)
    segments = segments_of(blocks, chain, settings)
    period = settings.interpolation_period
    path = AxisPathBuilder(chain, flank_height, period, stands=start).push(segments)
    return None if path is None else replace(path, cell_block=np.zeros_like(path.cell_block))


def straight(
    transform: Transform, flank_height: float, points: FloatArray, feeds: FloatArray
) -> AxisPath | None:
    """Return a straight path in axis positions from point to point, with a rest at each."""
    machine = transform.machine
    there = np.concatenate([points[1:, None], np.zeros((len(points) - 1, 3, points.shape[1]))], 1)
    none = np.zeros(len(there), dtype=np.int64)
    check_travel(machine, none.astype(float), there, there, none)
    moves = np.abs(np.diff(points, axis=0)).max(axis=1) > THERE
    if not moves.any():
        return None
    points, feeds = np.concatenate([points[:1], points[1:][moves]]), feeds[moves]
    way = np.diff(points, axis=0)
    weight = np.where(machine.is_linear, 1.0, flank_height)
    length = np.sqrt(((weight * way) ** 2).sum(axis=1))
    left = np.zeros((4, *way.shape))
    left[1] = way / length[:, None]
    right = left.copy()
    left[0], right[0] = points[:-1], points[1:]
    tip, axis = reached(transform, points)
    after = np.append(np.cumsum(length[::-1])[::-1], 0.0)
    return AxisPath(
        s=-after,
        cell_left=left,
        cell_right=right,
        tip=tip,
        axis=axis,
        cell_feed=feeds,
        cell_block=np.zeros(len(feeds), dtype=np.int64),
        stop=np.ones(len(points), dtype=np.bool_),
    )
