"""An arm whose URDF is on a topic, published by another process."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp.commands.cli import main
from cnc_interp.machine_model import arm_entries
from cnc_interp.machine_model.machine import Machine, content_of
from cnc_interp.proof.own_chain import OwnChain

PROGRAM = 'FEDRAT/1500,MMPM\nGOTO/-20,0,20,0,0,1\nGOTO/-20,0,0,0,0,1\nGOTO/20,10,0,0,0,1\nFINI\n'
#: What robot_state_publisher does with the description.
PUBLISHER = """
import sys, rclpy
from std_msgs.msg import String
from cnc_interp.nodes import qos
rclpy.init()
node = rclpy.create_node('publisher')
publisher = node.create_publisher(String, 'robot_description', qos.LOADED)
publisher.publish(String(data=sys.stdin.read()))
print('published', flush=True)
rclpy.spin(node)
"""
COMMAND = [sys.executable, '-m', 'cnc_interp']


@pytest.fixture
def machine_file(tmp_path):
    content = {**content_of('ur10e'), 'urdf': 'topic robot_description'}
    file = tmp_path / 'mine.yaml'
    file.write_text(yaml.safe_dump(content))
    return file


@pytest.fixture
def environment():
    from cnc_interp.processes.this_host import variables_of_this_host

    return {**os.environ, **variables_of_this_host(os.environ), 'ROS_DOMAIN_ID': '71'}


@pytest.fixture
def publisher(environment):
    process = subprocess.Popen(
        [sys.executable, '-c', PUBLISHER],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    process.stdin.write(content_of('ur10e')['urdf'])
    process.stdin.close()
    assert process.stdout.readline() == 'published\n'
    yield process
    process.terminate()
    process.wait()


def test_the_urdf_of_a_topic_is_planned_run_and_proven(
    tmp_path, machine_file, publisher, environment
):
    program, plan, ran = tmp_path / 'part.apt', tmp_path / 'plan', tmp_path / 'ran'
    program.write_text(PROGRAM)
    for command, out in (('plan', plan), ('run', ran)):
        words = [command, str(program), '--machine', str(machine_file), '--out', str(out)]
        done = subprocess.run(
            [*COMMAND, *words, '--json'], env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        assert json.loads(done.stdout)
    publisher.terminate()
    publisher.wait()
    q = np.load(plan / 'setpoints.npz')['position']
    for found, own in zip(
        OwnChain.of(Machine.load('ur10e')).forward(q),
        OwnChain.of(Machine.load(plan / 'machine.yaml')).forward(q),
        strict=True,
    ):
        assert np.abs(found - own).max() < 1e-12
    for out in (plan, ran):  # nobody publishes any more
        assert Path(out, 'machine.yaml').is_file()
        assert main(['check', str(out), '--program', str(program)]) == 0


def test_a_topic_that_nobody_publishes_is_named(tmp_path, machine_file, monkeypatch, capsys):
    arm_entries._published.cache_clear()
    monkeypatch.setenv('ROS_DOMAIN_ID', '72')
    program = tmp_path / 'part.apt'
    program.write_text(PROGRAM)
    words = ['plan', str(program), '--machine', str(machine_file), '--out', str(tmp_path / 'plan')]
    assert main(words) == 2
    told = capsys.readouterr().err.strip()
    assert told.endswith(
        'mine.yaml: urdf: nobody publishes robot_description within 10 s; start '
        'robot_state_publisher, or name a file'
    )
    assert len(told.splitlines()) == 1
