"""Progress of a run: a bar on a terminal, plain lines in a log."""

from __future__ import annotations

import math
import os
import time
from typing import Any, TextIO

BAR = 30
#: A check that takes no longer is not told; how often it is told in a log [s].
CHECK_SHOWN, CHECK_LOGGED = 1.0, 10.0


def redraws(stream: TextIO) -> bool:
    """Tell whether a line can be written over: a terminal, and none inside an editor."""
    return stream.isatty() and os.environ.get('TERM') != 'dumb'


class Progress:
    """
    Shows how far a run is.

    Parameters
    ----------
    stream : file, optional
        Where to; None shows nothing.

    """

    def __init__(self, stream: TextIO | None):
        self._stream = stream
        self._terminal = stream is not None and redraws(stream)
        self._shown = -1
        self._began = self._said_at = time.monotonic()

    def checking(self, text: str) -> None:
        """Show how far a check is that takes long; in a log seldom."""
        now = time.monotonic()
        pause = CHECK_SHOWN if self._terminal else CHECK_LOGGED
        if self._stream is None or self._shown >= 0 or now - self._began < CHECK_SHOWN:
            return
        if now - self._said_at >= pause:
            self._said_at = now
            self._stream.write(f'\r{text}   ' if self._terminal else f'{text}\n')
            self._stream.flush()

    def show(self, feedback: Any) -> None:
        """Show feedback: the bar moves with every per cent, a line comes with every ten."""
        if feedback.programs_ahead:
            return
        step = int(100 * feedback.progress) if self._terminal else int(10 * feedback.progress)
        if self._stream is None or step == self._shown:
            return
        self._shown = step
        share = feedback.progress
        rest = feedback.remaining_time
        left = '' if math.isnan(rest) else f', about {rest:.0f} s left'
        if self._terminal:
            filled = '#' * int(BAR * share)
            text = f'\r[{filled:<{BAR}}] {share:4.0%}  line {feedback.line_number}{left}   '
            self._stream.write(text)
        else:
            self._stream.write(f'{share:4.0%}  line {feedback.line_number}{left}\n')
        self._stream.flush()

    def end(self, complete: bool) -> None:
        """Finish the picture."""
        if self._stream is None or self._shown < 0:
            return
        if self._terminal:
            self._stream.write(f'\r[{"#" * BAR}] 100%{"":30}\n' if complete else '\n')
        self._stream.flush()
