"""
Record the bags of these tests anew: ``PYTHONPATH=test/ros python test/replay/record.py``.

To be done where planning has changed on purpose; look at the difference first
(``cnc-interp replay BAG --compare``). The blocks go to the look-ahead one by one, on ``blocks``,
so that many messages of a short program can be bad.
"""

import shutil
from pathlib import Path

import numpy as np
from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import G1Block, G1BlockBatch, MachineState
from nodes_under_test import NodesUnderTest
from relay import ARGUMENTS, SENT, Relay
from std_msgs.msg import Float64

from cnc_interp.client.recorder import Recorder
from cnc_interp.nodes import qos
from cnc_interp.nodes.streams import sealed
from cnc_interp.processes.node_processes import NODES

HERE = Path(__file__).resolve().parent
#: Chunks as long as they may be: fewer tails, smaller bags.
PARAMETERS = {'feedrate_node': {'chunk_time': 0.1}}
PROGRAM = """G21 G90 G94
TRAORI
G0 X0 Y0 Z0 A10 C0
G1 X6 A12 C5 F3000
G1 Y6 A14 C20
G1 X0 Y8 A12 C30
M30
"""
LONG = """G21 G90 G94
TRAORI
G0 X0 Y0 Z0 A10 C0
G1 X30 A12 C10 F1200
G1 Y20 A14 C20
G1 X0 Y25
M30
"""
#: Feed overrides of the operator, and the places where they are set [m].
OVERRIDES = ((0.01, 0.5), (0.02, 1.3), (0.05, 1.0))


class Session:
    """Nodes, recorder, and a relay that may be bad, until closed."""

    def __init__(self, bag, share=0.0, seed=0, period=1e-3):
        shutil.rmtree(bag, ignore_errors=True)
        arguments = {'program_node': ARGUMENTS['program_node']}
        parameters = {name: {'interpolation_period': period} for name in NODES}
        parameters['feedrate_node'] |= PARAMETERS['feedrate_node']
        self.nodes = NodesUnderTest(parameters, arguments)
        self.relay = Relay(
            self.nodes.namespace,
            self.nodes.domain,
            np.random.default_rng(seed),
            share,
            ['blocks'],
        )
        self.nodes.node.destroy_publisher(self.nodes.blocks)  # the relay is the only one there
        self.one_by_one = self.nodes.node.create_publisher(G1Block, f'{SENT}blocks', qos.STREAM)
        self.nodes.node.create_subscription(
            G1BlockBatch, f'{SENT}block_batches', self.divide, qos.STREAM
        )
        self.recorder = Recorder(self.nodes.node, bag)
        self.nodes.spin_until(
            lambda: (
                self.recorder.ready()
                and self.relay.heard_by(2)
                and self.one_by_one.get_subscription_count() == 1
            )
        )

    def divide(self, batch):
        for block in batch.blocks:
            self.one_by_one.publish(sealed(block))

    def run(self, hold=False):
        handle = self.nodes.start(text=PROGRAM)
        if hold:
            self.nodes.spin_until(
                lambda: (
                    self.nodes.peers.state.path_position > 0.004
                    and self.nodes.peers.state.approach_samples
                )
            )
            self.nodes.press('feed_hold')
            self.nodes.spin_until(
                lambda: (
                    self.nodes.peers.state.state == MachineState.HELD
                    or self.nodes.peers.state.completed
                )
            )
            if self.nodes.peers.state.completed:
                return 1  # the hold came too late
            self.nodes.spin_until(lambda: self.nodes.peers.state.plan == 1)
            self.nodes.press('cycle_start')
        result = self.nodes.result_of(handle)
        assert result.code == RunProgram.Result.SUCCEEDED, result.message
        self.nodes.spin_until(self.recorder.complete)
        return result.starvations

    def run_at(self, overrides):
        publisher = self.nodes.node.create_publisher(Float64, 'feed_override', qos.OVERRIDE)
        self.nodes.spin_until(lambda: publisher.get_subscription_count() == 1)
        handle = self.nodes.start(text=LONG)
        for place, share in overrides:
            self.nodes.spin_until(
                lambda place=place: (
                    self.nodes.peers.state.path_position > place
                    and self.nodes.peers.state.approach_samples
                )
            )
            publisher.publish(Float64(data=share))
        result = self.nodes.result_of(handle)
        assert result.code == RunProgram.Result.SUCCEEDED, result.message
        self.nodes.spin_until(self.recorder.complete)
        return result.starvations

    def close(self):
        self.recorder.close()
        self.relay.close()
        self.nodes.close()


def main():
    record(HERE / 'held', 0.0, lambda session: session.run(hold=True))
    record(HERE / 'faulty', 0.6, Session.run)
    record(HERE / 'overridden', 0.0, lambda session: session.run_at(OVERRIDES), 4e-3)


def record(bag, share, run, period=1e-3):
    """Record until a run was held and never without setpoints: what then comes is chance."""
    for seed in range(20):
        session = Session(bag, share, seed, period)
        starved = run(session)
        print(bag.name, session.relay.counts, f'{starved} times starved or not held')
        session.close()
        if not starved:
            return
    raise SystemExit(f'{bag.name}: the computer is too busy')


if __name__ == '__main__':
    main()
