"""Progress of a run: a bar on a terminal, plain lines in a log."""

from __future__ import annotations

import math
from typing import Any, TextIO

BAR = 30


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
        self._terminal = stream is not None and stream.isatty()
        self._shown = -1

    def show(self, feedback: Any) -> None:
        """Show feedback: the bar moves with every per cent, a line comes with every ten."""
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
