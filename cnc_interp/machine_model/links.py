"""Links of a machine and the joints between them: one tree from ``base_link``.

Two branches leave the machine frame M: X, Y, Z and the axes that carry the tool, down to
``tool_tip``; the axes that carry the workpiece, down to ``workpiece``, the frame of programs.
Joints have the names of the axes. With all axes at zero, all frames are parallel to M.
"""

from dataclasses import dataclass

import numpy as np

from cnc_interp.core import FloatArray, MachineError
from cnc_interp.machine_model.machine import Machine

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)
UP: Vector = (0.0, 0.0, 1.0)
BASE, TOOL_TIP, WORKPIECE = 'base_link', 'tool_tip', 'workpiece'
UNLIMITED = 10.0  #: Travel of a linear axis without limits, because URDF requires numbers [m].


@dataclass(frozen=True)
class Joint:
    name: str  #: Name of the axis or of the fixed connection.
    kind: str  #: ``prismatic``, ``revolute``, ``continuous`` or ``fixed``.
    parent: str
    child: str
    origin: Vector  #: Origin of the child in the frame of the parent, with the axis at zero [m].
    along: Vector = UP  #: Unit direction of the axis [-].
    travel: tuple[float, float] = (0.0, 0.0)  #: Lowest and highest position [m or rad].
    max_velocity: float = 0.0  #: Velocity limit [m/s or rad/s].
    axis: int = -1  #: Index of the axis; -1 of a fixed connection.


def vector(values: FloatArray) -> Vector:
    x, y, z = (float(value) + 0.0 for value in values)
    return x, y, z


def joints_of(machine: Machine) -> tuple[Joint, ...]:
    """Return the joints of a machine, parents before children."""
    if machine.arm is not None:
        raise MachineError(f'{machine.name} is an arm; its machine file names its own URDF')
    joints: list[Joint] = []

    def add(k: int, parent: str, child: str, origin: Vector, along: Vector) -> str:
        axis = machine.axes[k]
        kind = 'prismatic' if axis.linear else 'continuous' if axis.endless else 'revolute'
        travel = (-UNLIMITED, UNLIMITED) if axis.endless else axis.travel
        speed = axis.max_velocity
        joints.append(Joint(axis.name, kind, parent, child, origin, along, travel, speed, k))
        return child

    carrier, table = BASE, BASE
    for k, name in enumerate('xyz'):
        carrier = add(k, carrier, f'{name}_slide', ZERO, vector(np.eye(3)[k]))
    # The tip is at X Y Z in M while the head is at zero; its pivots lie above the tip.
    arms = machine.tool_offset[::-1] * any(machine.rotary_on_head)  # primary pivot first
    on_head, on_table = arms.sum(axis=0), np.zeros(3)
    first = len(machine.axis_names) - len(machine.extra_names)
    for k, along in enumerate(machine.extra_direction, start=first):
        name = machine.axis_names[k].lower()
        carrier = add(k, carrier, f'{name}_slide', ZERO, vector(along))
    for k in range(3, first):
        name, along = machine.axis_names[k].lower(), machine.rotary_direction[k - 3]
        on_table = on_table + machine.offsets[5 - k]
        if machine.rotary_on_head[k - 3]:
            carrier = add(k, carrier, f'{name}_head', vector(on_head), vector(along))
            on_head = np.zeros(3)
        else:
            table = add(k, table, f'{name}_table', vector(on_table), vector(along))
            on_table = np.zeros(3)
        on_head = on_head - arms[k - 3]
    joints.append(Joint('tool', 'fixed', carrier, TOOL_TIP, vector(on_head)))
    zero = vector(on_table + machine.offsets[0])
    joints.append(Joint('clamping', 'fixed', table, WORKPIECE, zero))
    return tuple(joints)
