"""Finished plans that a controller of ros2_control executes as goals of FollowJointTrajectory."""

import signal
import subprocess
import sys
import time

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

import controller_messages
from controller_stand_in import JOINTS, StandIn
from nodes_under_test import DOMAIN, PATIENCE, hear_ctrl_c

from cnc_interp.commands.cli import main
from cnc_interp.proof.plan_files import read_plan

PROGRAM = 'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A5 C10\nG1 X20 Y8 A9 C25 F3000\nX30 Y-5 Z4 A3\nM30\n'
LATEST = 0.1  #: Of the first cycle of the controller after the start of a trajectory [s].
AWAY = [0.02, 0.0, 0.0, 0.0, 0.0]  #: Of a robot that stands elsewhere [m, rad].


@pytest.fixture(scope='module')
def messages(tmp_path_factory):
    return controller_messages.built(tmp_path_factory.mktemp('control_msgs'))


@pytest.fixture(scope='module')
def plan(tmp_path_factory):
    folder = tmp_path_factory.mktemp('plan')
    (folder / 'part.ngc').write_text(PROGRAM)
    assert main(['plan', str(folder / 'part.ngc'), '--out', str(folder / 'part')]) == 0
    return folder / 'part'


@pytest.fixture
def robot(messages, plan):
    with StandIn(DOMAIN, messages) as robot:
        put(robot, read_plan(plan).position[0])
        yield robot


def put(robot, position, **more):
    """Put the robot somewhere, in the order of the axes, and wait until it holds there."""
    robot.tell(at=list(position)[::-1], **more)
    deadline = time.monotonic() + PATIENCE
    while not (len(rows := robot.commanded()[2]) and np.array_equal(rows[-1], position)):
        assert time.monotonic() < deadline
        time.sleep(0.05)


def sending(robot, plan):
    """The command, in a process of its own."""
    words = ['--controller', f'{robot.name}/arm_controller', '--joints', *JOINTS[::-1]]
    return subprocess.Popen(
        [
            *(sys.executable, '-m', 'cnc_interp', 'send', plan),
            *('--feedback', f'{robot.name}/joint_states', *words),
        ],
        env=robot.environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=hear_ctrl_c,
    )


def until_it_moves(robot, process):
    deadline = time.monotonic() + PATIENCE
    while not any(between for _, between, _ in zip(*robot.commanded(), strict=True)):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.thorough
def test_a_plan_is_executed_as_it_was_planned(robot, plan):
    sent = sending(robot, plan)
    said, faults = sent.communicate(timeout=PATIENCE)
    assert sent.returncode == 0, faults
    assert 'executed' in said and 'following' in said
    times, between, positions = robot.commanded()
    setpoints = read_plan(plan).setpoints
    end = float(setpoints['time'][-1])
    times, positions = times[between] - times[between][0], positions[between]
    assert times[-1] > end
    # How long after the start its first cycle came is unknown, and longer on a busy computer.
    lags = np.arange(0.0, LATEST, 1e-5)
    path = np.array(setpoints['position'])
    worst = [
        np.abs(
            np.column_stack(
                [np.interp(times + lag, setpoints['time'], column) for column in path.T]
            )
            - positions
        ).max()
        for lag in lags
    ]
    assert min(worst) < 5e-6


@pytest.mark.thorough
def test_a_robot_that_stands_elsewhere_does_not_move(robot, plan):
    put(robot, AWAY)
    sent = sending(robot, plan)
    faults = sent.communicate(timeout=PATIENCE)[1]
    assert sent.returncode == 2
    assert 'slide_x is at 20.000 mm, but the plan begins at' in faults
    assert not robot.commanded()[1].any()


@pytest.mark.thorough
def test_ctrl_c_ends_the_motion(robot, plan):
    sent = sending(robot, plan)
    until_it_moves(robot, sent)
    sent.send_signal(signal.SIGINT)
    assert sent.wait(PATIENCE) == 130
    assert 'cancelled' in robot.refusals


@pytest.mark.thorough
def test_why_the_controller_ended_it_is_told(robot, plan):
    put(robot, read_plan(plan).position[0], tolerance=1e-4, stuck='slide_x')
    sent = sending(robot, plan)
    faults = sent.communicate(timeout=PATIENCE)[1]
    assert sent.returncode == 2
    assert 'ended the trajectory: path tolerance' in faults


@pytest.mark.thorough
def test_without_the_messages_of_the_controller_it_says_what_to_do(plan, capfd):
    assert main(['send', str(plan), '--joints', *JOINTS]) == 2
    assert 'source the ROS 2 workspace' in capfd.readouterr().err
