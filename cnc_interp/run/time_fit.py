"""Fit those parameters of a machine file that determine run times to recorded runs.

The fitted values are logarithms of factors on the jerk of each linear axis, on their accelerations
(one factor), and on the velocity jump and the block time of the look-ahead. Gauss-Newton steps
with Broyden's update fit the planned to the recorded times of windows. A window is a few seconds
of a run in which only motion takes time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, IntArray, InterpError
from cnc_interp.feedrate.limit_use import limits_at
from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import PlannedPiece
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.machine_entries import (
    CHANGE,
    SCATTER,
    SPEED,
    USUAL_REVERSAL,
    BlockPace,
    Standstill,
)
from cnc_interp.machine_model.machine_entries import START as START_TIME
from cnc_interp.machine_model.machine_entries import STOP as STOP_TIME
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import open_program
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.blocks.functions import Functions
from cnc_interp.run.parallel_planner import Planning
from cnc_interp.run.path_chain import PathChain, batches
from cnc_interp.run.program_times import ProgramTimes
from cnc_interp.run.time_records import CycleTime, Trace
from cnc_interp.settings.options import Settings

SPAN = 3.0  #: Least duration of a window [s].
START = BlockPace(3e-3, 1e-3, 1.0, True)  #: Values at which the search starts.
#: Steps of the logarithms: for finite differences; largest one; one that ends the search.
SLOPE_STEP, LARGEST_STEP, ENOUGH = 0.15, 0.7, 0.02
STEPS = 4
#: A fit plans ``CHUNK`` of every ``EVERY`` rows, without the outer ``MARGIN`` lines of a part.
CHUNK, EVERY, MARGIN = 1200, 6000, 12
PRIOR = 0.5  #: Prior standard deviation of the fitted logarithms.
HIDDEN = 0.8  #: A value more uncertain than this share of the prior is not determined.
ROBUST = 0.3  #: Windows with larger residuals get less weight [s].
CLUSTER = 10  #: Residuals of this many consecutive windows may be correlated.
SETTLED = 0.2  #: A recorded feed belongs to a line only this long after its start [s].
HELD = 3  #: A velocity was reached if this many feeds agree within 1 %.
SIGMAS = 1.96  #: Half width of the 95 % interval in standard deviations.


@dataclass(frozen=True)
class TimedProgram:
    """A program that is planned on machines with different limits."""

    name: str
    blocks: Blocks
    functions: Functions
    settings: Settings
    override: float = 1.0
    whole: bool = False  #: Whether a fit plans the whole program, even if it is long.

    @staticmethod
    def load(path: Path, machine: Machine, settings: Settings) -> TimedProgram:
        stream = open_program(path, Transform.of(machine), settings)
        blocks = stream.read().blocks
        if (np.diff(blocks.line_number) < 0).any():
            raise InterpError(
                f'{path}: repeats lines, but times are recorded by line; take another'
            )
        return TimedProgram(path.name, blocks, stream.functions, settings)

    @property
    def lines(self) -> IntArray:
        return self.blocks.line_number

    @cached_property
    def switched(self) -> IntArray:
        """Source lines with functions."""
        return np.unique(self.functions.line_number)

    @property
    def first(self) -> int:
        """First source line with motion."""
        return int(self.lines[min(1, len(self.lines) - 1)])

    @property
    def last(self) -> int:
        return int(self.lines[-1])

    def overridden(self, override: float) -> TimedProgram:
        share = np.where(self.blocks.rapid, 1.0, override / self.override)
        blocks = replace(self.blocks, feedrate=share * self.blocks.feedrate)
        return replace(self, blocks=blocks, override=override)

    def sample(self) -> list[slice]:
        """Return the rows that a fit plans: all, or one fifth of a long program."""
        rows = len(self.blocks)
        if rows <= EVERY or self.whole:
            return [slice(0, rows)]
        return [slice(max(0, a - 1), a + CHUNK) for a in range(0, rows, EVERY)]

    def covers(self, lines: IntArray) -> BoolArray:
        """Return which windows lie within the sample; ``lines`` (w, 2): first and last line."""
        covered = np.zeros(len(lines), dtype=np.bool_)
        for rows in self.sample():
            part = self.lines[rows]
            low, high = (
                part[0] + (MARGIN if rows.start else 0),
                part[-1] - (MARGIN if part[-1] < self.lines[-1] else -1),
            )
            covered |= (lines[:, 0] >= low) & (lines[:, 1] <= high)
        return covered

    def _pieces(self, machine: Machine, rows: slice) -> Iterator[PlannedPiece]:
        chain = PathChain(Transform.of(machine), self.settings)
        limits = limits_at(machine, self.settings.interpolation_period)
        planner = Planning(limits, PlanOptions(bound=False), None).planner()
        for part in batches(self.blocks[rows]):
            if (path := chain.push(part).path) is not None:
                yield from planner.push(path)
        if (path := chain.finish().path) is not None:
            yield from planner.push(path)
        yield from planner.finish()

    def motion(self, machine: Machine, parts: Sequence[slice] = (slice(0, None),)) -> Motion:
        """Return the motion planned on a machine, for parts of the rows, from rest to rest."""
        planned = [
            (rows.start + p.path.cell_block[p.law.cell], p.law.duration, p.law.s_dot)
            for rows in parts
            for p in self._pieces(machine, rows)
        ]
        row, duration, speed = map(np.concatenate, zip(*planned, strict=True))
        return Motion(self.lines[row], duration, speed, int(self.lines[-1]))


@dataclass(frozen=True)
class Motion:
    """A planned motion as n pieces of constant jerk."""

    line: IntArray  #: (n,): Source line.
    duration: FloatArray  #: (n,): Duration [s].
    speed: FloatArray  #: (n,): Speed at the start of each piece [m/s].
    last: int  #: Last source line of the program.

    def until(self, line: IntArray) -> FloatArray:
        """Return the total time of all lines before each of ``line`` [s]."""
        by_line = np.bincount(self.line, self.duration, self.last + 1)
        return np.append(0.0, np.cumsum(by_line))[np.minimum(line, self.last + 1)]


def measured_override(program: TimedProgram, trace: Trace) -> float:
    """Return the feed override that most recorded feeds show; 1 if none is recorded."""
    feed = np.full(int(program.lines[-1]) + 2, np.inf)
    cuts = ~program.blocks.rapid
    feed[program.lines[cuts]] = program.blocks.feedrate[cuts] / program.override
    line, _ = trace.line_at(trace.feed[:, 0])
    share = trace.feed[:, 1] / feed[np.minimum(line, len(feed) - 1)]
    shares, count = np.unique(np.round(share[share > 0.5], 2), return_counts=True)
    if not len(shares):
        return 1.0
    most = shares[np.argmax(count)]
    return float(np.median(share[np.abs(share - most) < 0.01]))


def measured_velocities(program: TimedProgram, trace: Trace) -> FloatArray:
    """Return the largest velocities of X, Y, Z in rapids, (3,) [m/s]; 0 if not reached."""
    step = np.diff(program.blocks.tip, axis=0, prepend=program.blocks.tip[:1])
    length = np.linalg.norm(step, axis=1)
    rows = program.blocks.rapid & (length > 0.0)
    # Neither the end of a tool change nor the start of the program is known.
    rows &= ~np.isin(program.lines, program.switched) & (program.lines > program.first)
    share = np.zeros((int(program.lines[-1]) + 2, 3))
    share[program.lines[rows]] = np.abs(step[rows]) / length[rows, None]
    line, since = trace.line_at(trace.feed[:, 0])
    moves = share[np.minimum(line, len(share) - 1)] * trace.feed[:, 1:]
    moves = np.sort(moves[since > SETTLED], axis=0)[-HELD:]
    if len(moves) < HELD:
        return np.zeros(3)
    held, usual = moves[0] > 0.99 * moves[-1], np.round(np.median(moves, axis=0), 3)
    return np.asarray(np.where(held, usual, 0.0))


@dataclass(frozen=True)
class TracedRun:
    """A recorded run of a program, divided into windows."""

    program: TimedProgram
    trace: Trace
    windows: IntArray  #: (w, 2): Indices of the events at which windows begin and end.
    #: (w,): Time at rest in each window by the machine file [s]; only for cycle times.
    standing: FloatArray | None = None

    @staticmethod
    def of(program: TimedProgram, trace: Trace) -> TracedRun:
        switched, windows, first = program.switched, [], -1
        for event, line in enumerate(trace.line):
            # The line after a function may wait for it, too.
            if first >= 0 and np.any((switched >= trace.line[first] - 1) & (switched < line)):
                first = -1
            if first < 0:
                first = event if line >= program.first else -1
            elif trace.time[event] - trace.time[first] >= SPAN:
                windows.append((first, event))
                first = event
        if not windows:
            raise InterpError(
                f'{trace.name}: no {SPAN:g} s of motion without a function; take another'
            )
        return TracedRun(program, trace, np.array(windows))

    @staticmethod
    def of_times(
        program: TimedProgram, machine: Machine, times: Sequence[CycleTime], source: Path
    ) -> list[TracedRun]:
        """Return the runs in a table of cycle times; each row of the table is a window.

        The times are as `estimate` prints them: of the program, or of each tool in order.
        """
        program = replace(program, whole=True)
        gathered = ProgramTimes()
        gathered.blocks(program.blocks)
        sections = gathered.sections(program.functions, machine)
        rests = [one.times.total for one in sections]
        lines = [one.line for one in sections]
        if not times or times[0].tool is None:
            lines, rests = [program.first], [sum(rests) + sum(one.change for one in sections)]
        runs, count = [], len(lines)
        for at in range(0, len(times), count):
            part = times[at : at + count]
            for one, section in zip(part, sections, strict=False):
                if one.tool not in (None, section.tool):
                    text = f'{source}:{one.row}: T{one.tool}, but the next tool of '
                    raise InterpError(f'{text}{program.name} is T{section.tool}')
            if len(part) < count:
                text = f'{source}:{part[-1].row}: T{sections[len(part)].tool} of {program.name}'
                raise InterpError(f'{text} must follow')
            time = np.append(0.0, np.cumsum([one.time for one in part]))
            trace = Trace(source.name, time, np.append(lines, program.last + 1), np.zeros((0, 2)))
            windows = np.arange(count)[:, None] + [0, 1]
            runs.append(TracedRun(program, trace, windows, np.array(rests)))
        return runs

    @property
    def measured(self) -> FloatArray:
        took = np.diff(self.trace.time[self.windows], axis=1)[:, 0]
        return took if self.standing is None else took - self.standing

    def planned(self, motion: Motion) -> FloatArray:
        return np.diff(motion.until(self.trace.line[self.windows]), axis=1)[:, 0]

    def stretches(self) -> Iterator[tuple[int, int]]:
        """Yield first and last window of each sequence of adjacent windows."""
        breaks = np.flatnonzero(self.windows[1:, 0] != self.windows[:-1, 1]) + 1
        edges = [0, *breaks.tolist(), len(self.windows)]
        yield from ((a, b - 1) for a, b in pairwise(edges))

    def rests(self, machine: Machine, motion: Motion) -> Iterator[tuple[int, float]]:
        """Yield field number of ``Standstill`` and measured value, for each tool change."""
        if self.standing is not None:
            return
        functions, line, t = self.program.functions, self.trace.line, self.trace.time
        changes, starts, stops = (
            functions.standstill(machine.signals, one)
            for one in (Standstill(1.0), Standstill(start=1.0), Standstill(stop=1.0))
        )
        for row in np.flatnonzero(changes):
            at = functions.line_number[row]
            begin, end = np.searchsorted(line, [at, at + 1])
            known = end < len(line) and line[begin] == at
            if not known or not stops[: row + 1].any():
                continue  # at the first change the tool may already be in the spindle
            yield 0, float(t[end] - t[begin])
            after = self.windows[self.windows[:, 0] >= end, 0]
            if len(after) and starts[row:].any():
                rise = starts[row:][np.flatnonzero(starts[row:])[0]]
                yield 1, self._beyond(motion, end, int(after[0])) / rise
            before = self.windows[self.windows[:, 1] <= begin, 1]
            if len(before):
                fall = stops[np.flatnonzero(stops[: row + 1])[-1]]
                yield 2, self._beyond(motion, int(before[-1]), int(begin)) / fall

    def _beyond(self, motion: Motion, first: int, last: int) -> float:
        """Return the time between two events minus that of the planned motion, at least 0 [s]."""
        planned = np.diff(motion.until(self.trace.line[[first, last]]))[0]
        return max(0.0, float(self.trace.time[last] - self.trace.time[first] - planned))


@dataclass(frozen=True)
class Fitted:
    machine: Machine  #: Machine with the fitted values.
    #: Key in the machine file -> fitted value, and half width of its 95 % interval.
    values: dict[str, tuple[float, float]]
    motions: list[Motion]  #: Motion of each run, planned on this machine.


def with_parameters(machine: Machine, x: FloatArray) -> Machine:
    """Return the machine with fitted values; ``x`` (6,): logarithms of their factors."""
    jerk, acceleration = machine.max_jerk.copy(), machine.max_acceleration.copy()
    jerk[:3] *= np.exp(x[:3])
    acceleration[:3] *= np.exp(x[3])
    pace = machine.pace or START
    pace = BlockPace(
        pace.jump * float(np.exp(x[4])),
        pace.block_time * float(np.exp(x[5])),
        float(jerk[:3].min()),
        pace.stops_at_rapids,
    )
    return replace(machine, pace=pace).having(max_jerk=jerk, max_acceleration=acceleration)


class TimeFit:
    """The fit to several runs. Runs of the same program are planned only once."""

    def __init__(self, machine: Machine, runs: Sequence[TracedRun], tell: Callable[[str], None]):
        velocity = machine.max_velocity.copy()
        seen = np.max([measured_velocities(run.program, run.trace) for run in runs], axis=0)
        velocity[:3] = np.where(seen > 0.0, seen, velocity[:3])
        self._machine = machine.having(max_velocity=velocity)
        self._runs, self._tell = runs, tell
        self._kept = [run.program.covers(run.trace.line[run.windows]) for run in runs]
        pairs = zip(runs, self._kept, strict=True)
        self._measured = np.concatenate([run.measured[kept] for run, kept in pairs])
        # Each window also represents windows of its run that are not planned.
        stands = [np.full(kept.sum(), len(kept) / max(1, kept.sum())) for kept in self._kept]
        self._stands = np.concatenate(stands)

    def motions(self, x: FloatArray, whole: bool = False) -> list[Motion]:
        """Return the planned motion of each run's program: of its sample, or ``whole``."""
        machine = with_parameters(self._machine, x)
        planned: dict[int, Motion] = {}
        for program in (run.program for run in self._runs):
            if id(program) not in planned:
                parts = [slice(0, None)] if whole else program.sample()
                planned[id(program)] = program.motion(machine, parts)
        return [planned[id(run.program)] for run in self._runs]

    def _off(self, x: FloatArray) -> FloatArray:
        """Return measured minus planned time of each window [s]."""
        triples = zip(self._runs, self._kept, self.motions(x), strict=True)
        return self._measured - np.concatenate([run.planned(m)[kept] for run, kept, m in triples])

    def solve(self) -> Fitted:
        x = np.zeros(6)
        off = self._off(x)
        slopes = np.empty((len(off), len(x)))
        for k in range(len(x)):
            self._tell(f'planning with another value, {k + 1} of {len(x)}')
            slopes[:, k] = (self._off(x + SLOPE_STEP * np.eye(6)[k]) - off) / SLOPE_STEP
        best = (np.inf, x, off, slopes)
        for number in range(STEPS + 1):
            self._tell(f'step {number}: off by {np.sqrt(np.mean(off**2)):.3f} s in a window')
            cost = float(self._stands @ (np.hypot(1.0, off / ROBUST) - 1.0))
            best = min(best, (cost, x, off, slopes), key=lambda one: one[0])
            step = self._step(x, off, slopes)
            if number == STEPS or np.abs(step).max() < ENOUGH:
                break
            x = x + step
            change = self._off(x) - off
            off = off + change
            slopes = slopes + np.outer(change - slopes @ step, step) / (step @ step)
        return self._fitted(*best[1:])

    def _weights(self, off: FloatArray) -> tuple[FloatArray, float]:
        """Return the weight of each window, and the weight of the prior."""
        weight = self._stands / np.hypot(1.0, off / ROBUST)
        return weight, float(np.mean(weight * off**2)) / PRIOR**2

    def _step(self, x: FloatArray, off: FloatArray, slopes: FloatArray) -> FloatArray:
        weight, prior = self._weights(off)
        normal = slopes.T @ (weight[:, None] * slopes) + prior * np.eye(6)
        step = -np.linalg.solve(normal, slopes.T @ (weight * off) + prior * x)
        return np.asarray(step * min(1.0, LARGEST_STEP / max(float(np.abs(step).max()), 1e-9)))

    def _fitted(self, x: FloatArray, off: FloatArray, slopes: FloatArray) -> Fitted:
        weight, prior = self._weights(off)
        inverse = np.linalg.inv(slopes.T @ (weight[:, None] * slopes) + prior * np.eye(6))
        # Residuals of neighbouring windows are alike, so they are summed before they are squared.
        score = np.add.reduceat(
            slopes * (weight * off)[:, None], np.arange(0, len(off), CLUSTER), axis=0
        )
        spread = inverse @ (score.T @ score + (prior * PRIOR) ** 2 * np.eye(6)) @ inverse
        width = SIGMAS * np.sqrt(np.diag(spread))
        hidden = width > HIDDEN * SIGMAS * PRIOR
        if hidden.any():  # these values stay unchanged, and the others are adjusted
            part = np.linalg.solve(inverse[np.ix_(hidden, hidden)], x[hidden])
            x = np.where(hidden, 0.0, x - inverse[:, hidden] @ part)
            width = np.where(hidden, np.inf, width)
        machine, motions = with_parameters(self._machine, x), self.motions(x, whole=True)
        rests: tuple[list[float], ...] = ([], [], [])
        for run, motion in zip(self._runs, motions, strict=True):
            for number, value in run.rests(machine, motion):
                rests[number].append(value)
        speeds = [run.program.functions.speeds(machine.signals) for run in self._runs]
        speed = float(max(np.append(np.concatenate(speeds), 1.0)))
        if any(rests):
            change, start, stop = (float(np.mean(rest)) if rest else 0.0 for rest in rests)
            reversal = machine.standstill.reversal or USUAL_REVERSAL
            stands = Standstill(change, start, stop, reversal, speed)
            machine = replace(machine, standstill=stands)
        assert machine.pace is not None
        parts = np.arange(0, len(off), CLUSTER)
        told = np.add.reduceat(off, parts) / np.add.reduceat(self._measured, parts)
        scatter = SIGMAS * float(np.sqrt(np.mean(told**2)))
        machine = replace(machine, pace=replace(machine.pace, scatter=scatter))
        values = {
            f'limits.{name}.jerk_m_per_s3': (machine.max_jerk[k], machine.max_jerk[k] * width[k])
            for k, name in enumerate('XYZ')
        }
        for k, name in enumerate('XYZ'):
            values[f'limits.{name}.velocity_m_per_min'] = (60.0 * machine.max_velocity[k], np.nan)
            most = machine.max_acceleration[k]
            values[f'limits.{name}.acceleration_m_per_s2'] = (most, most * width[3])
        assert machine.pace is not None
        values[f'look_ahead.{SCATTER}'] = 100.0 * scatter, np.nan
        jump, time = 1e3 * machine.pace.jump, 1e3 * machine.pace.block_time
        values['look_ahead.velocity_jump_mm_per_s'] = (jump, jump * width[4])
        values['look_ahead.block_time_ms'] = (time, time * width[5])
        for key, unit, rest in zip(
            (CHANGE, START_TIME, STOP_TIME), (1.0, speed**2, speed**2), rests, strict=True
        ):
            if rest:
                half = SIGMAS * np.std(rest, ddof=1) / np.sqrt(len(rest)) if rest[1:] else np.nan
                values[f'standstill.{key}'] = float(np.mean(rest)) * unit, half * unit
        if any(rests):
            values[f'standstill.{SPEED}'] = speed, np.nan
        return Fitted(machine, values, motions)
