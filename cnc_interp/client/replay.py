"""Replay of a bag: setpoints computed again from its blocks, or its messages published again."""

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from cnc_interp_msgs.msg import G1Block, SetpointChunk
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions
from rosgraph_msgs.msg import Clock

from cnc_interp.client.bag import TOPICS, Bag
from cnc_interp.client.recorded_run import stream_of
from cnc_interp.core import InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform
from cnc_interp.nodes import parameters
from cnc_interp.processes.stop_signals import stop_signals
from cnc_interp.processes.this_host import stay_on_this_host
from cnc_interp.run.motion_plan import OperatorSettings
from cnc_interp.run.path_chain import smoother_of
from cnc_interp.run.run_planner import RunPlanner
from cnc_interp.run.run_state import RunId
from cnc_interp.run.setpoints import Setpoints, Wait
from cnc_interp.settings.options import Settings
from cnc_interp.wire.path_messages import blocks_from, setpoints_from
from cnc_interp.wire.run_messages import run_id_of, settings_of_block

#: Topics that are published again. The streams are left out: a live machine would follow them.
SHOWN = ('loaded_program', 'joint_states', 'machine_state', 'executed_setpoints', '/diagnostics')
COLUMNS = ('position', 'velocity', 'acceleration', 'jerk', 'block', 's')


@dataclass(frozen=True)
class Comparison:
    run_id: RunId  #: Run, attempt and plan.
    recorded: int  #: Setpoints that were recorded.
    same: int  #: Number of setpoints, from the first on, that are the same bit for bit.
    #: Largest difference of a position [m, rad]; infinite where setpoints are missing.
    difference: float
    #: True if the feed override changed during the run; after which setpoint is unknown.
    overridden: bool

    @property
    def ok(self) -> bool:
        """True if all setpoints are the same, or if they differ because of the override."""
        return self.same == self.recorded or self.overridden

    def text(self) -> str:
        run = self.run_id
        attempt = f', attempt {run.attempt}' if run.attempt else ''
        name = f'run {run.program_id}{attempt}, plan {run.plan}: {self.recorded} setpoints'
        if self.same == self.recorded:
            return f'{name}, computed again: the same bit for bit'
        reason = 'the feed override changed' if self.overridden else 'DIFFERENT'
        return (
            f'{name}, computed again: the same up to {self.same}, then {reason}, '
            f'by {self.difference:.1e} (m, rad) at most'
        )


def compute_again(bag: Bag, machine: str | None = None) -> Iterator[Comparison]:
    """Compute the setpoints of all runs in a bag again from its blocks, and compare."""
    transform = Transform.of(Machine.load(bag.machine(machine)))
    recorded: dict[RunId, dict[int, dict[int, SetpointChunk]]] = {}
    for chunk in bag.read('setpoints'):
        plans = recorded.setdefault(RunId(chunk.program_id, chunk.attempt), {})
        plans.setdefault(chunk.plan, {}).setdefault(chunk.first_sample, chunk)
    if not recorded:
        raise InterpError(f'{bag.path}: no setpoints in this bag; record a run')
    for run_id, plans in recorded.items():
        yield from _compare_run(bag, transform, run_id, plans)


def _compare_run(
    bag: Bag, transform: Transform, run_id: RunId, plans: dict[int, dict[int, SetpointChunk]]
) -> Iterator[Comparison]:
    # A plan that joins in motion follows settings whose moment is not in the bag.
    compared = list(takewhile(lambda plan: 0 in plans[plan], sorted(plans)))
    told = [joined(bag, plans[plan]) for plan in compared]
    blocks = stream_of(bag, 'blocks', run_id)
    period = plans[min(plans)][0].period
    overrides = _overrides(bag, run_id)
    followed = overrides[0]
    # After a loss the run continued from where the machine stood when planning began again.
    goes_on = blocks[0].continue_at > 0.0
    wanted = replace(
        own_settings(bag, 'feedrate_node'),
        flank_height=blocks[0].flank_height,
        interpolation_period=period,
    )
    place = float(told[0].s[0])
    planner = RunPlanner(
        transform,
        wanted,
        float(bag.parameters.get('feedrate_node.chunk_time', 0.005)),
        told[0].position[0],
        (place if place > 0.0 else float(blocks[0].continue_at)) if goes_on else math.nan,
        followed,
        asks=run_id.attempt == 0,
    )
    settings = settings_of_block(blocks[0], own_settings(bag))
    smoother = smoother_of(transform, settings)
    stops = {m.sequence: Wait.PROGRAM_STOP for m in blocks if m.program_stop == G1Block.STOP}
    for segments in (smoother.push(blocks_from(blocks)), smoother.finish()):
        if len(segments):
            planner.push(segments, stops)
    planner.finish()
    rests = {
        m.plan: m.path_position
        for m in bag.read('machine_state')
        if run_id_of(m).same_attempt(run_id) and m.plan_over
    }
    for plan, samples in zip(compared, told, strict=True):
        if plan > 0:
            if plan - 1 not in rests:
                raise InterpError(f'{bag.path}: does not tell where plan {plan - 1} was left')
            planner.resume(rests[plan - 1], samples.position[0], followed)
        again = _all_samples(planner, len(samples))
        yield Comparison(
            replace(run_id, plan=plan),
            len(samples),
            *_compared(samples, again),
            len(set(overrides)) > 1,
        )


def own_settings(bag: Bag, node: str = 'lookahead_node') -> Settings:
    prefix = f'{node}.'
    told = {k.removeprefix(prefix): v for k, v in bag.parameters.items() if k.startswith(prefix)}
    return parameters.settings_of(told)


def joined(bag: Bag, chunks: dict[int, SetpointChunk]) -> Setpoints:
    following, parts = 0, []
    for first in sorted(chunks):
        if first != following:
            raise InterpError(f'{bag.path}: setpoints {following} to {first - 1} are not in it')
        parts.append(setpoints_from(chunks[first]))
        following = first + len(parts[-1])
    return Setpoints.concatenate(parts)


def _settings(state: Any) -> OperatorSettings:
    shares = state.rapid_override, state.spindle_override
    return OperatorSettings(state.feed_override, False, *shares)


def _overrides(bag: Bag, run_id: RunId) -> list[OperatorSettings]:
    """Return the overrides at the start of a run, and all that followed during it."""
    found, running = [OperatorSettings()], False
    for topic, _, data in bag.raw('machine_state', 'setpoints'):
        message = deserialize_message(data, TOPICS[topic][0])
        if topic == 'setpoints':
            running = running or run_id_of(message).same_attempt(run_id)
        elif running and run_id_of(message).same_attempt(run_id):
            found.append(_settings(message))
        elif not running:
            found = [_settings(message)]
    return found


def _all_samples(planner: RunPlanner, wanted: int) -> Setpoints:
    parts: list[Setpoints] = []
    plan = planner.stream.current
    while sum(map(len, parts)) < wanted and (plan.can_sample or plan.can_plan):
        parts += [chunk.samples for chunk in planner.work(plan, True, -np.inf)]
    return Setpoints.concatenate(parts)


def _compared(samples: Setpoints, again: Setpoints) -> tuple[int, float]:
    """Return how many are the same, and the largest difference of a position [m, rad]."""
    n = min(len(samples), len(again))
    same = np.ones(n, dtype=bool)
    for name in COLUMNS:
        a, b = getattr(samples, name)[:n], getattr(again, name)[:n]
        same &= (a == b).reshape(n, -1).all(axis=1)
    off = np.abs(samples.position[:n] - again.position[:n]).max(initial=0.0)
    difference = float(off) if n == len(samples) else math.inf
    return n if same.all() else int(np.argmin(same)), difference


def show_again(bag: Bag, namespace: str, rate: float, clock: bool) -> int:
    stay_on_this_host()
    context = rclpy.Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('replay', namespace=namespace, context=context)
    shown = ((topic, *TOPICS[topic]) for topic in SHOWN)
    publishers = {topic: node.create_publisher(kind, topic, qos) for topic, kind, qos in shown}
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
