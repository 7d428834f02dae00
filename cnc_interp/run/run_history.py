"""A CSV file with a row for each run of a machine; a shop can compute its OEE from it."""

from __future__ import annotations

import csv
import fcntl
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from cnc_interp.core import InterpError
from cnc_interp.core.small_files import state_folder
from cnc_interp.run.run_state import State

COLUMNS = (
    *('started', 'machine', 'program', 'sha256', 'operator', 'outcome'),
    *('predicted_s', 'actual_s', 'motion_s', 'held_s', 'holds', 'alarms', 'message'),
)
TAIL = 1 << 16  #: This much of the end of the file is read [bytes].
#: States that count as a hold by the operator, and states that count as an alarm.
HOLDS = frozenset({State.HOLDING, State.HELD, State.PAUSED, State.AWAY})
ALARMS = frozenset({State.STARVING, State.STARVED, State.STOPPING, State.FAULT})


@dataclass
class RunTimes:
    """Times and counts of a run, taken from the states of the machine."""

    begun: float  #: Monotonic time at the start [s].
    started: datetime = field(default_factory=lambda: datetime.now().astimezone())
    held: float = 0.0  #: Time spent on hold [s].
    holds: int = 0
    alarms: int = 0  #: Number of stops by a fault, an emergency stop or missing setpoints.
    _state: State = State.IDLE
    _seen: float = 0.0

    def see(self, state: State, now: float) -> None:
        if self._state in HOLDS:
            self.held += now - self._seen
        self.holds += state in HOLDS and self._state not in HOLDS
        self.alarms += state in ALARMS and self._state not in ALARMS
        self._state, self._seen = state, now


class RunHistory:
    """The CSV file of the runs; ``path``: its path, or '' for the user's ``runs.csv``."""

    def __init__(self, path: str):
        self.file = Path(path) if path else state_folder() / 'runs.csv'

    def append(self, row: Mapping[str, object]) -> None:
        """Append a row to the file on disk; raises InterpError if that fails."""
        texts = {name: ' '.join(str(value).split()) for name, value in row.items()}
        try:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            with self.file.open('a+', newline='', encoding='utf-8') as out:
                fcntl.flock(out, fcntl.LOCK_EX)  # several machines may share the file
                writer = csv.DictWriter(out, COLUMNS, lineterminator='\n')
                if not out.tell():
                    writer.writeheader()
                elif not self._tail().endswith('\n'):  # a row that was cut off
                    out.write('\n')
                writer.writerow(texts)
                out.flush()
                os.fsync(out.fileno())
        except OSError as problem:
            raise InterpError(
                f'{self.file}: this run is not in the history: {problem.strerror}'
            ) from None

    def latest(self, count: int) -> list[dict[str, str]]:
        """Return the last ``count`` rows, the latest first; [] if the file cannot be read."""
        try:
            lines = self._tail().splitlines()
        except OSError:
            return []
        rows = [row for row in csv.reader(lines) if len(row) == len(COLUMNS)]
        found = [dict(zip(COLUMNS, row, strict=True)) for row in rows if row[0] != COLUMNS[0]]
        return found[: -count - 1 : -1]

    def _tail(self) -> str:
        with self.file.open('rb') as file:
            skipped = max(0, file.seek(0, os.SEEK_END) - TAIL)
            file.seek(skipped)
            text = file.read().decode('utf-8', errors='replace')
        return text.partition('\n')[2] if skipped else text
