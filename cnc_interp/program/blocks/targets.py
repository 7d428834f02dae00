"""Collect motion targets as rows of numbers, and convert them to blocks in batches."""

from array import array
from collections import deque
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf, nan

import numpy as np

from cnc_interp.core import DEG, FloatArray, IntArray, ProgramError
from cnc_interp.machine_model.joint import ARM
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.blocks import (
    GO_ON,
    OPEN_CORNER,
    OPTIONAL_STOP,
    POSES,
    ROTARY_LINEAR,
    STOP,
    WITHIN_MOTION,
    Blocks,
)
from cnc_interp.program.blocks.block_modes import NONE, ModesOfBlocks
from cnc_interp.program.blocks.moves import (
    BESIDE_ARC,
    CHORD_SHARE,
    NOTHING_BEFORE,
    SAME,
    Moves,
    merge_repeated,
)
from cnc_interp.program.blocks.start_line import StartLine
from cnc_interp.program.geometry import target_row as col
from cnc_interp.program.geometry.cutter_radius import CutterRadius, Told
from cnc_interp.program.geometry.subdivide import MOST_PIECES, angle_between, ragged
from cnc_interp.program.job import SetupChange
from cnc_interp.settings.options import Settings

_FIRST_BATCH, _BATCH_ROWS = 64, 4096
HOUR, LONGEST = 3600.0, 100.0 * 3600.0  #: A program that takes longer is rejected [s].
MOST_CHANGES = 1000  #: Largest number of changes of the setup that are kept individually.
#: Kind of program stop for each value of the column EXACT_STOP.
_WAITS = np.array([GO_ON, GO_ON, OPTIONAL_STOP, STOP])
_ANTIPARALLEL = 1e-4  # [rad]
_MOST_TURN = 500.0 * 360.0 * DEG
#: Largest turn of the rotary axes in a piece in which they and the tip move linearly [rad].
_LONGEST_TURN = 8.0 * 360.0 * DEG


@dataclass(frozen=True)
class ProgramChange:
    change: SetupChange  #: The change.
    line_number: int  #: Line of the program.
    #: Row of the block before which the change happens; the number of rows after the last block.
    block: int


class TargetColumns:
    def __init__(self, geometry: Transform, settings: Settings, source: str):
        self._geometry, self._settings, self._source = geometry, settings, source
        self._rows = array('d')
        self._radius: CutterRadius | None = None
        self._full = min(_FIRST_BATCH, _BATCH_ROWS) * col.WIDTH
        self.changed = 0  # changes of the setup, and functions, so far
        # Changes, and functions (step, value); their block is not yet known.
        self._coming: deque[tuple[int, SetupChange | tuple[int, float], int]] = deque()
        self._at_last = 0  # changes before the last target
        self._stops: deque[tuple[int, int]] = deque()  # changes between target and program stop
        #: Changes with a known row; if there are very many, only those still in effect.
        self.changes: list[ProgramChange] = []
        self.functions = array('d')
        self._emitted = 0  # rows of the blocks so far
        self.modes = ModesOfBlocks()
        self.state = (NONE, NONE, NONE)  # of the next target, as ``ModesOfBlocks.see`` takes it
        self.length = 0.0  # of the next target: the tool length that turns with the tool [m]
        self._before: FloatArray | None = None  # the last target that became a block
        self.waits_first = False  # for the operator, before the first motion
        self._parts: list[Blocks] = []
        self._tip: FloatArray | None = None  # where the last block ends
        # Time of the program so far, and its slowest block with its line [s].
        self._lasts, self._slowest = 0.0, (0.0, 0)
        self.start = StartLine(settings.from_line, settings.line_pass, source)
        self._curve: Blocks | None = None  # the last spline, until the stop at its end is known
        self._preceding = NOTHING_BEFORE  # the next motion
        self._zero = geometry.linear(np.zeros((1, 3)), np.zeros((1, 2)))[0]
        #: Positions of the extra axes before a word sets them, as in the columns EXTRA [m or rad].
        self.extra_start = np.zeros(3)
        if (arm := geometry.machine.arm) is not None:
            self.extra_start[: len(arm.further)] = arm.home[ARM:]
        self._extra = [col.EXTRA.start + k for k in range(len(geometry.machine.extra_names))]

    def add(self, row: tuple[float, ...], changed: int | None = None) -> None:
        if len(self._rows) >= self._full:
            self._convert(last=False)
        changed = self._at_last = self.changed if changed is None else changed
        whole = (*row, self.start.passes, changed, *self.state, self.length)
        if self._radius is None:
            self._rows.extend(whole)
            return
        for ready in self._radius.push(np.array(whole)):
            self._rows.extend(ready)

    def give_spin(self) -> int:
        """Reserve a column for (spin of an arm) x (flank height) [m]; return its index."""
        place = len(self._extra)
        if place == len(self.extra_start):
            raise ProgramError('poses need an arm with at most two further joints', self._source)
        self._extra.append(col.EXTRA.start + place)
        return place

    def begin_radius(
        self, distance: float, frame: FloatArray, own_entry: bool, told: Told | None
    ) -> None:
        before = np.array(self._rows[-col.WIDTH :])
        self._radius = CutterRadius(distance, frame, before, self._source, own_entry, told)

    def end_radius(self) -> FloatArray:
        if self._radius is not None:
            radius, self._radius = self._radius, None
            for ready in radius.end():
                self._rows.extend(ready)
        return np.array(self._rows[-col.WIDTH :])[col.POINT]

    def change(self, change: SetupChange | tuple[int, float], line_number: int) -> None:
        self.changed += 1
        self._coming.append((self.changed, change, line_number))

    @property
    def switches(self) -> bool:
        return any(not isinstance(change, SetupChange) for _, change, _ in self._coming)

    def extend(self, rows: FloatArray) -> None:
        """Add many targets, (n, WIDTH), and fill in PASSES, CHANGES, modal state and LENGTH."""
        if len(self._rows) >= self._full:
            self._convert(last=False)
        rows[:, col.PASSES] = self.start.passes
        rows[:, col.CHANGES] = self._at_last = self.changed
        rows[:, col.MODES.start], rows[:, col.LENGTH] = self.state[0], self.length
        self._rows.frombytes(np.ascontiguousarray(rows).tobytes())

    def stop_here(self, kind: float = 1.0) -> None:
        """Stop at the last target; with ``kind`` AT_M0 or AT_M1, also wait for the operator."""
        if self._radius is not None and self._radius.waits:
            self._radius.stop_here(kind)
        elif self._rows:
            at = col.EXACT_STOP - col.WIDTH
            self._rows[at] = max(self._rows[at], kind)

    def program_stop(self) -> None:
        self._stops.append((self._at_last, self.changed))

    def stand_at(self, rotary: FloatArray) -> None:
        if self._rows:
            last = len(self._rows) - col.WIDTH
            self._rows[last + col.ROTARY.start : last + col.ROTARY.stop] = array('d', rotary)

    def add_curve(self, curve: Blocks, end: tuple[float, ...], passes: int, changed: int) -> None:
        self._convert(last=True)
        extra = np.tile([end[column] for column in self._extra], (len(curve), 1))
        self._curve, self._before = replace(curve, extra=extra), None
        self._rows.extend((*end, passes, changed, *self.state, 0.0))
        self._at_last = changed

    @property
    def stands(self) -> bool:
        return self._before is None and self._curve is None and len(self._rows) <= col.WIDTH

    @property
    def empty(self) -> bool:
        return not self._rows

    @property
    def share(self) -> float:
        return self._emitted / max(self._emitted + len(self._rows) / col.WIDTH, 1.0)

    def take(self) -> list[Blocks]:
        parts, self._parts = self._parts, []
        return parts

    def finish(self) -> list[Blocks]:
        if self.empty:
            raise ProgramError('no motion found; is this a part program?', self._source)
        self.end_radius()
        self.stop_here()
        self._convert(last=True)
        self._place_changes(self.changed, self._emitted)
        return self.take()

    def _convert(self, last: bool) -> None:
        rows = np.frombuffer(self._rows, dtype=np.float64).reshape(-1, col.WIDTH).copy()
        by_rotary = np.isnan(rows[:, col.AXIS.start])
        if by_rotary.any():
            rows[by_rotary, col.AXIS] = self._geometry.tool_axis(rows[by_rotary, col.ROTARY])
        rows = merge_repeated(rows)
        held = rows[:0] if last else rows[-BESIDE_ARC:]
        rows = rows[: len(rows) - len(held)]
        self._rows = array('d', held.tobytes())
        self._full = min(4 * self._full, _BATCH_ROWS * col.WIDTH)
        if self._before is None and len(rows):
            beginning = self._beginning(rows[:1])
            self.start.see(np.full(len(beginning), rows[0, col.PASSES]))
            self._emit(beginning, np.zeros(1, np.int64), rows[:1])
            self._before, rows = rows[0], rows[1:]
        if len(rows) and self._before is not None:
            moves = self._moves(self._before, rows, held)
            if moves.undecided and not last:
                rows, later = np.split(rows, [len(rows) - moves.undecided])
                self._rows = array('d', later.tobytes()) + self._rows
                moves = self._moves(self._before, rows, np.concatenate([later, held]))
            if len(rows):
                self._before, self._preceding = rows[-1], moves.preceding
            for part in portions(moves):
                some = moves[part]
                blocks, row = blocks_of(some, self._settings, self._extra, self._source)
                self.start.see(some.rows[row, col.PASSES])
                self._emit(blocks, row, some.rows)

    def _emit(self, blocks: Blocks, row: IntArray, rows: FloatArray) -> None:
        if self._coming:
            changed, first = np.unique(rows[row, col.CHANGES], return_index=True)
            for count, block in zip(changed, first, strict=True):
                self._place_changes(int(count), self._emitted + int(block))
        self._demand_an_end(blocks)
        self.modes.see(rows[row][:, col.MODES], self._emitted)
        self._emitted += len(blocks)
        self._parts.append(blocks)

    def _demand_an_end(self, blocks: Blocks) -> None:
        """Reject a program that would take days; the error names its slowest line."""
        step = np.diff(
            blocks.tip, axis=0, prepend=blocks.tip[:1] if self._tip is None else self._tip
        )
        self._tip = blocks.tip[-1:]
        with np.errstate(divide='ignore', invalid='ignore'):
            time = np.linalg.norm(step, axis=1) / blocks.feedrate
        time = np.where(np.isfinite(blocks.duration), blocks.duration, np.nan_to_num(time))
        self._lasts += float(time.sum())
        slowest = int(np.argmax(time))
        if time[slowest] > self._slowest[0]:
            self._slowest = float(time[slowest]), int(blocks.line_number[slowest])
        if self._lasts > LONGEST:
            alone, line = self._slowest
            why = f'the program takes more than {LONGEST / HOUR:.0f} h'
            raise ProgramError(
                f'{why}, and a motion of this line {alone / HOUR:.3g} h; correct F or its unit',
                self._source,
                line,
            )

    def _place_changes(self, count: int, block: int) -> None:
        while self._coming and self._coming[0][0] <= count:
            number, change, line = self._coming.popleft()
            if isinstance(change, SetupChange):
                self.changes.append(ProgramChange(change, line, block))
            else:
                while self._stops and self._stops[0][1] < number:
                    self._stops.popleft()
                before_stop = bool(self._stops) and self._stops[0][0] < number
                self.functions.extend((block, line, *change, before_stop))
        if len(self.changes) > MOST_CHANGES:
            half = MOST_CHANGES // 2
            last = {(c.change.field, c.change.key): c for c in self.changes[:half]}
            self.changes[:half] = sorted(last.values(), key=lambda c: c.block)

    def _beginning(self, row: FloatArray) -> Blocks:
        if self._curve is None:
            here = Moves(self._geometry, self._zero, row, row, self._settings)
            return start_pose(here, self._geometry, self._extra)
        curve, self._curve = self._curve, None
        stop, waits = curve.exact_stop.copy(), curve.program_stop.copy()
        stop[-1] |= row[0, col.EXACT_STOP] != 0.0
        waits[-1] = waits_at(row)[0]
        return replace(curve, exact_stop=stop, program_stop=waits)

    def _moves(self, start: FloatArray, rows: FloatArray, coming: FloatArray) -> Moves:
        return Moves(
            self._geometry,
            self._zero,
            np.vstack([start, rows])[:-1],
            rows,
            self._settings,
            self._preceding,
            coming,
        )


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
        corner=np.where(final, OPEN_CORNER, WITHIN_MOTION),
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
            raise fault(
                rows[on_circle][np.argmax(angle)],
                'the tool axis turns by 180 deg in one block, so its plane of rotation is '
                'undefined; add a block between',
            )
        counts[on_circle] = np.maximum(np.ceil(angle / (90.0 * DEG) - 1e-9), 1.0)
    curved = np.flatnonzero(moves.curved())
    if len(curved):
        turned = np.abs(moves.sweep[curved]).sum(axis=1)
        turned = turned + np.nan_to_num(np.abs(rows[curved, col.SWEEP]))
        if (turned > _MOST_TURN).any():
            why = 'more than 500 turns in one block; correct it or cut it into blocks'
            raise fault(rows[curved[np.argmax(turned)]], why)
        pieces = moves.pieces(curved, turned, moves.chordal, settings.flank_height)
        if pieces.max() > MOST_PIECES:
            why = f'more than {MOST_PIECES:,} chords in one block; widen the tolerances'
            raise fault(rows[curved[np.argmax(pieces)]], why)
        counts[curved] = np.maximum(counts[curved], pieces)
    turning = moves.interpolation == ROTARY_LINEAR
    if turning.any():
        turns = np.abs(moves.sweep[turning]).max(axis=1) / _LONGEST_TURN
        counts[turning] = np.maximum(counts[turning], np.ceil(turns).astype(np.int64))
    return counts


def start_pose(here: Moves, geometry: Transform, extra: list[int]) -> Blocks:
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
