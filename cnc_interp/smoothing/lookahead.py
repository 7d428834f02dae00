"""
The look-ahead: from blocks to smooth segments.

Runs of short blocks first become curves (``compressor.py``). Then each vertex between the
remaining blocks is classified: a corner is rounded, at a stop the tool rests, and otherwise the
path continues straight. Where a stop is faster than a rounded corner, the tool rests, too
(``stop_choice.py``). A corner is final when the next corner has its size, because both share a
line between them that is too short. The result does not depend on how the blocks are divided
into batches.
"""

from __future__ import annotations

from dataclasses import replace

from cnc_interp.machine_model.machine_traits import MachineTraits
from cnc_interp.program.blocks import Blocks
from cnc_interp.settings.choices import Settings
from cnc_interp.smoothing.corners.stop_choice import StopChoice
from cnc_interp.smoothing.corners.vertices import Legs, classify, refuse_reversals
from cnc_interp.smoothing.dense.compressor import Compressor
from cnc_interp.smoothing.dense.path_rows import Rows
from cnc_interp.smoothing.emission import Emission, no_segments
from cnc_interp.smoothing.rounding import Rounding
from cnc_interp.smoothing.segments import PathSegments


class LookAhead:
    """Round the corners of a stream of blocks."""

    def __init__(
        self,
        settings: Settings,
        machine: MachineTraits,
        row: int = 0,
        joined: bool = False,
        stops: list[int] | None = None,
    ):
        # Corners that are made to be compared stay corners.
        machine = replace(machine, limits=None) if settings.compares_corners else machine
        self._settings, self._machine = settings, machine
        self._rounding = rounding = Rounding(settings, machine)
        self._none = no_segments(rounding.style)
        self._rows: Rows | None = None
        self._compressor = Compressor(settings, machine, rounding, row, joined)
        self._choice = StopChoice(
            rounding, machine, settings.flank_height, [] if stops is None else stops
        )
        self._outer_before = 0.0  # L2 after the first kept vertex, before left-overs are shared

    def push(self, blocks: Blocks) -> PathSegments:
        """
        Add blocks and return the segments that are final.

        Parameters
        ----------
        blocks : Blocks
            The next rows of the program; the very first row is the start pose.

        Returns
        -------
        PathSegments
            Segments that later blocks cannot change; may be empty.

        Raises
        ------
        BlockError
            If the tool axis of a block reverses, because its plane of rotation is undefined.

        """
        return self._take(self._compressor.push(blocks), final=False)

    def finish(self, joined: bool = False) -> PathSegments:
        """
        Return the remaining segments; the tool rests at the end.

        Parameters
        ----------
        joined : bool
            Whether a native spline follows. Then the last block stays a line.

        Returns
        -------
        PathSegments
            All segments that were not returned before.

        """
        return self._take(self._compressor.finish(joined), final=True)

    def _take(self, rows: Rows, final: bool) -> PathSegments:
        """Return the segments of every line, curve and corner that is final."""
        if self._rows is not None:
            rows = Rows.concatenate([self._rows, rows])
        rows = rows.moving(self._settings.flank_height)
        self._rows, blocks = rows, rows.blocks
        if len(blocks) < 2:
            return self._none
        legs = Legs.of(blocks, self._machine, self._settings.flank_height)
        refuse_reversals(rows, legs)
        vertex = classify(rows, legs, self._settings.flank_height, self._machine)
        decided = self._choice.decide(rows, legs, vertex, final)
        inner, outer = self._rounding.size(rows, legs, vertex)
        outer[0, 1] = self._outer_before
        # A vertex is final when its own corner and the next one have their size (left-overs).
        last = len(blocks) - 1 if final else min(len(blocks) - 3, decided - 2)
        if last < 1:
            return self._none
        own_share = float(outer[last, 1])
        self._rounding.share_left_overs(legs, outer, len(blocks) - 1 if final else last + 1)
        style = self._rounding.style
        emission = Emission(rows, legs, vertex, inner, outer, style, self._machine)
        segments = emission.segments(last)
        self._outer_before = own_share
        self._rows = rows[last:]
        self._choice.keep(rows, vertex, last)
        return segments
