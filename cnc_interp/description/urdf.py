"""URDF of a machine, as robot_state_publisher, RViz and Foxglove read it."""

from __future__ import annotations

from collections.abc import Iterable
from xml.etree import ElementTree

from cnc_interp.description.links import Description, Joint, Shape, describe_machine
from cnc_interp.machine_model.machine import Machine

HEADER = '<?xml version="1.0"?>\n'
#: Largest force of a joint, which URDF requires and machine files lack [N, N m].
UNKNOWN_EFFORT = 0.0


def urdf_of(machine: Machine) -> str:
    """Return the URDF of a machine, with its axis names as joints and its limits."""
    description = describe_machine(machine)
    robot = ElementTree.Element('robot', name=description.name)
    add_links(robot, description)
    for joint in description.joints:
        add_joint(robot, joint)
    ElementTree.indent(robot)
    return HEADER + ElementTree.tostring(robot, encoding='unicode') + '\n'


def add_links(robot: ElementTree.Element, description: Description) -> None:
    """Add every link with its shapes."""
    for name, shapes in description.links.items():
        link = ElementTree.SubElement(robot, 'link', name=name)
        for shape in shapes:
            add_shape(ElementTree.SubElement(link, 'visual'), shape)


def add_shape(part: ElementTree.Element, shape: Shape) -> None:
    """Add one box or cylinder with its colour."""
    ElementTree.SubElement(part, 'origin', xyz=words(shape.centre), rpy=words(shape.rpy))
    geometry = ElementTree.SubElement(part, 'geometry')
    if shape.is_box:
        ElementTree.SubElement(geometry, 'box', size=words(shape.size))
    else:
        radius, length = shape.size
        ElementTree.SubElement(geometry, 'cylinder', radius=word(radius), length=word(length))
    name = 'colour_' + ''.join(f'{round(255 * x):02x}' for x in shape.colour)
    material = ElementTree.SubElement(part, 'material', name=name)
    ElementTree.SubElement(material, 'color', rgba=words(shape.colour))


def add_joint(robot: ElementTree.Element, joint: Joint) -> None:
    """Add one joint; URDF uses SI units (REP-103)."""
    element = ElementTree.SubElement(robot, 'joint', name=joint.name, type=joint.kind)
    ElementTree.SubElement(element, 'parent', link=joint.parent)
    ElementTree.SubElement(element, 'child', link=joint.child)
    ElementTree.SubElement(element, 'origin', xyz=words(joint.origin), rpy='0 0 0')
    if joint.kind == 'fixed':
        return
    ElementTree.SubElement(element, 'axis', xyz=words(joint.along))
    limit = {'effort': word(UNKNOWN_EFFORT), 'velocity': word(joint.max_velocity)}
    if joint.kind != 'continuous':
        limit['lower'], limit['upper'] = (word(x) for x in joint.travel)
    ElementTree.SubElement(element, 'limit', limit)


def words(values: Iterable[float]) -> str:
    """Write numbers separated by spaces."""
    return ' '.join(word(value) for value in values)


def word(value: float) -> str:
    """Write a number with 15 digits, which is exact to a femtometre without rounding noise."""
    return f'{float(value) + 0.0:.15g}'
