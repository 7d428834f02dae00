"""Boxes and cylinders that show the parts of a machine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.machine_model.machine import Machine

Vector = tuple[float, float, float]
Colour = tuple[float, float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)
UP: Vector = (0.0, 0.0, 1.0)
IRON: Colour = (0.33, 0.38, 0.43, 1.0)
SLIDE: Colour = (0.50, 0.56, 0.62, 1.0)
TURNING: Colour = (0.24, 0.47, 0.66, 1.0)
STEEL: Colour = (0.58, 0.63, 0.68, 1.0)
CUTTER: Colour = (0.88, 0.55, 0.14, 1.0)
STOCK: Colour = (0.70, 0.74, 0.78, 0.35)
#: Height of the bridge above the tool tip, and its half width, for travels of half a metre [m].
BRIDGE, HALF_WIDTH = 0.78, 0.68


@dataclass(frozen=True)
class Shape:
    """A box or a cylinder."""

    size: tuple[float, ...]  #: Edges of a box (3), or radius and length of a cylinder (2) [m].
    centre: Vector  #: Middle, in the frame of the link [m].
    colour: Colour  #: Red, green, blue and opacity, 0 to 1.
    along: Vector = UP  #: Unit direction of a cylinder's axis [-].

    @property
    def is_box(self) -> bool:
        """True for a box, false for a cylinder."""
        return len(self.size) == 3

    @property
    def rpy(self) -> Vector:
        """Roll, pitch and yaw that turn the z axis into the direction of the cylinder [rad]."""
        x, y, z = self.along
        return 0.0, float(np.arctan2(np.hypot(x, y), z)), float(np.arctan2(y, x))


def vector(values: FloatArray) -> Vector:
    """Return three numbers as floats, without negative zeros."""
    x, y, z = (float(value) + 0.0 for value in values)
    return x, y, z


def table_radius(machine: Machine) -> float:
    """Choose the radius of the table so that the workpiece zero lies well inside."""
    return 0.09 + float(np.linalg.norm(machine.offsets[0, :2]))


def frame_shapes(machine: Machine) -> tuple[Shape, ...]:
    """Draw the fixed parts: rails of the bridge on posts, and the support of the table."""
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


def slide_shapes() -> tuple[tuple[Shape, ...], ...]:
    """Draw bridge, saddle and ram, one tuple each."""
    bridge = Shape((0.10, 2 * HALF_WIDTH, 0.12), (-0.13, 0.0, BRIDGE), SLIDE)
    saddle = Shape((0.12, 0.20, 0.20), (-0.06, 0.0, BRIDGE), IRON)
    ram = Shape((0.09, 0.09, 0.75), (0.02, 0.0, 0.63), SLIDE)
    return (bridge,), (saddle,), (ram,)


def cradle_shapes(machine: Machine) -> tuple[Shape, ...]:
    """Draw the primary table axis: a shaft with a block that carries the table."""
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
    """Draw the rotary table with its top in the origin; a slot shows the rotation."""
    radius = table_radius(machine)
    disc = Shape((radius, 0.025), (0.0, 0.0, -0.0125), STEEL)
    slot = Shape((0.85 * radius, 0.012, 0.003), (0.5 * radius, 0.0, 0.0), IRON)
    return disc, slot


def head_shapes(along: Vector, arm: Vector) -> tuple[Shape, ...]:
    """Draw a rotary axis of the head: its hub and the arm to the next part."""
    length = float(np.linalg.norm(arm))
    hub = Shape((0.05, 0.12), ZERO, TURNING, along)
    if length < 0.05:
        return (hub,)
    direction = vector(np.array(arm) / length)
    middle = vector(np.array(arm) * 0.25)
    return hub, Shape((0.03, 0.5 * length), middle, SLIDE, direction)


def tool_shapes() -> tuple[Shape, ...]:
    """Draw cutter, holder and spindle nose above the tip."""
    return (
        Shape((0.004, 0.05), (0.0, 0.0, 0.025), CUTTER),
        Shape((0.018, 0.06), (0.0, 0.0, 0.08), STEEL),
        Shape((0.038, 0.15), (0.0, 0.0, 0.185), IRON),
    )


def stock_shapes(machine: Machine) -> tuple[Shape, ...]:
    """Draw the stock between the table and the workpiece zero."""
    height = abs(float(machine.offsets[0, 2]))
    if height < 1e-3:
        return (Shape((0.2, 0.2, 0.02), (0.0, 0.0, -0.01), STOCK),)
    return (Shape((0.1, 0.1, height), (0.0, 0.0, -height / 2), STOCK),)
