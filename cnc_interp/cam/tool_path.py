"""
Tool path: passes as cubic B-splines, sampled within a chord tolerance and linked safely.

Running a pass backwards with the same postures sweeps the same volume, so that zigzag needs no
other postures than one-way.
"""

from __future__ import annotations

from collections.abc import Sequence
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
from cnc_interp.errors import InterpError
from cnc_interp.program.blocks import BoolArray, FloatArray, IntArray
from cnc_interp.units import MM, MM_PER_MIN, UM

Linking = Literal['zigzag', 'one-way']

#: Height above the tip at which the direction of the tool axis counts for the chord tolerance [m].
ARM = 10.0 * MM
FINEST = 20  # halvings of a pass
#: Distance of the poses through which the splines go [m].
SPACING = 0.2 * MM


class Curve(Protocol):
    """What can be run: a pass in the order in which its poses follow each other."""

    @property
    def ends(self) -> tuple[float, float]:
        """First and last parameter."""

    def poses(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return tool tips [m] and unit tool axes at parameters, each (n, 3)."""


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
    A pass as cubic B-splines of tip and axis.

    Parameters
    ----------
    spline : BSpline
        Six columns, tool tip [m] and tool axis, by arc length of the guided point.
    ends : (float, float)
        The part that is run [m].

    """

    spline: BSpline
    ends: tuple[float, float]

    @staticmethod
    def of(made: Strip, overrun: float, fixed_axis: FloatArray | None = None) -> SplinePass | None:
        """
        Return a pass where its strip lies on the surface, longer by ``overrun`` at both ends [m].

        A ball mill may keep a ``fixed_axis``. None where no part of the strip lies on the surface.
        """
        s = np.linspace(0.0, made.curve.length, max(60, int(made.curve.length / SPACING)))
        postures = made.tool(s)
        width = np.interp(s, made.s, made.reach)
        frames, surface = postures.frames, made.curve.surface
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
        axis = postures.axis if fixed_axis is None else np.broadcast_to(fixed_axis, (len(s), 3))
        tip = postures.cutter.tip(postures.centre, axis)
        spline = SplinePass.through(s, tip, axis).spline
        return SplinePass(spline, ends)

    @staticmethod
    def through(s: FloatArray, tip: FloatArray, axis: FloatArray) -> SplinePass:
        """Interpolate poses."""
        spline = make_interp_spline(s, np.concatenate([tip, axis], axis=1), k=3)
        return SplinePass(spline, (float(s[0]), float(s[-1])))

    def poses(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return tool tips [m] and unit tool axes."""
        values = self.spline(s)
        return values[:, :3], unit(values[:, 3:])


@dataclass(frozen=True)
class LinkOptions:
    """
    How passes become a program.

    Parameters
    ----------
    linking : {'zigzag', 'one-way'}
        Every second pass backwards after a short lift, or all forwards over a safe level.
    chord_tolerance : float
        Largest distance between the pass and its blocks [m].
    clearance : float
        Lift between passes, and height of the safe level over the surface [m].
    feedrate : float
        Programmed speed of the tool tip [m/s].

    """

    linking: Linking = 'zigzag'
    chord_tolerance: float = 1.0 * UM
    clearance: float = 2.0 * MM
    feedrate: float = 3000.0 * MM_PER_MIN

    def __post_init__(self) -> None:
        for name in ('chord_tolerance', 'clearance', 'feedrate'):
            if not getattr(self, name) > 0.0:
                raise InterpError(f'{name} must be positive')


@dataclass(frozen=True)
class ToolPath:
    """
    Poses of a whole program, joined by straight lines.

    Parameters
    ----------
    tip, axis : ndarray, shape (n, 3)
        Tool tip [m] and unit tool axis.
    rapid : ndarray of bool, shape (n,)
        True where the move to this pose cuts nothing.
    number : ndarray of int, shape (n,)
        Pass, from 1; 0 for links.
    feedrate : float
        Speed of the tool tip while cutting [m/s].

    """

    tip: FloatArray
    axis: FloatArray
    rapid: BoolArray
    number: IntArray
    feedrate: float

    @property
    def cutting_length(self) -> float:
        """Length of the tip's way along the passes [m]."""
        steps = norm(np.diff(self.tip, axis=0))
        return float(steps[(self.number[1:] > 0) & (self.number[1:] == self.number[:-1])].sum())

    def cl_data(self, name: str) -> str:
        """Return the path as CL data."""
        lines = [f'PARTNO {name}', 'UNITS/MM', 'MULTAX/ON']
        feed = f'FEDRAT/{self.feedrate / MM_PER_MIN:g},MMPM'
        asked = False
        for p, o, rapid, first in zip(
            self.tip / MM, self.axis, self.rapid, [True] + [False] * (len(self.tip) - 1),
            strict=True,
        ):  # fmt: skip
            if rapid and not first:
                lines.append('RAPID')
            elif not asked and not first:
                lines.append(feed)
                asked = True
            words = [f'{x:.6f}' for x in p] + [f'{x:.9f}' for x in o]
            lines.append('GOTO/' + ','.join(words))
        return '\n'.join([*lines, 'FINI', ''])


def link(
    curves: Sequence[Curve], surface: Surface, cutter: Cutter, options: LinkOptions
) -> ToolPath:
    """
    Sample passes and join them.

    Parameters
    ----------
    curves : sequence of Curve
        Passes in the order of cutting.
    surface : Surface
        What the links must not touch.
    cutter : Cutter
        The mill.
    options : LinkOptions
        The user's choices.

    Returns
    -------
    ToolPath

    """
    u, v = surface.grid(61, 61)
    points = surface.at(u, v)
    up = unit(points.normal.reshape(-1, 3).mean(axis=0))
    widest = cutter.tool_radius + cutter.corner_radius
    # The lowest point of a leaning mill lies below its tip by less than its radius.
    safe = float((points.position @ up).max()) + widest + options.clearance
    rows: list[tuple[FloatArray, FloatArray, bool, int]] = []

    def over(tip: FloatArray) -> FloatArray:
        return np.asarray(tip + max(safe - float(tip @ up), options.clearance) * up)

    last = len(curves) - 1
    for k, curve in enumerate(curves):
        tip, axis = sampled(curve, options.chord_tolerance)
        if options.linking == 'zigzag' and k % 2:
            tip, axis = tip[::-1], axis[::-1]
        from_above = k == 0 or options.linking == 'one-way'
        to_above = k == last or options.linking == 'one-way'
        before = tip[0] + options.clearance * axis[0]
        behind = tip[-1] + options.clearance * axis[-1]
        if from_above:
            rows.append((over(before), axis[0], True, 0))
        rows.append((before, axis[0], True, 0))
        rows.extend((p, o, False, k + 1) for p, o in zip(tip, axis, strict=True))
        rows.append((behind, axis[-1], False, 0))
        if to_above:
            rows.append((over(behind), axis[-1], True, 0))
    return ToolPath(
        np.array([row[0] for row in rows]), np.array([row[1] for row in rows]),
        np.array([row[2] for row in rows]), np.array([row[3] for row in rows]), options.feedrate,
    )  # fmt: skip


def sampled(curve: Curve, tolerance: float) -> tuple[FloatArray, FloatArray]:
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


def merged(curve: Curve, s: FloatArray, tolerance: float) -> tuple[FloatArray, FloatArray]:
    """Drop the inner poses of a pass that its ends give as well."""
    tip, axis = curve.poses(s)
    top = tip + ARM * axis
    ends = np.array([0, len(s) - 1])
    whole = [np.broadcast_to(x[ends], (len(s), 2, 3)) for x in (tip, top)]
    if float(chord_error(whole[0], whole[1], tip, top).max()) <= tolerance:
        return tip[ends], axis[ends]
    return tip, axis
