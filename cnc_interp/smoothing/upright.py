"""Move tool axes that are nearly on the pole onto it, before anything is smoothed."""

from dataclasses import replace

import numpy as np

from cnc_interp.core import UM, BoolArray, FloatArray, cross, norm
from cnc_interp.machine_model.machine_traits import MachineTraits
from cnc_interp.program.blocks import POSES, Blocks
from cnc_interp.smoothing.segments import SPLINE, PathSegments

#: Largest move of one tool axis: share of the orientation tolerance [-], and length [m].
SHARE, MOST = 0.05, 0.5 * UM
WANDER = 0.8  #: Larger share that may be used if both ends of a block move onto the pole [-].


class Upright:
    """Put tool axes on the pole. The result does not depend on how the blocks arrive."""

    def __init__(self, machine: MachineTraits, height: float):
        self._pole = None if machine.pole is None else np.asarray(machine.pole)
        self._height = height
        self._moved = 0.0  # how far the last tool axis was moved, at flank height [m]
        self._away = np.inf  # of the last tool axis from the pole, at flank height [m]
        self._row = 0
        #: For each program row: used part of the orientation tolerance, and the tolerance [m].
        self._used: dict[int, tuple[float, float]] = {}
        self._waiting: Blocks | None = None  # a block that may be the last one

    def push(self, blocks: Blocks) -> Blocks:
        """Return blocks whose tool axes are moved onto the pole if they were nearly on it.

        The last row may be returned by the next call. The start pose, exact stops, rows that name
        rotary positions, rows whose rotary axes run linearly, control points, and rows before a
        spline keep their tool axes.
        """
        if self._pole is None or not len(blocks):
            return blocks
        if self._waiting is not None:
            blocks, self._waiting = Blocks.concatenate([self._waiting, blocks]), None
        sine = np.minimum(norm(cross(blocks.axis, self._pole[None])), 1.0)
        away = self._height * 2.0 * np.sin(0.5 * np.arcsin(sine))
        most = np.minimum(SHARE * _least(blocks.orientation_tolerance), MOST)
        tolerance = WANDER * blocks.orientation_tolerance
        pair = np.maximum(away, np.r_[self._away, away[:-1]]) <= tolerance  # of both ends
        wanders = (away <= _least(tolerance)) & (pair | np.r_[pair[1:], True])
        near = (away > 0.0) & ((away <= most) | wanders)
        near &= np.isnan(blocks.rotary).all(axis=1) & (blocks.interpolation == POSES)
        near &= ~blocks.exact_stop & ~blocks.on_spline
        near[:-1] &= ~blocks.on_spline[1:]
        near[0] &= self._row > 0
        if near[-1]:
            self._waiting = blocks[-1:]
            blocks, near, away = blocks[:-1], near[:-1], away[:-1]
        self._away = float(away[-1]) if len(away) else self._away
        return self._moved_to_pole(blocks, near, np.where(near, away, 0.0))

    def finish(self) -> Blocks | None:
        """Return the row that still waits; the last row of a program keeps its tool axis."""
        waiting, self._waiting = self._waiting, None
        if waiting is None:
            return None
        return self._moved_to_pole(waiting, np.zeros(1, dtype=np.bool_), np.zeros(1))

    def counted(self, segments: PathSegments) -> PathSegments:
        """Return segments whose deviation includes the moves of tool axes onto the pole.

        A span of a curve may extend a little beyond the blocks that it refers to.
        """
        if not self._used or not len(segments):
            return segments
        deviation, room = segments.deviation.copy(), segments.room.copy()
        for k, (first, last) in enumerate(segments.block.tolist()):
            more = int(segments.kind[k] == SPLINE)
            near = range(first - more, last + more + 1)
            rows = [self._used[row] for row in near if row in self._used]
            own = deviation[k, 1]
            for used, tolerance in rows:
                deviation[k, 1] = max(deviation[k, 1], min(own + used, tolerance))
                room[k] = max(min(room[k], tolerance - used - own), 0.0)
        self._used = {k: row for k, row in self._used.items() if k >= segments.block[-1, 0] - 1}
        return replace(segments, deviation=deviation, room=room)

    def _moved_to_pole(self, blocks: Blocks, near: BoolArray, moved: FloatArray) -> Blocks:
        """Move tool axes onto the pole, and subtract that from the tolerances on both sides."""
        used = np.maximum(moved, np.r_[self._moved, moved[:-1]][: len(moved)])
        if len(moved):
            self._moved = float(moved[-1])
        for k in np.flatnonzero(used).tolist():
            self._used[self._row + k] = used[k], blocks.orientation_tolerance[k]
        self._row += len(blocks)
        if self._pole is None or not used.any():
            return blocks
        sense = np.where(blocks.axis @ self._pole < 0.0, -1.0, 1.0)
        return replace(
            blocks,
            axis=np.where(near[:, None], sense[:, None] * self._pole, blocks.axis),
            orientation_tolerance=blocks.orientation_tolerance - used,
        )


def _least(tolerance: FloatArray) -> FloatArray:
    """Return the smaller tolerance of the blocks before and after each tool axis."""
    return np.minimum(tolerance, np.append(tolerance[1:], np.inf))
