"""The markers node: shows both paths and the bodies of a scene in RViz and Foxglove."""

import math
from collections.abc import Iterable
from functools import partial
from pathlib import Path

import numpy as np
from cnc_interp_msgs.msg import G1Block, G1BlockBatch, SetpointChunk, SetupTable
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point
from rclpy.node import Node
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from cnc_interp.collision.drawing import DrawnBody, drawn_bodies
from cnc_interp.collision.scene_file import read_scene
from cnc_interp.convert.conversion import with_poses
from cnc_interp.core import MM
from cnc_interp.description.urdf import HIT, colour_of
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.nodes import parameters
from cnc_interp.nodes.node_main import AND, BODIES, every, run_node
from cnc_interp.nodes.qos import DIAGNOSTICS, LISTENING, LOADED, MARKERS
from cnc_interp.program.job import JobSetup
from cnc_interp.run.clearance_stage import setup_text
from cnc_interp.wire.path_messages import blocks_from, blocks_of

FRAME = 'workpiece'  #: Frame of programs in the URDF of the machine.
#: Largest number of points of a marker. Longer lines have several; only the last is resent.
POINTS = 1000
PROGRAMMED = ColorRGBA(r=0.55, g=0.62, b=0.68, a=1.0)
EXECUTED = ColorRGBA(r=0.30, g=0.76, b=0.54, a=1.0)


class MarkerLine:
    """A growing line, shown as markers of at most ``POINTS`` points."""

    def __init__(self, name: str, colour: ColorRGBA, width: float, spacing: float):
        self._name, self._colour, self._width, self._spacing = name, colour, width, spacing
        self._markers: list[Marker] = []
        self._last: tuple[float, ...] | None = None
        self._first_changed = 0

    def clear(self) -> None:
        self._markers, self._last, self._first_changed = [], None, 0

    def add(self, place: Iterable[float]) -> None:
        found = tuple(float(x) for x in place)
        if self._last is not None and math.dist(found, self._last) < self._spacing:
            return
        point = Point(x=found[0], y=found[1], z=found[2])
        if not self._markers or len(self._markers[-1].points) >= POINTS:
            joint = [self._markers[-1].points[-1]] if self._markers else []
            self._markers.append(self._empty(joint))
        self._markers[-1].points.append(point)
        self._first_changed = min(self._first_changed, len(self._markers) - 1)
        self._last = found

    def _empty(self, points: list[Point]) -> Marker:
        marker = Marker(
            ns=self._name,
            id=len(self._markers),
            type=Marker.LINE_STRIP,
            action=Marker.ADD,
            color=self._colour,
            points=points,
        )
        marker.header.frame_id = FRAME
        marker.scale.x = self._width
        marker.pose.orientation.w = 1.0
        return marker

    def news(self, everything: bool) -> list[Marker]:
        first = 0 if everything else self._first_changed
        self._first_changed = len(self._markers)
        return [marker for marker in self._markers[first:] if len(marker.points) > 1]


class BodyMarkers:
    """The bodies of a scene, in the frames of their links; bodies that hit each other are red."""

    def __init__(self, scene: Path, setup: Path | None, machine: Machine):
        read = read_scene(scene, setup_text(setup))
        self._bodies = tuple(drawn_bodies(read, machine))
        self._first_tool = read.first_tool
        self._tool, self._hits = 0, dict[str, tuple[str, ...]]()
        self._changed = True

    def see_table(self, table: SetupTable) -> None:
        tool = JobSetup.of_text(table.text).tool
        self._changed |= tool != self._tool
        self._tool = tool

    def see_hits(self, namespace: str, array: DiagnosticArray) -> None:
        before = dict(self._hits)
        for status in array.status:
            if status.hardware_id == namespace:
                self._hits.pop(status.name, None)
                values = {pair.key: pair.value for pair in status.values}
                if BODIES in values:
                    self._hits[status.name] = tuple(values[BODIES].split(AND))
        self._changed |= before != self._hits

    def news(self, everything: bool) -> list[Marker]:
        changed, self._changed = self._changed, False
        if not (changed or everything):
            return []
        return [self._marker(number, body) for number, body in enumerate(self._bodies)]

    def _marker(self, number: int, body: DrawnBody) -> Marker:
        here = body.tool in (0, self._tool or self._first_tool)
        hit = any(body.name in names for names in self._hits.values())
        r, g, b, a = HIT if hit else colour_of(body)
        marker = Marker(ns='bodies', id=number, type=Marker.TRIANGLE_LIST)
        marker.action = Marker.ADD if here else Marker.DELETE
        marker.header.frame_id, marker.frame_locked = body.link, True
        marker.color = ColorRGBA(r=r, g=g, b=b, a=a)
        marker.scale.x = marker.scale.y = marker.scale.z = marker.pose.orientation.w = 1.0
        corners = body.triangles.reshape(-1, 3).tolist()
        marker.points = [Point(x=x, y=y, z=z) for x, y, z in corners]
        return marker


class MarkersNode(Node):
    def __init__(self) -> None:
        super().__init__('markers_node')
        values = parameters.declare(self, parameters.MARKERS)
        machine = Machine.load(values['machine'])
        self._transform = Transform.of(machine)
        found = parameters.settings_of(values)
        self._bodies: BodyMarkers | None = None
        if found.scene is not None:
            self._bodies = BodyMarkers(found.scene, found.setup, machine)
            see = partial(self._bodies.see_hits, self.get_namespace())
            self.create_subscription(DiagnosticArray, '/diagnostics', see, DIAGNOSTICS)
            see_table = self._bodies.see_table
            self.create_subscription(SetupTable, 'setup_table', see_table, LOADED)
        spacing = values['spacing']
        self._programmed = MarkerLine('programmed', PROGRAMMED, 0.3 * MM, spacing)
        self._executed = MarkerLine('executed', EXECUTED, 0.6 * MM, spacing)
        self._program_id, self._sequence = '', -1
        self._block: G1Block | None = None
        self._cleared, self._viewers = False, 0
        self._publisher = self.create_publisher(MarkerArray, 'markers', MARKERS)
        self.create_subscription(G1Block, 'blocks', self._see_blocks, LISTENING)
        self.create_subscription(G1BlockBatch, 'block_batches', self._see_blocks, LISTENING)
        self.create_subscription(SetpointChunk, 'executed_setpoints', self._see_motion, LISTENING)
        every(self, 1.0 / values['rate'], self._tell)

    def _begin(self, program_id: str) -> None:
        if program_id != self._program_id:
            self._program_id, self._sequence, self._cleared = program_id, -1, True
            self._programmed.clear()
            self._executed.clear()

    def _see_blocks(self, message: G1Block | G1BlockBatch) -> None:
        for block in blocks_of(message):
            self._see_block(block)

    def _see_block(self, block: G1Block) -> None:
        self._begin(block.program_id)
        if block.sequence <= self._sequence:  # a repeated block is drawn already
            return
        tips = [block.tip]
        follows = 0 < block.sequence == self._sequence + 1
        if follows and block.interpolation == G1Block.AXES_LINEAR:
            # The axes run linearly, so the tip runs on a curve.
            pair = blocks_from([self._block, block])
            tips = list(with_poses(pair, self._transform, block.flank_height).tip[1:])
        for tip in tips:
            self._programmed.add(tip)
        self._sequence, self._block = block.sequence, block

    def _see_motion(self, chunk: SetpointChunk) -> None:
        q = np.reshape(chunk.positions, (-1, chunk.axis_count))
        if len(q) and chunk.sequences[-1] > 0:  # neither approach nor motion by hand
            self._begin(chunk.program_id)
            tip, _ = self._transform.forward(q[-1:])
            self._executed.add(tip[0])

    def _tell(self) -> None:
        viewers = self.count_subscribers('markers')
        everything, self._viewers = viewers > self._viewers, viewers
        markers = self._programmed.news(everything) + self._executed.news(everything)
        if self._bodies is not None:
            markers += self._bodies.news(everything or self._cleared)
        if self._cleared:
            markers.insert(0, Marker(action=Marker.DELETEALL))
            self._cleared = False
        if markers:
            self._publisher.publish(MarkerArray(markers=markers))


main = partial(run_node, MarkersNode, urgent=False)
