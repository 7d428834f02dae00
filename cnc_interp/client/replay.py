"""Replay a bag: recompute the setpoints from its blocks, or publish its messages again."""

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from cnc_interp_msgs.msg import G1Block, SetpointChunk
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock

from cnc_interp.client.bag import TOPICS, Bag
from cnc_interp.client.recorded_run import stream_of
from cnc_interp.core import InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.nodes import parameters
from cnc_interp.nodes.seals import OWNERS, SealedPublisher
from cnc_interp.processes.stop_signals import stop_signals
from cnc_interp.processes.this_host import stay_on_this_host
from cnc_interp.run.overrides import OperatorSettings
from cnc_interp.run.path_chain import smoother_of
from cnc_interp.run.run_planner import RunPlanner
from cnc_interp.run.run_state import RunId
from cnc_interp.run.setpoints import NO_FUNCTIONS, Chunk, Setpoints, Wait
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.segments import PathSegments
from cnc_interp.wire.path_messages import (
    blocks_from,
    check_functions,
    chunk_from,
    functions_from,
    segment_messages,
    settings_of_plan,
)
from cnc_interp.wire.run_messages import run_id_of, settings_of_block

#: Topics that are published again. Streams are left out: a running machine would follow them.
SHOWN = ('loaded_program', 'joint_states', 'machine_state', 'executed_setpoints', '/diagnostics')
#: Columns of setpoints that are compared bit for bit.
COLUMNS = [name for name in Setpoints.declared if name != 'time']


@dataclass(frozen=True)
class Comparison:
    run_id: RunId  #: Run, attempt and plan.
    recorded: int  #: Number of recorded setpoints.
    #: How many leading setpoints agree bit for bit; their stop tails agree, too.
    same: int
    #: Largest difference between positions [m, rad]; infinite if setpoints are missing.
    difference: float
    #: Whether the plan joined in motion; the bag does not contain the time of its request.
    joins: bool = False
    segment: int = -1  #: The first segment of the run that differs, or -1.

    @property
    def ok(self) -> bool:
        """Whether all setpoints that can be recomputed agree."""
        return (self.joins or self.same == self.recorded) and self.segment < 0

    def text(self) -> str:
        run = self.run_id
        attempt = f', attempt {run.attempt}' if run.attempt else ''
        name = f'run {run.program_id}{attempt}, plan {run.plan}: {self.recorded} setpoints'
        if self.segment >= 0:
            return f'{name}: segment {self.segment}, computed again, is DIFFERENT'
        if self.joins:
            return f'{name}: not computed again, because the plan joined another one in motion'
        if self.same == self.recorded:
            return f'{name}, computed again: the same bit for bit'
        return (
            f'{name}, computed again: the same up to {self.same}, then DIFFERENT, '
            f'by {self.difference:.1e} (m, rad) at most'
        )


def compute_again(bag: Bag, machine: str | None = None) -> Iterator[Comparison]:
    """Recompute the setpoints of all runs in a bag from blocks; yield a comparison per plan."""
    transform = Transform.of(Machine.load(bag.machine(machine)))
    recorded: dict[RunId, dict[int, dict[int, SetpointChunk]]] = {}
    for chunk in bag.messages('setpoints'):
        plans = recorded.setdefault(RunId(chunk.program_id, chunk.attempt), {})
        plans.setdefault(chunk.plan, {}).setdefault(chunk.first_sample, chunk)
    if not recorded:
        raise InterpError(f'{bag.path}: no setpoints in this bag; record a run')
    for run_id, plans in recorded.items():
        yield from Repetition(bag, transform, run_id, plans).compare()


Chunks = dict[int, SetpointChunk]  #: Number of the first setpoint -> chunk of a plan.


class Repetition:
    """One attempt at a run, planned again from the recorded blocks."""

    def __init__(self, bag: Bag, transform: Transform, run_id: RunId, plans: dict[int, Chunks]):
        self._bag, self._transform, self._run_id = bag, transform, run_id
        self._plans = plans
        self._blocks = stream_of(bag, 'blocks', run_id)
        smoother = smoother_of(transform, settings_of_block(self._blocks[0], own_settings(bag)))
        parts = smoother.push(blocks_from(self._blocks)), smoother.finish()
        self._segments = [part for part in parts if len(part)]

    def compare(self) -> Iterator[Comparison]:
        segment, planner = self._wrong_segment(), None
        rests = {
            m.plan: m.path_position
            for m in self._bag.messages('machine_state')
            if run_id_of(m).same_attempt(self._run_id) and m.plan_over
        }
        for number in sorted(self._plans):
            chunks, run_id = self._plans[number], replace(self._run_id, plan=number)
            if any(chunk.joins for chunk in chunks.values()):
                count = sum(len(chunk.sequences) for chunk in chunks.values())
                yield Comparison(run_id, count, 0, math.inf, True, segment)
                continue
            recorded = joined(self._bag, chunks)
            settings = settings_of_plan(chunks[0])
            if not number:
                planner = self._planner(recorded[0], settings)
            elif planner is None or number - 1 not in rests:
                text = f'the record does not show where plan {number - 1} stopped'
                raise InterpError(f'{self._bag.path}: {text}')
            else:
                planner.resume(rests[number - 1], recorded[0].samples.position[0], settings)
            same, difference = _compared(recorded, _all_chunks(planner, recorded))
            count = sum(len(chunk.samples) for chunk in recorded)
            yield Comparison(run_id, count, same, difference, False, segment)
            segment = -1

    def _wrong_segment(self) -> int:
        """Return the first recorded segment that differs from the recomputed one, or -1."""
        height = self._blocks[0].flank_height
        again = segment_messages(
            PathSegments.concatenate(self._segments), self._run_id, 0, height, end=True
        )
        recorded = stream_of(self._bag, 'segments', self._run_id)
        for k, (one, other) in enumerate(zip(recorded, again, strict=False)):
            for name in ('continue_at', 'program_stop', 'functions', 'checksum'):
                setattr(other, name, getattr(one, name))  # not of the smoother
            if repr(one) != repr(other):  # some contain NaN, which equals nothing
                return k
        return -1 if len(recorded) == len(again) else min(len(recorded), len(again))

    def _planner(self, begins: Chunk, followed: OperatorSettings) -> RunPlanner:
        first, bag, signals = self._blocks[0], self._bag, self._transform.machine.signals
        # After a loss the run continued from where the machine stood when planning began again.
        goes_on, place = first.continue_at > 0.0, float(begins.samples.s[0])
        wanted = replace(
            own_settings(bag, 'feedrate_node'),
            flank_height=first.flank_height,
            interpolation_period=self._plans[0][0].period,
        )
        planner = RunPlanner(
            self._transform,
            wanted,
            float(bag.parameters.get('feedrate_node.chunk_time', 0.005)),
            begins.samples.position[0],
            (place if place > 0.0 else float(first.continue_at)) if goes_on else math.nan,
            followed,
            asks=self._run_id.attempt == 0,
        )
        functions = [function for block in self._blocks for function in block.functions]
        check_functions('blocks', functions, signals)
        stops, given = self._stops(), functions_from(functions)
        for segments in self._segments:
            planner.push(segments, stops, given)
            given = NO_FUNCTIONS
        planner.finish()
        return planner

    def _stops(self) -> dict[int, Wait]:
        """Return the blocks with M0, and those with M1 at which the recorded setpoints stop."""
        waits = {G1Block.STOP: Wait.PROGRAM_STOP}
        optional = {
            chunk.sequences[-1]
            for chunks in self._plans.values()
            for chunk in chunks.values()
            if chunk.wait == SetpointChunk.OPTIONAL_STOP
        }
        return {
            m.sequence: waits.get(m.program_stop, Wait.OPTIONAL_STOP)
            for m in self._blocks
            if m.program_stop == G1Block.STOP
            or (m.program_stop == G1Block.OPTIONAL_STOP and m.sequence in optional)
        }


def own_settings(bag: Bag, node: str = 'lookahead_node') -> Settings:
    prefix = f'{node}.'
    told = {k.removeprefix(prefix): v for k, v in bag.parameters.items() if k.startswith(prefix)}
    return parameters.settings_of(told)


def joined(bag: Bag, chunks: Chunks) -> list[Chunk]:
    following, parts = 0, []
    for first in sorted(chunks):
        if first != following:
            raise InterpError(f'{bag.path}: setpoints {following} to {first - 1} are not in it')
        parts.append(chunk_from(chunks[first]))
        following = first + len(parts[-1].samples)
    return parts


def _all_chunks(planner: RunPlanner, recorded: list[Chunk]) -> list[Chunk]:
    parts: list[Chunk] = []
    plan = planner.stream.current
    while len(parts) < len(recorded) and (plan.can_sample or plan.can_plan):
        parts += [planner.with_lines(chunk) for chunk in planner.work(plan, True, -np.inf)]
    return parts


def _compared(recorded: list[Chunk], again: list[Chunk]) -> tuple[int, float]:
    """Return how many leading setpoints are equal, and the largest position difference.

    If a stop tail or a wait differs, the last setpoint before it counts as different.
    """
    same, difference, alike = 0, 0.0, True
    for chunk, other in zip(recorded, again, strict=False):
        for part, of_other in ((chunk.samples, other.samples), (chunk.tail, other.tail)):
            n = min(len(part), len(of_other))
            off = np.abs(part.position[:n] - of_other.position[:n]).max(initial=0.0)
            difference = max(difference, float(off) if len(part) == len(of_other) else math.inf)
        if alike:
            count = _same_rows(chunk.samples, other.samples)
            alike = count == len(chunk.samples) == len(other.samples)
            if alike:
                tails = _same_rows(chunk.tail, other.tail), len(chunk.tail), len(other.tail)
                alike = len(set(tails)) == 1 and chunk.wait is other.wait
                count -= not alike
            same += count
    return same, difference if len(again) >= len(recorded) else math.inf


def _same_rows(samples: Setpoints, again: Setpoints) -> int:
    n = min(len(samples), len(again))
    same = np.ones(n, dtype=bool)
    for name in COLUMNS:
        a, b = getattr(samples, name)[:n], getattr(again, name)[:n]
        same &= (a == b).reshape(n, math.prod(a.shape[1:])).all(axis=1)
    return n if same.all() else int(np.argmin(same))


def show_again(bag: Bag, namespace: str, rate: float, clock: bool) -> int:
    stay_on_this_host()
    context = rclpy.Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('replay', namespace=namespace, context=context)
    publishers: dict[str, Any] = {}
    for topic in SHOWN:
        make = partial(SealedPublisher, node) if topic in OWNERS else node.create_publisher
        publishers[topic] = make(TOPICS[topic][0], topic, TOPICS[topic][1])
    clocks = node.create_publisher(Clock, '/clock', 10) if clock else None
    count, first, begun = 0, 0, time.monotonic()
    try:
        with stop_signals() as stop:
            for topic, stamp, data in bag.raw(*SHOWN):
                first = first or stamp
                due = begun + (stamp - first) * 1e-9 / rate
                while not stop and (wait := due - time.monotonic()) > 0.0:
                    time.sleep(min(wait, 0.1))
                if stop:
                    break
                if clocks is not None:
                    clocks.publish(Clock(clock=Time(sec=stamp // 10**9, nanosec=stamp % 10**9)))
                publishers[topic].publish(data)
                count += 1
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)
    return count
