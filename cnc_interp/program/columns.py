"""
Targets -> Blocks: the readers' motion targets, collected in growing columns, made into blocks.

Readers append one row of numbers per motion statement. Whenever a batch is full its rows are
turned into blocks together (tool axes, merging of repeated points, subdivision), so the working
memory does not depend on the program's length and no row is looked at in Python twice.
"""

from __future__ import annotations

from array import array
from math import inf, nan

import numpy as np

from cnc_interp.errors import ProgramError
from cnc_interp.program.blocks import Blocks, BoolArray, FloatArray, IntArray
from cnc_interp.program.options import ReadOptions, RotaryGeometry
from cnc_interp.program.subdivide import (
    angle_between,
    great_circle,
    ragged,
    rotary_piece_counts,
)
from cnc_interp.units import DEG

# A target row: tip, tool axis (NaN: given by the rotary words), rotary words, and
_TIP, _AXIS, _ROTARY = slice(0, 3), slice(3, 6), slice(6, 8)
_NAMED, _GREAT_CIRCLE, _FEEDRATE, _DURATION, _RAPID, _EXACT_STOP = 8, 9, 10, 11, 12, 13
_CONTOUR, _ORIENTATION, _LINE, _WIDTH = 14, 15, 16, 17

_BATCH_ROWS = 4096
_SAME = 1e-12  # [m], [-], [rad]
_ANTIPARALLEL = 1e-4  # [rad]
_CHORD_SHARE = 0.1  # of the orientation tolerance, for the departure from linear rotary axes


class TargetColumns:
    """
    Growing columns of motion targets, turned into blocks batch by batch.

    Parameters
    ----------
    geometry : RotaryGeometry
        Gives the tool axis of rotary words.
    options : ReadOptions
        Flank height, for the subdivision.
    source : str
        File name for errors.

    """

    def __init__(self, geometry: RotaryGeometry, options: ReadOptions, source: str):
        self._geometry, self._options, self._source = geometry, options, source
        self._rows = array('d')
        self._full = _BATCH_ROWS * _WIDTH
        self._before: FloatArray | None = None  # the last target already made into blocks
        self._parts: list[Blocks] = []

    def add(self, row: tuple[float, ...]) -> None:
        """
        Append one target.

        Parameters
        ----------
        row : tuple of 17 floats
            Tip [m]; tool axis, NaN where the rotary words give it; rotary words [rad]; 1 if the
            program has named rotary words so far; 1 for orientation on the great circle, 0 for
            linear rotary axes; feedrate [m/s]; duration [s]; rapid; exact stop; contour and
            orientation tolerance [m]; line number.

        """
        if len(self._rows) >= self._full:
            self._convert(last=False)
        self._rows.extend(row)

    def stop_here(self) -> None:
        """Make the tool come to rest at the end of the last target, if there is one."""
        if self._rows:
            self._rows[_EXACT_STOP - _WIDTH] = 1.0

    @property
    def empty(self) -> bool:
        """True before the first target."""
        return not self._rows

    def finish(self) -> Blocks:
        """Close the program with a stop and return all blocks, the start pose first."""
        if self.empty:
            raise ProgramError('no motion found; is this a part program?', self._source)
        self.stop_here()
        self._convert(last=True)
        return self._parts[0] if len(self._parts) == 1 else Blocks.concatenate(self._parts)

    def _convert(self, last: bool) -> None:
        """Turn the collected rows into blocks; the last one waits for rows that repeat it."""
        rows = np.frombuffer(self._rows, dtype=np.float64).reshape(-1, _WIDTH).copy()
        by_rotary = np.isnan(rows[:, _AXIS.start])
        if by_rotary.any():
            rows[by_rotary, _AXIS] = self._geometry.tool_axis(rows[by_rotary, _ROTARY])
        rows = _merge_repeated(rows)
        held = rows[:0] if last else rows[-1:]
        rows = rows[: len(rows) - len(held)]
        self._rows = array('d', held.tobytes())
        if self._before is None and len(rows):
            self._parts.append(_start_pose(rows[:1]))
            self._before, rows = rows[0], rows[1:]
        if len(rows) and self._before is not None:
            before = np.vstack([self._before, rows[:-1]])
            self._before = rows[-1]
            self._parts.append(self._blocks(before, rows))

    def _blocks(self, before: FloatArray, rows: FloatArray) -> Blocks:
        counts = self._piece_counts(before, rows)
        row, piece = ragged(counts)
        u = (piece + 1.0) / counts[row]
        final = piece + 1 == counts[row]
        begin, end = before[row], rows[row]
        tip = begin[:, _TIP] + u[:, None] * (end[:, _TIP] - begin[:, _TIP])
        tip[final] = rows[:, _TIP]
        rotary = begin[:, _ROTARY] + u[:, None] * (end[:, _ROTARY] - begin[:, _ROTARY])
        rotary[final] = rows[:, _ROTARY]
        axis = end[:, _AXIS].copy()
        on_circle = end[:, _GREAT_CIRCLE] != 0.0
        cut = on_circle & ~final
        axis[cut] = great_circle(begin[cut, _AXIS], end[cut, _AXIS], u[cut])
        cut = ~on_circle & ~final
        if cut.any():
            axis[cut] = self._geometry.tool_axis(rotary[cut])
        rotary[on_circle | (end[:, _NAMED] == 0.0)] = nan
        return Blocks(
            tip=tip,
            axis=axis,
            rotary=rotary,
            feedrate=end[:, _FEEDRATE].copy(),
            duration=end[:, _DURATION] / counts[row],
            rapid=end[:, _RAPID] != 0.0,
            exact_stop=(end[:, _EXACT_STOP] != 0.0) & final,
            contour_tolerance=end[:, _CONTOUR].copy(),
            orientation_tolerance=end[:, _ORIENTATION].copy(),
            line_number=end[:, _LINE].astype(np.int64),
        )

    def _piece_counts(self, before: FloatArray, rows: FloatArray) -> IntArray:
        counts = np.ones(len(rows), dtype=np.int64)
        on_circle = rows[:, _GREAT_CIRCLE] != 0.0
        if on_circle.any():
            angle = angle_between(before[on_circle, _AXIS], rows[on_circle, _AXIS])
            if (angle > np.pi - _ANTIPARALLEL).any():
                worst = rows[on_circle][np.argmax(angle)]
                raise ProgramError(
                    'the tool axis turns by 180 deg in one block, so its plane of rotation is '
                    'undefined; add a block between',
                    self._source,
                    int(worst[_LINE]),
                )
            counts[on_circle] = np.maximum(np.ceil(angle / (90.0 * DEG) - 1e-9), 1.0)
        # A rotation with the tip at rest is left whole: it is a motion of the rotary axes alone.
        sweep = rows[:, _ROTARY] - before[:, _ROTARY]
        travels = np.abs(rows[:, _TIP] - before[:, _TIP]).max(axis=1) > _SAME
        cut = ~on_circle & travels & (np.abs(sweep).max(axis=1) > _SAME)
        if cut.any():
            allowed = _CHORD_SHARE * rows[cut, _ORIENTATION] / self._options.flank_height
            counts[cut] = rotary_piece_counts(
                self._geometry.tool_axis, before[cut, _ROTARY], sweep[cut], allowed
            )
        return counts


def _merge_repeated(rows: FloatArray) -> FloatArray:
    """Drop rows that move nothing; an exact stop asked for there passes to the row before."""
    # Row 0 is new: it begins the program, or it was held back by the batch before.
    same = np.zeros(len(rows), dtype=np.bool_)
    same[1:] = _moves_nothing(rows[:-1], rows[1:])
    if not same.any():
        return rows
    first = np.flatnonzero(~same)
    kept = rows[first]
    kept[:, _EXACT_STOP] = np.maximum.reduceat(rows[:, _EXACT_STOP], first)
    return kept


def _moves_nothing(rows: FloatArray, following: FloatArray) -> BoolArray:
    change = np.abs(following[:, : _ROTARY.stop] - rows[:, : _ROTARY.stop])
    still = (change[:, _TIP].max(axis=1) <= _SAME) & (change[:, _AXIS].max(axis=1) <= _SAME)
    on_circle = following[:, _GREAT_CIRCLE] != 0.0
    return np.asarray(still & (on_circle | (change[:, _ROTARY].max(axis=1) <= _SAME)))


def _start_pose(row: FloatArray) -> Blocks:
    """Row 0: where the tool stands; it has no motion, so neither feed nor duration."""
    return Blocks(
        tip=row[:, _TIP].copy(),
        axis=row[:, _AXIS].copy(),
        rotary=row[:, _ROTARY].copy(),
        feedrate=np.full(1, inf),
        duration=np.full(1, nan),
        rapid=row[:, _RAPID] != 0.0,
        exact_stop=row[:, _EXACT_STOP] != 0.0,
        contour_tolerance=row[:, _CONTOUR].copy(),
        orientation_tolerance=row[:, _ORIENTATION].copy(),
        line_number=row[:, _LINE].astype(np.int64),
    )
