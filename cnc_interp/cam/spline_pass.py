"""Passes as pairs of cubic B-splines, poses along them, and the passes of one face."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from cnc_interp.cam.cutter import Cutter, Postures
from cnc_interp.cam.gouge import Neighbours
from cnc_interp.cam.guiding import GuidingCurve
from cnc_interp.cam.passes import kept_ranges
from cnc_interp.cam.surface import Surface, SurfaceError
from cnc_interp.core import MM, UM, FloatArray, demand, dot, norm, scaled, unit

ARM = 10.0 * MM  #: Height above the tip at which the chord tolerance also holds [m].
FINEST = 20  #: How often an interval along a pass may be halved.
SPACING = 0.05 * MM  #: Distance of the poses that a spline is compared with [m].
CLOSE = 0.05 * UM  #: Largest distance of a spline from these poses [m].
COARSEST = 3.2 * MM  #: Distance of the knots at first [m].


class Strip(Protocol):
    """A pass of any strategy: path of the point K, half widths and postures along it."""

    @property
    def curve(self) -> GuidingCurve: ...
    @property
    def s(self) -> FloatArray: ...
    @property
    def reach(self) -> FloatArray: ...
    @property
    def postures(self) -> Postures: ...
    def tool(self, s: FloatArray) -> Postures: ...


class Strips(Protocol):
    @property
    def passes(self) -> Sequence[Strip]: ...
    @property
    def notes(self) -> Sequence[str]: ...


@dataclass(frozen=True)
class SplinePass:
    """A pass as two cubic B-splines: the tool tip, and the point ``ARM`` above it on the axis."""

    #: Six columns, tip and upper point [m], by arc length of the guided point [m].
    spline: BSpline

    @staticmethod
    def of(
        made: Strip,
        overrun: float,
        neighbours: Neighbours | None = None,
    ) -> list[SplinePass]:
        def rows(places: FloatArray) -> FloatArray:
            postures = made.tool(places)
            tip = postures.cutter.tip(postures.centre, postures.axis)
            return np.concatenate([tip, tip + ARM * postures.axis], axis=1)

        parts = kept_ranges(made.curve, made.s, made.reach, overrun)
        if neighbours:
            parts = neighbours.free_parts(rows, made.tool(made.s[:1]).cutter, parts)
        return [SplinePass.following(rows, ends) for ends in parts]

    @staticmethod
    def following(
        rows: Callable[[FloatArray], FloatArray], ends: tuple[float, float]
    ) -> SplinePass:
        """Interpolate poses within ``CLOSE``; only intervals with a larger error are halved."""
        dense = np.linspace(*ends, max(64, int((ends[1] - ends[0]) / SPACING)))
        exact = rows(dense)
        s = np.linspace(*ends, max(5, int((ends[1] - ends[0]) / COARSEST) + 1))
        while True:
            spline = make_interp_spline(s, rows(s), k=3)
            error = np.abs(spline(dense) - exact).max(axis=1)
            worst = np.maximum.reduceat(error, np.searchsorted(dense, s[:-1]))
            split = (worst > CLOSE) & (np.diff(s) > 2.0 * (dense[1] - dense[0]))
            if not split.any():
                return SplinePass(spline)
            s = np.sort(np.concatenate([s, 0.5 * (s[:-1] + s[1:])[split]]))

    @property
    def ends(self) -> tuple[float, float]:
        return float(self.spline.t[0]), float(self.spline.t[-1])

    @property
    def reversed(self) -> SplinePass:
        knots, points = self.spline.t, self.spline.c
        return SplinePass(BSpline(knots[0] + knots[-1] - knots[::-1], points[::-1], 3))

    def poses(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        values = self.spline(s)
        return values[:, :3], unit(values[:, 3:] - values[:, :3])


def sampled(curve: SplinePass, tolerance: float) -> tuple[FloatArray, FloatArray]:
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
    tip, axis = curve.poses(s)
    top, both = tip + ARM * axis, np.array([0, len(s) - 1])
    whole = [np.broadcast_to(x[both], (len(s), 2, 3)) for x in (tip, top)]
    if float(chord_error(whole[0], whole[1], tip, top).max()) <= tolerance:
        return tip[both], axis[both]  # one line
    return tip, axis


def chord_error(
    tip: FloatArray, top: FloatArray, middle_tip: FloatArray, middle_top: FloatArray
) -> FloatArray:
    """Return the distance of middle poses from linear blocks; tip and top share a parameter."""
    chord, chord_top = tip[:, 1] - tip[:, 0], top[:, 1] - top[:, 0]
    away = middle_tip - tip[:, 0]
    share = dot(away, chord) / np.maximum(dot(chord, chord), 1e-24)
    across = norm(away - scaled(share, chord))
    return np.maximum(across, norm(middle_top - top[:, 0] - scaled(share, chord_top)))


NOTICED = 0.5 * MM  #: A note reports that more than this length is left out [m].


@dataclass(frozen=True)
class MachinedFace:
    number: int  #: Number of the face.
    surface: Surface  #: Its surface.
    across: FloatArray  #: (3,): Unit normal N of the guiding planes [-].
    paths: Strips  #: The passes.
    parts: list[list[SplinePass]]  #: The milled parts of passes, without empty passes.
    seconds: float  #: Computing time [s].
    notes: list[str] = field(default_factory=list)  #: Notes for the user.


def cut_back(
    paths: Strips,
    cutter: Cutter,
    overrun: float,
    others: Neighbours | None,
) -> tuple[list[list[SplinePass]], list[str]]:
    found = [SplinePass.of(made, overrun, others) for made in paths.passes]
    parts = [one for one in found if one]
    if others is None:
        return parts, []
    whole = sum(
        last - first
        for made in paths.passes
        for first, last in kept_ranges(made.curve, made.s, made.reach, overrun)
    )
    milled = sum(part.ends[1] - part.ends[0] for one in parts for part in one)
    demand(
        parts,
        SurfaceError(
            'on every pass the mill would enter other faces of the part; use a smaller mill, or '
            '--ignore-neighbours'
        ),
    )
    if whole - milled < NOTICED:
        return parts, []
    left_out = (
        f'{(whole - milled) / MM:.0f} of {whole / MM:.0f} mm of passes are left out, because '
        f'the mill of {2.0 * (cutter.tool_radius + cutter.corner_radius) / MM:g} mm would enter '
        'other faces of the part there; it may reach more with another --direction'
    )
    return parts, [left_out]
