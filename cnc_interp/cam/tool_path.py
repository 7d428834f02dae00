"""
Tool path: passes as cubic B-splines, sampled within a chord tolerance and linked safely.

Running a pass backwards with the same postures sweeps the same volume, so that zigzag needs no
other postures than one-way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from cnc_interp.cam.classical import SurfaceCurve
from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.guiding import GuidingCurve
from cnc_interp.cam.posture import Postures
from cnc_interp.cam.surface import Surface
from cnc_interp.cam.vectors import dot, norm, scaled, unit
from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray
from cnc_interp.core.errors import InterpError
from cnc_interp.core.units import MM, UM

Linking = Literal['zigzag', 'one-way']

#: Height above the tip at which the direction of the tool axis counts for the chord tolerance [m].
ARM = 10.0 * MM
FINEST = 20  # halvings of a pass
#: The splines of a pass are compared with its poses so densely, follow them to this, and have at
#: first knots so far apart [m].
SPACING, CLOSE, COARSEST = 0.2 * MM, 0.02 * UM, 1.6 * MM


class Strip(Protocol):
    """What a strategy makes of a pass: a curve on the surface, a width and postures."""

    @property
    def curve(self) -> GuidingCurve | SurfaceCurve:
        """What the guided point follows."""

    @property
    def s(self) -> FloatArray:
        """Places at which the width is known, shape (n,) [m]."""

    @property
    def reach(self) -> FloatArray:
        """Half width there, shape (n,) [m]."""

    def tool(self, s: FloatArray) -> Postures:
        """Return the postures at places."""


@dataclass(frozen=True)
class SplinePass:
    """
    A pass as a pair of cubic B-splines: tool tip, and the point ``ARM`` higher on the axis.

    Parameters
    ----------
    spline : BSpline
        Six columns, tip and higher point [m], by arc length of the guided point.

    """

    spline: BSpline

    @staticmethod
    def of(made: Strip, overrun: float, fixed_axis: FloatArray | None = None) -> SplinePass | None:
        """
        Return a pass where its strip lies on the surface, longer by ``overrun`` at both ends [m].

        A ball mill may keep a ``fixed_axis``. None where no part of the strip lies on the surface.
        """
        s = np.linspace(0.0, made.curve.length, max(60, int(made.curve.length / SPACING)))
        frames, surface = made.curve.frames(s), made.curve.surface
        width = np.interp(s, made.s, made.reach)
        a, b = surface.at(frames.u, frames.v).components(scaled(width, frames.across))
        (u0, u1), (v0, v1) = surface.domain
        inside = np.zeros(len(s), bool)
        for side in (-1.0, 0.0, 1.0):
            u, v = frames.u + side * a, frames.v + side * b
            inside |= (u >= u0) & (u <= u1) & (v >= v0) & (v <= v1)
        if not inside.any():
            return None
        kept = s[inside]
        longer = overrun + s[1]
        ends = max(float(kept[0]) - longer, 0.0), min(float(kept[-1]) + longer, float(s[-1]))

        def rows(places: FloatArray) -> FloatArray:
            postures = made.tool(places)
            axis = postures.axis if fixed_axis is None else np.broadcast_to(fixed_axis, (1, 3))
            tip = postures.cutter.tip(postures.centre, axis)
            return np.concatenate([tip, tip + ARM * axis], axis=1)

        return SplinePass.following(rows, ends)

    @staticmethod
    def following(
        rows: Callable[[FloatArray], FloatArray], ends: tuple[float, float]
    ) -> SplinePass:
        """Interpolate poses, with so many knots that the splines stay within ``CLOSE``."""
        dense = np.linspace(*ends, max(16, int((ends[1] - ends[0]) / SPACING)))
        exact = rows(dense)
        count = max(8, int((ends[1] - ends[0]) / COARSEST))
        while True:
            s = np.linspace(*ends, count)
            spline = make_interp_spline(s, rows(s), k=3)
            if float(np.abs(spline(dense) - exact).max()) < CLOSE or count >= len(dense):
                return SplinePass(spline)
            count = 2 * count - 1

    @property
    def ends(self) -> tuple[float, float]:
        """First and last parameter."""
        return float(self.spline.t[0]), float(self.spline.t[-1])

    @property
    def reversed(self) -> SplinePass:
        """The same pass the other way."""
        knots, points = self.spline.t, self.spline.c
        return SplinePass(BSpline(knots[0] + knots[-1] - knots[::-1], points[::-1], 3))

    def poses(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return tool tips [m] and unit tool axes."""
        values = self.spline(s)
        return values[:, :3], unit(values[:, 3:] - values[:, :3])


@dataclass(frozen=True)
class LinkOptions:
    """
    How passes are joined.

    Parameters
    ----------
    linking : {'zigzag', 'one-way'}
        Every second pass backwards after a short lift, or all forwards over a safe level.
    clearance : float
        Lift between passes, and height of the safe level over the surface [m].

    """

    linking: Linking = 'zigzag'
    clearance: float = 2.0 * MM

    def __post_init__(self) -> None:
        if not self.clearance > 0.0:
            raise InterpError('clearance must be positive')


@dataclass(frozen=True)
class Link:
    """
    A straight move between passes.

    Parameters
    ----------
    tip, axis : ndarray, shape (3,)
        Where it ends [m], and the unit tool axis there.
    rapid : bool
        Moves as fast as the machine can.

    """

    tip: FloatArray
    axis: FloatArray
    rapid: bool


def link(
    passes: Sequence[SplinePass], surface: Surface, cutter: Cutter, options: LinkOptions
) -> list[Link | SplinePass]:
    """
    Put passes in the order and direction of cutting, with safe moves between them.

    Parameters
    ----------
    passes : sequence of SplinePass
        Passes as they follow each other on the surface.
    surface : Surface
        What the links must not touch.
    cutter : Cutter
        The mill.
    options : LinkOptions
        The user's choices.

    Returns
    -------
    list of Link or SplinePass

    """
    u, v = surface.grid(61, 61)
    points = surface.at(u, v)
    up = unit(points.normal.reshape(-1, 3).mean(axis=0))
    widest = cutter.tool_radius + cutter.corner_radius
    # The lowest point of a leaning mill lies below its tip by less than its radius.
    safe = float((points.position @ up).max()) + widest + options.clearance
    steps: list[Link | SplinePass] = []

    def over(tip: FloatArray) -> FloatArray:
        return np.asarray(tip + max(safe - float(tip @ up), options.clearance) * up)

    for k, one in enumerate(passes):
        turned = options.linking == 'zigzag' and k % 2
        one = one.reversed if turned else one
        tip, axis = one.poses(np.array(one.ends))
        before, behind = tip + options.clearance * axis
        if k == 0 or options.linking == 'one-way':
            steps.append(Link(over(before), axis[0], True))
        steps += [Link(before, axis[0], True), Link(tip[0], axis[0], False), one]
        steps.append(Link(behind, axis[1], False))
        if k == len(passes) - 1 or options.linking == 'one-way':
            steps.append(Link(over(behind), axis[1], True))
    return steps


@dataclass(frozen=True)
class ToolPath:
    """
    Poses of a whole program, joined by straight lines.

    Parameters
    ----------
    tip, axis : ndarray, shape (n, 3)
        Tool tip [m] and unit tool axis.
    rapid : ndarray of bool, shape (n,)
        True where the move to this pose is a rapid.
    number : ndarray of int, shape (n,)
        Pass, from 1; 0 for links.

    """

    tip: FloatArray
    axis: FloatArray
    rapid: BoolArray
    number: IntArray

    @staticmethod
    def of(steps: Sequence[Link | SplinePass], chord_tolerance: float) -> ToolPath:
        """Sample the passes within a chord tolerance [m]."""
        tips, axes, rapid, numbers, number = [], [], [], [], 0
        for step in steps:
            if isinstance(step, Link):
                tip, axis, ours = step.tip[None], step.axis[None], 0
            else:
                number += 1
                (tip, axis), ours = (x[1:] for x in sampled(step, chord_tolerance)), number
            tips.append(tip)
            axes.append(axis)
            rapid += [isinstance(step, Link) and step.rapid] * len(tip)
            numbers += [ours] * len(tip)
        return ToolPath(np.vstack(tips), np.vstack(axes), np.array(rapid), np.array(numbers))


def sampled(curve: SplinePass, tolerance: float) -> tuple[FloatArray, FloatArray]:
    """Return poses of a pass so close that its chords deviate by the tolerance at most [m]."""
    s = np.linspace(*curve.ends, 9)
    for _ in range(FINEST):
        tip, axis = curve.poses(s)
        top = tip + ARM * axis
        ends = [np.stack([x[:-1], x[1:]], axis=1) for x in (tip, top)]
        worst = np.zeros(len(s) - 1)
        for share in (0.25, 0.5, 0.75):
            p, o = curve.poses(s[:-1] + share * np.diff(s))
            worst = np.maximum(worst, chord_error(ends[0], ends[1], p, p + ARM * o))
        split = worst > tolerance
        if not split.any():
            break
        s = np.sort(np.concatenate([s, 0.5 * (s[:-1] + s[1:])[split]]))
    return merged(curve, s, tolerance)


def chord_error(
    tip: FloatArray, top: FloatArray, middle_tip: FloatArray, middle_top: FloatArray
) -> FloatArray:
    """
    Return how far poses lie from the blocks below them, shape (n,) [m].

    A block moves tip and axis together: the top is compared where the tip is on its chord.

    Parameters
    ----------
    tip, top : ndarray, shape (n, 2, 3)
        Tips and points on the axis at both ends of the blocks [m].
    middle_tip, middle_top : ndarray, shape (n, 3)
        Those of the poses [m].

    """
    chord, chord_top = tip[:, 1] - tip[:, 0], top[:, 1] - top[:, 0]
    away = middle_tip - tip[:, 0]
    share = dot(away, chord) / np.maximum(dot(chord, chord), 1e-24)
    across = norm(away - scaled(share, chord))
    return np.maximum(across, norm(middle_top - top[:, 0] - scaled(share, chord_top)))


def merged(curve: SplinePass, s: FloatArray, tolerance: float) -> tuple[FloatArray, FloatArray]:
    """Drop the inner poses of a pass that its ends give as well."""
    tip, axis = curve.poses(s)
    top = tip + ARM * axis
    ends = np.array([0, len(s) - 1])
    whole = [np.broadcast_to(x[ends], (len(s), 2, 3)) for x in (tip, top)]
    if float(chord_error(whole[0], whole[1], tip, top).max()) <= tolerance:
        return tip[ends], axis[ends]
    return tip, axis
