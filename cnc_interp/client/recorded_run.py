"""A recorded run: its blocks, segments and executed setpoints; convert it to plan files."""

import copy
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import (
    FollowedSpindle,
    G1Block,
    MachineState,
    PathSegment,
    SetpointChunk,
)

from cnc_interp.client.bag import Bag
from cnc_interp.client.sent_setpoints import SentSetpoints
from cnc_interp.core import FloatArray, IntArray, InterpError
from cnc_interp.kinematics.axis_path import AxisPath, evaluate, refine
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.machine.jog import JOG
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import ARMED
from cnc_interp.machine_model.transform_port import Transform, reached
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.blocks.functions import Functions
from cnc_interp.program.blocks.start_line import StartBlock, StartLine
from cnc_interp.proof.plan_files import BY_OPERATOR, BY_PROBE, MISSING
from cnc_interp.run.clearance_stage import ClearanceStage
from cnc_interp.run.overrides import OperatorSettings, OverrideStep
from cnc_interp.run.plan_writer import PlanWriter
from cnc_interp.run.run_state import NO_RUN, RunId
from cnc_interp.run.setpoints import Setpoints
from cnc_interp.run.start_place import StartFinder
from cnc_interp.settings.options import Settings
from cnc_interp.wire import path_messages as messages
from cnc_interp.wire.message_checks import check_setpoints
from cnc_interp.wire.path_messages import setpoints_from
from cnc_interp.wire.run_messages import run_id_of, settings_of_block

BATCH = 256  #: Number of segments that are converted in one call.
#: Slowing down to a lower override begins within this time after a join [s].
STOPS_WITHIN = 0.05
#: Number of setpoints per grid point of the path; length of the shortest cell [m].
GRID_EVERY, SHORTEST = 10, 1e-6


@dataclass(frozen=True)
class RecordedRun:
    program_id: str  #: Id of the run.
    name: str  #: Name of the program.
    machine: str  #: Machine of the nodes; empty if it is not in the bag.
    blocks: list[G1Block]  #: Blocks of the program, from the start pose, without gaps.
    segments: list[PathSegment]  #: Segments from the first one, without gaps.
    #: Executed setpoints; they are in a file, because a run may be larger than the memory.
    chunks: Sequence[SetpointChunk]
    sent: SentSetpoints  #: Setpoints sent to the machine.
    #: Offsets and tools at the start of the run: text of a setup file, or ''.
    setup: str = ''
    followed: Sequence[FollowedSpindle] = ()  #: Motion in step with the spindle.
    probed: int = 0  #: Source line that the probe ended; 0 if none.
    #: Count of executed setpoints at which the operator's last stop ended the run, or -1.
    held_at: int = -1

    @property
    def flank_height(self) -> float:
        return float(self.blocks[0].flank_height)

    @property
    def period(self) -> float:
        return float(self.chunks[0].period)

    @property
    def cut(self) -> str:
        """Where and how the record ends before the program does; '' if it is complete."""
        return self._order[1]

    @cached_property
    def _order(self) -> tuple[list[int], str]:
        """Return the indices of the chunks in order, up to the first gap; and ``cut``."""
        order: list[int] = []
        following, ended = 0, False
        last = next((chunk for chunk in self.chunks if len(chunk.sequences)), self.chunks[0])
        for k in np.argsort([chunk.first_sample for chunk in self.chunks], kind='stable'):
            chunk = self.chunks[k]
            if chunk.first_sample > following:
                end = f'lacks executed setpoints {following} to {chunk.first_sample - 1}'
                return order, f'the record {end}, after line {last.line_numbers[-1]}'
            following = chunk.first_sample + len(chunk.sequences)
            if len(chunk.sequences):  # else it only switches outputs
                last, ended = chunk, chunk.end_of_program
            order.append(int(k))
        end = 'in motion' if any(last.velocities[-last.axis_count :]) else 'at rest'
        line = f'the record ends {end}, in line {last.line_numbers[-1]}'
        if self.probed and end == 'at rest':
            line = f'{BY_PROBE}, in line {self.probed}'
        elif following == self.held_at and end == 'at rest':
            line = f'{BY_OPERATOR}, in line {last.line_numbers[-1]}'
        return order, '' if ended else line

    @property
    def by_operator(self) -> bool:
        return self.cut.startswith(BY_OPERATOR)

    @property
    def settings(self) -> Settings:
        """Settings of the run, read from its block 0."""
        settings = settings_of_block(self.blocks[0], Settings())
        return replace(settings, interpolation_period=self.period)

    def setpoints(self, machine: Machine) -> Iterator[Setpoints]:
        """Yield the executed setpoints of the program; their times count from its start.

        The approach and motions by hand during a hold are left out.

        Raises InterpError if a message is invalid, or if the period changes.
        """
        count = 0
        for part in self._executed(machine):
            rows = np.flatnonzero(part.block > 0)
            if len(rows):
                time = np.arange(count, count + len(rows)) * self.period
                yield replace(part[rows], time=time)
                count += len(rows)

    def beside(self, machine: Machine) -> list[FloatArray]:
        """Return the approach and other motions outside the program, (K, n_axes) each [m, rad]."""
        stretches: list[list[FloatArray]] = []
        before, inside = np.zeros((0, len(machine.axis_names))), True
        for part in self._executed(machine):
            changes = np.flatnonzero(np.diff(part.block > 0)) + 1
            for rows in np.split(np.arange(len(part)), changes):
                position, was_inside = part.position[rows], inside
                inside = bool(part.block[rows[0]] > 0)
                if not inside:
                    if was_inside:
                        stretches.append([before])
                    stretches[-1].append(position)
                before = position[-1:]
        if self.cut and not inside:  # it does not end at rest
            stretches.pop()
        return [np.concatenate(stretch) for stretch in stretches]

    def executed(self) -> Iterator[SetpointChunk]:
        """Yield the executed chunks in order, up to the first gap."""
        return map(self.chunks.__getitem__, self._order[0])

    def _executed(self, machine: Machine) -> Iterator[Setpoints]:
        period = self.period
        for chunk in self.executed():
            if chunk.period != period:
                raise InterpError(
                    f'setpoints from {chunk.first_sample} on have the period {chunk.period:g} s, '
                    f'those before {period:g} s; record the run again'
                )
            check_setpoints(chunk, len(machine.axis_names))
            if len(chunk.sequences):
                yield setpoints_from(chunk)

    def overrides(self) -> list[OverrideStep]:
        """Return the overrides that the setpoints of the program may use.

        They are the overrides of the setpoint's plan. A plan that joins a faster one in motion
        needs some path to slow down. There, until the faster plan could have stopped, the larger
        overrides apply.
        """
        steps: list[OverrideStep] = []
        slowing: list[tuple[float, FloatArray]] = []  # end of slowing down, and overrides before
        own, run_id, count = np.ones(2), NO_RUN, 0
        for chunk in self.executed():
            if run_id_of(chunk) != run_id:
                joins = self.sent.joins.get(run_id_of(chunk))
                later = round(STOPS_WITHIN / self.period)
                stop = 0.0 if joins is None else self.sent.stop_before(run_id, joins - 1, later)
                slowing = [] if joins is None else [*slowing, (stop, own)]
                run_id = run_id_of(chunk)
                settings = self.sent.settings.get(run_id, OperatorSettings())
                own = np.array([settings.override, settings.spindle])
            of_program = np.asarray(chunk.sequences) > 0
            place = np.asarray(chunk.path_positions)[of_program]
            counted = np.tile(own, (len(place), 1))
            for stop, before in slowing:
                counted[place <= stop] = np.maximum(counted[place <= stop], before)
            for k in np.flatnonzero(np.any(np.diff(counted, axis=0, prepend=np.nan), axis=1)):
                step = OverrideStep(count + int(k), *counted[k].tolist())
                if not steps or steps[-1][1:] != step[1:]:
                    steps.append(step)
            count += len(place)
        return steps

    def functions(self, machine: Machine) -> tuple[Functions, IntArray]:
        """Return the functions of the program, and for each the setpoint at which it acted.

        Raises InterpError if a function acted twice, or differs from the one that was sent.
        """
        sent = [function for block in self.blocks for function in block.functions]
        messages.check_functions('blocks', sent, machine.signals)
        kept = np.concatenate([np.zeros(0, bool), *(p.block > 0 for p in self._executed(machine))])
        program = np.append(np.cumsum(kept) - kept, kept.sum())
        sample = np.full(len(sent), MISSING)
        for done in (f for chunk in self.chunks for f in chunk.functions):
            plain = copy.copy(done)
            plain.sample = 0  # functions as sent have none
            if done.number >= len(sent) or sent[done.number] != plain:
                raise InterpError(f'function {done.number} differs from what was sent')
            if sample[done.number] != MISSING:
                raise InterpError(f'function {done.number} was executed twice')
            sample[done.number] = program[min(done.sample, len(program) - 1)]
        return messages.functions_from(sent), sample

    def paths(self, machine: Machine) -> Iterator[AxisPath]:
        builder = AxisPathBuilder(Transform.of(machine), self.flank_height, self.period)
        for first in range(0, len(self.segments), BATCH):
            path = builder.push(messages.segments_from(self.segments[first : first + BATCH]))
            if path is not None:
                yield path

    def start_row(self, machine: Machine, blocks: Blocks) -> int:
        """Return the row whose start is nearest to the end of the approach; 1 for the top."""
        settings, first = self.settings, self.blocks[0]
        if not settings.from_line:
            return 1
        for path in self.paths(machine):
            if path.s[-1] > first.continue_at:
                cell = int(np.searchsorted(path.s, first.continue_at, side='right')) - 1
                near = path.cell_block[max(cell, 0)] + np.arange(-BATCH, BATCH)
                near = near[(near >= 1) & (near < len(blocks))]
                q = evaluate(path, np.array([first.continue_at]))[0]
                tip, axis = reached(Transform.of(machine), q)
                off = np.linalg.norm(blocks.tip[near - 1] - tip, axis=1)
                off += self.flank_height * np.linalg.norm(blocks.axis[near - 1] - axis, axis=1)
                beside = np.abs(near - path.cell_block[cell])
                return int(near[np.lexsort((beside, off.round(9)))[0]])
        return 1


def recorded_run(bag: Bag, program_id: str = '') -> RecordedRun:
    """Return the run in a bag with this id, by default the last run with motion.

    Raises InterpError if nothing was executed, or if blocks or segments are missing.
    """
    executed = bag.spooled('executed_setpoints')
    if not executed:
        raise InterpError(f'{bag.path}: nothing was executed in this bag; record a run')
    if program_id:
        executed = executed.where(lambda message: message.program_id == program_id)
    last = run_id_of(executed[-1])
    names = {m.program_id: m.name for m in bag.messages('loaded_program')}
    probed = {m.program_id: m.line_number for m in bag.messages('probe_contact')}
    tables: dict[str, str] = {}
    for table in bag.messages('setup_table'):  # the first one of a run is that of its start
        tables.setdefault(table.program_id, table.text)
    states = [m for m in bag.messages('machine_state') if m.program_id == last.program_id]
    counted = max((int(state.samples) for state in states), default=-1)
    held = any(int(state.samples) == counted and ended_by_operator(state) for state in states)
    return RecordedRun(
        program_id=last.program_id,
        name=names.get(last.program_id, str(bag.path)),
        setup=tables.get(last.program_id, ''),
        machine=str(bag.parameters.get('machine_node.machine', '')),
        blocks=stream_of(bag, 'blocks', last),
        segments=stream_of(bag, 'segments', last),
        chunks=executed.where(lambda message: message.program_id == last.program_id),
        sent=SentSetpoints(bag, last.program_id),
        followed=[m for m in bag.messages('followed_spindle') if m.program_id == last.program_id],
        probed=probed.get(last.program_id, 0),
        held_at=counted if held else -1,
    )


def ended_by_operator(state: MachineState) -> bool:
    """Return whether the machine rests within a run because the operator stopped it."""
    stopped = state.state == MachineState.FAULT and state.reason == state.REASON_EMERGENCY_STOP
    return (state.state == MachineState.HELD or stopped) and not state.completed


def programs_of(bag: Bag) -> list[list[str]]:
    """Return the ids of all runs with motion in order, one list for each program.

    A program with probes has several runs; each but the last ends with the line of a probe.
    """
    probing = {
        block.program_id
        for batch in bag.messages('block_batches')
        for block in batch.blocks
        if any(function.output == ARMED for function in block.functions)
    }
    moved = (m.program_id for m in bag.messages('executed_setpoints') if len(m.sequences))
    programs: list[list[str]] = []
    goes_on = False
    for run in dict.fromkeys(moved):
        if run == JOG:
            continue  # motion by hand without a program
        programs = programs if goes_on else [*programs, []]
        programs[-1].append(run)
        goes_on = run in probing
    return programs


def stream_of(bag: Bag, stream: str, run_id: RunId) -> list[Any]:
    """Return the messages of a stream for one attempt at a run, in order, without repeats."""
    sent: Iterable[Any]
    if stream == 'blocks':
        sent = chain(bag.read(stream), *map(messages.blocks_of, bag.read('block_batches')))
    else:
        sent = chain.from_iterable(batch.segments for batch in bag.read(stream))
    found = {m.sequence: m for m in sent if run_id_of(m).same_attempt(run_id)}
    missing = next((k for k in range(len(found)) if k not in found), None)
    if missing is not None or not found:
        raise InterpError(
            f'{bag.path}: {stream[:-1]} {missing or 0} of run {run_id.program_id} is not in the '
            'bag; record from before the start'
        )
    return [found[k] for k in range(len(found))]


def write_run(run: RecordedRun, machine: Machine, directory: Path) -> dict[str, Any]:
    """Write the plan files of a recorded run to ``directory``; return the summary."""
    if next(run.setpoints(machine), None) is None:
        raise InterpError(f'{run.name}: the record ends before the program begins')
    way = ExecutedWay(run.setpoints(machine), run.period)
    settings, blocks = run.settings, messages.blocks_from(run.blocks)
    row = run.start_row(machine, blocks)
    start = StartLine(settings.from_line, settings.line_pass, run.name, row)
    finder = StartFinder(Transform.of(machine), run.flank_height, start)
    clearance = ClearanceStage.of(machine, settings, run.setup)  # a record has no certificates
    with PlanWriter(directory, machine, settings) as writer:
        functions, writer.acted = run.functions(machine)
        writer.functions = finder.functions(functions) if row > 1 else functions
        writer.blocks(own := finder.blocks(blocks))
        if clearance is not None:
            clearance.rows(own, writer.functions)
        for first in range(0, len(run.segments), BATCH):
            segments = messages.segments_from(run.segments[first : first + BATCH])
            writer.segments(finder.segments(segments))
        for path in map(finder.path, run.paths(machine)):
            if path is None:
                continue
            way.advance(float(path.s[0]), float(path.s[-1]))
            fine = refine(path, grid_points(path, way.some()))
            writer.path(fine, way.feed(fine.s[:-1]))
            if clearance is not None:
                writer.certificates(clearance.check(fine))
        for samples in run.setpoints(machine):
            writer.setpoints(finder.setpoints(samples))
        for one in run.followed:
            position = np.reshape(one.positions, (len(one.angles), -1))
            writer.followed(one.sequence, one.ramp, one.later, np.array(one.angles), position)
        if clearance is not None:
            writer.figures.clearance = clearance.summary()
            writer.stock(clearance.stock_columns())
        if row > 1:
            block = StartBlock(settings.from_line, row, 1, settings.line_pass, ())
            writer.figures.start = finder.place(block)
        writer.figures.cut, writer.figures.waits_first = run.cut, None
        return writer.finish(run.name, {}, run.overrides(), run.setup)


class ExecutedWay:
    """The executed path positions. Only those on one part of the path are in memory."""

    def __init__(self, setpoints: Iterator[Setpoints], period: float):
        self._setpoints, self._period = setpoints, period
        self._s, self._first = np.zeros(0), 0  # positions, and number of the first one

    def advance(self, first: float, last: float) -> None:
        """Advance to the part ``first`` to ``last`` [m], with two setpoints beyond each end."""
        before = max(int(np.searchsorted(self._s, first)) - 2, 0)
        parts, beyond = [self._s[before:]], int(np.count_nonzero(self._s[before:] > last))
        while beyond < 2 and (part := next(self._setpoints, None)) is not None:
            parts.append(part.s)
            beyond += int(np.count_nonzero(part.s > last))
        self._s, self._first = np.concatenate(parts), self._first + before

    def some(self) -> FloatArray:
        """Return the path position [m] of every ``GRID_EVERY``-th setpoint in this part."""
        return self._s[-self._first % GRID_EVERY :: GRID_EVERY]

    def feed(self, s: FloatArray) -> FloatArray:
        """Return the executed speed [m/s] at path positions ``s`` in this part [m]."""
        if len(self._s) < 2:
            return np.zeros(len(s))
        speed = np.gradient(self._s, self._period)
        way, first = np.unique(self._s, return_index=True)
        return np.asarray(np.interp(s, way, speed[first], right=0.0))


def grid_points(path: AxisPath, s: FloatArray) -> FloatArray:
    """Return the path positions of ``s`` [m] far enough from cell ends and from each other."""
    s = s[(s > path.s[0]) & (s < path.s[-1])]
    s = s[np.diff(s, prepend=-np.inf) > SHORTEST]
    after = np.searchsorted(path.s, s)
    inside = np.minimum(s - path.s[after - 1], path.s[after] - s) > SHORTEST
    return np.asarray(s[inside])
