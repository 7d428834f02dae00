"""The program as geometric shapes, and the comparison of a motion with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, IntArray
from cnc_interp.machine_model.machine import Machine
from cnc_interp.program.blocks import AXES_LINEAR, POSES
from cnc_interp.proof.own_chain import Forward, forward_of
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.proof.programmed_path import Deviation, ProgrammedPath

SAME = 1e-9  #: Tool axes that differ by less are equal [-]; a tip that moves less rests [m].
SMALL_USE = 0.02  #: Smallest use of the tolerances that is refined by a search [-].
# Golden section: number of steps, and the share of the bracket that each one keeps.
STEPS, SHARE = 40, 0.5 * (np.sqrt(5.0) - 1.0)
# Up to this way from a row whose rotary axes run linearly, its coordinates count [m].
JOINED = 5e-3
#: Indices of rotary and extra axes among the coordinates.
TURN, EXTRA = slice(3, 5), slice(5, None)
BRACKET = 8.0  #: Half the bracket around the nearest point, in tolerances.


@dataclass(frozen=True)
class ProgrammedAxes:
    machine: Forward  #: The forward kinematics.
    #: (M,): Rows with linear rotary axes, and rows next to them in which only the tip moves.
    known: BoolArray
    #: (M,): Rows with linear rotary axes; known rows in coordinates of the machine axes.
    linear: BoolArray
    in_axes: BoolArray
    #: (M, n): Coordinates at the start of known rows, and their change along the row [m, rad].
    start: FloatArray
    step: FloatArray
    tolerance: FloatArray  #: (M, 2): Contour and orientation tolerance of each row [m].
    #: (2, M, 2): Each tolerance divided by the smaller one of this row and a neighbour: the row
    #: before it, for the first half, and the row after it, for the second half.
    weight: FloatArray
    height: float  #: Flank height [m].

    @staticmethod
    def of(plan: PlanFiles, machine: Machine) -> ProgrammedAxes | None:
        """Return the linear rows of a plan; None if no row moves rotary axes linearly."""
        blocks = plan.blocks
        kind = np.asarray(blocks['interpolation'], dtype=np.int64)
        linear = kind != POSES
        if not linear.any() or not machine.has_rotary:
            return None
        tip, axis, transform = blocks['tip'], blocks['axis'], forward_of(machine)
        before = np.r_[0, np.arange(len(tip) - 1)]
        turned = np.abs(axis - axis[before]).max(axis=1)
        still = ~linear & (turned < SAME) & (np.linalg.norm(tip - tip[before], axis=1) > SAME)
        extra = blocks['extra_axes']
        still &= (extra == extra[before]).all(axis=1)
        first = np.array(blocks['rotary_from'], dtype=float)
        last = np.array(blocks['rotary'], dtype=float)
        rows, length = np.arange(len(tip)), np.linalg.norm(tip - tip[before], axis=1)
        way = np.cumsum(length)
        # The nearest other kind of row before and after, and the distance to it.
        at_start = np.maximum.accumulate(np.where(still, 0, rows))
        at_end = np.minimum.accumulate(np.where(still, len(tip) - 1, rows)[::-1])[::-1]
        follows = still & linear[at_start] & (way - length - way[at_start] <= JOINED)
        leads = still & linear[at_end] & (way[at_end] - length[at_end] - way <= JOINED)
        places = (follows, at_start, last.copy()), (leads, at_end, first.copy())
        for some, at, place in places:
            first[some] = last[some] = place[at[some]]
            kind = np.where(some, kind[at], kind)
        known, in_axes = linear | leads | follows, kind == AXES_LINEAR
        ends = []
        for rows, rotary in ((before, first), (np.arange(len(tip)), last)):
            found = np.hstack([tip[rows], rotary, extra[rows]])
            found[~known] = 0.0
            found[in_axes, :3] = axis_positions(transform, found[in_axes])
            ends.append(found)
        tolerance = np.stack(
            [blocks['contour_tolerance'], blocks['orientation_tolerance']], axis=1
        )
        tolerance = np.maximum(tolerance, 1e-12)
        beside = np.pad(tolerance, ((1, 1), (0, 0)), mode='edge')
        least = np.stack([np.minimum(tolerance, beside[:-2]), np.minimum(tolerance, beside[2:])])
        return ProgrammedAxes(
            transform,
            known,
            linear,
            in_axes,
            ends[0],
            ends[1] - ends[0],
            tolerance,
            tolerance / least,
            plan.flank_height,
        )

    @property
    def scale(self) -> FloatArray:
        """Factors from coordinates to lengths at flank height, shape (n,)."""
        scale = np.ones(self.start.shape[1])
        scale[3:5] = self.height
        return scale

    def improve(
        self,
        result: Deviation,
        position: FloatArray,
        block: IntArray,
        shifts: Sequence[int] = (0, -1, 1),
    ) -> FloatArray:
        """Update ``result`` where lines of the rows ``block`` or their neighbours are nearer.

        Return the use (K,) of both tolerances at the nearest point of a line in machine axes: the
        largest of tip, point at flank height, rotary and extra axes; 0 for other rows [-].
        """
        least, beside = np.full(len(block), np.inf), np.zeros(len(block))
        tip, axis = self.machine.forward(position)
        for shift in shifts:
            row = np.clip(block + shift, 0, len(self.known) - 1)
            at = np.flatnonzero(self.known[row] & ((row == block) == (shift == 0)))
            if not len(at):
                continue
            k = row[at]
            here = position[at].copy()
            here[~self.in_axes[k], :3] = tip[at][~self.in_axes[k]]
            search = _Search(self, k, here, tip[at], tip[at] + self.height * axis[at])
            x, gaps, use = search.best()
            own = use < least[at]
            at, x, k, gaps = at[own], x[own], k[own], gaps[own]
            least[at], beside[at] = use[own], np.where(self.in_axes[k], use[own], 0.0)
            contour, orientation = (gaps[:, 2:] * self.tolerance[k]).T
            nearer = contour <= result.contour[at]
            result.contour[at[nearer]] = contour[nearer]
            result.row[at[nearer]], result.part[at[nearer]] = k[nearer], x[nearer]
            result.orientation[at] = np.minimum(result.orientation[at], orientation)
        return np.where(self.linear[block] & self.in_axes[block], beside, 0.0)

    def speeds(
        self, position: FloatArray, tip: FloatArray, row: IntArray, period: float
    ) -> FloatArray:
        """Return the speed between samples, along the lines of their rows, (K - 1,) [m/s]."""
        step = np.diff(position, axis=0)
        beside = ~self.in_axes[row]
        step[beside, :3] = np.diff(tip, axis=0)[beside]
        return np.asarray(np.linalg.norm(step * self.scale, axis=1) / period)

    def gaps(self, position: FloatArray, tip: FloatArray, row: int) -> FloatArray:
        """Return the distance of samples from the end of a row [m], in X Y Z of its feed."""
        here = position[:, :3] if self.in_axes[row] else tip
        return np.asarray(np.linalg.norm(here - (self.start + self.step)[row, :3], axis=1))


@dataclass(frozen=True)
class _Search:
    program: ProgrammedAxes
    k: IntArray
    here: FloatArray
    tip: FloatArray
    top: FloatArray

    def best(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the nearest point on each row, (m,) in [0, 1], its gaps (m, 4) and use (m,)."""
        program, scale = self.program, self.program.scale
        step = program.step[self.k] * scale
        square = np.maximum((step**2).sum(axis=1), 1e-300)
        way = (self.here - program.start[self.k]) * scale
        x = np.clip((way * step).sum(axis=1) / square, 0.0, 1.0)
        gaps, use = self.gaps(np.arange(len(x)), x)
        far = np.flatnonzero((use > SMALL_USE) & (use < BRACKET**2))
        if len(far):
            room = BRACKET * program.tolerance[self.k[far]].sum(axis=1) / np.sqrt(square[far])
            low, high = np.maximum(x[far] - room, 0.0), np.minimum(x[far] + room, 1.0)
            for _ in range(STEPS):
                left, right = high - SHARE * (high - low), low + SHARE * (high - low)
                down = self.gaps(far, left)[1] < self.gaps(far, right)[1]
                low, high = np.where(down, low, left), np.where(down, right, high)
            found = 0.5 * (low + high)
            other, least = self.gaps(far, found)
            better = least < use[far]
            some = far[better]
            x[some], gaps[some], use[some] = found[better], other[better], least[better]
        return x, gaps, use

    def gaps(self, rows: IntArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compare poses with the points at x in [0, 1] on rows, both shape (m,).

        Return the gaps of extra axes, rotary axes, tip and point at flank height, each divided by
        its tolerance, shape (m, 4). The use (m,) is the largest gap, relative to the smaller
        tolerance of the two rows at the nearer vertex.
        """
        program, k = self.program, self.k[rows]
        point = program.start[k] + x[:, None] * program.step[k]
        apart = (self.here[rows] - point) * program.scale
        extra, rotary = (np.linalg.norm(apart[:, part], axis=1) for part in (EXTRA, TURN))
        tip, axis = program.machine.forward(point)
        beside = ~program.in_axes[k]
        tip[beside] = point[beside, :3]
        top = tip + program.height * axis
        off = np.linalg.norm(tip - self.tip[rows], axis=1)
        off_top = np.linalg.norm(top - self.top[rows], axis=1)
        gaps = np.stack([extra, rotary, off, off_top], axis=1) / np.tile(program.tolerance[k], 2)
        weight = program.weight[(x >= 0.5).astype(np.int64), k]
        return gaps, np.asarray((gaps * np.tile(weight, 2)).max(axis=1))


def axis_positions(machine: Forward, coordinates: FloatArray) -> FloatArray:
    """Return axis positions that bring the tip to given X Y Z, by forward kinematics alone."""
    at = coordinates.copy()
    at[:, :3] = 0.0
    zero = machine.forward(at)[0]
    gap, found = coordinates[:, :3] - zero, np.empty((len(at), 3))
    for i in range(3):
        at[:, :3] = np.eye(3)[i]
        found[:, i] = ((machine.forward(at)[0] - zero) * gap).sum(axis=1)
    return found


SLACK = 1e-9  #: Distances below this are zero [m].
# A search is widened by so many tolerances where each half of a segment names one of many rows. It
# is 50 tolerances long at most, as root mean square of tip and point at flank height; way plus
# rotation at flank height is up to sqrt(8) times that.
REACH = 142.0


@dataclass(frozen=True)
class ProgramShapes:
    plan: PlanFiles  #: The plan, with M program rows.
    machine: Machine  #: The machine.
    transform: Forward  #: Its forward kinematics.
    path: ProgrammedPath  #: The rows as lines and great circles.
    lines: ProgrammedAxes | None  #: Rows whose rotary axes run linearly.
    #: (M,): Tolerances at the vertices [m].
    contour: FloatArray
    orientation: FloatArray

    @staticmethod
    def of(plan: PlanFiles, machine: Machine) -> ProgramShapes:
        blocks = plan.blocks
        path = ProgrammedPath.of(
            blocks['tip'],
            blocks['axis'],
            blocks['rotary'],
            plan.flank_height,
            blocks['interpolation'] != POSES,
            blocks['rotary_from'],
        )
        return ProgramShapes(
            plan,
            machine,
            forward_of(machine),
            path,
            ProgrammedAxes.of(plan, machine),
            *vertex_tolerances(plan),
        )

    def tips(self, position: FloatArray) -> FloatArray:
        return self.transform.forward(position)[0]

    def tops(self, position: FloatArray) -> FloatArray:
        tip, axis = self.transform.forward(position)
        return tip + self.plan.flank_height * axis

    def tolerances(self, deviation: Deviation) -> tuple[FloatArray, FloatArray]:
        """Return contour and orientation tolerance at the vertex nearest to each pose [m]."""
        before = np.maximum(deviation.row - 1, 0)
        vertex = np.where(deviation.part >= 0.5, deviation.row, before)
        return self.contour[vertex], self.orientation[vertex]


def measure(program: ProgramShapes, position: FloatArray, block: IntArray) -> Deviation:
    """Measure the deviation of positions (K, n) from a program; ``block`` (K,): executed rows."""
    tip, axis = program.transform.forward(position)
    result = measure_widely(program, tip, axis, block, position)
    blocks = program.plan.blocks
    ruled = program.path.by_axes[block] & (blocks['interpolation'][block] == POSES)
    if ruled.any():
        # Here the rotary axes move linearly: compare with their position at the same part of it.
        row, position = block[ruled], position[ruled].copy()
        first = program.path.rotary_from[row]
        way = blocks['rotary'][row] - first
        share = np.sum((position[:, 3:5] - first) * way, axis=1)
        share = np.clip(share / np.maximum(np.sum(way**2, axis=1), 1e-300), 0.0, 1.0)
        position[:, 3:5] = first + share[:, None] * way
        turned = program.transform.forward(position)[1]
        gap = tip[ruled] - blocks['tip'][row]
        gap = gap + program.plan.flank_height * (axis[ruled] - turned)
        distance = np.linalg.norm(gap, axis=1)
        result.orientation[ruled] = np.minimum(result.orientation[ruled], distance)
    return result


def measure_widely(
    program: ProgramShapes,
    tip: FloatArray,
    axis: FloatArray,
    block: IntArray,
    position: FloatArray,
) -> Deviation:
    result = program.path.deviation(tip, axis, block)
    if program.lines is not None:
        program.lines.improve(result, position, block)
    contour, top = program.tolerances(result)
    far = (result.contour > contour + SLACK) | (result.orientation > top + SLACK)
    if far.any():
        # Another row at the same place may have a smaller tolerance: the executed row counts.
        own = program.path.deviation(tip[far], axis[far], block[far], rows=0)
        if program.lines is not None:
            program.lines.improve(own, position[far], block[far], shifts=(0,))
        contour, top = program.tolerances(own)
        kept = (own.contour <= contour + SLACK) & (own.orientation <= top + SLACK)
        for field in fields(own):
            getattr(result, field.name)[np.flatnonzero(far)[kept]] = getattr(own, field.name)[kept]
        far[far] = ~kept
        contour, top = program.tolerances(result)
    if far.any():
        reach = REACH * np.maximum(contour, top)[far]
        wide = program.path.deviation(tip[far], axis[far], block[far], reach)
        nearer = wide.contour <= result.contour[far]
        for name in ('contour', 'row', 'part'):
            getattr(result, name)[far] = np.where(
                nearer, getattr(wide, name), getattr(result, name)[far]
            )
        result.orientation[far] = np.minimum(result.orientation[far], wide.orientation)
    return result


def vertex_tolerances(plan: PlanFiles) -> tuple[FloatArray, FloatArray]:
    """Return contour and orientation tolerance (M,) of the vertices: the smaller of both rows."""
    both = []
    for name in ('contour_tolerance', 'orientation_tolerance'):
        own = np.array(plan.blocks[name], dtype=float)
        own[0] = own[1]
        both.append(np.minimum(own, np.r_[own[1:], own[-1]]))
    return both[0], both[1]
