"""The interface package: created, serialised, sent between two real nodes."""

import math
import time

import numpy as np
import pytest

rclpy = pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.action import RunProgram  # noqa: E402
from cnc_interp_msgs.msg import (  # noqa: E402
    BSpline,
    G1Block,
    G1BlockBatch,
    MachineState,
    PathSegment,
    SetpointChunk,
    StreamStatus,
)
from nodes_under_test import DOMAIN  # noqa: E402
from rclpy.action import ActionClient, ActionServer  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from rclpy.serialization import deserialize_message, serialize_message  # noqa: E402

PATIENCE = 120.0  # [s]; a bound for a machine at full load, not a timing


def block():
    return G1Block(
        program_id='run-1',
        sequence=7,
        line_number=12,
        tip=[0.01, -0.02, 0.003],
        axis=[0.0, 0.6, 0.8],
        rotary=[math.nan, 4.0 * math.pi],
        feedrate=math.inf,
        duration=math.nan,
        rapid=True,
        contour_tolerance=20e-6,
        orientation_tolerance=30e-6,
        flank_height=0.03,
        end_of_program=True,
    )


def batch():
    return G1BlockBatch(blocks=[block(), G1Block(sequence=8)])


def segment():
    knots = [0.0] * 4 + [1.0] * 4
    curve = BSpline(degree=3, dimension=3, knots=knots, control_points=np.linspace(0.0, 0.1, 12))
    return PathSegment(
        program_id='run-1',
        sequence=3,
        kind=PathSegment.CORNER,
        bottom=curve,
        top=curve,
        parametrization=BSpline(
            degree=3, dimension=1, knots=knots, control_points=[0, 0.2, 0.9, 1]
        ),
        flank_height=0.03,
        feedrate=[0.05, math.inf],
        first_block=4,
        last_block=5,
        line_number=21,
    )


def chunk(samples=10, axes=5, tail=300):
    rng = np.random.default_rng(1)
    return SetpointChunk(
        program_id='run-1',
        first_sample=2**40,
        period=0.001,
        axis_count=axes,
        positions=rng.normal(size=samples * axes),
        velocities=rng.normal(size=samples * axes),
        accelerations=rng.normal(size=samples * axes),
        jerks=rng.normal(size=samples * axes),
        sequences=[2**33 + i for i in range(samples)],
        line_numbers=list(range(samples)),
        path_positions=np.linspace(0.0, 0.01, samples),
        tail_positions=rng.normal(size=tail * axes),
        tail_velocities=rng.normal(size=tail * axes),
        tail_accelerations=rng.normal(size=tail * axes),
        tail_sequences=[1] * tail,
        tail_line_numbers=[2] * tail,
        tail_path_positions=np.linspace(0.01, 0.02, tail),
    )


def state():
    return MachineState(
        state=MachineState.STARVED,
        program_id='run-1',
        samples=1234,
        positions=[0.1, 0.2, 0.3, 0.4, 0.5],
        tip=[1.0, 2.0, 3.0],
        jerk_use=[0.99, 1.0, 0.5, 0.25, 0.0],
        message='no setpoints for 0.1 s: start the feedrate node again',
    )


def status():
    return StreamStatus(program_id='run-1', stream='blocks', next_sequence=5, window_limit=2000)


def fields_of(message):
    """Flatten a message to comparable values; NaN compares equal."""
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if name == 'blocks':
            for i, inner in enumerate(value):
                yield from ((f'{name}[{i}].{field}', v) for field, v in fields_of(inner))
        elif hasattr(value, 'get_fields_and_field_types'):
            yield from ((f'{name}.{inner}', v) for inner, v in fields_of(value))
        else:
            yield name, repr(value.tolist() if hasattr(value, 'tolist') else value)


@pytest.fixture(scope='module')
def nodes():
    """Two nodes of their own context, in a domain that no other test shares."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    sender = rclpy.create_node('sender', context=context)
    receiver = rclpy.create_node('receiver', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(sender)
    executor.add_node(receiver)
    yield sender, receiver, executor
    executor.shutdown()
    sender.destroy_node()
    receiver.destroy_node()
    rclpy.shutdown(context=context)


def spin_until(executor, done):
    deadline = time.monotonic() + PATIENCE
    while not done() and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.05)
    assert done()


@pytest.mark.parametrize('make', [block, batch, segment, chunk, state, status])
def test_serialised_and_back(make):
    sent = make()
    back = deserialize_message(serialize_message(sent), type(sent))
    assert dict(fields_of(back)) == dict(fields_of(sent))


@pytest.mark.parametrize('make', [block, batch, segment, chunk, state, status])
def test_sent_between_two_nodes(nodes, make):
    sender, receiver, executor = nodes
    sent, received = make(), []
    qos = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
    topic = f'test_{make.__name__}'
    subscription = receiver.create_subscription(type(sent), topic, received.append, qos)
    publisher = sender.create_publisher(type(sent), topic, qos)
    spin_until(executor, lambda: publisher.get_subscription_count() == 1)
    for _ in range(20):
        publisher.publish(sent)
    spin_until(executor, lambda: len(received) == 20)
    assert all(dict(fields_of(message)) == dict(fields_of(sent)) for message in received)
    sender.destroy_publisher(publisher)
    receiver.destroy_subscription(subscription)


def test_action_runs_to_its_result(nodes):
    sender, receiver, executor = nodes
    progress = []

    def execute(goal):
        goal.publish_feedback(RunProgram.Feedback(line_number=3, progress=0.5))
        goal.succeed()
        return RunProgram.Result(
            code=RunProgram.Result.SUCCEEDED, message=goal.request.program, cycle_time=1.5
        )

    server = ActionServer(receiver, RunProgram, 'test_run_program', execute)
    client = ActionClient(sender, RunProgram, 'test_run_program')
    spin_until(executor, client.server_is_ready)
    accepted = client.send_goal_async(
        RunProgram.Goal(program='part.ngc'),
        feedback_callback=lambda message: progress.append(message.feedback.progress),
    )
    spin_until(executor, accepted.done)
    result = accepted.result().get_result_async()
    spin_until(executor, lambda: result.done() and bool(progress))
    assert result.result().result.message == 'part.ngc'
    assert result.result().result.cycle_time == 1.5
    assert progress == [0.5]
    client.destroy()
    server.destroy()
