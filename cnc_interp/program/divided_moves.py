"""Motions divided into blocks: arcs into chords, curved motion into pieces.

Lines in machine axes stay whole, however far the rotary axes turn, up to eight turns.
"""

from __future__ import annotations

from itertools import pairwise
from math import inf, nan

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.core.errors import ProgramError
from cnc_interp.core.units import DEG
from cnc_interp.machine_model.transform import Transform
from cnc_interp.program import target_row as col
from cnc_interp.program.blocks import GO_ON, OPTIONAL_STOP, POSES, ROTARY_LINEAR, STOP, Blocks
from cnc_interp.program.moves import CHORD_SHARE, SAME, Moves
from cnc_interp.program.subdivide import MOST_PIECES, angle_between, piece_counts, ragged
from cnc_interp.settings.options import Settings

#: How the program waits, by EXACT_STOP of a target.
_WAITS = np.array([GO_ON, GO_ON, OPTIONAL_STOP, STOP])
_ANTIPARALLEL = 1e-4  # [rad]
_MOST_TURN = 500.0 * 360.0 * DEG
#: Largest turn of a piece whose rotary axes run linearly while the tip keeps its line [rad].
_LONGEST_TURN = 8.0 * 360.0 * DEG


def portions(moves: Moves) -> list[slice]:
    turned = np.nan_to_num(np.abs(moves.rows[:, col.SWEEP])) + np.abs(moves.sweep).sum(axis=1)
    portion = np.floor(np.cumsum(turned) / _MOST_TURN)
    edges = [0, *(np.flatnonzero(np.diff(portion)) + 1).tolist(), len(turned)]
    return [slice(first, last) for first, last in pairwise(edges) if last > first]


def blocks_of(
    moves: Moves, settings: Settings, extra: list[int], source: str
) -> tuple[Blocks, IntArray]:
    rows = moves.rows
    counts = _piece_counts(moves, settings, source)
    row, piece = ragged(counts)
    u = (piece + 1.0) / counts[row]
    final = piece + 1 == counts[row]
    rotary = moves.rotary(row, u)
    tip, axis = moves.poses(row, u)
    end = rows[row]
    on_circle = end[:, col.GREAT_CIRCLE] != 0.0
    interpolation = moves.interpolation[row]
    linear = interpolation != POSES
    rotary[~linear & (on_circle | (end[:, col.NAMED] == 0.0))] = nan
    rotary_from = np.full((len(row), 2), nan)
    named = linear | moves.rests[row]
    rotary_from[named] = moves.rotary(row[named], piece[named] / counts[row[named]])
    # Chords have used a part of the tolerance; the rest remains for the smoothing.
    share = np.where(moves.beside_arcs[row], 1.0 - CHORD_SHARE, 1.0)
    feedrate, duration = moves.speeds()
    blocks = Blocks(
        tip=tip,
        axis=axis,
        rotary=rotary,
        feedrate=feedrate[row],
        duration=duration[row] / counts[row],
        rapid=end[:, col.RAPID] != 0.0,
        exact_stop=(end[:, col.EXACT_STOP] != 0.0) & final,
        contour_tolerance=share * end[:, col.CONTOUR],
        orientation_tolerance=end[:, col.ORIENTATION].copy(),
        line_number=end[:, col.LINE].astype(np.int64),
        program_stop=np.where(final, waits_at(end), GO_ON),
        extra=moves.extra(row, u)[:, [column - col.EXTRA.start for column in extra]],
        interpolation=interpolation,
        rotary_from=rotary_from,
    )
    return blocks, row


def _piece_counts(moves: Moves, settings: Settings, source: str) -> IntArray:
    rows = moves.rows

    def fault(row: FloatArray, message: str) -> ProgramError:
        return ProgramError(message, source, int(row[col.LINE]))

    counts = np.ones(len(rows), dtype=np.int64)
    on_circle = rows[:, col.GREAT_CIRCLE] != 0.0
    if on_circle.any():
        angle = angle_between(moves.axis_before[on_circle], rows[on_circle, col.AXIS])
        if (angle > np.pi - _ANTIPARALLEL).any():
            raise fault(rows[on_circle][np.argmax(angle)],
                        'the tool axis turns by 180 deg in one block, so its plane of rotation is '
                        'undefined; add a block between')  # fmt: skip
        counts[on_circle] = np.maximum(np.ceil(angle / (90.0 * DEG) - 1e-9), 1.0)
    curved = np.flatnonzero(moves.curved())
    if len(curved):
        turned = np.abs(moves.sweep[curved]).sum(axis=1) + np.nan_to_num(
            np.abs(rows[curved, col.SWEEP])
        )
        if (turned > _MOST_TURN).any():
            worst = rows[curved[np.argmax(turned)]]
            raise fault(
                worst, 'more than 500 turns in one block; correct it or cut it into blocks'
            )
        pieces = piece_counts(
            lambda block, u: moves.chordal(curved[block], u),
            turned,
            CHORD_SHARE * rows[curved, col.CONTOUR],
            CHORD_SHARE * rows[curved, col.ORIENTATION],
            settings.flank_height,
        )
        if pieces.max() > MOST_PIECES:
            worst = rows[curved[np.argmax(pieces)]]
            raise fault(
                worst, f'more than {MOST_PIECES:,} chords in one block; widen the tolerances'
            )
        counts[curved] = np.maximum(counts[curved], pieces)
    turning = moves.interpolation == ROTARY_LINEAR
    if turning.any():
        turns = np.abs(moves.sweep[turning]).max(axis=1) / _LONGEST_TURN
        counts[turning] = np.maximum(counts[turning], np.ceil(turns).astype(np.int64))
    return counts


def start_pose(here: Moves, geometry: Transform, extra: list[int]) -> Blocks:
    """Return row 0, the start pose. It has no motion, so no feedrate and no duration."""
    row = here.rows
    tip, _ = here.poses(np.zeros(1, np.int64), np.ones(1))
    rotary = row[:, col.ROTARY].copy()
    if np.isfinite(rotary).all():
        axis = geometry.tool_axis(rotary)
        if np.abs(axis - row[:, col.AXIS]).max() > SAME:
            rotary[:] = nan  # the tool axis came from a direction
    return Blocks(
        tip=tip,
        axis=row[:, col.AXIS].copy(),
        rotary=rotary,
        feedrate=np.full(1, inf),
        duration=np.full(1, nan),
        rapid=row[:, col.RAPID] != 0.0,
        exact_stop=row[:, col.EXACT_STOP] != 0.0,
        contour_tolerance=row[:, col.CONTOUR].copy(),
        orientation_tolerance=row[:, col.ORIENTATION].copy(),
        line_number=row[:, col.LINE].astype(np.int64),
        extra=row[:, extra],
    )


def waits_at(rows: FloatArray) -> IntArray:
    return np.asarray(_WAITS[rows[:, col.EXACT_STOP].astype(np.int64)])
