"""The compressor: runs of short blocks become smooth curves within the tolerances.

A run of short blocks is a polyline (``polyline.py``) that is processed window by window. A quintic
spline through the whole window is fitted into the tolerance tube (``tube_fit.py``) and certified
(``certificate.py``). Its first half is committed, and the next window continues it with four
derivatives. A window is solved only when all data that it depends on have arrived. So the result
does not depend on how the blocks arrive. Where a curve meets a line or a corner, it begins with
the motion of the line: the tip moves straight and the tool axis on the great circle.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.machine_model.machine_traits import MachineTraits
from cnc_interp.program.blocks import Blocks
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.dense.curve_fit import Curve, DenseRun, Window
from cnc_interp.smoothing.dense.end_lines import EndLine, extended, with_end_line
from cnc_interp.smoothing.dense.knots import AHEAD, LONGEST
from cnc_interp.smoothing.dense.path_rows import Rows, Spans
from cnc_interp.smoothing.dense.polyline import lone_vertex
from cnc_interp.smoothing.dense.skeleton import CornerSearch, Skeleton, SkeletonBuilder
from cnc_interp.smoothing.dense.thinning import FEWEST_BLOCKS, LONG, SHORT, run_end
from cnc_interp.smoothing.stop_choice import MOST_BLOCKS, Choice, may_be_slow, ways_of_run

KEPT_VERTICES = 512  #: Number of vertices stored before the last vertex that was output.
#: Shortest distance between the committed curve and the end of its run, in tolerances.
SHORTEST_REST = 40.0


class Compressor:
    def __init__(
        self,
        settings: Settings,
        machine: MachineTraits,
        choice: Choice | None,
        row: int = 0,
        joined: bool = False,
    ):
        self._enabled, self._height = settings.compress, settings.flank_height
        self._share = settings.tolerance_share
        self._machine, self._choice = machine, choice
        self._builder = SkeletonBuilder(settings, machine.scale, row, joined)
        self._corners = CornerSearch(settings.corner_angle)
        self._first = row
        self._at = 0  # all blocks before this vertex have been sent
        self._begun = False
        self._run: DenseRun | None = None
        self._start = self._next = self._last = 0  # first, next and last vertex of the run
        self._lead: EndLine | None = None  # line before the run, if not sent yet
        self._tail: EndLine | None = None  # line after the run
        self._after_curve = False
        self._made: list[Made] = []

    def push(self, blocks: Blocks) -> Rows:
        """Add blocks; return the lines and curves that later blocks cannot change."""
        if not self._enabled:
            self._first += len(blocks)
            return Rows.plain(blocks, self._first - len(blocks))
        self._builder.push(blocks, final=False)
        return self._advance(final=False)

    def finish(self, joined: bool = False) -> Rows:
        """Return the last rows; if a native spline follows (``joined``), they end with a line."""
        if self._enabled:
            self._builder.push(None, final=True, joined=joined)
        return self._advance(final=True)

    def _advance(self, final: bool) -> Rows:
        if self._builder.skeleton is None:
            return Rows.plain(Blocks.none(), 0)
        self._corners.decide(self._skeleton, final)
        first = not self._begun and self._corners.decided > 0
        rows = [Rows.plain(self._skeleton.blocks[: int(first)], self._first)]
        self._begun |= first
        self._send()
        if self._made:
            rows.append(rows_of(self._skeleton, self._made))
            self._made = []
        self._forget()
        return Rows.concatenate(rows)

    @property
    def _skeleton(self) -> Skeleton:
        assert self._builder.skeleton is not None
        return self._builder.skeleton

    def _send(self) -> None:
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
            elif skeleton.kind[a + 1] == LONG and not (
                skeleton.closed[a + 1] or skeleton.corner[a + 1]
            ):
                start = a + 1
            else:
                self._line(a + 1)
                self._at = a + 1
                continue
            last, ended, ready = run_end(self._skeleton.vertices, start, self._corners.decided)
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

    def _is_faster(self, start: int, last: int, ended: bool) -> bool | None:
        """Return whether a run becomes a curve; None if more blocks are needed to decide."""
        if self._choice is None or last - start > MOST_BLOCKS:
            return True
        skeleton = self._skeleton
        if not ended or (last + 1 == len(skeleton) and not skeleton.stop[last]):
            return None
        if not may_be_slow(skeleton, start, last, self._height, self._machine):
            return True
        return not self._choice(*ways_of_run(skeleton, start, last, self._height, self._machine))

    def _line(
        self,
        k: int,
        leg: EndLine | None = None,
        leads: bool = False,
        off: FloatArray | None = None,
    ) -> None:
        """Add the line to vertex k, or its part before or after a curve, to the output."""
        skeleton, tolerance = self._skeleton, self._skeleton.tolerance[k]
        off = skeleton.used[k] if off is None else off
        feed = skeleton.blocks.feedrate[k]
        if leg is not None:
            off, tolerance = leg.used, leg.tolerance
            feed = feed if skeleton.blocks.rapid[k] else leg.feed
        pose = leg.pose if leg is not None and leads else None
        stop = bool(skeleton.stop[k]) and not leads
        self._made.append(
            Made(k, pose, tolerance - off, off, feed, stop, self._after_curve, leads)
        )
        self._after_curve = False

    def _begin(self, start: int, last: int, ended: bool) -> None:
        skeleton, v = self._skeleton, self._skeleton.vertices
        longest = LONGEST * float(skeleton.tolerance[start + 1].min())
        seen = min(last, int(np.searchsorted(v.u, v.u[start] + AHEAD * longest)))
        turning = bool(v.turning[start + 1 : seen + 1].any())
        turning = turning or not self._machine.keeps_tool(v.pose[start, 3:])
        line, following, self._lead = lone_vertex(v.pose[start], start), start + 1, None
        jet = np.concatenate([v.pose[start, :3], v.top[start]])[None]
        if not skeleton.stop[start]:
            leg, line, jet = with_end_line(line, v, start, 1, last, ended, self._height)
            self._lead, following = leg, leg.vertex + 1
        pole = np.array(self._machine.pole or (), dtype=np.float64)
        curve = Curve(turning, self._height, self._share, pole)
        self._run = DenseRun(line, jet, longest, curve)
        self._start, self._next = start, following

    def _follow(self, run: DenseRun) -> bool:
        """Process one window of the run; return False if more blocks are necessary."""
        skeleton, start = self._skeleton, self._start
        found = None
        if not run.ended:
            last, ended, _ = run_end(skeleton.vertices, start, self._corners.decided)
            turned = np.flatnonzero(skeleton.turning[start + 1 : last + 1])
            if not run.curve.turning and len(turned):
                # The tool did not turn up to here, so this curve ends where it begins to turn.
                skeleton.corner[start + int(turned[0])] = True
                last, ended, _ = run_end(skeleton.vertices, start, self._corners.decided)
            if last >= self._next:
                run.line = extended(run.line, skeleton.vertices, self._next, last, self._height)
                self._next = last + 1
            found = run.window()
            if found is None:
                if not ended:
                    return False
                self._end(run, last)
        if run.ended:
            found = run.window()
        assert found is not None
        if found.found:
            self._commit(run, found)
        else:
            self._retreat(run, found.t)
        return True

    def _end(self, run: DenseRun, last: int) -> None:
        v, self._last = self._skeleton.vertices, last
        line, self._tail = run.line, None
        jet = np.concatenate([v.pose[last, :3], v.top[last]])[None]
        if not self._skeleton.stop[last]:
            self._tail, line, jet = with_end_line(
                line, v, last, -1, self._start, True, self._height
            )
        run.end(line, jet)

    def _commit(self, run: DenseRun, found: Window) -> None:
        skeleton = self._skeleton
        if self._lead is not None:
            lead, self._lead = self._lead, None
            self._line(lead.segment, lead, leads=True)
        smooth = run.begun or not bool(skeleton.stop[self._start])
        k = self._last if found.last else self._start + 1
        stop = found.last and self._tail is None
        pose = np.concatenate([found.bottom[-1, 5], found.axis])
        tolerance, feed = skeleton.tolerance[k], skeleton.blocks.feedrate[k]
        self._made.append(Made(k, pose, tolerance, np.zeros(2), feed, stop, smooth, False, found))
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
        elif skeleton.closed[last] or skeleton.corner[last]:
            self._line(last, tail)

    def _retreat(self, run: DenseRun, worst: float) -> None:
        """End a run earlier, because no curve keeps the tolerance at the position ``worst`` [m].

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

    def _end_of(self, run: DenseRun) -> int:
        return self._last if run.ended else self._next

    def _forget(self) -> None:
        """Drop vertices that no later result depends on."""
        skeleton = self._skeleton
        widest = float(skeleton.tolerance.max())
        before = skeleton.u[self._corners.turned - 1] - 20.0 * widest
        kept = int(np.searchsorted(skeleton.u, before))
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
        self._lead, self._tail = (
            leg and leg._replace(segment=leg.segment - first, vertex=leg.vertex - first)
            for leg in (self._lead, self._tail)
        )


class Made(NamedTuple):
    """A row that replaces a vertex; values that it lacks are those of the vertex."""

    vertex: int  #: Its vertex of the skeleton.
    pose: FloatArray | None  #: (6,): Pose at its end, if not the vertex.
    #: (2,): Tolerances that are left, and those used by a line [m].
    tolerance: FloatArray
    used: FloatArray
    feed: float
    stop: bool
    #: Whether a curve joins the start of the row smoothly; whether a curve joins the end of a
    #: line.
    smooth: bool
    leads: bool
    curve: Window | None = None


def rows_of(skeleton: Skeleton, made: Sequence[Made]) -> Rows:
    k = np.array([one.vertex for one in made])
    blocks, row = skeleton.blocks[k], skeleton.row[k]
    tip, axis, rotary = blocks.tip.copy(), blocks.axis.copy(), blocks.rotary.copy()
    line = blocks.line_number.copy()
    for i, one in enumerate(made):
        if one.pose is not None:
            tip[i], axis[i], rotary[i] = one.pose[:3], one.pose[3:], np.nan
        if one.curve is not None:
            row[i], line[i] = one.curve.origin[-1, 1]
    tolerance = np.array([one.tolerance for one in made])
    blocks = replace(
        blocks,
        tip=tip,
        axis=axis,
        rotary=rotary,
        line_number=line,
        exact_stop=np.array([one.stop for one in made]),
        feedrate=np.array([one.feed for one in made]),
        contour_tolerance=tolerance[:, 0],
        orientation_tolerance=tolerance[:, 1],
    )
    curves = [one.curve for one in made if one.curve is not None]
    spans = Spans.none()
    if curves:
        bottom, top, feed, origin, deviation = map(
            np.concatenate, zip(*(curve[5:] for curve in curves), strict=True)
        )
        spans = Spans(
            bottom,
            top,
            np.repeat(feed[:, None], 2, axis=1),
            origin[:, :, 0],
            origin[:, 1, 1],
            deviation[:, :2],
            deviation[:, 2],
        )
    return Rows(
        blocks,
        row,
        np.array([one.used for one in made]),
        np.array([one.smooth for one in made]),
        np.array([one.leads for one in made]),
        np.array([0 if one.curve is None else len(one.curve.feed) for one in made]),
        spans,
    )
