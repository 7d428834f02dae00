"""
The compressor: runs of short blocks become smooth curves within the tolerances, block by block.

A run follows its polyline (``polyline.py``) window by window: a quintic spline through the whole
window is fitted to the tube (``tube.py``), certified (``certificate.py``), and its first half is
committed; the next window continues it with four derivatives. A window is solved when all it
depends on has come, so the result is the same however the blocks arrive. Where a curve meets a
line or a corner it takes over the line's own motion: straight tip, tool on the great circle.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.program.blocks import Blocks
from cnc_interp.settings.choices import Settings
from cnc_interp.smoothing.dense.corner_search import CornerSearch
from cnc_interp.smoothing.dense.curve_fit import AHEAD, Run, Window
from cnc_interp.smoothing.dense.end_lines import Leg, leg_at, longest_spacing, with_leg
from cnc_interp.smoothing.dense.growing_skeleton import LONG, SHORT, Chain, ChainBuilder
from cnc_interp.smoothing.dense.polyline import Polyline
from cnc_interp.smoothing.dense.rows import Rows
from cnc_interp.smoothing.machine_traits import MachineTraits
from cnc_interp.smoothing.orientation import angles_between

#: Blocks that a run must have at least.
FEWEST = 3
#: Vertices kept behind the last one sent, before those further back are forgotten.
KEPT = 2048
#: Way that a run needs to end before a vertex, in tolerances.
TO_END = 40.0


class Compressor:
    """
    Turn a stream of blocks into lines and curves.

    Parameters
    ----------
    settings : Settings
        The user's choices: what becomes a curve.
    machine : MachineTraits
        Where a turning tool stops.
    row : int
        Row in the program of the first block to come.
    joined : bool
        Whether a native spline ends at the first pose: the first block stays a line.

    """

    def __init__(
        self,
        settings: Settings,
        machine: MachineTraits,
        row: int = 0,
        joined: bool = False,
    ):
        self._enabled, self._height = settings.compress, settings.flank_height
        self._share = settings.tolerance_share
        self._pole, self._pole_cone = machine.pole, machine.pole_cone
        self._builder = ChainBuilder(settings, machine, row, joined)
        self._corners = CornerSearch(settings.corner_angle)
        self._first = row
        self._at = 0  # the vertex that everything before is sent of
        self._begun = False
        self._run: Run | None = None
        self._start = self._next = self._last = 0  # of the run: first vertex, next one, last one
        self._lead: Leg | None = None  # before the run, until its first window is committed
        self._tail: Leg | None = None  # after it
        self._after_curve = False
        self._rows: list[Rows] = []

    def push(self, blocks: Blocks) -> Rows:
        """
        Take further blocks and return what is final.

        Parameters
        ----------
        blocks : Blocks
            The next rows of the program; the very first row is the start pose.

        """
        if not self._enabled:
            self._first += len(blocks)
            return Rows.plain(blocks, self._first - len(blocks))
        self._builder.push(blocks, final=False)
        return self._advance(final=False)

    def finish(self, joined: bool = False) -> Rows:
        """Return the rest; with ``joined`` the last block stays a line."""
        if self._enabled:
            self._builder.push(None, final=True, joined=joined)
        return self._advance(final=True)

    def _advance(self, final: bool) -> Rows:
        """Send all that is known."""
        if self._builder.chain is not None:
            self._corners.look(self._chain, final)
            self._send()
            self._forget()
        rows, self._rows = self._rows, []
        return Rows.concatenate(rows) if rows else Rows.none()

    @property
    def _chain(self) -> Chain:
        assert self._builder.chain is not None
        return self._builder.chain

    def _send(self) -> None:
        """Send lines and runs, one after another, as far as vertices are decided."""
        if not self._begun and self._corners.decided:
            self._begun = True
            self._rows.append(Rows.plain(self._chain.blocks[:1], self._first))
        while True:
            if self._run is not None:
                if not self._follow(self._run):
                    return
                continue
            chain, a = self._chain, self._at
            if a + 1 >= self._corners.decided:
                return
            if chain.kind[a + 1] == SHORT:
                start = a
            elif chain.kind[a + 1] == LONG and not chain.ends[a + 1]:
                start = a + 1
            else:
                self._line(a + 1)
                self._at = a + 1
                continue
            last, ended, ready = self._extent(start)
            if not ready:
                return
            if last - start >= FEWEST:
                self._begin(start, last, ended)
                continue
            for k in range(a + 1, last + 1):
                self._line(k)
            self._at = last

    def _extent(self, start: int) -> tuple[int, bool, bool]:
        """
        Look how far a run from a vertex goes.

        Returns
        -------
        last : int
            Its last vertex known.
        ended : bool
            Whether it ends there.
        ready : bool
            Whether enough is known to begin it, or not to.

        """
        chain, stop = self._chain, self._corners.decided
        if start + 1 < len(chain) and chain.kind[start + 1] != SHORT:
            return start, True, True
        if start + 1 >= stop:
            return start, False, False
        following = np.append(chain.kind[start + 2 : stop + 1], SHORT)[: stop - start - 1]
        ends = np.flatnonzero(chain.ends[start + 1 : stop] | (following != SHORT))
        if len(ends):
            return start + 1 + int(ends[0]), True, True
        last = stop - 1
        long = chain.u[last] >= chain.u[start] + AHEAD * longest_spacing(chain, start + 1)
        return last, False, bool(long) and last - start >= FEWEST

    def _line(
        self, k: int, leg: Leg | None = None, leads: bool = False, off: FloatArray | None = None
    ) -> None:
        """Send the line to a vertex, on a leg perhaps; or only to where a curve begins on it."""
        chain = self._chain
        block = replace(chain.blocks[k : k + 1], exact_stop=chain.stop[k : k + 1].copy())
        if off is None:
            off = chain.used[k] if leg is None else leg.used
        if leg is not None and not block.rapid[0]:
            block = replace(block, feedrate=np.array([leg.feed]))
        if leg is not None and leads:
            block = replace(
                block, tip=leg.pose[0][None].copy(), axis=leg.pose[1][None].copy(),
                rotary=np.full((1, 2), np.nan), exact_stop=np.zeros(1, dtype=bool),
            )  # fmt: skip
        block = replace(
            block,
            contour_tolerance=block.contour_tolerance - off[0],
            orientation_tolerance=block.orientation_tolerance - off[1],
        )
        row = int(chain.row[k])
        self._rows.append(Rows.line(block, row, off, smooth=self._after_curve, leads=leads))
        self._after_curve = False

    def _begin(self, start: int, last: int, ended: bool) -> None:
        """Open a run at a vertex."""
        chain, height = self._chain, self._height
        tip, axis = chain.blocks.tip, chain.blocks.axis
        near = chain.u[start] + AHEAD * longest_spacing(chain, start + 1)
        seen = min(last, int(np.searchsorted(chain.u, near)))
        turning = bool(chain.turning[start + 1 : seen + 1].any()) or not self._fixed(axis[start])
        if chain.stop[start]:
            jet = np.concatenate([tip[start], chain.top[start]])[None]
            self._lead = None
            line, following = Polyline.at(tip[start], axis[start], start), start + 1
        else:
            leg = leg_at(chain, start, 1, last, ended)
            self._lead = leg
            line = Polyline.at(*leg.pose, -1)
            line, jet = with_leg(line, leg, leg.goal, leg.vertex, chain, height)
            following = leg.vertex + 1
        self._run = Run(line, jet, turning, height, longest_spacing(chain, start + 1), self._share)
        self._start, self._next = start, following

    def _fixed(self, axis: FloatArray) -> bool:
        """Tell whether a tool that does not turn now stays as it is for the whole run."""
        if self._pole is None:
            return True
        angle = float(angles_between(axis, np.asarray(self._pole)))
        return min(angle, np.pi - angle) < self._pole_cone

    def _follow(self, run: Run) -> bool:
        """Commit one window of the run; False when more blocks are needed."""
        chain, start = self._chain, self._start
        if not run.ended:
            last, ended, _ = self._extent(start)
            turned = np.flatnonzero(chain.turning[start + 1 : last + 1])
            if not run.turning and len(turned):
                # so far the tool did not turn: this curve ends where it begins to
                chain.corner[start + int(turned[0])] = True
                last, ended, _ = self._extent(start)
            if last >= self._next:
                rows = slice(self._next, last + 1)
                run.line = run.line.extended(
                    chain.blocks.tip[rows], chain.blocks.axis[rows], np.arange(last + 1)[rows],
                    chain.used[rows], chain.feed[rows], chain.row[rows],
                    chain.blocks.line_number[rows], self._height,
                )  # fmt: skip
                self._next = last + 1
            found = run.window(chain.tolerance[last], final=False)
            if found is None:
                if not ended:
                    return False
                self._end(run, last)
        if run.ended:
            found = run.window(chain.tolerance[self._last], final=True)
        assert found is not None
        if found.spans is None:
            self._retreat(run, found.worst)
            return True
        self._commit(run, found)
        return True

    def _end(self, run: Run, last: int) -> None:
        """Lead the polyline of a run to its end."""
        chain = self._chain
        self._last = last
        if chain.stop[last]:
            self._tail = None
            pose = np.concatenate([chain.blocks.tip[last], chain.top[last]])[None]
            run.end(run.line, pose)
            return
        leg = leg_at(chain, last, -1, self._start, True)
        self._tail = leg
        line = run.line.upto(leg.vertex)
        run.end(*with_leg(line, leg, leg.pose, -1, chain, self._height))

    def _commit(self, run: Run, found: Window) -> None:
        """Send the first spans of a window, the line that leads to them, and the line after."""
        chain = self._chain
        if self._lead is not None:
            lead, self._lead = self._lead, None
            self._line(lead.segment, lead, leads=True)
        assert found.spans is not None
        self._rows.append(self._curve(found, smooth=run.begun or not chain.stop[self._start]))
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
        elif chain.ends[last]:
            self._line(last, tail)

    def _curve(self, found: Window, smooth: bool) -> Rows:
        """Return the row of a piece of curve."""
        chain, spans = self._chain, found.spans
        assert spans is not None
        k = self._last if found.last else self._start + 1
        block = chain.blocks[k : k + 1]
        block = replace(
            block,
            tip=spans.bottom[-1:, 5].copy(),
            axis=found.axis[None],
            rotary=np.full((1, 2), np.nan),
            line_number=spans.line_number[-1:].copy(),
            exact_stop=np.array([found.last and self._tail is None]),
        )
        return Rows.curve(block, spans, smooth)

    def _retreat(self, run: Run, worst: float) -> None:
        """
        Give a run up from where no curve holds the tolerance.

        It ends at a vertex there, with a corner. Where that is too near, the blocks themselves
        are driven: all of them if nothing is committed, else from a stop to the next vertex.
        """
        chain, least = self._chain, float(self._chain.tolerance[self._start + 1].min())
        line = run.whole
        inside = np.flatnonzero(line.vertex >= 0)
        place = line.u[inside]
        nearest = int(np.argmin(np.abs(place - worst)))
        vertex = int(line.vertex[inside[nearest]])
        near = place[nearest] < run.t + TO_END * least
        if not run.begun:
            self._run = None
            if vertex - self._start < FEWEST or near or vertex >= self._end_of(run):
                vertex = max(vertex, self._start + 1)
                chain.corner[self._start + 1 : vertex + 1] = True
            else:
                chain.corner[vertex] = True
            return
        if near:
            later = inside[place >= run.t + TO_END * least]
            vertex = int(line.vertex[later[0]]) if len(later) else -1
        if 0 <= vertex < self._end_of(run):
            chain.corner[vertex] = True
            run.reopen(vertex)
            self._next = vertex + 1
            return
        # from where the curve ends, off the blocks by what it may, straight to the next vertex
        vertex = int(line.vertex[inside[place > run.t][0]])
        self._after_curve = False
        chain.stop[vertex] = chain.corner[vertex] = True
        self._line(vertex, off=self._share * chain.tolerance[vertex])
        self._at, self._run = vertex, None

    def _end_of(self, run: Run) -> int:
        """Return the last vertex that a run may reach."""
        return self._last if run.ended else self._next

    def _forget(self) -> None:
        """Drop vertices that nothing depends on any more."""
        chain = self._chain
        widest = float(chain.tolerance[-1].max())
        kept = int(np.searchsorted(chain.u, chain.u[self._corners.turned - 1] - 20.0 * widest))
        # a run that has begun never comes back to where it started, however long it gets
        needed = self._start if self._run is not None and self._run.begun else self._at
        first = min(needed - 1, kept - 1, self._corners.decided - 1)
        if first < KEPT:
            return
        self._builder.chain = chain.after(first)
        self._corners.shift(first)
        self._at -= first
        self._start -= first
        self._next -= first
        self._last -= first
        if self._run is not None:
            self._run.shift(first)
        for name in ('_lead', '_tail'):
            leg = getattr(self, name)
            if leg is not None:
                moved = replace(leg, segment=leg.segment - first, vertex=leg.vertex - first)
                setattr(self, name, moved)
