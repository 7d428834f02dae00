"""
Minutes of motion by hand with real processes: random keys, lost beats, moves, holds, stops.

``PYTHONPATH=.:test/ros:test/unit python benchmarks/jog.py --minutes 10 --reactions 20``. All
executed setpoints are proven: limits and travel by differences, from rest to rest. A reaction time
is measured from the command to the first setpoint that differs from the previous motion.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter

import numpy as np
from cnc_interp_msgs.msg import Jog, MachineState
from cnc_interp_msgs.srv import MoveAxes
from operated import LIMITS, MACHINE, Bench, T
from rclpy.time import Time
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from cnc_interp.nodes import qos

NAMES = list(MACHINE.axis_names)
#: Time between beats [s].
BEAT = 0.05


class Hand:
    """An operator who presses random keys."""

    def __init__(self, seed: int):
        self.random = np.random.default_rng(seed)
        self.bench = bench = Bench()
        self.beats = bench.node.create_publisher(Jog, 'jog', qos.BEATS)
        self.mover = bench.node.create_client(MoveAxes, 'move_axes')
        bench.spin_until(
            lambda: self.beats.get_subscription_count() and self.mover.service_is_ready()
        )
        self.done: Counter[str] = Counter()

    def press(self, keys: Jog, duration: float, lost: float = 0.0) -> None:
        """Hold keys for a time [s]; a share of the beats is lost."""
        until = time.monotonic() + duration
        while time.monotonic() < until:
            if self.random.random() >= lost:
                self.beats.publish(keys)
                self.done['beats'] += 1
            else:
                self.done['beats lost'] += 1
            self.bench.spin_for(BEAT)

    def anything(self) -> None:
        """Do one random thing."""
        random, bench, kind = self.random, self.bench, self.random.random()
        if kind < 0.55:
            chosen = random.random(5) < 0.5
            shares = [float(x) for x in random.uniform(-1.0, 1.0, 5)[chosen]]
            names = [name for name, on in zip(NAMES, chosen, strict=True) if on]
            lost = float(random.choice([0.0, 0.3, 0.8]))
            self.press(Jog(axes=names, shares=shares), random.uniform(0.1, 2.0), lost)
        elif kind < 0.7:
            self.press(Jog(tool=float(random.uniform(-1.0, 1.0))), random.uniform(0.1, 1.0))
        elif kind < 0.85:
            request = MoveAxes.Request(relative=True, speed=float(random.uniform(0.1, 1.0)))
            request.axes, request.values = NAMES, random.uniform(-0.1, 0.1, 5).tolist()
            answer = self.mover.call_async(request)
            bench.spin_until(answer.done)
            self.done['moves' if answer.result().success else 'moves refused'] += 1
        elif kind < 0.92:
            bench.override.publish(Float64(data=float(random.choice([0.2, 0.6, 1.0, 1.5]))))
            self.done['override changes'] += 1
        elif bench.press('feed_hold' if kind < 0.97 else 'emergency_stop').success:
            self.done['holds' if kind < 0.97 else 'emergency stops'] += 1
            bench.spin_until(lambda: bench.next_state().resting)
            if bench.state.state == MachineState.FAULT:
                assert bench.press('reset').success
        bench.spin_for(random.uniform(0.0, 0.5))

    def rest(self) -> None:
        """Wait until the axes rest."""
        self.bench.spin_until(lambda: self.bench.next_state().state == MachineState.IDLE)

    def heard(self, attempt: int) -> np.ndarray:
        """Return the setpoints of one motion, all of them, after it has ended."""
        state = self.bench.next_state()

        def rows() -> list[np.ndarray]:
            return [
                np.reshape(m.positions, (-1, 5))
                for m in self.bench.executed
                if m.program_id == 'jog' and m.attempt == attempt
            ]

        if (state.program_id, state.attempt) == ('jog', attempt):
            self.bench.spin_until(lambda: sum(map(len, rows())) >= state.samples)
        return np.concatenate(rows()) if rows() else np.zeros((0, 5))

    def prove(self) -> None:
        """Prove everything that was executed by hand, and print the largest use of each limit."""
        state = self.bench.next_state()
        attempt = state.attempt if state.program_id == 'jog' else 0
        self.heard(attempt)
        told = [m for m in self.bench.executed if m.program_id == 'jog']
        q = np.concatenate([np.zeros((3, 5)), *(np.reshape(m.positions, (-1, 5)) for m in told)])
        q = np.concatenate([q, q[-1:].repeat(3, 0)])
        uses = [
            (np.abs(np.diff(q, order, axis=0)).max(axis=0) / T**order / limit).max()
            for order, limit in enumerate(LIMITS, start=1)
        ]
        beyond = max((MACHINE.travel[:, 0] - q).max(), (q - MACHINE.travel[:, 1]).max())
        print(f'done             {dict(self.done)}')
        print(f'setpoints        {len(q) - 6} in {max(m.attempt for m in told)} motions')
        print('largest use      ' + '  '.join(f'{use:.4%}' for use in uses))
        print(f'beyond travel    {beyond:.2g} m or rad', flush=True)
        assert max(uses) <= 1.001 and beyond <= 1e-9

    def reaction(self, what: str) -> float:
        """Measure one reaction on X at constant speed [s]."""
        bench = self.bench
        bench.override.publish(Float64(data=1.0))
        answer = self.mover.call_async(MoveAxes.Request(axes=['X'], values=[-0.1]))
        bench.spin_until(answer.done)
        bench.spin_for(0.1)
        self.rest()
        bench.executed.clear()
        self.press(Jog(axes=['X'], shares=[0.2]), 1.0)
        self.beats.publish(Jog(axes=['X'], shares=[0.2]))
        state, now = bench.state, bench.node.get_clock().now()
        if what == 'key released':
            self.beats.publish(Jog())
        elif what == 'feed hold':
            bench.buttons['feed_hold'].call_async(Trigger.Request())
        stamp = Time.from_msg(state.header.stamp, clock_type=now.clock_type)
        pressed = state.samples + (now - stamp).nanoseconds * 1e-9 / T
        self.rest()
        speed = np.diff(self.heard(state.attempt)[:, 0])
        at = int(pressed)
        changed = np.abs(speed / np.median(speed[at - 50 : at]) - 1.0) > 1e-4
        return float((at + np.flatnonzero(changed[at:])[0] + 1 - pressed) * T)

    def beginning(self) -> float:
        """Measure the time from a beat at rest to the machine's report that the axes move [s]."""
        bench = self.bench
        self.rest()
        bench.spin_for(float(self.random.uniform(0.0, 0.1)))
        bench.states.clear()
        began = bench.node.get_clock().now()
        self.beats.publish(Jog(axes=['C'], shares=[0.1]))
        moving: list[MachineState] = []
        while not moving:
            bench.spin_for(0.01)
            moving = [state for state in bench.states if state.state == MachineState.JOGGING]
        told = Time.from_msg(moving[0].header.stamp, clock_type=began.clock_type)
        took = float((told - began).nanoseconds * 1e-9)
        self.beats.publish(Jog())
        return took


def main() -> None:
    """Run what the command line asks for."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument('--minutes', type=float, default=1.0)
    options.add_argument('--reactions', type=int, default=0)
    options.add_argument('--seed', type=int, default=0)
    chosen = options.parse_args()
    hand = Hand(chosen.seed)
    try:
        until = time.monotonic() + 60.0 * chosen.minutes
        while time.monotonic() < until:
            hand.anything()
        hand.rest()
        hand.prove()
        for what in ('key released', 'last beat', 'feed hold') if chosen.reactions else ():
            times = np.array([hand.reaction(what) for _ in range(chosen.reactions)]) * 1e3
            print(f'{what:<17}median {np.median(times):.0f} ms, largest {times.max():.0f} ms')
        if chosen.reactions:
            times = np.array([hand.beginning() for _ in range(chosen.reactions)]) * 1e3
            print(
                f'key at rest      median {np.median(times):.0f} ms, largest {times.max():.0f} ms'
            )
    finally:
        hand.bench.close()


if __name__ == '__main__':
    main()
