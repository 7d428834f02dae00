"""The limits of the axes: one object per axis, made from the machine file and used in every room.

Rooms read a quantity from ``Limits`` by its name. Kernels get ``Limits.table``, which is packed
only here; ``limit_kernels.py`` describes and reads it. A new kind of limit, such as one that
depends on another axis, needs a field of ``AxisLimits``, rows of the table, and a change of
``limit_at``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf
from typing import Any, NamedTuple

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.core.limit_kernels import DRIVE, FAR, PLACE, limits_along


@dataclass(frozen=True)
class DriveLoad:
    """Largest torque T of a drive and its load: |J q_ddot + B q_dot + C sign(q_dot)| <= T."""

    inertia: float  #: Mass or moment of inertia J [kg or kg m2].
    torque: float  #: Largest force or torque T [N or Nm].
    coulomb: float  #: Coulomb friction C [N or Nm].
    viscous: float  #: Viscous friction B [N s/m or Nm s/rad].

    @property
    def row(self) -> FloatArray:
        """T/J, C/J and B/J, the entries of the table [m or rad per s2, the same, 1/s]."""
        return np.array([self.torque, self.coulomb, self.viscous]) / self.inertia

    def least_acceleration(self, velocity: float) -> float:
        return (self.torque - self.coulomb - self.viscous * velocity) / self.inertia


class LimitsByPlace(NamedTuple):
    """Limits at k positions of the axis, linear in between and constant beyond the ends."""

    max_velocity: FloatArray
    max_acceleration: FloatArray
    max_jerk: FloatArray
    position: FloatArray  #: Increasing [m or rad].


@dataclass(frozen=True)
class AxisLimits:
    """The limits of one axis."""

    #: Limits; the largest of all positions if they depend on it [m/s or rad/s, per s, per s2].
    max_velocity: float
    max_acceleration: float
    max_jerk: float
    #: Lowest and highest position, infinite for an endless axis [m or rad].
    travel: tuple[float, float] = (-inf, inf)
    by_place: LimitsByPlace | None = None  #: Limits that depend on the position of the axis.
    load: DriveLoad | None = None  #: Torque limit and load of its drive, if it has one.


@dataclass(frozen=True, eq=False)
class Limits:
    """The limits of all axes, by quantity; arrays are read-only."""

    axes: tuple[AxisLimits, ...]

    @staticmethod
    def constant(velocity: FloatArray, acceleration: FloatArray, jerk: FloatArray) -> Limits:
        """Return limits (n_axes,) that hold everywhere, without travel or torque."""
        rows = np.stack([velocity, acceleration, jerk], axis=1).tolist()
        return Limits(tuple(AxisLimits(*row) for row in rows))

    def having(self, **columns: Sequence[Any] | FloatArray | Mapping[int, Any]) -> Limits:
        """Return limits in which some fields of ``AxisLimits`` have other values.

        A column holds a value for every axis, or maps axis numbers to values; other axes get None.
        """
        each = range(len(self.axes))
        whole = [
            [of.get(k) for k in each] if isinstance(of, Mapping) else of for of in columns.values()
        ]
        rows = zip(self.axes, *whole, strict=True)
        return Limits(
            tuple(replace(axis, **dict(zip(columns, row, strict=True))) for axis, *row in rows)
        )

    @cached_property
    def max_velocity(self) -> FloatArray:
        """(n_axes,): Velocity limits; the largest ones if they depend on the position."""
        return read_only(np.array([axis.max_velocity for axis in self.axes]))

    @cached_property
    def max_acceleration(self) -> FloatArray:
        return read_only(np.array([axis.max_acceleration for axis in self.axes]))

    @cached_property
    def max_jerk(self) -> FloatArray:
        return read_only(np.array([axis.max_jerk for axis in self.axes]))

    @cached_property
    def travel(self) -> FloatArray:
        """(n_axes, 2): Lowest and highest position [m or rad]."""
        return read_only(np.array([axis.travel for axis in self.axes], dtype=float))

    @cached_property
    def by_order(self) -> FloatArray:
        """(3, n_axes): Largest velocity, acceleration and jerk."""
        return read_only(np.stack([self.max_velocity, self.max_acceleration, self.max_jerk]))

    @cached_property
    def loads(self) -> dict[int, DriveLoad]:
        """Loads of the axes whose drives have a torque limit, by axis number."""
        return {k: axis.load for k, axis in enumerate(self.axes) if axis.load is not None}

    @property
    def placed(self) -> Iterator[tuple[int, LimitsByPlace]]:
        """Yield number and limits of the axes whose limits depend on their position."""
        return ((k, axis.by_place) for k, axis in enumerate(self.axes) if axis.by_place)

    @cached_property
    def table(self) -> FloatArray:
        """All limits in the form for kernels, (7, n_axes, m); see ``limit_kernels.py``."""
        m = max((len(of.position) for _, of in self.placed), default=1)
        table = np.zeros((7, len(self.axes), m))
        table[:PLACE], table[PLACE], table[DRIVE] = self.by_order[..., None], inf, inf
        table[PLACE, :, 0] = -FAR
        for k, of in self.placed:
            rows, count = np.array(of), len(of.position)
            table[:PLACE, k] = rows[:PLACE, -1:]
            table[: PLACE + 1, k, :count] = rows
        for k, load in self.loads.items():
            table[DRIVE:, k] = load.row[:, None]
        return read_only(table)

    @cached_property
    def lowest(self) -> Limits:
        """Constant limits that hold at every position and velocity."""
        velocity, acceleration, jerk = self.table[:PLACE].min(axis=2)
        for k, load in self.loads.items():
            left = load.least_acceleration(self.axes[k].max_velocity)
            acceleration[k] = min(acceleration[k], left)
        return Limits.constant(velocity, acceleration, jerk).having(travel=self.travel)

    def along(self, q: FloatArray) -> FloatArray:
        """Return all limits at positions (K, n_axes): (3, K, n_axes), or (3, 1, n_axes)."""
        return limits_along(self.table, q)


def read_only(table: FloatArray) -> FloatArray:
    table.flags.writeable = False
    return table
