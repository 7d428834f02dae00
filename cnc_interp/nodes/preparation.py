"""The reading and checking of a program, in a thread, and how that ended."""

from __future__ import annotations

from concurrent.futures import Future

from cnc_interp.core.errors import BlockError, InterpError, ProgramError
from cnc_interp.nodes.program_check import Prepared
from cnc_interp.run.run_phase import Code, Outcome


class Preparation:
    """The check of a program in a thread, and its result."""

    def __init__(self) -> None:
        self.future: Future[Prepared] | None = None
        self.prepared: Prepared | None = None
        self.checked = 0.0  # share of the text that is read and checked
        self.cancelled = False

    def has_checked(self, share: float) -> None:
        """Record the progress of the check, or end it if the user has cancelled."""
        self.checked = share
        if self.cancelled:
            raise BlockError('cancelled before anything moved')

    def look(self) -> Outcome | None:
        """Return the outcome if the program was refused; store it when it is checked."""
        if self.prepared is not None or self.future is None or not self.future.done():
            return None
        try:
            self.prepared = self.future.result()
        except ProgramError as problem:
            return Outcome(Code.BAD_PROGRAM, str(problem))
        except Exception as problem:
            known = isinstance(problem, InterpError)
            text = str(problem) if known else f'{type(problem).__name__}: {problem}'
            return Outcome(Code.CANCELED if self.cancelled else Code.REFUSED, text)
        return None

    def again(self, future: Future[Prepared]) -> None:
        """Drop the result and wait for another check."""
        if self.prepared is not None:
            self.prepared.blocks.close()
        self.prepared, self.future, self.checked = None, future, 0.0

    def close(self) -> None:
        """Drop the program and end a check that is under way."""
        self.cancelled = True
        if self.prepared is not None:
            self.prepared.blocks.close()
