"""Links of a machine and the joints between them: one tree from ``base_link``.

Two branches start at the machine frame M. One has X, Y, Z and the axes that carry the tool, and
ends at ``tool_tip``. The other has the axes that carry the workpiece, and ends at ``workpiece``,
the frame of programs. Joints have the names of the axes. At zero all frames are parallel to M.

An arm has the links and joints of its URDF, beginning at the base. A fixed joint leads from the
flange to ``tool_tip``, whose Z is the tool axis, and another one from the base to ``workpiece``.
"""

import numpy as np

from cnc_interp.machine_model.joint import TOOL_TIP, WORKPIECE, ZERO, Joint, Vector, vector
from cnc_interp.machine_model.machine import Machine

BASE = 'base_link'
#: Travel in the URDF of a linear axis without travel limits; URDF requires numbers [m].
UNLIMITED = 10.0


def joints_of(machine: Machine) -> tuple[Joint, ...]:
    """Return all joints of a machine, parents before children, beginning at the base."""
    if machine.arm is not None:
        return machine.arm.tree
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
