"""
Links and joints of a machine, with simple shapes.

The links are one tree from ``base_link``, the machine frame M. One branch is X, Y, Z and the axes
that carry the tool, down to ``tool_tip``. The other branch is the axes that carry the workpiece,
down to ``workpiece``, the frame of programs and markers. Joints have the names of the axes. With
all axes at zero, all frames are parallel to M.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from cnc_interp.core.arrays import FloatArray
from cnc_interp.description.shapes import (
    TURNING,
    UP,
    ZERO,
    Shape,
    Vector,
    cradle_shapes,
    disc_shapes,
    frame_shapes,
    head_shapes,
    slide_shapes,
    stock_shapes,
    tool_shapes,
    vector,
)
from cnc_interp.machine_model.machine import Machine

BASE, TOOL_TIP, WORKPIECE = 'base_link', 'tool_tip', 'workpiece'


#: Travel of a linear axis without limits, because URDF requires numbers [m].
UNLIMITED = 10.0


@dataclass(frozen=True)
class Joint:
    """The connection of two links."""

    name: str  #: Name of the axis or of the fixed connection.
    kind: str  #: ``prismatic``, ``revolute``, ``continuous`` or ``fixed``.
    #: Names of the links.
    parent: str
    child: str
    origin: Vector  #: Origin of the child in the frame of the parent, with the axis at zero [m].
    along: Vector = UP  #: Unit direction of the axis [-].
    travel: tuple[float, float] = (0.0, 0.0)  #: Lowest and highest position [m or rad].
    max_velocity: float = 0.0  #: Velocity limit [m/s or rad/s].


@dataclass(frozen=True)
class Description:
    """A machine as a tree of links."""

    name: str  #: Name of the machine.
    links: dict[str, tuple[Shape, ...]]  #: Shapes of each link, the base first.
    joints: tuple[Joint, ...]  #: Parents before children.

    def pose(self, link: str, positions: Mapping[str, float]) -> tuple[FloatArray, FloatArray]:
        """
        Return the pose of a link in the base.

        Parameters
        ----------
        positions : mapping of str to float
            Position of each axis by name; 0 if it is missing [m, rad].

        Returns
        -------
        rotation : ndarray, shape (3, 3)
            Rotation matrix of the link in the base [-].
        place : ndarray, shape (3,)
            Origin of the link in the base [m].

        """
        rotation, place = np.eye(3), np.zeros(3)
        joint_of = {joint.child: joint for joint in self.joints}
        while link in joint_of:
            joint = joint_of[link]
            along, value = np.array(joint.along), positions.get(joint.name, 0.0)
            shift = np.array(joint.origin)
            turn = np.eye(3)
            if joint.kind == 'prismatic':
                shift = shift + along * value
            elif joint.kind != 'fixed':
                turn = Rotation.from_rotvec(along * value).as_matrix()
            rotation, place = turn @ rotation, shift + turn @ place
            link = joint.parent
        return rotation, place


def describe_machine(machine: Machine) -> Description:
    """Return links, joints and shapes of a machine; ``Machine`` has the kinematic formula."""
    links: dict[str, tuple[Shape, ...]] = {BASE: frame_shapes(machine)}
    joints: list[Joint] = []

    def add(joint: Joint, *shapes: Shape) -> str:
        joints.append(joint)
        links[joint.child] = shapes
        return joint.child

    carrier = BASE
    for k, (name, shapes) in enumerate(zip('XYZ', slide_shapes(), strict=True)):
        joint = axis_joint(
            machine, k, carrier, f'{name.lower()}_slide', ZERO, vector(np.eye(3)[k])
        )
        carrier = add(joint, *shapes)

    # The tip is at X Y Z in M while the head is at zero; its pivots lie above the tip.
    arms = machine.tool_offset[::-1] * any(machine.rotary_on_head)  # primary pivot first
    on_head, on_table, table = arms.sum(axis=0), np.zeros(3), BASE
    first = len(machine.axis_names) - len(machine.extra_names)
    for k, (name, along) in enumerate(
        zip(machine.extra_names, machine.extra_direction, strict=True), start=first
    ):
        joint = axis_joint(machine, k, carrier, f'{name.lower()}_slide', ZERO, vector(along))
        carrier = add(joint, Shape((0.06, 0.06, 0.5), (0.02, 0.0, 0.45), TURNING))
    for k in range(3, first):
        arm, offset = arms[k - 3], machine.offsets[5 - k]
        letter, along = machine.axis_names[k].lower(), vector(machine.rotary_direction[k - 3])
        on_table = on_table + offset
        if machine.rotary_on_head[k - 3]:
            joint = axis_joint(machine, k, carrier, f'{letter}_head', vector(on_head), along)
            carrier = add(joint, *head_shapes(along, vector(-arm)))
            on_head = np.zeros(3)
        else:
            joint = axis_joint(machine, k, table, f'{letter}_table', vector(on_table), along)
            tilts_another = k == 3 and not machine.rotary_on_head[1]
            table = add(joint, *(cradle_shapes if tilts_another else disc_shapes)(machine))
            on_table = np.zeros(3)
        on_head = on_head - arm
    add(Joint('tool', 'fixed', carrier, TOOL_TIP, vector(on_head)), *tool_shapes())
    zero = on_table + machine.offsets[0]
    add(Joint('clamping', 'fixed', table, WORKPIECE, vector(zero)), *stock_shapes(machine))
    return Description(machine.name, links, tuple(joints))


def axis_joint(
    machine: Machine, k: int, parent: str, child: str, origin: Vector, along: Vector
) -> Joint:
    """Return the joint of an axis; an endless rotary axis has no travel."""
    axis = machine.axes[k]
    kind = 'prismatic' if axis.linear else 'continuous' if axis.endless else 'revolute'
    travel = (-UNLIMITED, UNLIMITED) if axis.endless else axis.travel
    return Joint(axis.name, kind, parent, child, origin, along, travel, axis.max_velocity)
