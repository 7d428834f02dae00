"""Simple shapes for the links of a machine, and its URDF for RViz, Foxglove and others."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from cnc_interp.core import FloatArray
from cnc_interp.machine_model.joint import (
    TOOL_TIP,
    UP,
    WORKPIECE,
    ZERO,
    Joint,
    Vector,
    vector,
)
from cnc_interp.machine_model.links import BASE, joints_of
from cnc_interp.machine_model.machine import Machine

if TYPE_CHECKING:
    from cnc_interp.collision.drawing import DrawnBody

Colour = tuple[float, float, float, float]
IRON: Colour = (0.33, 0.38, 0.43, 1.0)
SLIDE: Colour = (0.50, 0.56, 0.62, 1.0)
TURNING: Colour = (0.24, 0.47, 0.66, 1.0)
STEEL: Colour = (0.58, 0.63, 0.68, 1.0)
CUTTER: Colour = (0.88, 0.55, 0.14, 1.0)
STOCK: Colour = (0.70, 0.74, 0.78, 0.35)
FIXTURE: Colour = (0.66, 0.50, 0.30, 1.0)
HIT: Colour = (0.92, 0.18, 0.20, 1.0)  #: Colour of bodies that hit each other.
#: Height above the tool tip, and half width, of the bridge for a travel of 0.5 m [m].
BRIDGE, HALF_WIDTH = 0.78, 0.68
LIMB = 0.025  #: Radius of an arm's limb over the length of the arm [-].


@dataclass(frozen=True)
class Shape:
    size: tuple[float, ...]  #: Three edges of a box, or radius and length of a cylinder [m].
    centre: Vector  #: Centre in the frame of the link [m].
    colour: Colour  #: Red, green, blue and opacity, 0 to 1.
    along: Vector = UP  #: Unit direction of a cylinder's axis [-].

    @property
    def is_box(self) -> bool:
        return len(self.size) == 3

    @property
    def rpy(self) -> Vector:
        """Roll, pitch and yaw that turn the z axis into the direction of the cylinder [rad]."""
        x, y, z = self.along
        return 0.0, float(np.arctan2(np.hypot(x, y), z)), float(np.arctan2(y, x))


def table_radius(machine: Machine) -> float:
    return 0.09 + float(np.linalg.norm(machine.offsets[0, :2]))


def frame_shapes(machine: Machine) -> tuple[Shape, ...]:
    rail, reach = 0.06, 0.62
    shapes = [Shape((1.6, 1.6, 0.04), (0.0, 0.0, -0.36), IRON)]
    for side in (-HALF_WIDTH, HALF_WIDTH):
        shapes.append(Shape((2 * reach + rail, rail, rail), (0.0, side, BRIDGE - 0.1), IRON))
        for end in (-reach, reach):
            height = BRIDGE - 0.1 + 0.34
            post = (end, side, BRIDGE - 0.1 - height / 2)
            shapes.append(Shape((rail, rail, height), post, IRON))
    if not machine.has_rotary or all(machine.rotary_on_head):
        shapes.append(Shape((0.5, 0.4, 0.34), (0.0, 0.0, -0.19 + machine.offsets[0, 2]), IRON))
        return tuple(shapes)
    primary = machine.offsets[2]
    along = machine.rotary_direction[0]
    if machine.rotary_on_head[0] or abs(along[2]) > 0.5:
        shapes.append(Shape((0.2, 0.32), vector(primary - [0.0, 0.0, 0.19]), IRON))
        return tuple(shapes)
    half = table_radius(machine) + 0.06
    for side in (-half, half):
        place = primary + side * along
        height = 0.34 + place[2] + 0.05
        foot = (float(place[0]), float(place[1]), float(place[2]) + 0.05 - height / 2)
        shapes.append(Shape((0.07, 0.07, height), foot, IRON))
    return tuple(shapes)


#: Shapes of the bridge, the saddle and the ram, which X, Y and Z move.
SLIDES = (
    Shape((0.10, 2 * HALF_WIDTH, 0.12), (-0.13, 0.0, BRIDGE), SLIDE),
    Shape((0.12, 0.20, 0.20), (-0.06, 0.0, BRIDGE), IRON),
    Shape((0.09, 0.09, 0.75), (0.02, 0.0, 0.63), SLIDE),
)
TOOL = (
    Shape((0.004, 0.05), (0.0, 0.0, 0.025), CUTTER),
    Shape((0.018, 0.06), (0.0, 0.0, 0.08), STEEL),
    Shape((0.038, 0.15), (0.0, 0.0, 0.185), IRON),
)


def cradle_shapes(machine: Machine) -> tuple[Shape, ...]:
    along = vector(machine.rotary_direction[0])
    radius = table_radius(machine)
    shaft = Shape((0.035, 2 * radius + 0.10), ZERO, TURNING, along)
    top = machine.offsets[1]
    height = max(0.02, float(top[2]) - 0.025)
    block = Shape(
        (1.1 * radius, 1.1 * radius, height), vector(top - [0, 0, 0.025 + height / 2]), TURNING
    )
    return shaft, block


def disc_shapes(machine: Machine) -> tuple[Shape, ...]:
    radius = table_radius(machine)
    disc = Shape((radius, 0.025), (0.0, 0.0, -0.0125), STEEL)
    slot = Shape((0.85 * radius, 0.012, 0.003), (0.5 * radius, 0.0, 0.0), IRON)
    return disc, slot


def head_shapes(along: Vector, arm: Vector) -> tuple[Shape, ...]:
    length = float(np.linalg.norm(arm))
    hub = Shape((0.05, 0.12), ZERO, TURNING, along)
    if length < 0.05:
        return (hub,)
    direction = vector(np.array(arm) / length)
    middle = vector(np.array(arm) * 0.25)
    return hub, Shape((0.03, 0.5 * length), middle, SLIDE, direction)


def stock_shape(machine: Machine) -> Shape:
    height = abs(float(machine.offsets[0, 2]))
    if height < 1e-3:
        return Shape((0.2, 0.2, 0.02), (0.0, 0.0, -0.01), STOCK)
    return Shape((0.1, 0.1, height), (0.0, 0.0, -height / 2), STOCK)


@dataclass(frozen=True)
class Description:
    name: str  #: Name of the machine.
    links: dict[str, tuple[Shape, ...]]  #: Link -> its shapes; the base comes first.
    joints: tuple[Joint, ...]  #: All joints, parents before children.
    bodies: tuple[DrawnBody, ...] = ()  #: Bodies of a scene; they replace all shapes.

    def pose(self, link: str, positions: Mapping[str, float]) -> tuple[FloatArray, FloatArray]:
        """Return rotation (3, 3) and origin (3,) [m] of a link in the base; missing axes at 0."""
        rotation, place = np.eye(3), np.zeros(3)
        joint_of = {joint.child: joint for joint in self.joints}
        while link in joint_of:
            joint = joint_of[link]
            along, value = np.array(joint.along), positions.get(joint.name, 0.0)
            shift, turn = np.array(joint.origin), joint.turn
            if joint.kind == 'prismatic':
                shift = shift + along * value
            elif joint.kind != 'fixed':
                turn = turn @ Rotation.from_rotvec(along * value).as_matrix()
            rotation, place = turn @ rotation, shift + turn @ place
            link = joint.parent
        return rotation, place


def describe_machine(machine: Machine, bodies: Sequence[DrawnBody] = ()) -> Description:
    joints, links = joints_of(machine), dict[str, tuple[Shape, ...]]()
    if machine.arm is None:
        links[BASE] = frame_shapes(machine)
        links |= {joint.child: shapes_of(machine, joint) for joint in joints}
    else:
        links[joints[0].parent] = ()
        links |= {joint.child: () for joint in joints}
        links |= arm_shapes(joints) | {TOOL_TIP: TOOL, WORKPIECE: (stock_shape(machine),)}
    if bodies:
        links = dict.fromkeys(links, ())
    return Description(machine.name, links, joints, tuple(bodies))


def colour_of(body: DrawnBody) -> Colour:
    """Return the colour of a scene body, which depends on its role or its link."""
    roles = {'STOCK': STOCK, 'CUTTER': CUTTER, 'SHANK': STEEL, 'HOLDER': IRON}
    links = {BASE: IRON, WORKPIECE: FIXTURE, TOOL_TIP: CUTTER}
    turns = body.link.endswith(('_table', '_head'))
    return roles.get(body.role.name, links.get(body.link, TURNING if turns else SLIDE))


def shapes_of(machine: Machine, joint: Joint) -> tuple[Shape, ...]:
    """Return simple shapes for the link that ``joint`` moves."""
    k, child = joint.axis, joint.child
    if child == TOOL_TIP:
        return TOOL
    if child == WORKPIECE:
        return (stock_shape(machine),)
    if joint.kind == 'prismatic':
        extra = Shape((0.06, 0.06, 0.5), (0.02, 0.0, 0.45), TURNING)
        return (SLIDES[k] if k < len(SLIDES) else extra,)
    if machine.rotary_on_head[k - 3]:
        arm = machine.tool_offset[::-1][k - 3]
        return head_shapes(joint.along, vector(-arm))
    tilts_another = k == 3 and not machine.rotary_on_head[1]
    return (cradle_shapes if tilts_another else disc_shapes)(machine)


def arm_shapes(joints: Sequence[Joint]) -> dict[str, tuple[Shape, ...]]:
    """Return link -> limbs for an arm without shapes in its URDF; a limb joins two joints."""
    size, found = sum(float(np.linalg.norm(joint.origin)) for joint in joints), {}
    for link in {joint.parent for joint in joints}:
        shapes = list[Shape]()
        for joint in joints:
            length = float(np.linalg.norm(joint.origin))
            thick = LIMB * size
            if joint.child == link and joint.axis >= 0:
                shapes.append(Shape((1.2 * thick, 2.0 * thick), ZERO, TURNING, joint.along))
            if joint.parent == link and length > 0.0 and joint.child != WORKPIECE:
                along, middle = vector(np.array(joint.origin) / length), np.array(joint.origin) / 2
                shapes.append(Shape((thick, length), vector(middle), SLIDE, along))
        found[link] = tuple(shapes)
    return found


HEADER = '<?xml version="1.0"?>\n'
UNKNOWN_EFFORT = 0.0  #: Largest force of a joint: required in a URDF, but unknown [N, N m].


def urdf_of(
    machine: Machine,
    bodies: Sequence[DrawnBody] = (),
    meshes: Sequence[str] = (),
    frames_only: bool = False,
) -> str:
    """Return the URDF of a machine, with simple shapes or with scene bodies and their STL files.

    If the URDF of an arm has shapes, it is returned with added frames of tool tip and part.
    """
    description = describe_machine(machine, bodies)
    robot = ElementTree.Element('robot', name=description.name)
    if machine.arm is not None and not bodies and not frames_only:
        own = ElementTree.fromstring(machine.arm.urdf)
        if own.find('.//visual') is not None:
            for joint in description.joints:
                if joint.child in (TOOL_TIP, WORKPIECE):
                    ElementTree.SubElement(own, 'link', name=joint.child)
                    add_joint(own, joint)
            return HEADER + ElementTree.tostring(own, encoding='unicode') + '\n'
    for name, shapes in description.links.items():
        link = ElementTree.SubElement(robot, 'link', name=name)
        for shape in () if frames_only else shapes:
            add_shape(ElementTree.SubElement(link, 'visual'), shape)
        for body, file in zip(bodies, meshes, strict=True):
            if body.link == name:
                add_mesh(link, body, file)
    for joint in description.joints:
        add_joint(robot, joint)
    ElementTree.indent(robot)
    return HEADER + ElementTree.tostring(robot, encoding='unicode') + '\n'


def add_shape(part: ElementTree.Element, shape: Shape) -> None:
    ElementTree.SubElement(part, 'origin', xyz=words(shape.centre), rpy=words(shape.rpy))
    geometry = ElementTree.SubElement(part, 'geometry')
    if shape.is_box:
        ElementTree.SubElement(geometry, 'box', size=words(shape.size))
    else:
        radius, length = shape.size
        ElementTree.SubElement(geometry, 'cylinder', radius=word(radius), length=word(length))
    add_colour(part, shape.colour)


def add_mesh(link: ElementTree.Element, body: DrawnBody, file: str) -> None:
    for kind in ('visual', 'collision'):
        part = ElementTree.SubElement(link, kind, name=body.name)
        ElementTree.SubElement(ElementTree.SubElement(part, 'geometry'), 'mesh', filename=file)
        if kind == 'visual':
            add_colour(part, colour_of(body))


def add_colour(part: ElementTree.Element, colour: Colour) -> None:
    name = 'colour_' + ''.join(f'{round(255 * x):02x}' for x in colour)
    material = ElementTree.SubElement(part, 'material', name=name)
    ElementTree.SubElement(material, 'color', rgba=words(colour))


def add_joint(robot: ElementTree.Element, joint: Joint) -> None:
    element = ElementTree.SubElement(robot, 'joint', name=joint.name, type=joint.kind)
    ElementTree.SubElement(element, 'parent', link=joint.parent)
    ElementTree.SubElement(element, 'child', link=joint.child)
    ElementTree.SubElement(element, 'origin', xyz=words(joint.origin), rpy=words(joint.rpy))
    if joint.kind == 'fixed':
        return
    ElementTree.SubElement(element, 'axis', xyz=words(joint.along))
    limit = {'effort': word(UNKNOWN_EFFORT), 'velocity': word(joint.max_velocity)}
    if joint.kind != 'continuous':
        limit['lower'], limit['upper'] = (word(x) for x in joint.travel)
    ElementTree.SubElement(element, 'limit', limit)


def words(values: Iterable[float]) -> str:
    return ' '.join(word(value) for value in values)


def word(value: float) -> str:
    """Return a number as text with 15 digits: exact to a femtometre, without rounding noise."""
    return f'{float(value) + 0.0:.15g}'
