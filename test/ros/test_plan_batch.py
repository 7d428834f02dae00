"""The action plan_batch: the table of `cnc-interp batch`, feedback, refusals and cancels."""

import os
import subprocess
import sys
import time
import uuid
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

import rclpy
from cnc_interp_msgs.action import PlanBatch
from nodes_under_test import DOMAIN
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor

from cnc_interp.commands.cli import main

PATIENCE = 300.0
LINE = 'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A10 C0\nG1 F3000 X{}\nM30\n'


class Client:
    """The node as a process, and who asks it."""

    def __init__(self, folder):
        namespace, domain = f'/test_{uuid.uuid4().hex[:8]}', DOMAIN
        command = [sys.executable, '-m', 'cnc_interp.nodes', 'batch_node', '--ros-args']
        given = [f"program_folders:=['{folder / 'programs'}']", f'batch_folder:={folder / "out"}']
        given.append('use_sim_time:=true')  # and nobody publishes /clock
        command += ['-r', f'__ns:={namespace}', *(w for one in given for w in ('-p', one))]
        self.process = subprocess.Popen(
            command,
            env=os.environ
            | {'ROS_DOMAIN_ID': str(domain), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'},
        )
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node('asker', namespace=namespace, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.action = ActionClient(self.node, PlanBatch, 'plan_batch')
        self.feedback = []
        self.spin_until(self.action.server_is_ready)

    def spin_until(self, done):
        deadline = time.monotonic() + PATIENCE
        while not done():
            assert self.process.poll() is None, 'the batch node ended'
            assert time.monotonic() < deadline, 'waited too long'
            self.executor.spin_once(timeout_sec=0.05)

    def send(self, **goal):
        handle = self.action.send_goal_async(
            PlanBatch.Goal(**goal), lambda message: self.feedback.append(message.feedback)
        )
        self.spin_until(handle.done)
        return handle.result()

    def result_of(self, handle):
        answer = handle.get_result_async()
        self.spin_until(answer.done)
        return answer.result().result

    def close(self):
        self.process.terminate()
        self.process.wait()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def client(tmp_path):
    (tmp_path / 'programs').mkdir()
    running = Client(tmp_path)
    yield running
    running.close()


@pytest.mark.thorough
def test_a_batch_over_ros_makes_the_same_table(client, tmp_path):
    programs = tmp_path / 'programs'
    for k in range(6):
        (programs / f'{k}.ngc').write_text(LINE.format(k + 1))
    (programs / 'wrong.ngc').write_text('G1 X\n')
    handle = client.send(programs=[str(programs)], machines=['xyzac', 'xyzbc'], name='monday')
    busy = client.result_of(client.send(programs=[str(programs)], name='tuesday'))
    assert not busy.success and 'a batch is running' in busy.message
    result = client.result_of(handle)
    assert result.success, result.message
    # xyzbc has no axis A
    assert (result.total, result.proven, result.refused) == (14, 6, 8)
    out = tmp_path / 'here'
    machines = ['--machine', 'xyzac', 'xyzbc']
    main(['batch', str(programs), *machines, '--out', str(out)])
    assert (out / 'table.csv').read_bytes() == Path(result.table).read_bytes()
    assert (tmp_path / 'out' / 'monday' / 'batch.html').is_file()


@pytest.mark.thorough
def test_a_cancelled_batch_keeps_what_it_has(client, tmp_path):
    programs, results = tmp_path / 'programs', tmp_path / 'out' / 'long' / 'results'
    for k in range(60):
        (programs / f'{k}.ngc').write_text(LINE.format(f'{k}\nY{k + 1}\nX0'))
    handle = client.send(programs=[str(programs)], name='long')
    client.spin_until(lambda: len(list(results.glob('[0-9a-f]*.json'))) >= 2)
    client.spin_until(handle.cancel_goal_async().done)
    result = client.result_of(handle)
    assert not result.success and 'finished results are kept' in result.message
    known = len(list(results.glob('[0-9a-f]*.json')))
    assert 2 <= known < 60
    assert client.feedback[-1].total == 60 and client.feedback[-1].done <= known
    again = client.result_of(client.send(programs=[str(programs)], name='long'))
    assert again.success and again.proven == 60


@pytest.mark.thorough
def test_what_a_goal_may_not_have_is_refused(client, tmp_path):
    (tmp_path / 'programs' / 'a.ngc').write_text(LINE.format(1))
    inside, outside = str(tmp_path / 'programs'), str(tmp_path / 'other')
    for goal, text in (
        ({'programs': [outside], 'name': 'a'}, 'no file of a folder'),
        ({'programs': [inside], 'name': '../a'}, 'name: may have at most 100 letters'),
        ({'programs': [inside], 'name': 'a', 'machines': ['no']}, "no machine 'no'"),
        ({'programs': [], 'name': 'a'}, 'no programs here'),
    ):
        result = client.result_of(client.send(**goal))
        assert not result.success and text in result.message
    (tmp_path / 'programs' / 'link.ngc').symlink_to(tmp_path / 'no.ngc')
    (tmp_path / 'no.ngc').write_text(LINE.format(2))
    result = client.result_of(client.send(programs=[inside], name='a'))
    assert not result.success and 'no file of a folder' in result.message
    assert not (tmp_path / 'out').exists()
    (tmp_path / 'programs' / 'link.ngc').rename(tmp_path / 'programs' / '10')  # a subprogram
    (tmp_path / 'no.ngc').write_text(f'o10 sub\n{LINE.format(2)[:-4]}o10 endsub\n')
    (tmp_path / 'programs' / 'a.ngc').write_text('o10 call\nM2\n')
    result = client.result_of(client.send(programs=[inside], name='a'))
    assert (result.proven, result.refused) == (0, 1)
    assert 'no file of a folder' in Path(result.table).read_text()
