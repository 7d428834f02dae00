"""Setpoints as JointTrajectory: what a joint_trajectory_controller would follow ends at rest."""

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from operated import MACHINE, PROGRAM, Bench, path_of
from trajectory_msgs.msg import JointTrajectory

from cnc_interp.kinematics.axis_path import evaluate
from cnc_interp.nodes import qos

pytestmark = pytest.mark.thorough

TOPIC = 'controller/joint_trajectory'


def test_every_trajectory_ends_at_rest_on_the_path():
    bench = Bench({'machine_node': {'trajectory_topic': TOPIC}})
    try:
        heard = bench.listen(TOPIC, JointTrajectory, qos.TRAJECTORY)
        handle = bench.begin()
        bench.until_at(0.03)
        assert bench.press('feed_hold').success
        bench.spin_until(lambda: bench.state.plan_over)
        assert bench.press('cycle_start').success
        bench.finish(handle)
    finally:
        bench.close()
    assert len(heard) > 20
    path = path_of(PROGRAM)
    on_path = evaluate(path, np.linspace(0.0, path.s[-1], 50_000))[0]
    way = np.linspace(0.0, 1.0, 50_000)[:, None] * on_path[0]  # the approach, from zero
    places = np.concatenate([way, on_path])
    for message in heard:
        assert message.joint_names == list(MACHINE.axis_names)
        times = np.array(
            [p.time_from_start.sec + p.time_from_start.nanosec * 1e-9 for p in message.points]
        )
        q = np.array([p.positions for p in message.points])
        v = np.array([p.velocities for p in message.points])
        assert (np.diff(times) > 0.0).all() and np.abs(v[-1]).max() < 1e-6
        if len(times) > 2:  # positions and velocities belong together
            chord = np.diff(q, axis=0) / np.diff(times)[:, None]
            mean = 0.5 * (v[1:] + v[:-1])
            bound = MACHINE.max_jerk * np.diff(times)[:, None] ** 2 / 12 + 1e-9
            assert (np.abs(chord - mean) <= 1.01 * bound).all()
        assert np.abs(places - q[-1]).max(axis=1).min() < 1e-4  # it ends where the tool may be
