"""The markers node: what it draws is what the blocks ask for and what the drives were told."""

import os
import subprocess
import sys
import time
import uuid

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

import rclpy
from cnc_interp_msgs.msg import G1Block, SetpointChunk
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from nodes_under_test import DOMAIN
from rclpy.executors import SingleThreadedExecutor
from visualization_msgs.msg import Marker, MarkerArray

from cnc_interp.collision.drawing import drawn_bodies
from cnc_interp.collision.scene_file import read_scene
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.nodes import qos
from cnc_interp.program import read_text
from cnc_interp.run.run_state import RunId
from cnc_interp.settings.options import Settings
from cnc_interp.wire.path_messages import block_messages

pytestmark = pytest.mark.thorough

PATIENCE = 120.0
CHUNK = 30
TRANSFORM = Transform.of(Machine.load('xyzac'))
CORNERS = np.array([[0, 0, 0], [12, 0, 0], [12, 9, 0], [0, 9, 4]]) * 1e-3
PROGRAM = (
    'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A15 C30\n'
    + ''.join(f'G1 X{x * 1e3:g} Y{y * 1e3:g} Z{z * 1e3:g} F3000\n' for x, y, z in CORNERS[1:])
    + 'M30\n'
)


class Viewer:
    """The markers node as a process, somebody who streams, and somebody who looks."""

    def __init__(self, *parameters):
        namespace, domain = f'/test_{uuid.uuid4().hex[:8]}', DOMAIN
        command = [sys.executable, '-m', 'cnc_interp.nodes', 'markers_node', '--ros-args']
        self.process = subprocess.Popen(
            [*command, '-r', f'__ns:={namespace}', *parameters],
            env=os.environ
            | {'ROS_DOMAIN_ID': str(domain), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'},
        )
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=domain)
        self.node = rclpy.create_node('viewer', namespace=namespace, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.markers = {}
        self.blocks = self.node.create_publisher(G1Block, 'blocks', qos.STREAM)
        self.executed = self.node.create_publisher(SetpointChunk, 'executed_setpoints', qos.STREAM)
        self.look()
        # The node listens with best effort: what is sent before it has found us is lost.
        senders = self.blocks, self.executed
        assert self.seen(lambda: all(sender.get_subscription_count() for sender in senders))
        found = time.monotonic()  # the node finds the senders at about the same time
        self.seen(lambda: time.monotonic() > found + 1.0)

    def look(self):
        self.node.create_subscription(MarkerArray, 'markers', self.see, qos.MARKERS)

    def see(self, array):
        for marker in array.markers:
            if marker.action == Marker.DELETEALL:
                self.markers.clear()
            else:
                assert marker.header.frame_id == 'workpiece' or marker.ns == 'bodies'
                self.markers[marker.ns, marker.id] = marker

    def points(self, name):
        found = [m for key, m in sorted(self.markers.items()) if key[0] == name]
        return np.array([[p.x, p.y, p.z] for m in found for p in m.points]).reshape(-1, 3)

    def seen(self, done, patience=PATIENCE):
        deadline = time.monotonic() + patience
        while not done() and time.monotonic() < deadline:
            assert self.process.poll() is None, 'the markers node ended'
            self.executor.spin_once(timeout_sec=0.05)
        return done()

    def stream(self, run, attempt=0):
        """Send the blocks of the program, one of them twice, and setpoints along them."""
        blocks = read_text(PROGRAM, 'part.ngc', TRANSFORM, Settings()).blocks
        messages = block_messages(blocks, RunId(run, attempt), 0, 0.03, end=True)
        for message in [*messages, messages[1]]:
            self.blocks.publish(message)
        share = np.linspace(0.0, len(CORNERS) - 1, 3001)
        tips = np.array([np.interp(share, np.arange(len(CORNERS)), x) for x in CORNERS.T]).T
        rotary = np.tile(np.radians([15.0, 30.0]), (len(tips), 1))
        q = np.c_[TRANSFORM.linear(tips, rotary), rotary]
        for k in range(0, len(q) - 1, CHUNK):
            self.executed.publish(
                SetpointChunk(
                    program_id=run,
                    attempt=attempt,
                    axis_count=5,
                    positions=q[k : k + CHUNK].ravel(),
                    sequences=[1] * CHUNK,
                )
            )
            time.sleep(0.02)  # five times as fast as a machine reports; listeners may miss bursts
        return tips[CHUNK - 1 :: CHUNK]

    def close(self):
        self.process.terminate()
        assert self.process.wait(20.0) == 0
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def viewer():
    running = Viewer()
    yield running
    running.close()


def test_programmed_and_executed_path_are_drawn(viewer):
    tips = viewer.stream('one')
    assert viewer.seen(lambda: len(viewer.points('executed')) == len(tips))
    assert np.abs(viewer.points('executed') - tips).max() < 1e-9
    assert viewer.seen(lambda: len(viewer.points('programmed')) == len(CORNERS))
    assert np.abs(viewer.points('programmed') - CORNERS).max() < 1e-12

    # Who comes later sees it too, a run that goes on keeps it, another one begins anew.
    viewer.markers.clear()
    viewer.look()
    assert viewer.seen(lambda: len(viewer.points('executed')) == len(tips))
    viewer.stream('one', attempt=1)
    assert viewer.seen(lambda: len(viewer.points('executed')) == 2 * len(tips))
    viewer.stream('two')
    assert viewer.seen(lambda: len(viewer.points('executed')) == len(tips))


def test_bodies_of_the_scene_are_drawn_and_a_hit_is_red():
    viewer = Viewer('-p', 'scene:=xyzac')
    try:
        told = viewer.node.create_publisher(DiagnosticArray, '/diagnostics', qos.DIAGNOSTICS)
        bodies = list(drawn_bodies(read_scene('xyzac'), Machine.load('xyzac')))

        def red():
            reds = [m for m in viewer.markers.values() if m.ns == 'bodies' and m.color.r > 0.9]
            return {bodies[m.id].name for m in reds if m.color.g < 0.3}

        def drawn(number, body):
            marker = viewer.markers.get(('bodies', number))
            return marker is not None and len(marker.points) == 3 * len(body.triangles)

        assert viewer.seen(lambda: all(drawn(k, body) for k, body in enumerate(bodies)))
        for k, body in enumerate(bodies):
            marker = viewer.markers['bodies', k]
            assert marker.header.frame_id == body.link
            points = [(p.x, p.y, p.z) for p in marker.points]
            assert np.abs(np.array(points) - body.triangles.reshape(-1, 3)).max() < 1e-12
        assert viewer.seen(told.get_subscription_count) and not red()
        hit = KeyValue(key='bodies', value='nose | cradle')
        status = {'name': 'feedrate_node: collision', 'level': b'\1'}

        def tell(values, namespace):
            status.update(hardware_id=namespace, values=values)
            told.publish(DiagnosticArray(status=[DiagnosticStatus(**status)]))

        tell([hit], '/other')
        tell([hit], viewer.node.get_namespace())
        assert viewer.seen(lambda: red() == {'nose', 'cradle'})
        tell([], viewer.node.get_namespace())
        assert viewer.seen(lambda: not red())
    finally:
        viewer.close()


def test_axes_that_run_linearly_are_drawn_where_the_tool_goes(viewer):
    """C turns by 90 deg with tool-tip control off: the tip runs on an arc about the C axis."""
    text = 'G21 G90\nG0 X0 Y0 Z0 A0 C0\nG1 C90 F3000\nG1 X10 C100\nM30\n'
    blocks = read_text(text, 'turn.ngc', TRANSFORM, Settings()).blocks
    for message in block_messages(blocks, RunId('turn'), 0, 0.03, end=True):
        viewer.blocks.publish(message)
    assert viewer.seen(lambda: len(viewer.points('programmed')) > 100)
    centre = -Machine.load('xyzac').offsets[0, :2]  # of the C axis, from the workpiece zero
    apart = np.linalg.norm(viewer.points('programmed')[:, :2] - centre, axis=1)
    radius, points = np.linalg.norm(centre), viewer.points('programmed')
    on_arc = np.abs(apart - radius) < 1e-9
    assert on_arc.sum() > 50 and on_arc[:50].all()
    steps = np.linalg.norm(np.diff(points[on_arc], axis=0), axis=1)
    assert (steps**2 / (8.0 * radius)).max() < 0.02e-3  # chords stay within the tolerance
    assert np.abs(points[-1] - blocks.tip[-1]).max() < 1e-12
