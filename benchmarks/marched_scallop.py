"""
Scallop points by the paper's own method, for comparison with ours [TL2008, 3.1].

The unknowns are the three coordinates of P. From the scallop point of the previous pass, the
intersection curve of tool and iso-scallop surface is followed step by step until the sign of
``V_P . n_tool`` changes (Eq. 3.8 to 3.10). From the middle of that step, Newton's method solves
Eq. 3.1 to 3.3. ``scallop.py``, which makes the passes, finds the same points with one unknown.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cnc_interp.cam.cutter import Postures
from cnc_interp.cam.surface import Surface
from cnc_interp.core import MM, BoolArray, FloatArray, IntArray, cross, dot, norm, scaled, unit

#: Largest residual of all equations, as lengths, at a scallop point and on the way to it [m].
CLOSE, ROUGH = 1e-11, 1e-7
#: First step along the intersection curve [m]; steps after it turn the tangent by about ``TURN``.
FIRST, TURN = 0.1 * MM, 0.35
#: Shortest and longest step [m]. The curve is a few mm long.
SHORTEST, LONGEST = 1e-3 * MM, 1.0 * MM
#: Most steps along the curve, and Newton steps to a point.
MOST_STEPS, MOST_CORRECTIONS = 400, 12
#: Distance of numerical differentiation [m].
NEAR = 1e-8

Residuals = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class MarchedScallops:
    """Scallop points on the right of a pass, and what they cost."""

    position: FloatArray  #: (n, 3): P [m].
    found: BoolArray  #: (n,): False where the march or Newton's method did not end.
    steps: IntArray  #: (n,): Steps along the intersection curve, n_1 of the paper.
    corrections: IntArray  #: (n,): Newton steps of all these corrections.
    solved: IntArray  #: (n,): Newton steps of the solution, n_2 of the paper.


class _Conditions:
    """Eq. 3.1 to 3.3 for n postures, each scaled to a length [m]."""

    def __init__(self, surface: Surface, postures: Postures, height: float):
        self.surface, self.postures, self.height = surface, postures, height
        self.u, self.v = postures.frames.u.copy(), postures.frames.v.copy()

    def on_surface(self, point: FloatArray) -> FloatArray:
        """Return the distance from the iso-scallop surface, Eq. 3.1, shape (n,)."""
        self.u, self.v, above = self.surface.project(point, self.u, self.v)
        return above - self.height

    def on_tool(self, point: FloatArray) -> FloatArray:
        """Return Eq. 3.2, divided by its slope 8 R^2 r_c on the flat side of the torus, (n,)."""
        R, r = self.postures.cutter.tool_radius, self.postures.cutter.corner_radius
        away = point - self.postures.centre
        along = dot(away, self.postures.axis)
        square = dot(away, away)
        torus = (square + R**2 - r**2) ** 2 - 4.0 * R**2 * (square - along**2)
        return np.asarray(torus / (8.0 * R**2 * r))

    def tool_normal(self, point: FloatArray) -> FloatArray:
        """Return the unit gradient of Eq. 3.2, shape (n, 3)."""
        R, r = self.postures.cutter.tool_radius, self.postures.cutter.corner_radius
        away = point - self.postures.centre
        along = dot(away, self.postures.axis)
        across = away - scaled(along, self.postures.axis)
        square = dot(away, away)
        return unit(scaled(square + R**2 - r**2, away) - scaled(2.0 * R**2, across))

    def generates(self, point: FloatArray) -> FloatArray:
        """Return Eq. 3.3 times 1 mm, shape (n,)."""
        return dot(self.postures.velocity(point), self.tool_normal(point)) * MM

    def tangent(self, point: FloatArray) -> FloatArray:
        """Return T_p: both normals are perpendicular to the intersection curve, shape (n, 3)."""
        self.on_surface(point)
        return unit(cross(self.tool_normal(point), self.surface.at(self.u, self.v).normal))


def march_to_scallops(
    surface: Surface, postures: Postures, height: float, start: FloatArray
) -> MarchedScallops:
    """Find the scallop points on the right of a pass from those on its left."""
    conditions = _Conditions(surface, postures, height)
    n = len(postures)
    here, step = start.copy(), np.full(n, FIRST)
    steps, corrections = np.zeros(n, np.int64), np.zeros(n, np.int64)
    middle, found = start.copy(), np.zeros(n, bool)
    # The curve is followed over the front of the mill, where V_P . n_tool is positive.
    tangent = conditions.tangent(here)
    way = np.sign(dot(tangent, postures.frames.feed))
    tangent = scaled(way, tangent)
    for _ in range(MOST_STEPS):
        if found.all() or float(step[~found].min()) < SHORTEST:
            break
        steps += ~found
        aim = here + scaled(step, tangent)  # prediction

        def residuals(
            point: FloatArray,
            here: FloatArray = here,
            tangent: FloatArray = tangent,
            step: FloatArray = step,
        ) -> FloatArray:
            ahead = dot(point - here, tangent) - step  # Eq. 3.10
            return np.stack([conditions.on_surface(point), conditions.on_tool(point), ahead], 1)

        there, good, count = newton(residuals, aim, ~found, ROUGH)
        corrections += np.where(found, 0, count)
        good &= norm(there - here) < 2.0 * step
        after = scaled(way, conditions.tangent(np.where(good[:, None], there, here)))
        turn = np.arccos(np.clip(dot(after, tangent), -1.0, 1.0))
        good &= turn < 2.0  # a larger turn is the other side of the curve
        passed = good & ~found & (conditions.generates(np.where(good[:, None], there, here)) < 0.0)
        middle = np.where(passed[:, None], 0.5 * (here + there), middle)
        found |= passed
        moved = good & ~found
        growth = np.clip(TURN / np.maximum(turn, 1e-3), 0.5, 2.0)
        step = np.where(moved, np.clip(step * growth, SHORTEST, LONGEST), step)
        step = np.where(~good & ~found, 0.5 * step, step)
        here = np.where(moved[:, None], there, here)
        tangent = np.where(moved[:, None], after, tangent)

    def all_three(point: FloatArray) -> FloatArray:
        own = conditions.on_surface(point), conditions.on_tool(point), conditions.generates(point)
        return np.stack(own, axis=1)

    position, good, solved = newton(all_three, middle, found, CLOSE)
    return MarchedScallops(position, found & good, steps, corrections, solved)


def newton(
    residuals: Residuals, point: FloatArray, wanted: BoolArray, close: float
) -> tuple[FloatArray, BoolArray, IntArray]:
    """Solve three equations for the three coordinates of each point."""
    count, done = np.zeros(len(point), np.int64), np.zeros(len(point), bool)
    for _ in range(MOST_CORRECTIONS + 1):
        value = residuals(point)
        done = np.asarray((np.abs(value) < close).all(axis=1))
        busy = wanted & ~done & np.isfinite(value).all(axis=1)
        if not busy.any():
            break
        count += busy
        jacobian = np.stack(
            [
                (residuals(point + NEAR * e) - residuals(point - NEAR * e)) / (2.0 * NEAR)
                for e in np.eye(3)
            ],
            axis=2,
        )
        jacobian[~busy] = np.eye(3)
        singular = ~(np.abs(np.linalg.det(jacobian)) > 1e-12)
        jacobian[singular] = np.eye(3)
        move = np.linalg.solve(jacobian, -value[..., None])[..., 0]
        point = np.where((busy & ~singular)[:, None], point + move, point)
    return point, done & wanted, count
