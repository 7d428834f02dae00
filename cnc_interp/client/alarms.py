"""Alarms for the operator: warnings and errors from the nodes, and notices from the client."""

from __future__ import annotations

import math
import re
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import datetime
from threading import Lock

from diagnostic_msgs.msg import DiagnosticStatus

KEPT = 200  #: Number of alarms in the history.
COMPARED = 8  #: Number of earlier alarms with which a new one is compared.
TOGETHER = 5.0  #: A text that several sources report within this time is one alarm [s].
#: A number in an alarm text that is not part of a word: M5 and M6 are different alarms.
NUMBER = re.compile(r'\b\d+(\.\d+)?')
LEVELS = {DiagnosticStatus.WARN: 'warning', DiagnosticStatus.ERROR: 'error'}


@dataclass(frozen=True)
class Alarm:
    time: str  #: Time of day.
    level: str  #: Severity.
    source: str  #: Node, and its part that reports the alarm.
    message: str  #: What happened, and what to do.
    count: int = 1  #: Number of occurrences.

    def repeats(self, other: Alarm) -> bool:
        one, two = (NUMBER.sub('#', alarm.message) for alarm in (self, other))
        return (self.level, self.source, one) == (other.level, other.source, two)


class AlarmList:
    """The latest alarms. A repeated alarm is stored once, with a count; ``clock`` returns [s]."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._told: dict[str, tuple[str, float]] = {}  # recent messages: by which source, and when
        self._alarms: deque[Alarm] = deque(maxlen=KEPT)
        self._lock = Lock()  # alarms come from the thread of ROS and from those of the page
        self._last: dict[str, tuple[bytes, str]] = {}
        self._cleared: set[Alarm] = set()

    @property
    def history(self) -> list[Alarm]:
        with self._lock:
            return list(self._alarms)[::-1]

    @property
    def newest_first(self) -> list[Alarm]:
        return [alarm for alarm in self.history if alarm not in self._cleared]

    def clear(self) -> None:
        """Hide the current alarms; they stay in the history."""
        self.hide(lambda _: True)

    def hide(self, gone: Callable[[Alarm], bool]) -> None:
        before, now = self._cleared, self.history
        self._cleared = {alarm for alarm in now if gone(alarm) or alarm in before}

    def forget(self, source: str) -> None:
        """Drop the alarms of a source, because it will report all of them again."""
        with self._lock:
            kept = [alarm for alarm in self._alarms if alarm.source != source]
            self._alarms = deque(kept, maxlen=KEPT)

    def add(self, level: str, source: str, message: str) -> None:
        with self._lock:
            self._add(level, source, message)

    def _add(self, level: str, source: str, message: str) -> None:
        now = self._clock()
        alarm = Alarm(datetime.now().strftime('%H:%M:%S'), level, source, message)
        told_by, told_at = self._told.get(message, (source, -math.inf))
        if level != 'notice' and told_by != source and now - told_at < TOGETHER:
            return
        self._told = {m: told for m, told in self._told.items() if now - told[1] < TOGETHER}
        self._told[message] = source, now
        for before in list(self._alarms)[-COMPARED:]:
            if alarm.repeats(before):
                self._alarms.remove(before)
                alarm = replace(alarm, count=before.count + 1)
        self._alarms.append(alarm)

    def hear(self, status: DiagnosticStatus) -> None:
        """Store the current report of one part of a node; it replaces the earlier one."""
        news = (status.level, status.message)
        if self._last.get(status.name) == news:
            return
        self._last[status.name] = news
        self.hide(lambda alarm: alarm.source == status.name)
        if status.level in LEVELS:
            self.add(LEVELS[status.level], status.name, status.message)
