"""Base of line readers: order of lines, loops and calls, refusals, and start lines."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator

from cnc_interp.core import ProgramError
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.blocks.block_modes import ActiveModes
from cnc_interp.program.blocks.targets import TargetColumns
from cnc_interp.program.execution.block_executor import execute
from cnc_interp.program.execution.context import Execution
from cnc_interp.program.execution.machine_words import restore
from cnc_interp.program.motion.block_motion import Mover
from cnc_interp.program.notices import Refusals
from cnc_interp.program.text.control_traits import LINUXCNC
from cnc_interp.program.text.words import BlockWords


class ProgramReader(ABC):
    """Converts lines to words, which ``execution/`` carries out."""

    def __init__(self, at: Execution):
        self.at, self.flow, self.settings = at, at.flow, at.settings
        self.fault, self.demand, self.refuse_if = at.fault, at.demand, at.refuse_if
        self.notice = at.notice
        self.of_macro: ProgramReader | None = None  # of the macro of M6, if it is another one
        self.in_flow = False  # whether a refused line may have chosen the next line

    @abstractmethod
    def read_line(self, raw: str) -> None:
        """Execute one line."""

    @abstractmethod
    def read_lines(self, first: int, end: int) -> None:
        """Execute plain lines, rows ``first`` to ``end`` of the text window, up to a jump."""

    def execute(self, words: BlockWords) -> None:
        execute(self.at, words)

    @property
    def mover(self) -> Mover:
        return self.at.mover

    @property
    def targets(self) -> TargetColumns:
        return self.at.mover.targets

    @property
    def used(self) -> set[str]:
        return self.mover.used | {'G92', self.mover.last_offset}

    @property
    def share(self) -> float:
        return self.flow.share * self.targets.share

    def active_modes(self, offset: str, tool: int) -> ActiveModes:
        _, motion, feed = self.at.state()
        return self.at.active_modes(offset, tool).moving(motion, feed)

    def blocks(self) -> Iterator[Blocks]:
        """Yield the blocks in batches, none after a refusal; raise all refusals at the end."""
        flow, refused = self.flow, Refusals()
        while self.at.probe is None:
            try:
                self.in_flow = True
                if not flow.here():
                    break
                self.in_flow = False
                self._next_lines(together=not refused)
            except ProgramError as problem:
                if self.in_flow:  # the following lines may not be executed
                    refused.add(problem, ends=True)
                    raise refused.error() from None
                refused.add(problem)
                self.mover.placed.clear()
                flow.row += 1
            else:
                if refused and self.mover.placed >= set('XYZ'):
                    refused.arrive()
            parts = self.targets.take()
            if not refused:
                yield from parts
        yield from self._last_blocks(refused)

    def _last_blocks(self, refused: Refusals) -> Iterator[Blocks]:
        flow, mover, targets = self.flow, self.mover, self.targets
        self.refuse_if(
            flow.ran_out and flow.has_o_words and mover.dialect is LINUXCNC,
            'the program ends without M2, M30 or %; add M2',
        )
        if refused:
            raise refused.error()
        if mover.lone_arc:
            raise mover.lone_arc
        self.at.splines.end()
        mover.end_corner()
        if targets.empty and targets.switches:  # a program that moves nothing
            mover.go(mover.point, mover.rotary, rapid=True)
        yield from targets.finish()

    def _next_lines(self, together: bool) -> None:
        self._restore()  # after a subprogram that its text has ended
        self._read_next(together)
        self._restore()

    def _restore(self) -> None:
        if self.flow.restoring is not None:
            restore(self.at, self.flow.restoring)
            self.flow.restoring = None

    def _read_next(self, together: bool) -> None:
        flow = self.flow
        window, row = flow.window, flow.row
        if flow.rest is not None:
            rest, flow.rest, flow.jumped = flow.rest, None, False
            self.execute(rest)
            flow.row += not flow.jumped
            return
        reader = self.of_macro if self.of_macro and flow.in_macro else self
        end = self._until_start(row, window.next_rare(row))
        end = end if together else min(end, row + 1)
        if end > row:
            reader.read_lines(row, end)
        else:
            flow.jumped = False
            reader.read_line(window.line(row))
            if not flow.jumped:
                flow.row = row + 1

    def _until_start(self, row: int, end: int) -> int:
        start, flow = self.targets.start, self.flow
        ahead = start.line - flow.line_number
        if not start.line or ahead < 0 or flow.source is not flow.main:
            return end
        if ahead == 0:
            start.reach(self.at.state_words)
            return end
        return min(end, row + ahead)
