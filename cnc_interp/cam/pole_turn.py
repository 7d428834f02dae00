"""Passes beside the pole, and the turn of the workpiece that keeps them away from it.

Where the tool axis o passes the pole u at the angle d, the outer axis turns at the rate
``|(o x o') . u| / sin(d)^2``. On a great circle ``o x o'`` is constant, so the smallest d counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from cnc_interp.cam.spline_pass import SPACING, SplinePass
from cnc_interp.core import DEG, FloatArray, cross, dot, norm
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform

TURNS = range(1, 61)  #: Turns of the workpiece that are tried, in this order [deg].
#: A pass is near the pole where the outer axis is asked for more of its largest velocity [-].
NEAR = 2.0
#: A path is moved through the pole if it is nearer than this share of its tolerance [-].
THROUGH = 0.5


@dataclass(frozen=True)
class PoleTurn:
    axis: str  #: Name of the outer rotary axis.
    passes: int  #: Number of passes that are near the pole.
    distance: float  #: Smallest angle between tool axis and pole in these passes [rad].
    rate: float  #: Largest rate of the axis at the programmed feed over its largest velocity [-].
    about: str  #: X or Y, the workpiece axis to turn about; empty if no turn helps.
    #: Smallest turn of the workpiece with which this axis can follow, in whole degrees [rad].
    angle: float

    @property
    def text(self) -> str:
        said = (
            f'passes that come near the pole: {self.passes}, to {self.distance / DEG:.2f} deg, '
            f'where {self.axis} would have to turn {self.rate:.3g} times as fast as it can'
        )
        if not self.about:
            return f'{said}; no turn of the workpiece about X or Y avoids it'
        return f'{said}; turn the workpiece by {self.angle / DEG:.0f} deg about {self.about}'


def pole_turn(
    passes: Sequence[SplinePass], feedrate: float, tolerance: float, machine: Machine
) -> PoleTurn | None:
    if not machine.has_rotary or not passes:
        return None
    transform = Transform.of(machine)
    outer, limit = machine.axis_names[3 + transform.outer], THROUGH * tolerance
    fastest = float(machine.max_velocity[3 + transform.outer])
    turns = [_Turns.of(one, feedrate) for one in passes]
    found = [turn.nearest(transform.pole, limit, fastest) for turn in turns]
    near = [one for one in found if one[1] > NEAR]
    if not near:
        return None
    together = _Turns(*(np.concatenate(columns) for columns in zip(*(
        (turn.start, turn.end, turn.rate) for turn in turns), strict=True)))  # fmt: skip
    about, angle = '', 0.0
    for size, name, sign in (
        (size, name, sign) for size in TURNS for name in 'XY' for sign in (1, -1)
    ):
        turned = together.turned(Rotation.from_euler(name.lower(), sign * size, degrees=True))
        if turned.nearest(transform.pole, limit, fastest)[1] <= 1.0 and turned.reached(transform):
            about, angle = name, sign * size * DEG
            break
    return PoleTurn(
        outer, len(near), min(one[0] for one in near), max(one[1] for one in near), about, angle
    )


@dataclass(frozen=True)
class _Turns:
    start: FloatArray
    end: FloatArray
    rate: FloatArray

    @staticmethod
    def of(one: SplinePass, feedrate: float) -> _Turns:
        first, last = one.ends
        tip, axis = one.poses(np.linspace(first, last, max(9, int((last - first) / SPACING))))
        return _Turns(axis[:-1], axis[1:], feedrate / norm(np.diff(tip, axis=0)))

    def turned(self, rotation: Rotation) -> _Turns:
        return _Turns(rotation.apply(self.start), rotation.apply(self.end), self.rate)

    def nearest(self, pole: FloatArray, limit: float, fastest: float) -> tuple[float, float]:
        normal = cross(self.start, self.end)
        theta = np.arctan2(norm(normal), dot(self.start, self.end))
        normal = normal / np.maximum(norm(normal), 1e-15)[:, None]
        # The foot of the pole on each great circle, if it lies there; both poles count alike.
        side = cross(normal, self.start)
        foot = np.arctan2(side @ pole, self.start @ pole)
        foot = np.where(self.start @ pole < 0.0, foot - np.pi * np.sign(foot), foot)
        foot = np.clip(foot, 0.0, theta)[:, None]
        sine = norm(cross(np.cos(foot) * self.start + np.sin(foot) * side, pole))
        rate = theta * self.rate * np.abs(normal @ pole) / np.maximum(sine, 1e-12) ** 2
        rate = np.where(sine < limit, 0.0, rate)
        return float(np.arcsin(min(sine.min(), 1.0))), float(rate.max()) / fastest

    def reached(self, transform: Transform) -> bool:
        """Tell whether the travel of the tilt contains the largest angles from the pole."""
        inner = 1 - transform.outer
        low, high = transform.machine.travel[3 + inner]
        along = self.start @ transform.pole
        for k in (int(along.argmin()), int(along.argmax())):
            tilts = [pair[inner] for pair in transform.rotary_solutions(self.start[k])]
            if not any(low <= tilt <= high for tilt in tilts):
                return False
        return True
