"""A bag holds everything from the first to the last message of a run, on every topic."""

import math
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from itertools import chain
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from nodes_under_test import DOMAIN, PATIENCE
from sensor_msgs.msg import JointState
from test_leftovers import family, started

from cnc_interp.client.bag import TOPICS, Bag
from cnc_interp.client.operator_client import OperatorClient
from cnc_interp.client.recorder import Recorder
from cnc_interp.client.recorder_process import NAME
from cnc_interp.commands.cli import main
from cnc_interp.nodes.qos import JOINTS

#: Topic of the batches.
TRAVEL_AS = {'blocks': 'block_batches', 'segments': 'segments'}
#: So short that the run is over before the slower topics have been published again.
SHORT = 'G21 G90 G0 X0 Y0 Z0\nG1 F1000\nX5\nY5\nM2\n'
#: 5,000 blocks a second, which nobody could send as so many messages.
DENSE = (
    'G21 G90 G0 X0 Y0 Z0\nG1 F6000\n'
    + ''.join(f'X{0.02 * k:.2f} Y{5 * math.sin(0.001 * k):.4f}\n' for k in range(1, 1501))
    + 'M2\n'
)
#: Lines in machine axes with rounded corners, through the pole and with a rapid.
IN_AXES = (
    'G21 G90 G49 G0 X0 Y0 Z0 A-5 C20\nG1 F2000\nX10 A5\nY8 C40\nG0 X15 Z5 A10\nG1 A-5 C0\nM2\n'
)


@pytest.fixture(
    scope='module',
    params=[
        pytest.param(SHORT, id='short', marks=pytest.mark.thorough),
        pytest.param(DENSE, id='dense'),
        pytest.param(IN_AXES, id='axes', marks=pytest.mark.thorough),
    ],
)
def recorded(request):
    """The folder of a recorded run that has ended."""
    with tempfile.TemporaryDirectory() as name:  # a short path, because it will hold sockets
        run = started(Path(name), request.param, '--record', f'{name}/bag')
        assert run.wait(PATIENCE) == 0
        yield Path(name)


@pytest.fixture(scope='module')
def messages(recorded):
    """All messages of the run by topic."""
    with Bag(recorded / 'bag') as bag:
        return {topic: bag.read(topic) for topic in TOPICS}


def test_nothing_stays_of_a_run_that_ends_in_order(recorded):
    assert list((recorded / 'tmp').iterdir()) == []


def test_the_run_is_proven(recorded, capsys):
    assert main(['check', str(recorded / 'bag')]) == 0
    assert capsys.readouterr().out.endswith('proven\n')


def test_a_node_that_lives_on_after_its_recorder_hears_nothing_more(tmp_path):
    with OperatorClient('recorder', '/recorded', DOMAIN) as client:
        sender = client.node.create_publisher(JointState, 'joint_states', JOINTS)
        recorder = Recorder(client.node, tmp_path / 'bag')

        def tell(done):
            until = time.monotonic() + PATIENCE
            while not done() and time.monotonic() < until:
                sender.publish(JointState())
                client.serve(0.05)

        tell(lambda: recorder.count)
        recorder.close()
        count, spun = recorder.count, iter(range(5))
        tell(lambda: next(spun, None) is None)
        assert 0 < count == recorder.count
        assert sender.get_subscription_count() == 0


def recorder_of(run):
    """The process that records a run; it is there once the bag has grown."""
    for member in family(run.pid):
        comm = Path(f'/proc/{member}/comm')
        if comm.exists() and comm.read_text().strip() == NAME:
            return member
    return None


def kill(recorder):
    os.kill(recorder, signal.SIGKILL)


def fill_the_disk(recorder):
    resource.prlimit(recorder, resource.RLIMIT_FSIZE, (100_000, 100_000))


@pytest.mark.parametrize(
    ('harm', 'reason'),
    [
        (kill, 'its recorder was killed; cnc-interp repair'),
        pytest.param(fill_the_disk, 'File too large', marks=pytest.mark.thorough),
    ],
)
def test_a_run_goes_on_without_its_recorder_and_says_so(tmp_path, capfd, harm, reason):
    program, bag = tmp_path / 'program.ngc', tmp_path / 'bag'
    program.write_text('G21 G90 G0 X0 Y0 Z0\nG1 F1000\nX100\nM2\n')
    words = ['run', program, '--record', bag]
    run = subprocess.Popen([sys.executable, '-m', 'cnc_interp', *words])
    until = time.monotonic() + PATIENCE
    while sum(file.stat().st_size for file in bag.glob('*.mcap')) < 50_000:
        assert run.poll() is None and time.monotonic() < until
        time.sleep(0.1)
    harm(recorder_of(run))
    assert run.wait(PATIENCE) == 1
    told = capfd.readouterr()
    summary = told.out.splitlines()[0]
    assert 'executed to the end' in summary and reason in summary
    lines = [line for line in told.err.splitlines() if reason in line]
    assert len(lines) == 1 and lines[0].endswith('the run goes on')
    assert main(['repair', str(bag), '--out', str(tmp_path / 'repaired')]) == 0


def first_times(items, number):
    """
    The items by their number, in the order of their first arrival.

    On a busy computer some come twice: what is not acknowledged in time is sent again, unchanged.
    Only the checksum may differ: it covers bytes between the fields, which are not set.
    """
    once = {}
    for item in items:
        if hasattr(item, 'checksum'):
            item.checksum = 0
        first = once.setdefault(number(item), item)
        assert repr(item) == repr(first)  # NaN, which equals nothing, is in some of them
    return once


@pytest.mark.parametrize('topic', ['blocks', 'segments'])
def test_streams_have_every_message_to_the_end_of_the_program(messages, topic):
    batches = messages[TRAVEL_AS[topic]]
    found = first_times(
        chain.from_iterable(getattr(batch, topic) for batch in batches), lambda m: m.sequence
    )
    assert list(found) == list(range(len(found)))
    assert [m.end_of_program for m in found.values()] == [False] * (len(found) - 1) + [True]


@pytest.mark.parametrize(('topic', 'together'), [('blocks', 32), ('segments', 8)])
def test_they_travel_together(messages, topic, together):
    batches = first_times(
        messages[TRAVEL_AS[topic]], lambda batch: getattr(batch, topic)[0].sequence
    )
    sizes = [len(getattr(batch, topic)) for batch in batches.values()]
    assert not messages['blocks']
    assert len(sizes) <= 4 + sum(sizes) / together


def test_executed_setpoints_are_whole(messages):
    chunks = first_times(messages['executed_setpoints'], lambda chunk: chunk.first_sample)
    ends = [0, *(first + len(chunk.sequences) for first, chunk in chunks.items())]
    assert list(chunks) == ends[:-1]
    assert ends[-1] == messages['machine_state'][-1].samples
    assert messages['executed_setpoints'][-1].end_of_program


def test_setpoints_of_each_plan_are_whole(messages):
    """There are several where the computer was so busy that the machine rested on the way."""
    chunks = first_times(messages['setpoints'], lambda chunk: (chunk.plan, chunk.first_sample))
    for plan in {plan for plan, _ in chunks}:
        told = {first: chunk for (of, first), chunk in chunks.items() if of == plan}
        ends = [0, *(first + len(chunk.sequences) for first, chunk in told.items())]
        assert list(told) == ends[:-1]
    assert messages['setpoints'][-1].end_of_program


def test_states_are_told_to_the_end(messages):
    assert messages['machine_state'][-1].completed
    last = messages['executed_setpoints'][-1]
    assert (
        messages['machine_state'][-1].commanded_positions.tolist() == last.positions[-5:].tolist()
    )
    assert len(messages['loaded_program']) == 1
    assert messages['/diagnostics'] and messages['stream_status'] and messages['joint_states']
