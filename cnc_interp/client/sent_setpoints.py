"""The setpoints of a run, as sent to the machine."""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import SetpointChunk

from cnc_interp.client.bag import Bag
from cnc_interp.core import FloatArray
from cnc_interp.run.overrides import OperatorSettings
from cnc_interp.run.run_state import RunId
from cnc_interp.run.setpoints import Setpoints
from cnc_interp.wire.message_checks import check_setpoints
from cnc_interp.wire.path_messages import SETPOINT_FIELDS, settings_of_plan
from cnc_interp.wire.run_messages import run_id_of

LONGEST_TAIL = 1 << 14  #: No stop along the path has more setpoints.
S, BLOCK, LINE = -3, -2, -1  #: Columns of ``rows_of``.


def rows_of(message: SetpointChunk, prefix: str = '') -> FloatArray:
    """Return the setpoints of a message as rows; with prefix ``tail_`` its stop tail."""
    check_setpoints(message, message.axis_count, prefix)
    n, columns = len(getattr(message, f'{prefix}sequences')), []
    for field, name in SETPOINT_FIELDS.items():
        width = message.axis_count if Setpoints.declared[name].tail else 1
        values = np.asarray(getattr(message, prefix + field), dtype=float)
        columns.append(values.reshape(n, width))
    return np.hstack(columns)


class SentSetpoints:
    """The setpoints that were sent in a run, by plan and number; read when they are needed.

    Sent setpoints never change, so copies of a recorded run share this object.
    """

    def __init__(self, bag: Bag, program_id: str):
        self._messages = bag.spooled('setpoints')
        self._places: dict[RunId, dict[int, int]] = defaultdict(dict)  # by first setpoint
        self.joins: dict[RunId, int] = {}  #: Plan that joined in motion -> first setpoint.
        #: Plan -> operator settings with which it was planned.
        self.settings: dict[RunId, OperatorSettings] = {}
        self.faults: list[str] = []
        for place, message in enumerate(self._messages):
            if message.program_id != program_id:
                continue
            run_id, first = run_id_of(message), message.first_sample
            known = self._places[run_id].setdefault(first, place)
            if known != place and not _same(self._messages[known], message):
                self.faults.append(
                    f'setpoint {first} of {run_id} was sent twice with different values'
                )
            settings = settings_of_plan(message)
            if self.settings.setdefault(run_id, settings) != settings:
                self.faults.append(f'{run_id} was planned with different operator settings')
            if message.joins:
                self.joins[run_id] = first
        self._firsts = {run_id: sorted(places) for run_id, places in self._places.items()}

    def __deepcopy__(self, _: Any) -> SentSetpoints:
        return self

    def stop_before(self, run_id: RunId, number: int, later: int) -> float:
        """Return where a plan could have stopped [m]: the end of a stop tail.

        The tail is that of the chunk ``later`` setpoints after ``number`` or, if the record lacks
        """
        message = self.at(run_id, number + later) or self.at(run_id, number)
        if message is None:
            return -np.inf
        return float((message.tail_path_positions or message.path_positions)[-1])

    def at(self, run_id: RunId, number: int) -> SetpointChunk | None:
        """Return the message with setpoint ``number``; None if the record does not have it."""
        firsts = self._firsts.get(run_id, [])
        k = bisect_right(firsts, number) - 1
        if k < 0:
            return None
        message = self._messages[self._places[run_id][firsts[k]]]
        return message if number < firsts[k] + len(message.sequences) else None

    def tail(self, run_id: RunId, number: int, row: FloatArray) -> FloatArray | None:
        """Return the rest of the stop tail that was executed from setpoint ``number`` on, or None.

        ``row`` is its first setpoint that differs from the plan. A tail may agree with the plan
        """
        plan = np.zeros((0, len(row)))  # from the end of a chunk to the setpoint
        while len(plan) < LONGEST_TAIL:
            message = self.at(run_id, number - len(plan) - 1)
            if message is None:
                return None
            rows = rows_of(message)[: number - len(plan) - message.first_sample]
            tail, count = rows_of(message, 'tail_'), len(plan)
            whole = len(rows) == len(message.sequences)
            if whole and count < len(tail) and (tail[:count] == plan).all():
                if (tail[count] == row).all():
                    return tail[count:]
            plan = np.concatenate([rows, plan])
        return None


def _same(a: SetpointChunk, b: SetpointChunk) -> bool:
    """Return whether two messages are equal except their checksums, which cover padding bytes."""
    return all(
        getattr(a, name) == getattr(b, name)
        for name in a.get_fields_and_field_types()
        if name != 'checksum'
    )
