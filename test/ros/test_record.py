"""A bag holds everything from the first to the last message of a run, on every topic."""

import os
import subprocess
import sys

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp.client.bag import TOPICS, Bag

#: So short that the run is over before the slower topics have been published again.
PROGRAM = 'G21 G90 G0 X0 Y0 Z0\nG1 F1000\nX5\nY5\nM2\n'


@pytest.fixture(scope='module')
def messages(tmp_path_factory):
    """All messages of a recorded run by topic; nothing is sourced."""
    folder = tmp_path_factory.mktemp('record')
    (folder / 'short.ngc').write_text(PROGRAM)
    command = [sys.executable, '-m', 'cnc_interp', 'run', folder / 'short.ngc', '--record']
    plain = {
        k: v for k, v in os.environ.items() if k not in ('AMENT_PREFIX_PATH', 'RMW_IMPLEMENTATION')
    }
    subprocess.run([*command, folder / 'bag'], check=True, env=plain)
    check = [sys.executable, '-m', 'cnc_interp', 'check', folder / 'bag']
    assert (
        'proven'
        in subprocess.run(check, check=True, env=plain, capture_output=True, text=True).stdout
    )
    with Bag(folder / 'bag') as bag:
        return {topic: bag.read(topic) for topic in TOPICS}


@pytest.mark.parametrize('topic', ['blocks', 'segments'])
def test_streams_have_every_message_to_the_end_of_the_program(messages, topic):
    found = messages[topic]
    assert [m.sequence for m in found] == list(range(len(found)))
    assert [m.end_of_program for m in found] == [False] * (len(found) - 1) + [True]


@pytest.mark.parametrize('topic', ['setpoints', 'executed_setpoints'])
def test_setpoints_are_whole(messages, topic):
    following = 0
    for chunk in messages[topic]:
        assert chunk.first_sample == following
        following += len(chunk.sequences)
    assert messages[topic][-1].end_of_program
    assert following == messages['machine_state'][-1].samples


def test_states_are_told_to_the_end(messages):
    assert messages['machine_state'][-1].completed
    last = messages['executed_setpoints'][-1]
    assert (
        messages['machine_state'][-1].commanded_positions.tolist() == last.positions[-5:].tolist()
    )
    assert len(messages['loaded_program']) == 1
    assert messages['/diagnostics'] and messages['stream_status'] and messages['joint_states']
