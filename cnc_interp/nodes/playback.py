"""Plays the machine's buffer of setpoints into the simulated drives, one period at a time."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from cnc_interp.interpolator import Setpoints
from cnc_interp.machine import Event, Feedback, SimulatedMachine, State
from cnc_interp.program.blocks import FloatArray


@dataclass(frozen=True)
class Row:
    """One setpoint in the buffer."""

    position: FloatArray
    velocity: FloatArray
    block: int
    line: int
    s: float
    moving: bool


class Playback:
    """
    The machine's buffer and the figures of the run; no thread, no clock.

    Parameters
    ----------
    machine : SimulatedMachine
        The drives.
    start_count : int
        Setpoints at hand before the machine starts, unless the program ends earlier.

    """

    def __init__(self, machine: SimulatedMachine, start_count: int):
        self.machine = machine
        self.feedback = machine.rest()
        self._start_count = start_count
        self._rows: deque[Row] = deque()
        self.begin('')

    def begin(self, program_id: str) -> None:
        """Get ready for a run; figures start anew, the axes stay where they are."""
        if self.machine.state in (State.STARVED, State.HOLDING):
            self.machine.handle(Event.RESET)
        self.program_id = program_id
        self._rows.clear()
        self._end_known = False
        self.completed = False
        self.lost = ''
        self.played = self.approach_samples = self.starvations = 0
        self.last: Row | None = None
        self._forget_figures()

    def _forget_figures(self) -> None:
        """Start the figures anew: at a run, and where its approach ends."""
        self.machine.largest_use[:] = 0.0
        self.largest_following_error = np.zeros(len(self.machine.machine.axis_names))
        self.largest_contour_error = 0.0
        self.least_buffered = np.inf

    @property
    def buffered(self) -> int:
        """Setpoints at hand."""
        return len(self._rows)

    def push(self, samples: Setpoints, lines: list[int], end: bool) -> None:
        """Take setpoints into the buffer."""
        moving = (np.abs(samples.velocity) + np.abs(samples.acceleration)).max(axis=1) > 0.0
        columns = (samples.block.tolist(), lines, samples.s.tolist(), moving.tolist())
        self._rows.extend(map(Row, samples.position, samples.velocity, *columns))
        self._end_known = self._end_known or end

    def step(self) -> Feedback:
        """Let one period pass."""
        state = self.machine.state
        if state in (State.IDLE, State.STARVED) and self._may_start():
            self.machine.handle(Event.START if state is State.IDLE else Event.RESUME)
        if self.machine.state is not State.RUNNING:
            self.feedback = self.machine.rest()
        elif self._rows:
            self._play(self._rows.popleft())
        elif self._end_known:
            self.machine.handle(Event.FINISH)
            self.completed = True
            self.feedback = self.machine.rest()
        else:
            self._starve()
        return self.feedback

    def _may_start(self) -> bool:
        """Start with enough at hand; never again after setpoints were missing in motion."""
        enough = len(self._rows) >= self._start_count or self._end_known
        return bool(self._rows) and enough and not self.lost

    def _play(self, row: Row) -> None:
        """Follow one setpoint and keep the figures of the run."""
        if not self._end_known:
            self.least_buffered = min(self.least_buffered, len(self._rows))
        if row.block == 0:
            self.approach_samples += 1
        elif self.last is None or self.last.block == 0:
            self._forget_figures()
        self.feedback = self.machine.step(row.position, row.velocity)
        self.last = row
        self.played += 1
        error = np.abs(self.feedback.following_error)
        self.largest_following_error = np.maximum(self.largest_following_error, error)
        self.largest_contour_error = max(self.largest_contour_error, self.feedback.contour_error)
        if self.machine.state is State.FAULT:
            self._rows.clear()

    def _starve(self) -> None:
        """Hold the last setpoint; after a rest the run may go on, after motion it is lost."""
        self.starvations += 1
        message = f'no setpoints after {self.played}: holding the last one'
        if self.last is not None and self.last.moving:
            self.lost = f'{message}; feedrate_node came too late or is lost, start the run again'
            message = self.lost
        self.machine.handle(Event.STARVE, message)
        self.feedback = self.machine.rest()

    def fail(self, reason: str) -> None:
        """Stop the drives where they are."""
        self._rows.clear()
        self.machine.handle(Event.FAIL, reason)
