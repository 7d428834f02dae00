"""Compare the motions of a program text with the rows of a plan, by line or by position."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cnc_interp.core import DEG, MM, MM_PER_MIN, BoolArray, FloatArray, IntArray
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.blocks import GO_ON, OPTIONAL_STOP, STOP
from cnc_interp.proof.functions import compare_calls
from cnc_interp.proof.linuxcnc_reader import LAST_DIGIT
from cnc_interp.proof.plain_reader import STOPS, ReadCall, ReadMove
from cnc_interp.proof.plan_files import Columns, PlanFiles

# Ends agree within this [m, -, rad] and this many last digits; feeds and durations by this share.
SAME_PLACE, DIGITS, SAME_FEED = 2e-9, 2.0, 1e-6
SAME_TURN = 1e-9  #: Turns about the tool axis that differ by less are equal [whole turns].
STILL = 1e-12  #: A shorter way counts as zero: the turning axes then set the time [m].
ROUNDED = 0.75  #: Largest error of a printed angle, in last digits.
# A row inside a motion may lie beside it by this share of the tolerances: curves become lines.
CHORD = 0.11
PARALLEL = 1e-6  #: Sine below which a normal counts as parallel to the tool.
Read = ReadMove | ReadCall
WAITS = {GO_ON: 'no program stop', STOP: 'M0', OPTIONAL_STOP: 'M1'}
STOP_LAST = 1 + max(WAITS)
UNKNOWN = (float('nan'), float('nan'))  #: Tolerances if the settings are unknown [m].


@dataclass(frozen=True)
class Agreement:
    #: Number of motions in the text, and of arcs among them.
    motions: int
    arcs: int
    faults: tuple[str, ...]  #: One sentence for each line that differs.
    readers: str = ''  #: Which readers have read the text, and why others have not.


class RowsByLine:
    """Matches motions of the text with rows of the plan by their line numbers."""

    def __init__(self, blocks: Columns, machine: Machine, tolerances: Sequence[float] = UNKNOWN):
        self.blocks, self.machine, self.tolerances = blocks, machine, tolerances
        self.transform = Transform.of(machine)
        # Whether degrees count as millimetres in the feed; both if the text does not determine it.
        self.combined: tuple[bool, ...] = (False,)
        self.height = float('nan')  # flank height [m]
        self.faults: list[str] = []
        self.row = self.motions = self.arcs = 0  # row: the first one that is not compared yet
        # Axis positions with the tip at the workpiece zero and the rotary axes at zero.
        count = len(machine.axis_names)
        self.zero = np.zeros((1, count))
        self.zero[0, :3] -= self.transform.forward(self.zero)[0][0]
        self.before: ReadMove | None = None
        self.linear: FloatArray | None = None
        self.calls: list[tuple[ReadCall, int]] = []  # and the row before which each acts

    def follow(self, moves: Iterable[Read]) -> Agreement:
        for move in moves:
            if isinstance(move, ReadCall):
                self.calls.append((move, self.row_of_call()))
            elif not self.take(move):
                break
        else:
            self.end()
        return Agreement(self.motions, self.arcs, tuple(self.faults))

    def row_of_call(self) -> int:
        return self.row

    def waits(self, plan: PlanFiles, known: Collection[str] = ()) -> tuple[str, ...]:
        """Return the differences between text and plan in functions and program stops."""
        signals = self.machine.signals
        waits = np.zeros(len(self.blocks['line']), dtype=np.int64)
        waits_first, faults = False, []
        for call, row in self.calls:
            if call.word in STOPS and row <= 1:  # it waits before the motion begins
                waits_first |= call.word != 'M1'
            elif call.word in STOPS:
                kinds = [OPTIONAL_STOP if call.word == 'M1' else STOP, waits[row - 1] or STOP_LAST]
                waits[row - 1] = min(kinds)
        for row in np.flatnonzero(waits != self.blocks['program_stop'])[:1]:
            line, found = self.blocks['line'][row], int(self.blocks['program_stop'][row])
            wanted = WAITS[int(waits[row])]
            faults.append(
                f'line {line} of the program: {wanted} must follow it, not {WAITS[found]}'
            )
        stated = plan.summary.get('waits_first', waits_first)
        if stated is not waits_first:
            stated = 'waits' if stated else 'does not wait'
            faults.append(f'the plan {stated} for the operator before the motion begins')
        fault = compare_calls(plan, signals, self.calls, known)
        return (*faults, *([fault] if fault else []))

    def fault(self, move: ReadMove, text: str) -> None:
        self.faults.append(f'line {move.line} of the program: {text}')

    def rows_of(self, move: ReadMove) -> int:
        lines, last = self.blocks['line'], self.row
        if self.before is None:
            return 1  # the start pose
        while last < len(lines) and lines[last] == move.line:
            last += 1
        return last

    def pose(self, move: ReadMove) -> tuple[FloatArray, FloatArray]:
        if move.tcp or not self.machine.has_rotary:
            axis = move.axis
            if axis is None:
                axis = np.array([0.0, 0.0, 1.0])
                if self.machine.has_rotary:
                    axis = self.transform.tool_axis(move.rotary[None])[0]
            end = move.end if move.normal is None else _tip_of(move, axis)
            return end + move.length * axis, axis
        q = self.zero.copy()
        q[0, :3] += move.end
        q[0, 3 : 3 + len(move.rotary)] = move.rotary
        q[0, 3 + len(move.rotary) :] = move.extra
        tip, axes = self.transform.forward(q)
        return tip[0], axes[0]

    def end_of(self, move: ReadMove, length: float) -> FloatArray:
        """Return the tip at the end of a motion, for a tool shorter by ``length``, (3,) [m]."""
        end, axis = self.pose(move)
        return np.asarray(end - length * axis)

    def room(self, move: ReadMove) -> float:
        room = _place(move)
        if move.digit and not move.tcp:
            tip = self.pose(move)[0]
            for step in ROUNDED * LAST_DIGIT * DEG * np.eye(len(move.rotary)):
                turned = self.pose(replace(move, rotary=move.rotary + step))[0]
                room += float(np.linalg.norm(turned - tip))
        return room

    def take(self, move: ReadMove) -> bool:
        last = self.rows_of(move)
        rows = np.arange(self.row, last)
        tip, axis = self.pose(move)
        before, self.before, self.row = self.before, move, last
        self.motions, self.arcs = self.motions + 1, self.arcs + (move.sweep != 0)
        near, angle = self.room(move), _angle(move)
        if not len(rows):
            self.unmoved(move, before, tip, axis)
            return True
        end = rows[-1]
        if move.stop and before is not None and not self.blocks['exact_stop'][end]:
            self.fault(move, f'rests at its end, but its row {end} does not')
        off = float(np.linalg.norm(self.blocks['tip'][end] - tip))
        if off > near:
            self.fault(move, f'ends {off / MM:.4g} mm from the end of its row {end}')
        turned = float(np.linalg.norm(self.blocks['axis'][end] - axis))
        if turned > angle:
            self.fault(move, f'its tool axis is {turned:.3g} rad from that of its row {end}')
        rotary = self.blocks['rotary'][end, : len(move.rotary)]
        if move.worded and np.isnan(rotary).any():
            self.fault(move, f'has rotary words, but its row {end} has none')
        if len(move.rotary) and np.isfinite(rotary).all() and move.axis is None:
            away = float(np.abs(rotary - move.rotary).max())
            if away > angle:
                self.fault(move, f'its rotary words are {away:.3g} rad from those of row {end}')
        extra, spin = np.split(self.blocks['extra_axes'][end], [len(move.extra)])
        if (np.abs(extra - move.extra) > SAME_PLACE).any():
            self.fault(move, f'its extra axes are not those of row {end}')
        gap = (spin / self.height - move.spin) / (2.0 * np.pi)
        turns = self.machine.arm is not None and np.isfinite(move.spin)
        if len(gap) != turns or not (np.abs(gap - np.round(gap)) <= SAME_TURN).all():
            self.fault(move, f'its turn about the tool axis is not that of row {end}')
        if before is not None:
            self.way(move, before, rows)
            self.speed(move, before, rows)
        return off <= near or move.line > 0

    def unmoved(
        self, move: ReadMove, before: ReadMove | None, tip: FloatArray, axis: FloatArray
    ) -> None:
        if before is None:
            self.fault(move, 'is not the start pose of the plan')
            return
        here, pointing = self.pose(before)
        gone = max(float(np.linalg.norm(tip - here)), float(np.linalg.norm(axis - pointing)))
        turned = np.abs(move.rotary - before.rotary).max(initial=0.0)
        if gone > self.room(move) or turned > _angle(move) or move.sweep:
            self.fault(move, 'has no row in the plan')

    def points(self, move: ReadMove, rows: IntArray | slice) -> FloatArray:
        if move.tcp or not self.machine.has_rotary:
            return np.asarray(self.blocks['tip'][rows] - move.length * self.blocks['axis'][rows])
        if self.linear is None:
            rotary = np.nan_to_num(self.blocks['rotary'])
            self.linear = self.transform.linear(self.blocks['tip'], rotary) - self.zero[0, :3]
        return np.asarray(self.linear[rows])

    def way(self, move: ReadMove, before: ReadMove, rows: IntArray) -> None:
        tolerance = float(self.blocks['contour_tolerance'][rows].min())
        room = CHORD * tolerance + SAME_PLACE + 3.0 * move.digit
        self.kept(move, rows, self.chord_error(move, rows) if move.sweep else 0.0)
        if move.sweep:
            self.arc(move, rows, room)
            return
        if len(rows) < 2 or not (move.tcp or np.allclose(move.rotary, before.rotary)):
            return
        points = self.blocks['tip'][rows] - move.length * self.blocks['axis'][rows]
        start, end = (self.end_of(one, move.length) for one in (before, move))
        chord, length = end - start, float(np.linalg.norm(end - start))
        share = (points - start) @ chord / max(length**2, 1e-30)
        off = np.linalg.norm(points - start - np.clip(share, 0, 1)[:, None] * chord, axis=1)
        unsure = SAME_PLACE + move.digit / max(length, 1e-15)
        if off.max() > room or (np.diff(share) < -unsure).any():
            self.fault(move, f'rows {rows[0]} to {rows[-1]} are not on its line')

    def kept(self, move: ReadMove, rows: IntArray, chord_error: float) -> None:
        kinds = (
            ('contour', 'a', move.tolerance, chord_error),
            ('orientation', 'an orientation', move.orientation, 0.0),
        )
        for usual, (name, what, told, chords) in zip(self.tolerances, kinds, strict=True):
            wanted = usual if np.isnan(told) else told
            used = float(self.blocks[f'{name}_tolerance'][rows].max())
            if used + chords > wanted * (1.0 + SAME_FEED) + _place(move):
                arc = f', and its arc {chords / MM:.4g} mm' if chords else ''
                self.fault(
                    move,
                    f'has {what} tolerance of {wanted / MM:.6g} mm, but its rows may use '
                    f'{used / MM:.6g} mm{arc}',
                )

    def chord_error(self, move: ReadMove, rows: IntArray) -> float:
        if len(move.extra) and not move.tcp:
            return 0.0
        arms = _arms(move, self.points(move, slice(rows[0] - 1, rows[-1] + 1)))
        turn = np.diff(np.unwrap(np.arctan2(arms[:, 1], arms[:, 0])))
        radius = np.linalg.norm(arms, axis=1)
        return float(np.max(np.maximum(radius[1:], radius[:-1]) * (1.0 - np.cos(0.5 * turn))))

    def arc(self, move: ReadMove, rows: IntArray, room: float) -> None:
        if len(move.extra) and not move.tcp:
            return
        points = self.points(move, slice(rows[0] - 1, rows[-1] + 1))
        arms = _arms(move, points)
        radius = np.linalg.norm(arms, axis=1)
        # The radius changes evenly from start to end where both differ.
        turns = move.sweep * np.diff(np.unwrap(np.arctan2(arms[:, 1], arms[:, 0])))
        angle, wanted = float(turns.sum()), self.turn_of(move, points[0])
        share = np.r_[0.0, np.cumsum(turns)] / max(angle, 1e-12)
        even = np.abs(radius - (radius[0] + share * (radius[-1] - radius[0]))).max()
        height = points[:, move.plane[2]]
        straight = np.abs(height - (height[0] + share * (height[-1] - height[0]))).max()
        blur = 1e-6 + _blur(move, points[0])
        if abs(angle - wanted) > blur or (turns < 0.0).any():
            self.fault(
                move,
                f'turns by {np.degrees(wanted):.6g} deg, but its rows turn by '
                f'{np.degrees(angle):.6g} deg',
            )
        # A centre that is off by a digit turns a helix, and so moves it along its axis.
        elif max(even, straight - blur / max(angle, 1e-12) * np.ptp(height)) > room:
            self.fault(move, 'its rows are not on the arc')

    def turn_of(self, move: ReadMove, start: FloatArray) -> float:
        first, last = _arms(move, start), _arms(move, move.end)
        turn = move.sweep * float(np.arctan2(last[1], last[0]) - np.arctan2(first[1], first[0]))
        # A chord of one digit is a short arc; both ends printed alike are a whole turn.
        whole = np.linalg.norm(last - first) <= SAME_PLACE + 0.75 * move.digit
        turn = 2.0 * np.pi if whole else turn % (2.0 * np.pi)
        return turn + 2.0 * np.pi * (move.turns - 1)

    def speed(self, move: ReadMove, before: ReadMove, rows: IntArray) -> None:
        if (self.blocks['rapid'][rows] != move.rapid).any():
            self.fault(move, f'is {"a" if move.rapid else "no"} rapid, but its rows are not')
            return
        duration, feed = self.blocks['duration'][rows], self.blocks['feed'][rows]
        if move.rapid:
            if np.isfinite(duration).any() or np.isfinite(feed).any():
                self.fault(move, 'is a rapid, but one of its rows has a feed or a duration')
            return
        timed, times = np.isfinite(duration), self.lasts(move, before, rows)
        if np.isnan(move.feed) and np.isnan(move.duration):
            if not timed.all():
                self.fault(move, 'has no feed')
        elif timed.any() or np.isfinite(move.duration):
            # The rows of a motion share its time evenly.
            spent = float(duration.sum())
            wanted = min(times, key=lambda time: abs(time - spent))
            share = wanted / len(rows)
            room = SAME_FEED * wanted + self.unsure_time(move, wanted, rows)
            even = np.abs(duration - share).max() <= room
            if not (even and abs(spent - wanted) <= room):
                self.fault(move, f'lasts {wanted:.6g} s, but its rows last {spent:.6g} s')
        else:
            worst = feed[np.argmax(np.abs(feed - move.feed))]
            if not abs(worst - move.feed) <= (SAME_FEED + move.unsure) * move.feed:
                found = f'{move.feed / MM_PER_MIN:.6g} mm/min, but one of its rows has'
                self.fault(move, f'has F {found} {worst / MM_PER_MIN:.6g}')

    def unsure_time(self, move: ReadMove, wanted: float, rows: IntArray) -> float:
        """Return the uncertainty of a motion's time due to rounded digits of the reader [s]."""
        unsure = move.unsure * wanted
        if np.isnan(move.duration):
            unsure += 2.0 * SAME_PLACE / move.feed
            if move.digit:
                unsure += 2.0 * (DIGITS * move.digit + self.room(move)) / move.feed
        return unsure

    def lasts(self, move: ReadMove, before: ReadMove, rows: IntArray) -> list[float]:
        """Return the possible durations of a motion [s]: as written, or from its feed.

        The feed is that of X Y Z or the tip; if these do not move, that of the extra axes, else of
        the rotary axes.
        """
        if np.isfinite(move.duration) or np.isnan(move.feed):
            return [move.duration]
        first, last = rows[0] - 1, rows[-1]
        extra, direction = self.blocks['extra_axes'], self.machine.extra_direction
        if move.tcp:
            start, end = (self.end_of(one, move.length) for one in (before, move))
        else:
            start, end = self.points(move, rows[:1] - 1)[0] - extra[first] @ direction, move.end
        way = float(np.linalg.norm(end - start))
        if way <= DIGITS * move.digit:  # only the rows show whether X Y Z move
            ends = self.points(move, np.array([first, last]))
            way = float(np.linalg.norm(ends[1] - ends[0]))
        if move.sweep:
            way = self.arc_length(move, start, end)
        elif not move.tcp and np.abs(move.rotary - before.rotary).max(initial=0.0) <= SAME_PLACE:
            aside = extra[last] - extra[first]
            along = end - start + aside @ direction
            way = max(float(np.linalg.norm(along)), float(np.linalg.norm(aside)))
        turning = float(np.linalg.norm(move.rotary - before.rotary)) / move.turn_feed
        alone = way / move.feed if way > STILL else turning
        both = float(np.hypot(way / move.feed, turning))
        return [alone if move.tcp or not combined else both for combined in self.combined]

    def arc_length(self, move: ReadMove, start: FloatArray, end: FloatArray) -> float:
        arms = np.linalg.norm(_arms(move, np.stack([start, end])), axis=1)
        across = float((end - start)[move.plane[2]])
        return float(np.hypot(arms.mean() * self.turn_of(move, start), across))

    def end(self) -> None:
        if self.row < len(self.blocks['line']):
            line = self.blocks['line'][self.row]
            self.faults.append(
                f'row {self.row} of the plan (line {line}) is no motion of the text'
            )
        if not self.motions:
            self.faults.append('the text has no motion')


class RowsByPlace(RowsByLine):
    def __init__(self, blocks: Columns, machine: Machine, tolerances: Sequence[float] = UNKNOWN):
        super().__init__(blocks, machine, tolerances)
        self.tiny = 0  # motions shorter than the last digit, which may have rows
        # The row after those of the same line, for each row.
        count = len(blocks['line'])
        borders = np.append(1 + np.flatnonzero(np.diff(blocks['line'])), count)
        self.stops = borders[np.searchsorted(borders, np.arange(count), side='right')]

    def fault(self, move: ReadMove, text: str) -> None:
        line = self.blocks['line'][min(self.row, len(self.blocks['line'])) - 1]
        self.faults.append(f'line {line} of the program, by LinuxCNC: {text}')

    def row_of_call(self) -> int:
        self.pass_tiny()
        return self.row

    def take(self, move: ReadMove) -> bool:
        if self.before is None and move.rapid and not self.near(move, 0, 1)[0]:
            return True
        return super().take(move)

    def rows_of(self, move: ReadMove) -> int:
        """Return the first row after a motion; its last row is the first one at its end point."""
        before = self.before
        if before is None:
            return 1
        self.pass_tiny()
        rests = not move.sweep and np.array_equal(move.end, before.end)
        if rests and np.array_equal(move.rotary, before.rotary):
            self.tiny += 1
            return self.row
        here = [] if move.sweep else self.near(move, self.row - 1, 2).tolist()
        if here == [True, False]:  # shorter than a digit, and without a row of this line
            return self.row
        stop, some = int(self.stops[self.row]) if self.row < len(self.stops) else self.row, 4
        while self.row < stop:
            some = min(some, stop - self.row)
            there = (self.swept if move.sweep else self.near)(move, self.row, some)
            if there.any():
                return self.row + int(np.argmax(there)) + 1
            if self.row + some == stop:
                break
            some *= 4
        return self.row if not move.sweep and self.near(move, self.row - 1, 1)[0] else stop

    def pass_tiny(self) -> None:
        before, last = self.before, len(self.stops)
        while before and self.tiny and self.row < last and self.near(before, self.row, 1)[0]:
            self.row, self.tiny = self.row + 1, self.tiny - 1

    def end(self) -> None:
        self.pass_tiny()
        super().end()

    def near(self, move: ReadMove, first: int, some: int) -> BoolArray:
        rows = slice(first, first + some)
        turned = np.abs(self.blocks['rotary'][rows, : len(move.rotary)] - move.rotary)
        away = np.linalg.norm(self.points(move, rows) - move.end, axis=1)
        turning = turned.max(axis=1, initial=0.0) > _angle(move)
        return np.asarray((away <= _place(move)) & ~turning)

    def swept(self, move: ReadMove, first: int, some: int) -> BoolArray:
        points = self.points(move, slice(first - 1, first + some))
        arms = _arms(move, points)
        turned = np.unwrap(np.arctan2(arms[:, 1], arms[:, 0]))
        turned = move.sweep * (turned[1:] - turned[0])
        wanted = self.turn_of(move, points[0])
        return np.asarray(turned >= wanted - 1e-6 - _blur(move, points[0]))


def _tip_of(move: ReadMove, axis: FloatArray) -> FloatArray:
    assert move.normal is not None
    ring, corner = move.cutter
    # The corner touches where its centre lies along the normal; from there to the axis, and down.
    beside = np.cross(axis, np.cross(move.normal, axis))
    length = float(np.linalg.norm(beside))
    centre = move.end + corner * move.normal
    inward = beside / length if length > PARALLEL else np.zeros(3)
    return np.asarray(centre + ring * inward - corner * axis)


def _place(move: ReadMove) -> float:
    return SAME_PLACE + DIGITS * move.digit


def _angle(move: ReadMove) -> float:
    """Return the accepted difference of tool axis and rotary words [rad]."""
    return SAME_PLACE + (DIGITS * LAST_DIGIT * DEG if move.digit else 0.0)


def _blur(move: ReadMove, start: FloatArray) -> float:
    """Return the uncertainty of the angle of an arc [rad]."""
    return 4.0 * move.digit / max(float(np.linalg.norm(_arms(move, start))), 1e-12)


def _arms(move: ReadMove, points: FloatArray) -> FloatArray:
    assert move.centre is not None
    return np.asarray(points[..., list(move.plane[:2])] - move.centre)
