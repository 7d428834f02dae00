"""Passes along guiding curves: their angles, their width, and the parts that are milled."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from cnc_interp.cam.cutter import Cutter, Postures
from cnc_interp.cam.guiding import GuidingCurve
from cnc_interp.cam.scallop import Scallops, scallop_points
from cnc_interp.cam.surface import SurfaceError, place
from cnc_interp.core import DEG, MM, UM, BoolArray, FloatArray, IntArray, dot, scaled


class UnfitError(SurfaceError):
    def __init__(self, what: str, remedy: str):
        super().__init__(f'{what}; {remedy}')
        self.what = what


class StripError(UnfitError):
    """A strip is narrower than required, even at the smallest tilt."""


class WideStripError(UnfitError):
    """A strip is wider than required at some places, even at the largest tilt."""


@dataclass(frozen=True)
class Angles:
    """Tilt and yaw along a pass: cubic splines through values, constant beyond them."""

    s: FloatArray  #: (n,): Arc lengths along the curve, in increasing order [m].
    #: (n,): Angles at these arc lengths [rad].
    tilt: FloatArray
    yaw: FloatArray

    def postures(self, curve: GuidingCurve, cutter: Cutter, s: FloatArray) -> Postures:
        inside = np.clip(s, self.s[0], self.s[-1])
        moving = (s >= self.s[0]) & (s <= self.s[-1])
        values = np.stack([self.tilt, self.yaw], axis=1)
        # Natural ends: the second derivative joins the constant continuation without a jump.
        spline = CubicSpline(self.s, values, bc_type='natural')
        angle, rate = spline(inside), spline(inside, 1) * moving[:, None]
        frames = curve.frames(s)
        return Postures(cutter, frames, angle[:, 0], angle[:, 1], rate[:, 0], rate[:, 1])


@dataclass(frozen=True)
class Pass:
    curve: GuidingCurve  #: Path of the guided point K.
    angles: Angles  #: Tilt and yaw along it.
    s: FloatArray  #: (n,): Arc lengths along the curve for the scallop points [m].
    postures: Postures  #: The postures at these arc lengths.
    right: Scallops  #: Scallop points on the side of the next pass.
    #: (n,): Newton steps of stage 2; zero in passes that were not fitted to the previous pass.
    iterations: IntArray
    #: True for the first pass and for passes that do not continue the previous pass exactly.
    fresh: bool
    #: (n,): True where the pass is milled: the strip lies over the surface, or in the overrun.
    kept: BoolArray

    def tool(self, s: FloatArray) -> Postures:
        return self.angles.postures(self.curve, self.postures.cutter, s)

    @property
    def plane(self) -> float:
        return self.curve.plane

    @property
    def reach(self) -> FloatArray:
        """Half widths at ``s``: distances of scallop points from the plane, (n,) [m]."""
        return plane_distance(self.postures, self.right, self.curve.plane_normal)

    @property
    def kept_reach(self) -> FloatArray:
        return self.reach[self.kept] if self.kept.any() else self.reach


def plane_distance(postures: Postures, scallops: Scallops, normal: FloatArray) -> FloatArray:
    """Return the distance of scallop points, lifted to the guiding surface, from the plane.

    On a slope the contact point lies beside the plane; only on the guiding surface both half
    widths agree.
    """
    lifted = scallops.position + postures.cutter.corner_radius * scallops.normal
    return np.abs(dot(lifted - postures.frames.position, normal))


def constant_tilt(curve: GuidingCurve, tilt: float, yaw: float, count: int) -> Angles:
    s = np.linspace(0.0, curve.length, count)
    return Angles(s, np.full(count, tilt), np.full(count, yaw))


class StripWidth(NamedTuple):
    """Requirements of a pass: scallop height, half width, overrun [m]."""

    height: float
    half_width: float
    overrun: float


def constant_width(
    curve: GuidingCurve,
    cutter: Cutter,
    strip: StripWidth,
    limits: tuple[float, float],
    yaw: float,
    count: int,
    strict: bool = True,
) -> Angles:
    """Find tilts such that the scallop lies in a plane parallel to the guiding plane."""
    height, half_width, overrun = strip
    s = np.linspace(0.0, curve.length, count)
    kept = kept_places(curve, s, np.full(count, half_width), overrun)
    bend = curve.frames(s).curvature
    local = half_width / np.maximum(1.0 + cutter.corner_radius * bend, 0.1)
    wanted = 2.0 * height / local**2 - bend
    last = np.full(count, np.nan), np.full(count, np.nan)
    wide, narrow = np.full(count, -np.inf), np.full(count, np.inf)
    for _ in range(24):
        angles = Angles(s, cutter.tilt_of_curvature(wanted, limits), np.full(count, yaw))
        postures = angles.postures(curve, cutter, s)
        right = scallop_points(curve.surface, postures, height)
        # Where no scallop was found, the strip is wider than the mill.
        reach = plane_distance(postures, right, curve.plane_normal)
        reach = np.where(right.found, reach, 2.0 * half_width)
        miss = np.where(kept, np.abs(reach - half_width), 0.0)
        if float(miss.max()) < 0.02 * UM:
            break
        sine = np.sin(angles.tilt)
        held = sine / (cutter.tool_radius + cutter.corner_radius * sine)
        wide = np.where(reach > half_width, np.maximum(wide, held), wide)
        narrow = np.where(reach < half_width, np.minimum(narrow, held), narrow)
        # First the width of a parabola, then secant steps, then bisection where the width jumps.
        step = np.maximum(held + bend, 0.1) * ((reach / half_width) ** 2 - 1.0)
        with np.errstate(invalid='ignore', divide='ignore'):
            secant = (half_width - reach) * (held - last[0]) / (reach - last[1])
        sound = (secant * step > 0.0) & (np.abs(secant) < 8.0 * np.abs(step))
        last = held, reach
        wanted = held + np.where(sound, secant, step)
        outside = (wide < narrow) & ((wanted <= wide) | (wanted >= narrow))
        outside &= np.isfinite(wide) & np.isfinite(narrow)
        wanted = np.where(outside, 0.5 * (wide + narrow), wanted)
    # Where the width jumps, the strip is wider; elsewhere a tilt is at its limit.
    jumps = (miss > 0.005 * half_width) & np.isfinite(wide) & np.isfinite(narrow)
    if jumps.any():
        tilt = cutter.tilt_of_curvature(np.where(jumps, wide, held), limits)
        angles = Angles(s, tilt, angles.yaw)
    if strict and float(miss[~jumps].max(initial=0.0)) > 0.005 * half_width:
        i = int(np.argmax(np.where(jumps, 0.0, miss)))
        short = reach[i] < half_width
        wasteful = bool((reach[kept] > 1.005 * half_width).all())
        kind = StripError if short else UnfitError if wasteful else WideStripError
        raise kind(
            f'a strip of {2.0 * half_width / MM:.3f} mm is too {"wide" if short else "narrow"} at '
            f'{place(postures.contact[i])}: with the tilt at its '
            f'{"smallest" if short else "largest"}, '
            f'{(limits[0] if short else limits[1]) / DEG:.3g} deg, it becomes '
            f'{2.0 * reach[i] / MM:.3f} mm',
            f'take a {"smaller" if short else "larger"} plane distance or other tilt limits',
        )
    return angles


SPACING = 0.2 * MM  #: Distance of points along the strip that are compared with the border [m].
LINES = 9  #: Lines along the strip that are compared with the border, over its whole width.


def kept_ranges(
    curve: GuidingCurve, s: FloatArray, reach: FloatArray, overrun: float
) -> list[tuple[float, float]]:
    dense = np.linspace(0.0, curve.length, max(60, int(curve.length / SPACING)))
    known = np.isfinite(reach)
    width = np.interp(dense, s[known], reach[known]) if known.any() else np.zeros(len(dense))
    frames, surface = curve.frames(dense), curve.surface
    a, b = surface.at(frames.u, frames.v).components(scaled(width, frames.across))
    across = np.linspace(-1.0, 1.0, LINES)[:, None]
    inside = surface.contains(frames.u + across * a, frames.v + across * b).any(axis=0)
    longer = overrun + dense[1]
    parts: list[tuple[float, float]] = []
    for run in runs(inside):
        first = max(float(dense[run.start]) - longer, 0.0)
        last = min(float(dense[run.stop - 1]) + longer, float(dense[-1]))
        if parts and first <= parts[-1][1]:
            first = parts.pop()[0]
        parts.append((first, last))
    return parts


def kept_places(
    curve: GuidingCurve, s: FloatArray, reach: FloatArray, overrun: float
) -> BoolArray:
    kept = np.zeros(len(s), bool)
    for first, last in kept_ranges(curve, s, reach, overrun):
        kept |= (s >= first) & (s <= last)
    return kept


def runs(true: BoolArray) -> list[slice]:
    bounds = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]])))
    return [slice(int(a), int(b)) for a, b in zip(bounds[::2], bounds[1::2], strict=True)]


def places_around(good: BoolArray, kept: BoolArray) -> IntArray:
    """Return the good places in all runs of them between the first and the last milled one."""
    found = runs(good)
    ours = [run for run in found if kept[run].any()]
    if not ours:
        ours = sorted(found, key=lambda run: run.stop - run.start)[-1:]
    if not ours:
        return np.zeros(0, np.int64)
    return np.asarray(ours[0].start + np.flatnonzero(good[ours[0].start : ours[-1].stop]))
