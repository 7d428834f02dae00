"""What a plan was made for, in shapes that its motion is compared with, and that comparison."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform
from cnc_interp.program.blocks import POSES
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.proof.programmed_axes import ProgrammedAxes
from cnc_interp.proof.programmed_path import Deviation, ProgrammedPath

SLACK = 1e-9  #: Distances below this are zero [m].
# A search is widened by this number of tolerances where blocks are tiny. There one path segment
# covers many rows, but each of its halves names one row: the middle one, or the first or last row
# of a curve. A half is 50 tolerances long at most, counted as the root mean square of tip and
# point at flank height. Way of the tip plus rotation at flank height is up to sqrt(8) times that.
REACH = 142.0


@dataclass(frozen=True)
class ProgramShapes:
    """What a plan was made for, in the shapes that its motion is compared with."""

    plan: PlanFiles  #: The plan, with M program rows.
    machine: Machine  #: The machine.
    transform: Transform  #: Its forward kinematics.
    path: ProgrammedPath  #: The rows as lines and great circles.
    lines: ProgrammedAxes | None  #: Rows whose rotary axes run linearly.
    #: (M,): Tolerances at the vertices [m].
    contour: FloatArray
    orientation: FloatArray

    @staticmethod
    def of(plan: PlanFiles, machine: Machine) -> ProgramShapes:
        blocks = plan.blocks
        path = ProgrammedPath.of(
            blocks['tip'], blocks['axis'], blocks['rotary'], plan.flank_height,
            blocks['interpolation'] != POSES,
        )  # fmt: skip
        return ProgramShapes(
            plan, machine, Transform.of(machine), path, ProgrammedAxes.of(plan, machine),
            *vertex_tolerances(plan),
        )  # fmt: skip

    def tips(self, position: FloatArray) -> FloatArray:
        return self.transform.forward(position)[0]

    def tops(self, position: FloatArray) -> FloatArray:
        """Return the points at flank height of axis positions, shape (K, 3) [m]."""
        tip, axis = self.transform.forward(position)
        return tip + self.plan.flank_height * axis

    def tolerances(self, deviation: Deviation) -> tuple[FloatArray, FloatArray]:
        """Return contour and orientation tolerance at the vertex nearest to each pose [m]."""
        before = np.maximum(deviation.row - 1, 0)
        vertex = np.where(deviation.part >= 0.5, deviation.row, before)
        return self.contour[vertex], self.orientation[vertex]


def measure(program: ProgramShapes, position: FloatArray, block: IntArray) -> Deviation:
    """Measure positions (K, n) [m, rad] against a program; ``block`` (K,) is the executed row."""
    tip, axis = program.transform.forward(position)
    result = measure_widely(program, tip, axis, block, position)
    blocks = program.plan.blocks
    ruled = program.path.by_axes[block] & (blocks['interpolation'][block] == POSES)
    if ruled.any():
        # Here the rotary axes move linearly: compare with their position at the same part of it.
        row, position = block[ruled], position[ruled].copy()
        rotary = blocks['rotary']
        first, way = rotary[row - 1], rotary[row] - rotary[row - 1]
        share = np.sum((position[:, 3:5] - first) * way, axis=1)
        share = np.clip(share / np.maximum(np.sum(way**2, axis=1), 1e-300), 0.0, 1.0)
        position[:, 3:5] = first + share[:, None] * way
        turned = program.transform.forward(position)[1]
        gap = tip[ruled] - blocks['tip'][row]
        gap = gap + program.plan.flank_height * (axis[ruled] - turned)
        distance = np.linalg.norm(gap, axis=1)
        result.orientation[ruled] = np.minimum(result.orientation[ruled], distance)
        result.twist[ruled] = np.minimum(result.twist[ruled], distance)
    return result


def measure_widely(
    program: ProgramShapes, tip: FloatArray, axis: FloatArray, block: IntArray,
    position: FloatArray,
) -> Deviation:  # fmt: skip
    """Measure near the executed row; where a tolerance is exceeded, search more rows."""
    result = program.path.deviation(tip, axis, block)
    if program.lines is not None:
        program.lines.improve(result, position, block)
    contour, top = program.tolerances(result)
    far = (result.contour > contour + SLACK) | (result.orientation > top + SLACK)
    if far.any():
        reach = REACH * np.maximum(contour, top)[far]
        wide = program.path.deviation(tip[far], axis[far], block[far], reach)
        nearer = wide.contour <= result.contour[far]
        for name in ('contour', 'row', 'part', 'twist'):
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
