"""
Holds, override changes, kills and bad messages at random moments, with real processes.

``PYTHONPATH=.:test/ros:test/unit python benchmarks/operation.py --reactions 20 --holds 200
--overrides 200 --kills 50 --messages 1000 --foreign 1000``; ``test/ros`` runs the same in small
numbers. After every run all executed setpoints are proven: limits by differences, the path by its
own evaluation, end of the program reached, blocks sent = executed. A reaction time is measured
from the command to the first setpoint that differs from the previous motion.

``--foreign``: another node repeats messages of the nodes: unchanged, with one value changed, and
with the next sequence number, always with correct checksums. Every run must complete within the
limits and on the path, and its result must name this node with each topic on which it published.
"""

from __future__ import annotations

import argparse
import math
import os
import signal
import sys
import time
from collections import Counter, deque
from functools import partial
from typing import Any

import numpy as np
from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import (
    G1Block,
    G1BlockBatch,
    MachineState,
    PathSegmentBatch,
    SetpointChunk,
    StreamStatus,
)
from operated import Bench, T, path_of, waves
from rclpy.time import Time
from relay import ARGUMENTS, Relay
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from cnc_interp.nodes import qos
from cnc_interp.nodes.seals import place_of
from cnc_interp.nodes.streams import opened, sealed
from cnc_interp.wire.seals import SIZE, opened_seal

#: Blocks of the program in which things happen, twice; its corners and turns take a minute.
WAVES = 120
#: A line at constant speed, for reaction times [mm], and its feedrate [mm/min].
LINE, FEED = 150, 1200
#: Nodes that are killed and frozen: all but the machine.
LOST = ('feedrate_node', 'lookahead_node', 'program_node')
#: What the nodes of a run say to each other.
SAID = {
    'blocks': (G1Block, qos.STREAM),
    'block_batches': (G1BlockBatch, qos.STREAM),
    'segments': (PathSegmentBatch, qos.STREAM),
    'setpoints': (SetpointChunk, qos.STREAM),
    'stream_status': (StreamStatus, qos.STATUS),
    'machine_state': (MachineState, qos.STATE),
}


def straight() -> str:
    """Program of one long line at constant speed."""
    return f'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A15 C30\nG1 X{LINE} F{FEED}\nM30\n'


class Trial:
    """Random events on one bench."""

    def __init__(self, seed: int, arguments: dict[str, list[str]] | None = None):
        self.random = np.random.default_rng(seed)
        self.bench = Bench(arguments=arguments)
        self.lost_in = -1  # the attempt in which a node was killed last

    def pause(self, most: float) -> None:
        """Let a random time pass."""
        until = time.monotonic() + self.random.uniform(0.05, most)
        self.bench.spin_until(lambda: time.monotonic() > until)

    def wait_in_program(self) -> bool:
        """Wait until the program moves, or is over; tells whether it moves."""
        bench = self.bench
        bench.spin_until(
            lambda: (
                bench.state.completed
                or (bench.state.state == MachineState.RUNNING and bench.state.approach_samples > 0)
            )
        )
        return not bench.state.completed

    def holds(self, count: int) -> None:
        """Hold and go on at random moments."""
        done = runs = starved = 0
        while done < count:
            handle = self.bench.begin(waves(WAVES))
            self.bench.spin_until(lambda: not self.bench.state.completed)
            while done < count and self.wait_in_program():
                self.pause(0.6)
                if not self.bench.press('feed_hold').success or not self.held():
                    break
                done += 1
                assert self.bench.press('cycle_start').success
            starved += self.finish(handle).starvations
            runs += 1
            say('holds', done, runs, starved)

    def held(self) -> bool:
        """Wait until the machine holds; False where the program ended first."""
        ends = (MachineState.HELD, MachineState.IDLE)
        self.bench.spin_until(lambda: self.bench.state.state in ends)
        return bool(self.bench.state.state == MachineState.HELD)

    def overrides(self, count: int) -> None:
        """Change the override at random moments."""
        done = runs = starved = 0
        while done < count:
            handle = self.bench.begin(waves(WAVES))
            self.bench.spin_until(lambda: not self.bench.state.completed)
            while done < count and self.wait_in_program():
                self.bench.override.publish(Float64(data=float(self.random.uniform(0.0, 1.5))))
                done += 1
                self.pause(0.5)
            self.bench.override.publish(Float64(data=1.0))
            starved += self.finish(handle).starvations
            runs += 1
            say('override changes', done, runs, starved)

    def kills(self, count: int) -> None:
        """Kill or freeze a node at random moments, bring it back, go on."""
        bench, done, runs, starved = self.bench, 0, 0, 0
        ways = [(what, node) for what in (self.kill, self.freeze) for node in LOST]
        while done < count:
            handle = bench.begin(waves(WAVES))
            bench.spin_until(lambda: not bench.state.completed)
            known, self.lost_in = True, -1
            while done < count and known and self.wait_in_program():
                self.pause(1.5)
                lose, node = ways[int(self.random.integers(len(ways)))]
                known = lose(node)
                done += 1
                say(f'{lose.__name__} {node}', done, runs, starved)
            if known:
                bench.spin_until(lambda: not bench.peers.missing(time.monotonic(), 1.0))
                starved += self.finish(handle).starvations
            runs += 1
            say('kills', done, runs, starved)

    def freeze(self, node: str) -> bool:
        """Stop a process for a while; the cycle must go on by itself."""
        process = self.bench.children.nodes[node].process.pid
        assert process is not None
        os.kill(process, signal.SIGSTOP)
        self.pause(2.5)
        os.kill(process, signal.SIGCONT)
        # After a node killed before, the machine may still execute what it had.
        return self.moves_on(press=self.bench.state.attempt == self.lost_in)

    def kill(self, node: str) -> bool:
        """Kill a process, start it again, go on; False where nobody knows the run any more."""
        bench = self.bench
        self.lost_in = bench.state.attempt
        bench.kill(node)
        # Without a hold what is on its way would be executed first, here to the end.
        if node != 'feedrate_node' and self.random.uniform() < 0.8:
            bench.press('feed_hold')
        bench.spin_until(
            lambda: (
                bench.state.completed
                or bench.state.plan_over
                or bench.state.state == MachineState.HELD
                or (
                    node == 'feedrate_node'
                    and bench.state.waits_for == MachineState.WAITS_FOR_SETPOINTS
                )
            )
        )
        if node == 'program_node':
            self.stop()
            bench.recorded()
        bench.children.revive()
        bench.watching = True
        if node == 'program_node':
            if not bench.state.completed:
                assert bench.press('reset').success
            bench.until_state(MachineState.IDLE)
            return False
        return self.moves_on(press=True)

    def stop(self) -> None:
        """Hold, also a machine that rests: a starved one goes on with what still comes."""
        if not self.bench.state.completed:
            self.bench.press('feed_hold')
            self.held()

    def moves_on(self, press: bool = False) -> bool:
        """Wait until the tool advances, or has reached the end; press cycle_start as needed."""
        bench = self.bench
        bench.spin_until(lambda: not bench.peers.missing(time.monotonic(), 1.0))
        at, pressed = bench.next_state().path_position, -math.inf

        def moves() -> bool:
            nonlocal pressed
            state = bench.state
            rests = state.state == MachineState.HELD or (
                state.state == MachineState.STARVED and state.plan_over
            )
            if press and rests and not state.start_wanted and time.monotonic() - pressed > 1.0:
                bench.press('cycle_start')
                pressed = time.monotonic()
            return bool(state.completed or state.path_position > at)

        bench.spin_until(moves)
        return True

    def finish(self, handle: Any) -> Any:
        """Wait for the end; prove what was executed."""
        result, _ = self.bench.finish(handle, patience=600.0)
        return result

    def reactions(self, command: str, count: int) -> list[float]:
        """Measure the reaction to a hold or an override on a line at constant speed [s]."""
        found: list[float] = []
        bench = self.bench
        while len(found) < count:
            handle = bench.begin(straight())
            bench.spin_until(lambda: not bench.state.completed)
            bench.until_at(0.03)
            self.pause(0.5)
            state, now = bench.state, bench.node.get_clock().now()
            if command == 'hold':
                bench.buttons['feed_hold'].call_async(Trigger.Request())
            else:
                bench.override.publish(Float64(data=0.4))
            stamp = Time.from_msg(state.header.stamp, clock_type=now.clock_type)
            pressed = state.samples + (now - stamp).nanoseconds * 1e-9 / T
            if command == 'hold':
                assert self.held()
                bench.press('cycle_start')
            else:
                self.pause(0.6)
                bench.override.publish(Float64(data=1.0))
            bench.finish(handle)
            _, s = bench.recorded()
            speed = np.diff(s) / T
            at = int(pressed)
            changed = np.abs(speed / np.median(speed[at - 50 : at]) - 1.0) > 1e-4
            after = np.flatnonzero(changed[at:])
            found.append((at + after[0] + 1 - pressed) * T)
        return found

    def close(self) -> None:
        """End the processes."""
        self.bench.close()


def messages(count: int, seed: int) -> None:
    """Run over a bad line until so many messages were spoilt, lost, repeated or reordered."""
    trial = Trial(seed, ARGUMENTS)
    relay = Relay(trial.bench.namespace, trial.bench.domain, trial.random, 0.05)
    try:
        runs = starved = 0
        while relay.faults < count:
            starved += trial.finish(trial.bench.begin(waves(WAVES))).starvations
            runs += 1
            print(
                f'messages         {relay.counts}, {relay.passed} passed on untouched; {runs} '
                f'runs, {starved} times starved; all proven',
                flush=True,
            )
    finally:
        relay.close()
        trial.close()


#: What a stranger does to a message that it heard.
WAYS = ('again', 'changed', 'next')


class Stranger:
    """A node that says again what it heard: unchanged, changed, or as the next message."""

    def __init__(self, bench: Bench, random: np.random.Generator):
        self.bench, self.random = bench, random
        self.heard: dict[str, deque[bytes]] = {topic: deque(maxlen=1) for topic in SAID}
        self.publishers: dict[str, Any] = {}
        for topic, (kind, profile) in SAID.items():
            bench.node.create_subscription(
                kind, topic, partial(self.hear, topic), profile, raw=True
            )
        bench.be_known()

    def hear(self, topic: str, data: bytes) -> None:
        """Keep what the nodes said; its own messages have no seal."""
        if opened_seal(place_of(self.bench.node, topic), data) is not None:
            self.heard[topic].append(data)

    def come(self) -> None:
        """Begin to speak in a run."""
        for topic, (kind, profile) in SAID.items():
            self.heard[topic].clear()
            self.publishers[topic] = self.bench.node.create_publisher(kind, topic, profile)

    def speak(self) -> str:
        """Send one message; return on which topic, or nothing if none was heard."""
        heard = [topic for topic, messages in self.heard.items() if messages]
        if not heard:
            return ''
        source = topic = str(self.random.choice(heard))
        data, way = bytes(self.heard[source][0]), str(self.random.choice(WAYS))
        message = opened(data[:-SIZE], SAID[source][0])
        if source == 'block_batches' and self.random.random() < 0.3:
            topic, message = 'blocks', message.blocks[-1]
        if way == 'again' and topic == source:
            self.publishers[topic].publish(data)
            return topic
        self.change(message) if way == 'changed' else follow(message)
        is_sealed = hasattr(message, 'checksum')
        self.publishers[topic].publish(sealed(message) if is_sealed else message)
        return topic

    def change(self, message: Any) -> str:
        """Change one value of a message, or of one inside."""
        fields = message.get_fields_and_field_types()
        names = [name for name in fields if name not in ('checksum', 'header')]
        name = str(self.random.choice(names))
        value = getattr(message, name)
        if hasattr(value, 'get_fields_and_field_types'):
            return f'{name}.{self.change(value)}'
        if isinstance(value, str):
            setattr(message, name, value + 'x')
        elif isinstance(value, bool):
            setattr(message, name, not value)
        elif isinstance(value, int):
            step = int(self.random.choice([-100, -1, 1, 100]))
            setattr(message, name, max(0, value + step) % 256)
        elif isinstance(value, float):
            setattr(message, name, self.other(value))
        elif len(value) > 0:
            at = int(self.random.integers(len(value)))
            if hasattr(value[at], 'get_fields_and_field_types'):
                return f'{name}[{at}].{self.change(value[at])}'
            if isinstance(value[at], str):
                value[at] += 'x'
            elif isinstance(value[at], bool):
                value[at] = not value[at]
            else:
                number = self.other(float(value[at]))
                value[at] = number if isinstance(value[at], float) else int(abs(number))
        return name

    def other(self, value: float) -> float:
        """Return another number: near, far, of the other sign or none."""
        return float(self.random.choice([value + 1e-4, value + 1.0, -value, 2.0 * value]))

    def leave(self) -> None:
        """Go, so that the next run begins alone."""
        for publisher in self.publishers.values():
            self.bench.node.destroy_publisher(publisher)


def follow(message: Any) -> None:
    """Make a message of a stream the next one, 1 mm off; or a state that the run is over."""
    if isinstance(message, G1Block):
        message.sequence, message.tip = message.sequence + 1, message.tip + 1e-3
    elif isinstance(message, G1BlockBatch):
        for block in message.blocks:
            block.sequence += len(message.blocks)
            block.tip = block.tip + 1e-3
    elif isinstance(message, PathSegmentBatch):
        for segment in message.segments:
            segment.sequence += len(message.segments)
            segment.bottom.control_points[0] += 1e-3
    elif isinstance(message, SetpointChunk):
        message.first_sample += len(message.sequences)
    elif isinstance(message, StreamStatus):
        message.next_sequence += 1
    else:
        message.completed = message.plan_over = True


def foreign(count: int, seed: int) -> None:
    """Speak as the nodes do in the middle of runs until so many foreign messages were sent."""
    trial = Trial(seed)
    bench, done, runs = trial.bench, 0, 0
    bench.node.destroy_publisher(bench.blocks)
    stranger, sent = Stranger(bench, trial.random), Counter[str]()
    try:
        while done < count:
            handle = bench.begin(waves(24))
            bench.spin_until(lambda: not bench.state.completed)
            stranger.come()
            wanted, said = handle.get_result_async(), Counter[str]()
            while done + said.total() < count and not wanted.done():
                trial.pause(0.06)
                if topic := stranger.speak():
                    said[topic] += 1
            bench.spin_until(wanted.done)
            stranger.leave()
            result = wanted.result().result
            assert result.code == RunProgram.Result.SUCCEEDED, (said, result.message)
            unnamed = [topic for topic in said if f'{topic} from ' not in result.message]
            # Of the last ones the run may not have heard before it ended.
            assert not [topic for topic in unnamed if said[topic] > 2], (said, result.message)
            _, s = bench.proven(bench.heard_whole(), path_of(bench.text))
            assert abs(s[-1] - path_of(bench.text).s[-1]) < 1e-12
            done += said.total()
            sent += said
            bench.tidy()
            runs += 1
            say(f'foreign, {len(unnamed)} unnamed', done, runs, 0)
    finally:
        trial.close()
    print(*sent.items(), sep='\n')


def say(what: str, done: int, runs: int, starved: int) -> None:
    """Tell how far it has come."""
    print(f'{what:<24}{done} in {runs} proven runs, {starved} times starved', flush=True)


def main() -> int:
    """Run what is asked for."""
    asked = argparse.ArgumentParser(description=__doc__)
    for name in ('holds', 'overrides', 'kills', 'messages', 'foreign', 'reactions'):
        asked.add_argument(f'--{name}', type=int, default=0)
    asked.add_argument('--seed', type=int, default=1)
    options = asked.parse_args()
    if options.holds or options.overrides or options.kills or options.reactions:
        trial = Trial(options.seed)
        try:
            for command in ('hold', 'override') if options.reactions else ():
                times = np.array(trial.reactions(command, options.reactions)) * 1e3
                print(
                    f'reaction to {command:<9} median {np.median(times):.0f} ms, largest '
                    f'{times.max():.0f} ms, {len(times)} times',
                    flush=True,
                )
            trial.holds(options.holds)
            trial.overrides(options.overrides)
            trial.kills(options.kills)
        finally:
            trial.close()
    if options.messages:
        messages(options.messages, options.seed)
    if options.foreign:
        foreign(options.foreign, options.seed)
    return 0


if __name__ == '__main__':
    sys.exit(main())
