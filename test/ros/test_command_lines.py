"""
Every `ros2` command line of README and docs does what it says.

Where `ros2` is installed it runs them. Elsewhere clients of the same names, types, quality of
service and patience stand in for `ros2 topic pub`, `service call` and `action send_goal`.
"""

import os
import re
import shlex
import shutil
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

import rclpy
from cnc_interp_msgs.msg import MachineState
from nodes_under_test import DOMAIN, PATIENCE, NodesUnderTest
from rclpy.action import ActionClient
from rclpy.qos import QoSPresetProfiles
from rosidl_parser.definition import NamespacedType

from cnc_interp.client.operator_client import OperatorClient
from cnc_interp.client.session import domain_of_nodes

ROOT = Path(__file__).parents[2]
SETUP = (ROOT / 'setup.py').read_text()
PROGRAM = 'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A10 C0\nG1 X3 F3000\nM30\n'
#: What `ros2 topic pub --once` waits after its message before it ends [s].
KEEP_ALIVE = 0.1
REAL = shutil.which('ros2')
#: What a topic or service of the documentation says on a machine that nobody has touched.
SAID = {
    '/modal_state': 'G54',
    '/setup_table': 'work_offsets',
    '/feed_hold': 'nothing to hold: no program is moving',
    '/touch_off': 'G54: not set',
}
CLEAR = (
    'ros2 service call /set_offset cnc_interp_msgs/srv/SetOffset '
    '"{offset: G54, clear: true, client: test}"'
)


def command_lines():
    """Return all command lines of the documentation that begin with `ros2`, each once."""
    pages = [ROOT / 'README.md', *sorted((ROOT / 'docs').rglob('*.md'))]
    fences = [
        fence for page in pages for fence in re.findall(r'```\n(.*?)```', page.read_text(), re.S)
    ]
    text = '\n'.join(fences).replace('\\\n', ' ')
    found = re.findall(r'^\s*(ros2 .*)$', text, re.M)
    return sorted({' '.join(shlex.split(line, comments=True, posix=False)) for line in found})


def of(group):
    return [line for line in command_lines() if line.split()[1] == group]


def filled(kind, values):
    """Make a message of the values that a command line gives in YAML."""
    message = kind()
    for name, value in values.items():
        slot = kind.SLOT_TYPES[list(kind.get_fields_and_field_types()).index(name)]
        element = getattr(slot, 'value_type', slot)
        if isinstance(element, NamespacedType):
            parts = (*element.namespaces, element.name)
            inner = getattr(__import__('.'.join(parts[:2]), fromlist=['_']), parts[-1])
            value = [filled(inner, each) for each in value]
        setattr(message, name, value)
    return message


def interface(name):
    package, folder, kind = name.split('/')
    return getattr(__import__(f'{package}.{folder}', fromlist=['_']), kind)


class Client:
    """Does what `ros2` does, in a context of its own."""

    def __init__(self, domain):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node('command_line', context=self.context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)

    def run(self, words):
        verb, rest = words[1:3], [word for word in words[3:] if not word.startswith('--')]
        if verb == ['topic', 'echo']:
            return self.hear_once(words)
        values = yaml.safe_load(rest[2]) if len(rest) > 2 else {}
        if verb == ['topic', 'pub']:
            return self.publish_once(rest[0], interface(rest[1]), values)
        if verb == ['service', 'call']:
            return self.call(rest[0], interface(rest[1]), values)
        assert verb == ['action', 'send_goal'], words
        return self.send_goal(rest[0], interface(rest[1]), values)

    def publish_once(self, topic, kind, values):
        profile = QoSPresetProfiles.get_from_short_key('default')
        publisher = self.node.create_publisher(kind, topic, profile)
        deadline = time.monotonic() + PATIENCE
        while publisher.get_subscription_count() < 1:
            assert time.monotonic() < deadline, f'nobody takes {topic} of a plain publisher'
            time.sleep(KEEP_ALIVE)
        publisher.publish(filled(kind, values))
        time.sleep(KEEP_ALIVE)
        return ''

    def hear_once(self, words):
        """Listen as `ros2 topic echo` does, for which one named policy leaves the others alone."""
        topic = next(word for word in words if word.startswith('/'))
        profile = QoSPresetProfiles.get_from_short_key('sensor_data')
        for name in ('reliability', 'durability'):
            if (option := f'--qos-{name}') in words:
                kind, given = type(getattr(profile, name)), words[words.index(option) + 1]
                setattr(profile, name, kind.get_from_short_key(given))
        deadline = time.monotonic() + PATIENCE
        while not (kinds := dict(self.node.get_topic_names_and_types()).get(topic)):
            assert time.monotonic() < deadline, f'nobody publishes {topic}'
            time.sleep(KEEP_ALIVE)
        heard = []
        listener = self.node.create_subscription(interface(kinds[0]), topic, heard.append, profile)
        while not heard:
            assert time.monotonic() < deadline, f'{topic} says nothing'
            rclpy.spin_once(self.node, executor=self.executor, timeout_sec=KEEP_ALIVE)
        self.node.destroy_subscription(listener)
        return repr(heard[0])

    def call(self, name, kind, values):
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(PATIENCE), f'nobody answers {name}'
        answer = client.call_async(filled(kind.Request, values))
        rclpy.spin_until_future_complete(self.node, answer, self.executor)
        return repr(answer.result())

    def send_goal(self, name, kind, values):
        client = ActionClient(self.node, kind, name)
        assert client.wait_for_server(PATIENCE), f'nobody answers {name}'
        goal = client.send_goal_async(filled(kind.Goal, values))
        rclpy.spin_until_future_complete(self.node, goal, self.executor)
        result = goal.result().get_result_async()
        rclpy.spin_until_future_complete(self.node, result, self.executor)
        client.destroy()
        return repr(result.result().result)

    def close(self):
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


def environment_of(domain):
    return os.environ | {
        'ROS_DOMAIN_ID': str(domain),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
    }


def done(line, domain):
    """Run a command line to its end, and return what it prints."""
    words = shlex.split(line)
    if REAL:
        return subprocess.run(
            words,
            env=environment_of(domain),
            check=True,
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        ).stdout
    client = Client(domain)
    try:
        return client.run(words)
    finally:
        client.close()


@pytest.fixture(scope='module')
def nodes():
    running = NodesUnderTest(namespace='/')
    yield running
    running.close()


def test_nodes_are_sought_in_the_domain_named_or_that_of_the_environment_or_that_of_ros(
    monkeypatch,
):
    for value, found in (('7', 7), ('', 0), ('x', 0)):
        monkeypatch.setenv('ROS_DOMAIN_ID', value)
        assert (domain_of_nodes(None), domain_of_nodes(3)) == (found, 3)


def test_no_command_line_is_left_out():
    groups = {line.split()[1] for line in command_lines()}
    assert groups <= {'topic', 'service', 'action', 'launch', 'run', 'security'}, groups
    assert len(of('topic')) >= 1 and len(of('service')) >= 1 and len(of('action')) >= 2


def is_repeated(line):
    return ' -r ' in line


@contextmanager
def repeating(line, domain):
    """Publish again and again, as `ros2 topic pub -r` does."""
    words = shlex.split(line)
    ended = threading.Event()
    if REAL:
        process = subprocess.Popen(words, env=environment_of(domain), stdout=subprocess.DEVNULL)
        yield
        process.terminate()
        process.wait()
        return
    rate = words.index('-r')
    plain = [*words[:rate], *words[rate + 2 :]]

    def publish():
        client = Client(domain)
        while not ended.wait(1.0 / float(words[rate + 1])):
            client.run(plain)
        client.close()

    thread = threading.Thread(target=publish)
    thread.start()
    yield
    ended.set()
    thread.join()


@pytest.mark.parametrize('line', [line for line in of('topic') if is_repeated(line)])
def test_a_repeated_publisher_moves_axes_until_it_ends(nodes, line):
    names, shares = re.search(r'axes: \[(.*?)\], shares: \[(.*?)\]', line).groups()
    moved = dict(zip(names.split(', '), map(float, shares.split(', ')), strict=True))
    assert ' /jog ' in line
    before = nodes.next_state().commanded_positions
    ways = {name: 'XYZAC'.index(name) for name in moved}

    def has_moved(name):
        way = nodes.peers.state.commanded_positions[ways[name]] - before[ways[name]]
        return way * moved[name] > 0.0

    with repeating(line, nodes.domain):
        nodes.spin_until(lambda: all(map(has_moved, moved)))
        assert nodes.peers.state.state == MachineState.JOGGING
    nodes.spin_until(lambda: nodes.peers.state.state == MachineState.IDLE)


@pytest.mark.parametrize('line', [line for line in of('topic') if ' pub --once ' in line])
def test_a_plain_publisher_sets_the_override(nodes, line):
    wanted = float(re.search(r'data: ([0-9.]+)', line)[1])
    assert ' /feed_override ' in line and nodes.next_state().feed_override == 1.0
    done(line, nodes.domain)
    nodes.spin_until(lambda: nodes.peers.state.feed_override == wanted)
    with OperatorClient('late', nodes.namespace, nodes.domain) as late:
        while late.override_of('feed_override') != wanted:  # as a page that is opened now
            late.serve()
    done(line.replace(f'{wanted}', '1.0'), nodes.domain)
    nodes.spin_until(lambda: nodes.peers.state.feed_override == 1.0)


@pytest.mark.parametrize('line', [line for line in of('topic') if ' echo --once ' in line])
def test_a_listener_that_joins_late_hears_the_state(nodes, line):
    topic = next(word for word in shlex.split(line) if word.startswith('/'))
    assert SAID[topic] in done(line, nodes.domain)


@pytest.mark.parametrize('line', of('service'))
def test_a_service_answers(nodes, line):
    assert SAID[shlex.split(line)[3]] in done(line, nodes.domain)
    done(CLEAR, nodes.domain)  # the offset that a touch-off sets


@pytest.mark.parametrize('line', [line for line in of('action') if '/run_program' in line])
def test_a_program_runs_to_its_end(nodes, line, tmp_path):
    program = tmp_path / 'program.ngc'
    program.write_text(PROGRAM)
    said = done(re.sub(r'/\S+\.ngc', str(program), line), nodes.domain)
    assert 'executed to the end' in said


@pytest.mark.parametrize('line', [line for line in of('action') if '/plan_batch' in line])
def test_a_batch_is_planned(line, tmp_path):
    (tmp_path / 'program.ngc').write_text(PROGRAM)
    command = [sys.executable, '-m', 'cnc_interp.nodes', 'batch_node', '--ros-args']
    given = f"program_folders:=['{tmp_path}']", f'batch_folder:={tmp_path / "plans"}'
    words = [word for one in given for word in ('-p', one)]
    with subprocess.Popen([*command, *words], env=environment_of(DOMAIN)) as node:
        said = done(line.replace('/parts', str(tmp_path)), DOMAIN)
        node.terminate()
    assert 'success=True' in said and '1 proven' in said


@pytest.mark.parametrize('line', of('launch'))
def test_launch_files_and_their_arguments_exist(line):
    words = shlex.split(line)
    source = (ROOT / 'launch' / words[3]).read_text()
    for argument in words[4:]:
        assert f"'{argument.partition(':=')[0]}'" in source


@pytest.mark.parametrize('line', of('run'))
def test_nodes_to_run_exist(line):
    package, node = shlex.split(line)[2:4]
    assert package == 'cnc_interp' and f"'{node.removesuffix('_node')}'" in SETUP


@pytest.mark.parametrize('line', of('security'))
def test_security_files_exist(line):
    for word in shlex.split(line):
        if word.endswith('.xml'):
            assert (ROOT / word).is_file()
