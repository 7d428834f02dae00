"""The program read once more: ends, arcs and feeds of its text compared with `blocks.npz`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.core.errors import InterpError, ProgramError
from cnc_interp.core.units import MM, MM_PER_MIN
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.proof.plain_reader import Move, read_plainly
from cnc_interp.proof.plan_files import PlanFiles

# Ends agree within this [m, -, rad], and feeds and durations by this share [-].
SAME_PLACE, SAME_FEED = 2e-9, 1e-6
# A row inside a motion may lie beside it by this share of the tolerances: some curves of the
# machine become lines of poses.
CHORD = 0.11
# Longest program that is read [bytes].
LONGEST = 64 << 20


@dataclass(frozen=True)
class Agreement:
    """
    What was compared, and what differs.

    Parameters
    ----------
    motions, arcs : int
        Motions of the text, and arcs among them.
    faults : tuple of str
        One sentence for each line that differs.

    """

    motions: int
    arcs: int
    faults: tuple[str, ...]


def compare_with_text(plan: PlanFiles, machine: Machine, program: Path) -> Agreement:
    """
    Read a program by the second reader and compare it with the rows of a plan.

    Parameters
    ----------
    plan : PlanFiles
        The plan.
    machine : Machine
        Its machine.
    program : Path
        Text of the program.

    Returns
    -------
    Agreement

    Raises
    ------
    InterpError
        If the text has a word that the second reader does not know, or cannot be read.

    """
    settings = plan.summary.get('settings')
    settings = settings if isinstance(settings, dict) else {}
    if settings.get('setup') or settings.get('rotary_sense') == 'shortest':
        raise InterpError(
            f'{program}: planned with --setup or --rotary-sense shortest, which the second '
            'reader does not know; this program cannot be compared'
        )
    try:
        with program.open('rb') as file:
            text = file.read(LONGEST + 1).decode('utf-8-sig', errors='replace')
    except OSError as problem:
        raise ProgramError(f'cannot be opened: {problem.strerror}', str(program)) from None
    if len(text) > LONGEST:
        raise InterpError(f'{program}: longer than {LONGEST >> 20} MB; cannot be compared')
    feed = settings.get('feedrate')
    moves = read_plainly(
        text, str(program), machine.axis_names,
        float(feed) if isinstance(feed, int | float) else None, bool(settings.get('skip_blocks')),
    )  # fmt: skip
    comparison = _Comparison(plan, machine)
    for move in moves:
        comparison.take(move)
    comparison.end(moves)
    return Agreement(len(moves), sum(move.sweep != 0 for move in moves), tuple(comparison.faults))


class _Comparison:
    """Follows the rows of a plan with the motions of its text."""

    def __init__(self, plan: PlanFiles, machine: Machine):
        self.blocks, self.machine = plan.blocks, machine
        self.height, self.transform = plan.flank_height, Transform.of(machine)
        self.faults: list[str] = []
        self.row = 0  # the first row that is not compared yet
        # Axis positions with the tip at the workpiece zero and the rotary axes at zero.
        count = len(machine.axis_names)
        self.zero = np.zeros((1, count))
        self.zero[0, :3] -= self.transform.forward(self.zero)[0][0]
        self.before: Move | None = None

    def fault(self, move: Move, text: str) -> None:
        """Record that a line differs."""
        self.faults.append(f'line {move.line} of the program: {text}')

    def pose(self, move: Move) -> tuple[FloatArray, FloatArray]:
        """Return tool tip and tool axis at the end of a motion."""
        if move.tcp or not self.machine.has_rotary:
            axis = move.axis
            if axis is None:
                axis = np.array([0.0, 0.0, 1.0])
                if self.machine.has_rotary:
                    axis = self.transform.tool_axis(move.rotary[None])[0]
            return move.end, axis
        q = self.zero.copy()
        q[0, :3] += move.end
        q[0, 3:5] = move.rotary
        tip, axes = self.transform.forward(q)
        return tip[0], axes[0]

    def take(self, move: Move) -> None:
        """Compare one motion with its rows."""
        lines = self.blocks['line']
        last = self.row
        while last < len(lines) and lines[last] == move.line:
            last += 1
        rows = np.arange(self.row, last)
        tip, axis = self.pose(move)
        before, self.before, self.row = self.before, move, last
        if not len(rows):
            self.unmoved(move, before, tip, axis)
            return
        end = rows[-1]
        off = float(np.linalg.norm(self.blocks['tip'][end] - tip))
        if off > SAME_PLACE:
            self.fault(move, f'ends {off / MM:.4g} mm from the end of its row {end}')
        turned = float(np.linalg.norm(self.blocks['axis'][end] - axis))
        if turned > SAME_PLACE:
            self.fault(move, f'its tool axis is {turned:.3g} rad from that of its row {end}')
        rotary = self.blocks['rotary'][end]
        if len(move.rotary) and np.isfinite(rotary).all() and move.axis is None:
            off = float(np.abs(rotary - move.rotary).max())
            if off > SAME_PLACE:
                self.fault(move, f'its rotary words are {off:.3g} rad from those of row {end}')
        extra = self.blocks['extra_axes'][end]
        if len(extra) and np.abs(extra - move.extra).max() > SAME_PLACE:
            self.fault(move, f'its extra axes are not those of row {end}')
        if before is not None:
            self.way(move, before, rows)
            self.speed(move, before, rows)

    def unmoved(self, move: Move, before: Move | None, tip: FloatArray, axis: FloatArray) -> None:
        """Accept a motion without rows if it goes nowhere."""
        if before is None:
            self.fault(move, 'is not the start pose of the plan')
            return
        here, pointing = self.pose(before)
        gone = max(float(np.linalg.norm(tip - here)), float(np.linalg.norm(axis - pointing)))
        turned = np.abs(move.rotary - before.rotary).max(initial=0.0)
        if max(gone, float(turned)) > SAME_PLACE or move.sweep:
            self.fault(move, 'has no row in the plan')

    def way(self, move: Move, before: Move, rows: IntArray) -> None:
        """Compare the rows inside a motion with its line or arc."""
        points = self.blocks['tip'][rows]
        room = CHORD * float(self.blocks['contour_tolerance'][rows].min()) + SAME_PLACE
        if move.sweep:
            self.arc(move, before, points, room)
            return
        if len(rows) < 2 or not (move.tcp or np.allclose(move.rotary, before.rotary)):
            return
        start, end = self.pose(before)[0], self.pose(move)[0]
        chord = end - start
        share = (points - start) @ chord / max(float(chord @ chord), 1e-30)
        off = np.linalg.norm(points - start - np.clip(share, 0, 1)[:, None] * chord, axis=1)
        if off.max() > room or (np.diff(share) < -SAME_PLACE).any():
            self.fault(move, f'rows {rows[0]} to {rows[-1]} are not on its line')

    def arc(self, move: Move, before: Move, points: FloatArray, room: float) -> None:
        """Compare rows with an arc or a helix."""
        a, b, across = move.plane
        assert move.centre is not None
        if not (move.tcp or np.allclose(move.rotary, before.rotary)):
            return
        shift = self.pose(move)[0] - move.end  # of a tilted workpiece
        if not move.tcp and self.machine.has_rotary and np.abs(shift).max() > SAME_PLACE:
            return
        all_points = np.vstack([before.end, points])
        arms = all_points[:, [a, b]] - move.centre
        radius = np.linalg.norm(arms, axis=1)
        # The radius changes evenly from start to end where both differ.
        turns = move.sweep * np.diff(np.unwrap(np.arctan2(arms[:, 1], arms[:, 0])))
        angle = float(turns.sum())
        first, last = arms[0], move.end[[a, b]] - move.centre
        wanted = move.sweep * (np.arctan2(last[1], last[0]) - np.arctan2(first[1], first[0]))
        wanted = float(wanted % (2.0 * np.pi)) or 2.0 * np.pi
        whole = np.linalg.norm(move.end[[a, b]] - before.end[[a, b]]) < SAME_PLACE
        wanted = 2.0 * np.pi if whole else wanted
        share = np.r_[0.0, np.cumsum(turns)] / max(angle, 1e-12)
        even = np.abs(radius - (radius[0] + share * (radius[-1] - radius[0]))).max()
        height = all_points[:, across]
        straight = np.abs(height - (height[0] + share * (height[-1] - height[0]))).max()
        if abs(angle - wanted) > 1e-6 or (turns < 0.0).any():
            self.fault(move, f'turns by {np.degrees(wanted):.6g} deg, its rows by '
                       f'{np.degrees(angle):.6g} deg')  # fmt: skip
        elif max(float(even), float(straight)) > room:
            self.fault(move, 'its rows are not on the arc')

    def speed(self, move: Move, before: Move, rows: IntArray) -> None:
        """Compare rapids, feeds and durations."""
        if (self.blocks['rapid'][rows] != move.rapid).any():
            self.fault(move, f'is {"a" if move.rapid else "no"} rapid, its rows are not so')
            return
        turns = np.abs(move.rotary - before.rotary).max(initial=0.0) > SAME_PLACE
        duration, feed = self.blocks['duration'][rows], self.blocks['feed'][rows]
        if np.isfinite(move.duration):
            spent = float(duration.sum())
            if not abs(spent - move.duration) <= SAME_FEED * move.duration:
                self.fault(move, f'lasts {move.duration:.6g} s, its rows {spent:.6g} s')
        elif np.isfinite(move.feed) and (move.tcp or not turns) and np.isnan(duration).all():
            moving = feed[np.isfinite(feed)]
            if (np.abs(moving - move.feed) > SAME_FEED * move.feed).any():
                worst = moving[np.argmax(np.abs(moving - move.feed))] / MM_PER_MIN
                self.fault(
                    move, f'has F {move.feed / MM_PER_MIN:.6g} mm/min, a row of it {worst:.6g}'
                )
        elif np.isnan(move.feed) and not move.rapid and np.isnan(duration).all():
            self.fault(move, 'has no feed')

    def end(self, moves: list[Move]) -> None:
        """Record rows that no motion explains."""
        if self.row < len(self.blocks['line']):
            line = self.blocks['line'][self.row]
            self.faults.append(
                f'row {self.row} of the plan (line {line}) is no motion of the text'
            )
        if not moves:
            self.faults.append('the text has no motion')
