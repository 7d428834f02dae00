"""When a run goes on after the loss of a node: nothing moves, and somebody waits for motion."""

from __future__ import annotations

import math

from cnc_interp.run.machine_report import MachineReport
from cnc_interp.run.run_state import SELF_STARTING, State

SETTLED = 0.1
"""A machine that rests for so long after cycle_start has nothing to execute [s]."""
FILLED = 0.5
"""A machine with a plan whose buffer is not full after so long gets no more setpoints [s]."""


class LossRecovery:
    """
    Watches a machine after a node was restarted.

    A machine that still has setpoints starts at once on cycle_start. The rest of the program is
    sent again only where the machine goes on resting: it must not move meanwhile. A machine whose
    stop was not planned waits for cycle_start. One that would have started by itself does so:
    its buffer was not full yet, or the feed override is 0.
    """

    def __init__(self) -> None:
        self.node = ''  # the node that has forgotten the run
        self._restarted = False  # the machine went on with what it had
        self._wants_since, self._waits = math.inf, -math.inf  # by the machine's clock [s]
        self._report: MachineReport | None = None

    def see(self, report: MachineReport) -> None:
        """Take a report of the machine, which is on this run, or free and not on it yet."""
        before, self._report = self._report, report
        held = before is not None and before.state is State.HELD
        if self.node and held and report.moves and report.state is not State.HELD:
            self._restarted = True
        wants = report.start_wanted or (self._restarted and report.state is State.STARVED)
        wants = (wants and report.rests_on_path) or (bool(self.node) and self._starts_by_itself)
        self._wants_since = min(self._wants_since, report.time) if wants else math.inf
        self._waits = report.time - self._wants_since

    @property
    def _starts_by_itself(self) -> bool:
        """Tell whether the machine moves as soon as it has setpoints; nobody has stopped it."""
        report = self._report
        return report is not None and report.state in SELF_STARTING - {State.STARVED}

    @property
    def is_due(self) -> bool:
        """Tell whether the program must be sent again now."""
        report = self._report
        fills = report is not None and report.state is State.STARVED and not report.plan_over
        least = FILLED if fills or self._starts_by_itself else SETTLED
        return bool(self.node) and self._waits >= least

    def begin_again(self) -> None:
        """Reset after a loss."""
        self.node, self._restarted = '', False
        self._wants_since, self._waits = math.inf, -math.inf
