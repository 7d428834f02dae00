"""The MTConnect device that describes a machine: its components and their data items.

Names and types are those of MTConnect 2.4, part 2 (devices) and part 3 (observations).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from uuid import NAMESPACE_DNS, uuid5

from cnc_interp.core import DEG, MM
from cnc_interp.machine_model.joint import Joint
from cnc_interp.machine_model.links import BASE, joints_of
from cnc_interp.machine_model.machine import Machine

SAMPLE, EVENT, CONDITION = 'SAMPLE', 'EVENT', 'CONDITION'
ACTUAL, COMMANDED, PROGRAMMED, RAPID = 'ACTUAL', 'COMMANDED', 'PROGRAMMED', 'RAPID'
#: Node -> condition that its diagnostics report; and the condition of all other nodes.
CONDITION_OF = {'program_node': 'LOGIC_PROGRAM', 'machine_node': 'SYSTEM'}
OTHER_CONDITION = 'MOTION_PROGRAM'


@dataclass(frozen=True)
class DataItem:
    id: str
    type: str
    category: str
    sub_type: str = ''
    units: str = ''

    @property
    def element(self) -> str:
        """Name of the XML element of this data item in a streams document."""
        return self.type.title().replace('_', '')


@dataclass(frozen=True)
class Component:
    kind: str  #: Name of its XML element, such as ``Linear``.
    id: str
    name: str = ''
    items: tuple[DataItem, ...] = ()
    parts: tuple[Component, ...] = ()
    joint: Joint | None = None  #: Joint of an axis; None for other components.
    carrier: str = ''  #: Name of the axis that carries it; empty for the bed.
    uuid: str = ''  #: UUID of the device; empty for components.

    def walk(self) -> Iterator[Component]:
        """Yield this component and all its parts."""
        yield self
        for part in self.parts:
            yield from part.walk()


def _axis(machine: Machine, number: int, joints: dict[str, Joint]) -> Component:
    axis = machine.axes[number]
    name = axis.name
    kind, type_, units = (
        ('Linear', 'POSITION', 'MILLIMETER') if axis.linear else ('Rotary', 'ANGLE', 'DEGREE')
    )
    items = tuple(
        DataItem(f'{name}_{sub.lower()}', type_, SAMPLE, sub, units) for sub in (ACTUAL, COMMANDED)
    )
    carriers = {one.child: one.name for one in joints.values()}
    joint = joints.get(name)
    carrier = carriers.get(joint.parent, '') if joint and joint.parent != BASE else ''
    return Component(kind, f'axis_{name}', name, items, joint=joint, carrier=carrier)


def name_of(machine: str) -> str:
    """Return the name of a machine, with letters, digits and underscores only."""
    return ''.join(c if c.isalnum() else '_' for c in machine)


def device_of(machine: Machine, host: str) -> Component:
    """Return the device of a machine; its UUID is a hash of the names of host and machine."""
    joints = {} if machine.arm is not None else {one.name: one for one in joints_of(machine)}
    axes = [_axis(machine, number, joints) for number in range(len(machine.axis_names))]
    spindle = (
        DataItem('spindle_speed', 'ROTARY_VELOCITY', SAMPLE, ACTUAL, 'REVOLUTION/MINUTE'),
        DataItem('spindle_wanted', 'ROTARY_VELOCITY', SAMPLE, PROGRAMMED, 'REVOLUTION/MINUTE'),
        DataItem('spindle_override', 'ROTARY_VELOCITY_OVERRIDE', EVENT),
    )
    axes.append(Component('Rotary', 'spindle', 'S', spindle))
    path = (
        DataItem('execution', 'EXECUTION', EVENT),
        DataItem('mode', 'CONTROLLER_MODE', EVENT),
        DataItem('program', 'PROGRAM', EVENT),
        DataItem('line', 'LINE_NUMBER', EVENT, 'ABSOLUTE'),
        DataItem('block', 'BLOCK', EVENT),
        DataItem('feed', 'PATH_FEEDRATE', SAMPLE, ACTUAL, 'MILLIMETER/SECOND'),
        DataItem('feed_override', 'PATH_FEEDRATE_OVERRIDE', EVENT, PROGRAMMED),
        DataItem('rapid_override', 'PATH_FEEDRATE_OVERRIDE', EVENT, RAPID),
        DataItem('tip', 'PATH_POSITION', SAMPLE, ACTUAL, 'MILLIMETER_3D'),
        DataItem('tool', 'TOOL_NUMBER', EVENT),
        DataItem('tool_asset', 'TOOL_ASSET_ID', EVENT),
        DataItem('parts', 'PART_COUNT', EVENT, 'ALL'),
        DataItem('motion', OTHER_CONDITION, CONDITION),
        DataItem('logic', 'LOGIC_PROGRAM', CONDITION),
    )
    controller = (
        DataItem('emergency_stop', 'EMERGENCY_STOP', EVENT),
        DataItem('system', 'SYSTEM', CONDITION),
        DataItem('communications', 'COMMUNICATIONS', CONDITION),
    )
    parts = (
        Component('Axes', 'axes', parts=tuple(axes)),
        Component(
            'Controller',
            'controller',
            items=controller,
            parts=(Component('Path', 'path', 'path', path),),
        ),
    )
    # Asset events are required of each device since version 1.5.
    own = (
        DataItem('availability', 'AVAILABILITY', EVENT),
        DataItem('asset_changed', 'ASSET_CHANGED', EVENT),
        DataItem('asset_removed', 'ASSET_REMOVED', EVENT),
    )
    identity = str(uuid5(NAMESPACE_DNS, f'{host}/{machine.name}'))
    return Component('Device', 'device', name_of(machine.name), own, parts, uuid=identity)


def items_of(device: Component) -> dict[str, DataItem]:
    return {item.id: item for part in device.walk() for item in part.items}


def in_units(machine: Machine, number: int, value: float) -> float:
    """Return a position ``value`` [m or rad] of axis ``number`` in mm or deg."""
    return value / (MM if machine.axes[number].linear else DEG)
