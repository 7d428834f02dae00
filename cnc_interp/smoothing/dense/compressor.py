"""
The compressor: runs of short blocks become smooth curves within the tolerances.

A run of short blocks is a polyline (``polyline.py``) that is processed window by window. A quintic
spline through the whole window is fitted into the tolerance tube (``tube_fit.py``) and certified
(``certificate.py``). Its first half is committed, and the next window continues it with four
derivatives. A window is solved only when all data that it depends on have arrived. So the result
does not depend on how the blocks arrive. Where a curve meets a line or a corner, it begins with
the motion of the line: the tip moves straight and the tool axis on the great circle.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.machine_model.machine_traits import MachineTraits
from cnc_interp.program.blocks import Blocks
from cnc_interp.settings.choices import Settings
from cnc_interp.smoothing.dense.curve_fit import AHEAD, Run, Window
from cnc_interp.smoothing.dense.end_lines import (
    EndLine,
    choose_end_line,
    longest_spacing,
    with_end_line,
)
from cnc_interp.smoothing.dense.path_rows import Rows
from cnc_interp.smoothing.dense.polyline import Polyline
from cnc_interp.smoothing.dense.skeleton import (
    LONG,
    SHORT,
    CornerSearch,
    Skeleton,
    SkeletonBuilder,
)
from cnc_interp.smoothing.stop_choice import MOST_BLOCKS, Choice, may_be_slow, ways_of_run

#: Smallest number of blocks in a run.
FEWEST_BLOCKS = 3
#: Number of vertices that are kept before the last one sent.
KEPT_VERTICES = 2048
#: Shortest distance between the committed curve and the end of its run, in tolerances.
SHORTEST_REST = 40.0


class Compressor:
    """Convert a stream of blocks to lines and curves."""

    def __init__(
        self, settings: Settings, machine: MachineTraits, choice: Choice | None, row: int = 0,
        joined: bool = False,
    ):  # fmt: skip
        self._enabled, self._height = settings.compress, settings.flank_height
        self._share = settings.tolerance_share
        self._machine, self._choice = machine, choice
        self._builder = SkeletonBuilder(settings, row, joined)
        self._corners = CornerSearch(settings.corner_angle)
        self._first = row
        self._at = 0  # all blocks before this vertex have been sent
        self._begun = False
        self._run: Run | None = None
        self._start = self._next = self._last = 0  # first, next and last vertex of the run
        self._lead: EndLine | None = None  # line before the run, if not sent yet
        self._tail: EndLine | None = None  # line after the run
        self._after_curve = False
        self._rows: list[Rows] = []

    def push(self, blocks: Blocks) -> Rows:
        """Add blocks; return the lines and curves that later blocks cannot change."""
        if not self._enabled:
            self._first += len(blocks)
            return Rows.plain(blocks, self._first - len(blocks))
        self._builder.push(blocks, final=False)
        return self._advance(final=False)

    def finish(self, joined: bool = False) -> Rows:
        """Return the rest; if a native spline follows (``joined``), the last block is a line."""
        if self._enabled:
            self._builder.push(None, final=True, joined=joined)
        return self._advance(final=True)

    def _advance(self, final: bool) -> Rows:
        """Find corners, and return all rows that are final."""
        if self._builder.skeleton is not None:
            self._corners.decide(self._skeleton, final)
            self._send()
            self._forget()
        rows, self._rows = self._rows, []
        return Rows.concatenate(rows) if rows else Rows.plain(Blocks.none(), 0)

    @property
    def _skeleton(self) -> Skeleton:
        assert self._builder.skeleton is not None
        return self._builder.skeleton

    def _send(self) -> None:
        """Send lines and runs in order, as far as their vertices are decided."""
        if not self._begun and self._corners.decided:
            self._begun = True
            self._rows.append(Rows.plain(self._skeleton.blocks[:1], self._first))
        while True:
            if self._run is not None:
                if not self._follow(self._run):
                    return
                continue
            skeleton, a = self._skeleton, self._at
            if a + 1 >= self._corners.decided:
                return
            if skeleton.kind[a + 1] == SHORT:
                start = a
            elif skeleton.kind[a + 1] == LONG and not skeleton.ends[a + 1]:
                start = a + 1
            else:
                self._line(a + 1)
                self._at = a + 1
                continue
            last, ended, ready = self._extent(start)
            if not ready:
                return
            if last - start >= FEWEST_BLOCKS:
                faster = self._is_faster(start, last, ended)
                if faster is None:
                    return
                if faster:
                    self._begin(start, last, ended)
                else:
                    skeleton.corner[start + 1 : last] = True
                continue
            for k in range(a + 1, last + 1):
                self._line(k)
            self._at = last

    def _extent(self, start: int) -> tuple[int, bool, bool]:
        """
        Find the end of a run that begins at a vertex.

        Returns the last known vertex of the run, whether the run ends there, and whether enough
        is known to decide if there is a run.
        """
        skeleton, stop = self._skeleton, self._corners.decided
        if start + 1 < len(skeleton) and skeleton.kind[start + 1] != SHORT:
            return start, True, True
        if start + 1 >= stop:
            return start, False, False
        following = np.append(skeleton.kind[start + 2 : stop + 1], SHORT)[: stop - start - 1]
        ends = np.flatnonzero(skeleton.ends[start + 1 : stop] | (following != SHORT))
        if len(ends):
            return start + 1 + int(ends[0]), True, True
        last = stop - 1
        long = skeleton.u[last] >= skeleton.u[start] + AHEAD * longest_spacing(skeleton, start + 1)
        return last, False, bool(long) and last - start >= FEWEST_BLOCKS

    def _is_faster(self, start: int, last: int, ended: bool) -> bool | None:
        """Tell whether a run is to become a curve; None if more blocks are necessary."""
        if self._choice is None or last - start > MOST_BLOCKS:
            return True
        skeleton = self._skeleton
        if not ended or (last + 1 == len(skeleton) and not skeleton.stop[last]):
            return None
        if not may_be_slow(skeleton, start, last, self._height, self._machine):
            return True
        return not self._choice(*ways_of_run(skeleton, start, last))

    def _line(
        self, k: int, leg: EndLine | None = None, leads: bool = False,
        off: FloatArray | None = None,
    ) -> None:  # fmt: skip
        self._rows.append(line_row(self._skeleton, k, leg, leads, off, self._after_curve))
        self._after_curve = False

    def _begin(self, start: int, last: int, ended: bool) -> None:
        """Begin a run at a vertex."""
        skeleton, height = self._skeleton, self._height
        tip, axis = skeleton.blocks.tip, skeleton.blocks.axis
        near = skeleton.u[start] + AHEAD * longest_spacing(skeleton, start + 1)
        seen = min(last, int(np.searchsorted(skeleton.u, near)))
        turning = bool(skeleton.turning[start + 1 : seen + 1].any())
        turning = turning or not self._machine.keeps_tool(axis[start])
        if skeleton.stop[start]:
            jet = np.concatenate([tip[start], skeleton.top[start]])[None]
            self._lead = None
            line, following = Polyline.at(tip[start], axis[start], start), start + 1
        else:
            leg = choose_end_line(skeleton, start, 1, last, ended)
            self._lead = leg
            line = Polyline.at(*leg.pose, -1)
            line, jet = with_end_line(line, leg, leg.goal, leg.vertex, skeleton, height)
            following = leg.vertex + 1
        longest = longest_spacing(skeleton, start + 1)
        pole = None if self._machine.pole is None else np.array(self._machine.pole)
        self._run = Run(line, jet, turning, height, longest, self._share, pole)
        self._start, self._next = start, following

    def _follow(self, run: Run) -> bool:
        """Process one window of the run; return False if more blocks are necessary."""
        skeleton, start = self._skeleton, self._start
        if not run.ended:
            last, ended, _ = self._extent(start)
            turned = np.flatnonzero(skeleton.turning[start + 1 : last + 1])
            if not run.turning and len(turned):
                # The tool did not turn up to here, so this curve ends where it begins to turn.
                skeleton.corner[start + int(turned[0])] = True
                last, ended, _ = self._extent(start)
            if last >= self._next:
                rows = slice(self._next, last + 1)
                run.line = run.line.extended(
                    skeleton.blocks.tip[rows], skeleton.blocks.axis[rows],
                    np.arange(last + 1)[rows],
                    skeleton.used[rows], skeleton.narrow[rows], skeleton.feed[rows],
                    skeleton.row[rows],
                    skeleton.blocks.line_number[rows], self._height,
                )  # fmt: skip
                self._next = last + 1
            found = run.window(final=False)
            if found is None:
                if not ended:
                    return False
                self._end(run, last)
        if run.ended:
            found = run.window(final=True)
        assert found is not None
        if found.spans is None:
            self._retreat(run, found.worst)
            return True
        self._commit(run, found)
        return True

    def _end(self, run: Run, last: int) -> None:
        """Complete the polyline of a run with its end line."""
        skeleton = self._skeleton
        self._last = last
        if skeleton.stop[last]:
            self._tail = None
            pose = np.concatenate([skeleton.blocks.tip[last], skeleton.top[last]])[None]
            run.end(run.line, pose)
            return
        leg = choose_end_line(skeleton, last, -1, self._start, True)
        self._tail = leg
        line = run.line.upto(leg.vertex)
        run.end(*with_end_line(line, leg, leg.pose, -1, skeleton, self._height))

    def _commit(self, run: Run, found: Window) -> None:
        """Send the first spans of a window, and the lines before and after the curve."""
        skeleton = self._skeleton
        if self._lead is not None:
            lead, self._lead = self._lead, None
            self._line(lead.segment, lead, leads=True)
        assert found.spans is not None
        smooth = run.begun or not bool(skeleton.stop[self._start])
        k = self._last if found.last else self._start + 1
        stop = found.last and self._tail is None
        self._rows.append(curve_row(skeleton, k, found, stop, smooth))
        run.begun = True
        self._after_curve = True
        if not found.last:
            self._start = max(self._start, run.passed)
            return
        tail, last = self._tail, self._last
        self._run = None
        self._at = last
        if tail is None:
            self._after_curve = False
        elif skeleton.ends[last]:
            self._line(last, tail)

    def _retreat(self, run: Run, worst: float) -> None:
        """
        End a run earlier, because no curve keeps the tolerance at the position ``worst`` [m].

        The run ends at a vertex there, with a corner. If this vertex is too near, the blocks are
        followed as lines: all of them if nothing is committed yet. Otherwise the tool stops at
        the end of the curve and moves straight to the next vertex.
        """
        skeleton, least = self._skeleton, float(self._skeleton.tolerance[self._start + 1].min())
        line = run.whole
        inside = np.flatnonzero(line.vertex >= 0)
        place = line.u[inside]
        nearest = int(np.argmin(np.abs(place - worst)))
        vertex = int(line.vertex[inside[nearest]])
        near = place[nearest] < run.t + SHORTEST_REST * least
        if not run.begun:
            self._run = None
            if vertex - self._start < FEWEST_BLOCKS or near or vertex >= self._end_of(run):
                vertex = max(vertex, self._start + 1)
                skeleton.corner[self._start + 1 : vertex + 1] = True
            else:
                skeleton.corner[vertex] = True
            return
        if near:
            later = inside[place >= run.t + SHORTEST_REST * least]
            vertex = int(line.vertex[later[0]]) if len(later) else -1
        if 0 <= vertex < self._end_of(run):
            skeleton.corner[vertex] = True
            run.reopen(vertex)
            self._next = vertex + 1
            return
        # The curve may end beside the blocks, within its tolerance; a line leads back to a vertex.
        vertex = int(line.vertex[inside[place > run.t][0]])
        self._after_curve = False
        skeleton.stop[vertex] = skeleton.corner[vertex] = True
        self._line(vertex, off=self._share * skeleton.tolerance[vertex])
        self._at, self._run = vertex, None

    def _end_of(self, run: Run) -> int:
        """Return the last vertex that a run may reach."""
        return self._last if run.ended else self._next

    def _forget(self) -> None:
        """Drop vertices that no later result depends on."""
        skeleton = self._skeleton
        widest = float(skeleton.tolerance.max())
        behind = skeleton.u[self._corners.turned - 1] - 20.0 * widest
        kept = int(np.searchsorted(skeleton.u, behind))
        # A run that has begun never needs its first vertices again, however long it becomes.
        needed = self._start if self._run is not None and self._run.begun else self._at
        first = min(needed - 1, kept - 1, self._corners.decided - 1)
        if first < KEPT_VERTICES:
            return
        self._builder.skeleton = skeleton.after(first)
        self._corners.shift(first)
        self._at -= first
        self._start -= first
        self._next -= first
        self._last -= first
        if self._run is not None:
            self._run.shift(first)
        self._lead, self._tail = (leg and leg.shifted(first) for leg in (self._lead, self._tail))


def line_row(
    skeleton: Skeleton, k: int, leg: EndLine | None, leads: bool, off: FloatArray | None,
    smooth: bool,
) -> Rows:  # fmt: skip
    """Return the row of the line to vertex k."""
    block, tolerance = skeleton.blocks[k : k + 1], skeleton.tolerance[k]
    changed: dict[str, Any] = {'exact_stop': skeleton.stop[k : k + 1].copy()}
    if leg is not None:
        off, tolerance = leg.used, leg.tolerance
        if not block.rapid[0]:
            changed['feedrate'] = np.array([leg.feed])
        if leads:
            changed |= {
                'tip': leg.pose[0][None].copy(), 'axis': leg.pose[1][None].copy(),
                'rotary': np.full((1, 2), np.nan), 'exact_stop': np.zeros(1, dtype=bool),
            }  # fmt: skip
    elif off is None:
        off = skeleton.used[k]
    assert off is not None
    changed['contour_tolerance'] = tolerance[:1] - off[0]
    changed['orientation_tolerance'] = tolerance[1:] - off[1]
    block = replace(block, **changed)
    return Rows.line(block, int(skeleton.row[k]), off, smooth=smooth, leads=leads)


def curve_row(skeleton: Skeleton, k: int, found: Window, stop: bool, smooth: bool) -> Rows:
    """Return the row of the committed part of a curve."""
    spans = found.spans
    assert spans is not None
    block = replace(
        skeleton.blocks[k : k + 1], tip=spans.bottom[-1:, 5].copy(), axis=found.axis[None],
        rotary=np.full((1, 2), np.nan), line_number=spans.line_number[-1:].copy(),
        exact_stop=np.array([stop]),
    )  # fmt: skip
    return Rows.curve(block, spans, smooth)
