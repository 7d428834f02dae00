"""The four nodes as real processes, and a client that sends goals and raw messages to them."""

import os
import signal
import time
import uuid

import rclpy
from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import G1Block, LoadedProgram, MachineState
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.time import Time
from std_srvs.srv import Trigger

from cnc_interp.client.question import Question, SentProgram
from cnc_interp.client.session import nodes_file
from cnc_interp.nodes import qos
from cnc_interp.nodes.peers import Peers
from cnc_interp.processes.node_processes import Children

#: ROS domain of this process; each worker of a parallel run has a range of its own.
DOMAIN = 1 + 25 * (int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0')[2:]) % 4) + os.getpid() % 25
START, PATIENCE = 300.0, 300.0  # [s]; the first start compiles; bounds, not timings


def hear_ctrl_c():
    """As in a terminal: what is started in the background does not hear it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def clean_environment():
    """Environment without the variables of pytest, which change how NiceGUI starts."""
    return {k: v for k, v in os.environ.items() if not k.startswith('PYTEST')}


class NodesUnderTest:
    """Start the nodes, talk to them, end them."""

    def __init__(self, parameters=None, arguments=None, namespace=''):
        self.namespace = namespace or f'/test_{uuid.uuid4().hex[:8]}'
        self.domain = DOMAIN
        everywhere = {'program_node': {'program_folders': "['/']"}}
        self.children = Children(
            self.namespace, self.domain, everywhere | (parameters or {}), nodes_file(), arguments
        )
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=self.domain)
        self.node = rclpy.create_node('tester', namespace=self.namespace, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.peers = Peers(self.node)
        self.watching = True  # a node that ends is a failure
        self.diagnostics = []
        self.states = []
        self.node.create_subscription(DiagnosticArray, '/diagnostics', self._hear, qos.DIAGNOSTICS)
        self.node.create_subscription(MachineState, 'machine_state', self.states.append, qos.STATE)
        self.loaded = []
        self.node.create_subscription(
            LoadedProgram, 'loaded_program', self.loaded.append, qos.LOADED
        )
        self.blocks = self.node.create_publisher(G1Block, 'blocks', qos.STREAM)
        self.action = ActionClient(self.node, RunProgram, 'run_program')
        names = ('feed_hold', 'cycle_start', 'reset', 'emergency_stop')
        self.buttons = {name: self.node.create_client(Trigger, name) for name in names}
        self.spin_until(
            lambda: (
                self.action.server_is_ready()
                and not self.peers.missing(time.monotonic(), 1.0)
                and self.blocks.get_subscription_count() == 1
                and all(client.service_is_ready() for client in self.buttons.values())
            ),
            START,
        )

    def _hear(self, array):
        self.diagnostics += [
            (status.name, status.message)
            for status in array.status
            if status.hardware_id == self.namespace
        ]

    def listen(self, topic, kind, profile):
        """Collect the messages of a topic; returns when the nodes send to the subscription."""
        heard = []
        self.node.create_subscription(kind, topic, heard.append, profile)
        self.be_known()
        return heard

    def be_known(self):
        """Wait until the nodes send to all subscriptions that there are."""
        for name in self.children.nodes:  # who answers a client that was made later knows of both
            client = self.node.create_client(Trigger, f'{name}/flush')
            question = Question(client, Trigger.Request(), 1.0)
            self.spin_until(lambda asked=question: asked.answer() is not None)
            self.node.destroy_client(client)

    def spin_until(self, done, patience=PATIENCE):
        deadline = time.monotonic() + patience
        while not done():
            assert time.monotonic() < deadline, f'waited too long; {self.last_words()}'
            if self.watching:
                self.children.check()
            self.executor.spin_once(timeout_sec=0.05)

    def spin_for(self, time_span):
        """Spin for a time [s]; a busy computer may take longer."""
        end = time.monotonic() + time_span
        # With another timeout the executor would begin again with the first subscription, and a
        # stream of messages there would keep all others waiting.
        while time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.05)

    def last_words(self):
        """Last diagnostics of each part of the nodes, acknowledgements, state of the machine."""
        return dict(self.diagnostics), self.peers._status, self.peers.state

    def press(self, button):
        """Use a service of the machine; returns its answer."""
        answer = self.buttons[button].call_async(Trigger.Request())
        self.spin_until(answer.done)
        return answer.result()

    def start(self, **goal):
        """Send a goal; returns its handle."""
        sent = SentProgram(self.action, RunProgram.Goal(**goal))

        def accepted():
            sent.follow()
            return sent.accepted

        self.spin_until(accepted)
        self.sent = sent
        return sent.handle

    def result_of(self, handle, patience=PATIENCE):
        wanted = handle.get_result_async()
        self.spin_until(wanted.done, patience)
        return wanted.result().result

    def run(self, **goal):
        return self.result_of(self.start(**goal))

    def next_state(self):
        """A machine state sent after this call."""
        asked = self.node.get_clock().now()
        self.states.clear()
        self.spin_until(
            lambda: self.states and Time.from_msg(self.states[-1].header.stamp) > asked
        )
        return self.states[-1]

    def close(self):
        """End everything; returns the exit codes."""
        self.executor.shutdown()
        self.action.destroy()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)
        self.children.end()
        return {name: node.process.exitcode for name, node in self.children.nodes.items()}
