"""The five-axis transformation in closed form: tool tip and tool axis in W <-> machine axes.

T is the rotation of the axes that carry the workpiece, H that of the axes that carry the tool:

    o_W = T^-1 H e_z = Rot(u, a) Rot(w, b) e_z
    (x, y, z) = Table(p_W) + Head(rotary) - Head(0)

(x, y, z) is the position of the tool in M: X Y Z plus the extra axes along their directions.
The *outer* axis u turns about the pole, and the *inner* axis w, next to the tool, tilts the tool.
On table-table machines u is the secondary, w the primary axis, both with negated angles. On
head-head machines u is the primary, w the secondary. Otherwise u is the table axis, negated.

``o . u = c0 + R cos(b - b0)`` has two solutions b, one for each sign of sin(b - b0): the branches.
The outer angle follows from the projections on the plane normal to u. Near the pole, o = +-u, the
sine is computed from |o x u|, which keeps full relative accuracy.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import pi

import numpy as np

from cnc_interp.core import FloatArray, jet, norm
from cnc_interp.machine_model.error_map import ErrorMap, packed_errors
from cnc_interp.machine_model.five_axis_kernels import (
    HEAD_ZERO,
    INNER_SIGN,
    ON_HEAD,
    OUTER,
    OUTER_SIGN,
    PRIMARY,
    SIZE,
    TIP_ARM,
    WORKPIECE,
    forward,
    linear_position,
    rates,
    rotary_jets,
)
from cnc_interp.machine_model.machine import Machine

ON_POLE = 1e-9  #: Below this sine of the angle to the pole, the tool axis is on the pole [-].


@dataclass(frozen=True)
class FiveAxis:
    """``Transform`` of a machine with X Y Z, up to two rotary axes, and extra axes."""

    machine: Machine  #: The machine.
    #: (29 + 3 k,): Geometry of the machine; the last 3 k values: directions of k extra axes.
    packed: FloatArray

    @staticmethod
    def of(machine: Machine) -> FiveAxis:
        first_on_head, second_on_head = machine.rotary_on_head
        outer = 0 if second_on_head else 1
        packed = np.zeros(SIZE)
        packed[PRIMARY : PRIMARY + 6] = machine.rotary_direction.ravel()
        packed[WORKPIECE : WORKPIECE + 9] = machine.offsets.ravel()
        packed[TIP_ARM : TIP_ARM + 6] = machine.tool_offset.ravel()
        packed[ON_HEAD : ON_HEAD + 2] = machine.rotary_on_head
        packed[OUTER] = outer
        packed[OUTER_SIGN] = 1.0 if machine.rotary_on_head[outer] else -1.0
        packed[INNER_SIGN] = 1.0 if machine.rotary_on_head[1 - outer] else -1.0
        on_head = first_on_head or second_on_head
        packed[HEAD_ZERO : HEAD_ZERO + 3] = machine.tool_offset.sum(axis=0) * on_head
        return FiveAxis(machine, np.concatenate([packed, machine.extra_direction.ravel()]))

    @property
    def five_axis(self) -> FiveAxis:
        return self

    @cached_property
    def errors(self) -> ErrorMap:
        own = 5 if self.machine.has_rotary else 3
        return ErrorMap(packed_errors(self.machine.errors), self.packed, own)

    @property
    def outer(self) -> int:
        """Index of the rotary axis that is undefined at the pole: 0 primary, 1 secondary."""
        return int(self.packed[OUTER])

    @property
    def pole(self) -> FloatArray:
        """Direction in W at which the outer rotary axis is undefined, shape (3,)."""
        return np.asarray(self.machine.rotary_direction[self.outer])

    def nearest_to_pole(self, start: FloatArray, end: FloatArray) -> FloatArray:
        """Return the smallest angle of tool axis and pole in n linear rotary motions, (n,) [rad].

        ``o . u = c0 + R cos(b - b0)`` is extreme at an end, or where b - b0 is a multiple
        of pi.
        """
        inner = 1 - self.outer
        u, w = self.machine.rotary_direction[[self.outer, inner]]
        c0 = w[2] * float(w @ u)
        c1, c2 = u[2] - c0, w[1] * u[0] - w[0] * u[1]
        radius, b0 = np.hypot(c1, c2), np.arctan2(c2, c1)
        ends = self.packed[INNER_SIGN] * np.stack([start[:, inner], end[:, inner]]) - b0
        low, high = ends.min(axis=0), ends.max(axis=0)
        cosine = c0 + radius * np.cos(ends)
        top = np.where(np.ceil(low / (2 * pi)) * 2 * pi <= high, c0 + radius, cosine.max(axis=0))
        turn = np.ceil((low - pi) / (2 * pi)) * 2 * pi + pi
        bottom = np.where(turn <= high, c0 - radius, cosine.min(axis=0))
        return np.asarray(np.arccos(np.clip(np.maximum(top, -bottom), -1.0, 1.0)))

    def levers(self, stands: FloatArray, rotary: FloatArray, height: float) -> FloatArray:
        """Return the travel of a tool axis point in W per rad of each rotary axis, (n, 2) [m]."""
        machine = self.machine
        u1, u2 = machine.rotary_direction
        first_on_head, second_on_head = machine.rotary_on_head
        tip_arm, head_arm = machine.tool_offset
        on_head = first_on_head or second_on_head
        up = np.array([0.0, 0.0, height])
        # From the point to the pivots, as in ``forward``; a tool that never turns is vertical.
        arm = np.broadcast_to(tip_arm - up if on_head else -up, stands.shape)
        levers = np.zeros((len(stands), 2))
        if second_on_head:
            levers[:, 1] = norm(np.cross(u2, arm))
            arm = rotated(u2, rotary[:, 1], arm)
        arm = arm + (head_arm if on_head else 0.0)
        if first_on_head:
            levers[:, 0] = norm(np.cross(u1, arm))
            arm = rotated(u1, rotary[:, 0], arm)
        point = stands - arm + self.packed[HEAD_ZERO : HEAD_ZERO + 3] - machine.offsets[2]
        if not first_on_head:
            levers[:, 0] = norm(np.cross(u1, point))
            point = rotated(u1, -rotary[:, 0], point)
        if not second_on_head:
            levers[:, 1] = norm(np.cross(u2, point - machine.offsets[1]))
        return levers

    def tool_axis(self, rotary: FloatArray) -> FloatArray:
        q = np.concatenate([np.zeros((len(rotary), 3)), np.asarray(rotary, float)], axis=1)
        return np.asarray(forward(self.packed, q)[1])

    def forward(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        q = np.asarray(q, float)
        own = 5 if self.machine.has_rotary else 3
        if q.shape[1] > own:
            stands = q[:, :3] + q[:, own:] @ self.machine.extra_direction
            q = np.concatenate([stands, q[:, 3:own]], axis=1)
        if own == 3:
            q = np.concatenate([q, np.zeros((len(q), 2))], axis=1)
        return forward(self.packed, q)

    def linear(self, tip: FloatArray, rotary: FloatArray) -> FloatArray:
        """Return X Y Z (n, 3) [m] of tool tips at rotary positions [rad], with extra axes at 0."""
        return np.array(
            [linear_position(self.packed, p, r[0], r[1]) for p, r in zip(tip, rotary, strict=True)]
        )

    def counted(self, q: FloatArray, tip: FloatArray) -> FloatArray:
        return q

    def rates(
        self, tip: FloatArray, axis: FloatArray, step: FloatArray, turn: FloatArray
    ) -> FloatArray:
        if not self.machine.has_rotary:
            return step
        rows = [np.ascontiguousarray(column).view() for column in (tip, axis, step, turn)]
        for row in rows:
            row.flags.writeable = False  # one form for the kernel: no other is compiled in motion
        return np.asarray(rates(self.packed, self.outer, *rows))

    def on_pole(self, axis: FloatArray) -> bool:
        return float(np.linalg.norm(np.cross(axis, self.pole))) < ON_POLE

    def branch_at(self, rotary: FloatArray) -> float:
        """Return the branch, +1 or -1, on which rotary positions (2,) [rad] lie."""
        found = self.rotary_solutions(self.tool_axis(rotary[None])[0])
        gaps = [np.abs(np.sin(0.5 * (rotary - pair))).max() for pair in found]
        return 1.0 if not gaps or gaps[0] <= gaps[-1] else -1.0

    def branches(
        self, axis: FloatArray, near: FloatArray, free: FloatArray | None = None
    ) -> list[FloatArray]:
        """Return the rotary positions (2,) [rad] on both branches for a tool axis (3,), +1 first.

        Whole turns are added so that each is nearest to ``near``. With ``free``, the outer axis
        has its value there, as on the pole. If the tool axis is out of reach, the list is empty.
        """
        found = self.rotary_solutions(axis)
        if free is not None:
            for pair in found:
                pair[self.outer] = free[self.outer]
        return [pair + 2.0 * pi * np.round((near - pair) / (2.0 * pi)) for pair in found]

    def rotary_solutions(self, axis: FloatArray) -> list[FloatArray]:
        """Return rotary positions (2,) of both branches in (-pi, pi] [rad]; [] if out of reach."""
        o = (jet.constant(axis[0]), jet.constant(axis[1]), jet.constant(axis[2]))
        found = []
        for branch in (1.0, -1.0):
            tilt, turn, sine_squared = rotary_jets(self.packed, o, branch, 0.0, 0.0)
            if sine_squared >= -1e-12:
                pair = [tilt[0], turn[0]] if self.outer == 1 else [turn[0], tilt[0]]
                found.append(np.array(pair))
        return found


def rotated(u: FloatArray, angle: FloatArray, v: FloatArray) -> FloatArray:
    s, c = np.sin(angle)[:, None], np.cos(angle)[:, None]
    return np.asarray(v * c + np.cross(u, v) * s + u * ((v @ u)[:, None] * (1.0 - c)))
