"""A joint between two links of a machine, defined as in a URDF."""

from dataclasses import dataclass

import numpy as np

from cnc_interp.core import FloatArray

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)
UP: Vector = (0.0, 0.0, 1.0)
ARM = 6  #: Number of joints of an arm. Joints of rail and positioner follow in q.
TOOL_TIP, WORKPIECE = 'tool_tip', 'workpiece'  #: Links at the tool tip and at program zero.


@dataclass(frozen=True)
class Joint:
    name: str  #: Name of the axis; for an arm, name of the joint in its URDF.
    kind: str  #: ``prismatic``, ``revolute``, ``continuous`` or ``fixed``.
    parent: str
    child: str
    origin: Vector  #: Origin of the child in the parent's frame, axis at zero [m].
    along: Vector = UP  #: Unit direction of the axis in the child's frame [-].
    travel: tuple[float, float] = (0.0, 0.0)  #: Lowest and highest position [m or rad].
    max_velocity: float = 0.0  #: Velocity limit [m/s or rad/s].
    axis: int = -1  #: Index of the machine axis; -1 for a fixed joint.
    rpy: Vector = ZERO  #: Rotation of the child about fixed X, then Y, then Z [rad].

    @property
    def turn(self) -> FloatArray:
        """(3, 3): Rotation of the child relative to the parent, with the axis at zero."""
        return rotation(*self.rpy)


def rotation(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Return the rotation matrix (3, 3) of a turn about fixed X, then Y, then Z [rad]."""
    (r, p, y), (s, c) = (roll, pitch, yaw), (np.sin, np.cos)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, c(r), -s(r)], [0.0, s(r), c(r)]])
    about_y = np.array([[c(p), 0.0, s(p)], [0.0, 1.0, 0.0], [-s(p), 0.0, c(p)]])
    about_z = np.array([[c(y), -s(y), 0.0], [s(y), c(y), 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about_z @ about_y @ about_x)


def angles(turn: FloatArray) -> Vector:
    """Return roll, pitch and yaw [rad] of a rotation matrix (3, 3)."""
    level = np.hypot(turn[0, 0], turn[1, 0])
    pitch = float(np.arctan2(-turn[2, 0], level))
    if level < 1e-9:  # pitch of 90 deg: only the sum of roll and yaw counts
        return float(np.arctan2(-turn[1, 2], turn[1, 1])), pitch, 0.0
    return (
        float(np.arctan2(turn[2, 1], turn[2, 2])),
        pitch,
        float(np.arctan2(turn[1, 0], turn[0, 0])),
    )


def vector(values: FloatArray) -> Vector:
    x, y, z = (float(value) + 0.0 for value in values)
    return x, y, z
