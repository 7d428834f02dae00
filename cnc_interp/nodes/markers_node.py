"""The markers node: programmed and executed path for RViz and Foxglove; it only listens."""

import math
from collections.abc import Iterable
from functools import partial

import numpy as np
from cnc_interp_msgs.msg import G1Block, G1BlockBatch, SetpointChunk
from geometry_msgs.msg import Point
from rclpy.node import Node
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from cnc_interp.convert.conversion import with_poses
from cnc_interp.core import MM
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.nodes import parameters
from cnc_interp.nodes.node_main import every, run_node
from cnc_interp.nodes.qos import LISTENING, MARKERS
from cnc_interp.wire.path_messages import blocks_from, blocks_of

FRAME = 'workpiece'  #: The frame of programs, see the machines' URDF.
#: Points of one marker: long lines are cut, so that only their end is sent again.
POINTS = 1000
PROGRAMMED = ColorRGBA(r=0.55, g=0.62, b=0.68, a=1.0)
EXECUTED = ColorRGBA(r=0.30, g=0.76, b=0.54, a=1.0)


class MarkerLine:
    """A line that grows, as markers of at most ``POINTS`` points."""

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


class MarkersNode(Node):
    def __init__(self) -> None:
        super().__init__('markers_node')
        values = parameters.declare(self, parameters.MARKERS)
        self._transform = Transform.of(Machine.load(values['machine']))
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
        if self._cleared:
            markers.insert(0, Marker(action=Marker.DELETEALL))
            self._cleared = False
        if markers:
            self._publisher.publish(MarkerArray(markers=markers))


main = partial(run_node, MarkersNode, urgent=False)
