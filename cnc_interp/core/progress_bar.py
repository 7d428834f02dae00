"""Progress of long work: a line that is redrawn on a terminal, or plain lines in a log."""

import math
import os
import time
from collections import deque
from collections.abc import Callable
from typing import Self, TextIO

BAR = 30  #: Length of the bar [characters].
PATIENCE = 1.0  #: No progress is shown for work that takes less time than this [s].
ESTIMATED_FROM = 0.05  #: Smallest part of the work from which the remaining time is estimated [-].
BEFORE_THE_END = 0.99  #: Largest part that is shown while time is left [-].


class TimeLeft:
    """Estimates the remaining time of work from its speed in the second half of the past time."""

    def __init__(self, begun: float = math.nan) -> None:
        self._first = begun  # when the work began, or its first part was done [s]
        known = [] if math.isnan(begun) else [(begun, 0.0)]
        self._later = deque[tuple[float, float]](known)  # time and share in the later half

    def after(self, now: float, share: float) -> float:
        """Return the remaining time [s], given the time and the finished share; NaN if unknown."""
        if share <= 0.0:
            return math.nan
        later = self._later
        if not later:
            self._first = now
        later.append((now, share))
        half = 0.5 * (self._first + now)
        while len(later) > 1 and later[1][0] <= half:
            later.popleft()
        begun, done = later[0]
        return (now - begun) * (1.0 - share) / (share - done) if share > done else math.nan


class ProgressBar:
    """Context in which the finished part of the work is shown; silent without a stream."""

    def __init__(self, stream: TextIO | None):
        self._stream = stream
        dumb = os.environ.get('TERM') == 'dumb'
        self._redraws = stream is not None and stream.isatty() and not dumb
        self._steps = 100 if self._redraws else 10
        self._began = time.monotonic()
        self._time_left = TimeLeft()
        self._work = ''
        self._step = 0
        self._width = 0  # width of the line on the terminal [characters]

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.end(complete=kind is None)

    def start(self, work: str, note: str) -> None:
        """Say what begins; the time left counts from now, not from the first part that is done."""
        now = time.monotonic()
        self.end(complete=False)
        self._work, self._step, self._began, self._time_left = work, 0, now, TimeLeft(now)
        if self._stream is not None:
            self._stream.write(f'{work} {note}\n')
            self._stream.flush()

    def of(self, work: str) -> Callable[[float], None]:
        return lambda share: self.show(work, share)

    def show(self, work: str, share: float, note: str = '', left: float = math.nan) -> None:
        """Show progress: every percent on a terminal, every ten percent in a log."""
        now = time.monotonic()
        if work != self._work:
            self.end(complete=False)
            self._work, self._step, self._began, self._time_left = work, 0, now, TimeLeft()
        estimate = self._time_left.after(now, share)
        step = int(self._steps * share)
        if self._stream is None or step == self._step or now - self._began < PATIENCE:
            return
        self._step = step
        left = estimate if math.isnan(left) else left
        estimated = share >= ESTIMATED_FROM and math.isfinite(left)
        notes = [note, f'about {left:.0f} s left' if estimated and left >= 0.5 else '']
        shown = min(share, BEFORE_THE_END) if left > 0.0 else share
        self._write(work, shown, ', '.join(text for text in notes if text))

    def _write(self, work: str, share: float, note: str) -> None:
        assert self._stream is not None
        if self._redraws:
            bar = f'[{"#" * int(BAR * share):<{BAR}}] '
            text = f'{work} {bar}{share:4.0%}  {note}'.rstrip()
            self._stream.write(f'\r{text:<{self._width}}')
            self._width = len(text)
        else:
            self._stream.write(f'{work} {share:.0%}{", " if note else ""}{note}\n')
        self._stream.flush()

    def end(self, complete: bool) -> None:
        if self._stream is None or not self._step or not self._redraws:
            return
        if complete:
            self._write(self._work, 1.0, '')
        self._stream.write('\n')
        self._stream.flush()
        self._step, self._width = 0, 0
