"""5-axis iso-scallop passes along parallel planes [TL2008], and the options for them.

Neighbouring strips share a border, so an error of a half width passes undiminished to the next
strip. The recursion starts with a constant half width. The recursion restarts, with a small
overlap, if a pass cannot be found or its half width strays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from cnc_interp.cam import scallop
from cnc_interp.cam.cutter import Cutter, Postures
from cnc_interp.cam.gouge import finely, gouge_depth, raised
from cnc_interp.cam.guiding import GuidingCurve, GuidingPlanes
from cnc_interp.cam.passes import (
    Angles,
    Pass,
    StripError,
    StripWidth,
    UnfitError,
    WideStripError,
    constant_tilt,
    constant_width,
    kept_places,
    kept_ranges,
    places_around,
    plane_distance,
)
from cnc_interp.cam.surface import SAMPLES, Surface, SurfaceError, place
from cnc_interp.core import (
    DEG,
    MM,
    UM,
    BoolArray,
    FloatArray,
    IntArray,
    InterpError,
    demand,
    norm,
    refuse_if,
)

CLOSER = 0.985  #: Factor on the plane distance of a restarted pass, for the overlap [-].
#: Default distance of the points along a pass [m]; there are at least 25.
SPACING = 0.8 * MM
MOST_PASSES = 5000
#: How often a plane may be moved closer; its least distance over the original distance [-].
CLOSER_PLANES, CLOSEST = 12, 0.7
#: Other yaws are tried if the plane moves closer than this share [-]; changes of yaw [rad].
NEAR, TURNS = 0.75, (20.0 * DEG, -20.0 * DEG, 40.0 * DEG, -40.0 * DEG)
HIDDEN = 20.0 * UM  #: Largest gap between a strip and the scallop of the previous pass [m].
ENDS = 3  #: Points at each end where the gap is unlimited, because the angles are free there.


class NoPassError(UnfitError):
    """No posture produces this scallop, because the plane distance does not fit the curvature."""


class HeelError(UnfitError):
    """The heel of the mill enters the surface; a larger tilt would lift it."""


class PassRecursion:
    def __init__(
        self, surface: Surface, cutter: Cutter, normal: FloatArray, options: IsoScallopOptions
    ):
        self.surface, self.cutter, self.normal, self.options = surface, cutter, normal, options
        widest = 2.0 * (cutter.tool_radius + cutter.corner_radius)
        stepover = options.stepover or self.largest_stepover()
        self.planes = GuidingPlanes(surface, cutter.corner_radius, normal, min(stepover, widest))
        self.notes: list[str] = []

    def largest_stepover(self) -> float:
        """Estimate the largest plane distance that any point of the surface allows [m]."""
        u, v = self.surface.grid(SAMPLES, SAMPLES)
        ours = self.surface.contains(u, v)
        smallest = self.surface.at(u[ours], v[ours]).principal_curvatures()[0]
        half = scallop.estimated_half_width(
            self.cutter, self.options.tilt, self.options.yaw, smallest, self.options.scallop_height
        )
        return 2.0 * float(half.max()) + self.options.overrun

    def all_passes(self, progress: Callable[[float], None]) -> list[Pass]:
        first, last = self.planes.span
        passes = [self.first_pass()]
        while passes[-1].plane + float(passes[-1].kept_reach.min()) < last:
            refuse_if(
                len(passes) >= MOST_PASSES,
                SurfaceError(f'more than {MOST_PASSES} passes; is the scallop height right?'),
            )
            passes.append(self.next_pass(passes[-1], len(passes) + 1))
            progress(min(1.0, (passes[-1].plane - first) / (last - first)))
        progress(1.0)
        return passes

    def first_pass(self) -> Pass:
        width = self.half_width_at(self.planes.span[0])
        plane = self.planes.span[0] + 0.9 * width
        try:
            return self.fresh_pass(plane, 1, tilted=self.options.start == 'tilt')
        except (HeelError, StripError, WideStripError) as error:
            if self.options.stray is None:
                raise
            return self.closer_pass(None, plane, 1, error)

    def half_width_at(self, plane: float) -> float:
        """Return half the plane distance; without a stepover, it follows from the tilt [m]."""
        if self.options.stepover is not None:
            return 0.5 * self.options.stepover
        curve = self.planes.curve(plane)
        angles = constant_tilt(curve, self.options.tilt, self.options.yaw, self.count(curve))
        reach = self.reach(curve, angles)
        if np.isnan(reach).all():
            radius = (self.cutter.tool_radius + self.cutter.corner_radius) / MM
            raise SurfaceError(
                f'the mill of {radius:.4g} mm radius does not fit into the surface at the guiding '
                f'plane at {plane / MM:.4g} mm; use a smaller mill'
            )
        kept = kept_places(curve, angles.s, reach, self.options.overrun)
        if not kept.any():
            return float(np.nanmin(reach))
        # A strip of the smallest width may be milled a little further.
        narrow = np.full(len(reach), np.nanmin(reach[kept]))
        kept |= kept_places(curve, angles.s, narrow, self.options.overrun)
        return float(np.nanmin(reach[kept]))

    def reach(self, curve: GuidingCurve, angles: Angles, side: float = 1.0) -> FloatArray:
        postures = angles.postures(curve, self.cutter, angles.s)
        height = self.options.scallop_height
        scallops = scallop.scallop_points(self.surface, postures, height, side)
        return plane_distance(postures, scallops, self.normal)

    def count(self, curve: GuidingCurve) -> int:
        return self.options.points or max(25, int(np.ceil(curve.length / SPACING)))

    def fresh_pass(self, plane: float, number: int, tilted: bool = False) -> Pass:
        o, curve = self.options, self.planes.curve(plane)
        if tilted or o.freedom == 'yaw':
            angles = constant_tilt(curve, o.tilt, o.yaw, self.count(curve))
        else:
            strip = StripWidth(o.scallop_height, self.half_width_at(plane), o.overrun)
            count = self.count(curve)
            angles = constant_width(curve, self.cutter, strip, o.tilt_limits, o.yaw, count)
        return self.finished(curve, angles, np.zeros(1, np.int64), fresh=True, number=number)

    def next_pass(self, before: Pass, number: int) -> Pass:
        reach, stepover = before.kept_reach, self.options.stepover
        middle = self.half_width_at(before.plane) if stepover is None else 0.5 * stepover
        stray = self.options.stray
        if stray is not None and float(np.abs(reach / middle - 1.0).max()) > stray:
            problem = f'half widths from {reach.min() / MM:.3f} to {reach.max() / MM:.3f} mm'
        else:
            try:
                return self.continued(before, self.distance(before), number)
            except UnfitError as error:
                if stray is None:
                    raise
                problem = error.what
        plane = before.plane + float(reach.min()) + CLOSER * middle
        if stepover is None:  # the width is that of the new plane
            plane = before.plane + float(reach.min()) + CLOSER * self.half_width_at(plane)
        try:
            made = self.fresh_pass(plane, number)
            if plane - before.plane > self.room(before, made.curve, made.angles):
                raise StripError(problem, 'use a smaller plane distance')
        except (HeelError, StripError, WideStripError) as error:
            return self.closer_pass(before, plane, number, error)
        self.notes.append(f'pass {number} restarts the recursion: {problem}')
        return made

    def closer_pass(
        self, before: Pass | None, plane: float, number: int, reason: UnfitError
    ) -> Pass:
        """Make a pass on a plane that is closer, because its strip is narrower in some places.

        Where the heel would enter the surface, the tilt is increased. Where no tilt within the
        limits fits, it stays at a limit. The strip still reaches the scallops of the previous
        pass, or the border. If the plane would have to be much closer, the mill is yawed, so that
        its heel lies beside the hollow.
        """
        start = self.planes.span[0] if before is None else before.plane
        own = self.options.yaw
        best = self.closest(before, plane, own)
        near = best is None or best[0].plane - start < NEAR * (plane - start)
        if near and isinstance(reason, HeelError):
            for turn in TURNS:
                found = self.closest(before, plane, own + turn)
                if found and (best is None or found[0].plane > best[0].plane):
                    best = found
        if best is None:
            raise reason
        curve, angles = best
        yaw = f', yaw {angles.yaw[0] / DEG:.0f} deg' if angles.yaw[0] != own else ''
        self.notes.append(
            f'pass {number} restarts the recursion, {(curve.plane - start) / MM:.3f} mm from '
            f'{"the border" if before is None else "the pass before"}, tilts '
            f'{angles.tilt.min() / DEG:.1f} to {angles.tilt.max() / DEG:.1f} deg{yaw}: '
            f'{reason.what}'
        )
        return self.finished(curve, angles, np.zeros(1, np.int64), fresh=True, number=number)

    def closest(
        self, before: Pass | None, plane: float, yaw: float
    ) -> tuple[GuidingCurve, Angles] | None:
        o, start = self.options, self.planes.span[0] if before is None else before.plane
        least = CLOSEST * (plane - start)
        for _ in range(CLOSER_PLANES):
            curve = self.planes.curve(plane)
            strip = StripWidth(o.scallop_height, self.half_width_at(plane), o.overrun)
            count = self.count(curve)
            angles = constant_width(
                curve, self.cutter, strip, o.tilt_limits, yaw, count, strict=False
            )
            parts = kept_ranges(curve, angles.s, self.reach(curve, angles), o.overrun)
            try:
                angles = raised(curve, self.cutter, angles, parts, o.tilt_limits[1], o.gouge)
            except SurfaceError:
                return None
            room = self.room(before, curve, angles)
            if plane - start <= room:
                return curve, angles
            plane = start + CLOSER * room
            if not room > least:
                break
        return None

    def room(self, before: Pass | None, curve: GuidingCurve, angles: Angles) -> float:
        """Return the plane distance from the previous pass at which the strips just meet [m]."""
        if before is None:
            reach = self.reach(curve, angles, -1.0)
            kept = kept_places(curve, angles.s, reach, self.options.overrun)
            return float(np.nanmin(reach[kept] if kept.any() else reach))
        s = scallop.nearest_places(curve, before.right)
        postures = angles.postures(curve, self.cutter, s)
        left = scallop.scallop_points(self.surface, postures, self.options.scallop_height, -1.0)
        both = before.reach + plane_distance(postures, left, self.normal)
        return float(np.nanmin(both[before.kept] if before.kept.any() else both))

    def distance(self, before: Pass) -> float:
        if self.options.stepover is not None:
            return self.options.stepover
        distance = 2.0 * float(before.kept_reach.min())
        for _ in range(2):
            curve = self.planes.curve(before.plane + distance)
            tilted = constant_tilt(curve, self.options.tilt, self.options.yaw, self.count(curve))
            distance = CLOSER * self.room(before, curve, tilted)
        return distance

    def left_reach(self, curve: GuidingCurve, before: Pass, tilt: float) -> FloatArray:
        frames = curve.frames(scallop.nearest_places(curve, before.right))
        postures = scallop.resting(self.cutter, frames, tilt, self.options.yaw)
        left = scallop.scallop_points(self.surface, postures, self.options.scallop_height, -1.0)
        return plane_distance(postures, left, self.normal)

    def continued(self, before: Pass, distance: float, number: int) -> Pass:
        o = self.options
        curve = self.planes.curve(before.plane + distance)
        fixed = o.yaw if o.freedom == 'tilt' else o.tilt
        fit = scallop.fit_postures(
            curve, self.cutter, before.right, o.scallop_height, o.freedom, fixed
        )
        low, high = o.tilt_limits
        slack = 1e-6
        fits = fit.found & (fit.tilt >= low - slack) & (fit.tilt <= high + slack)
        places = scallop.nearest_places(curve, before.right)
        kept = kept_places(curve, places, np.abs(distance - before.reach), o.overrun)
        if np.any(kept & ~fits) or not fits.any():
            raise NoPassError(*self.diagnosis(before, curve, fit, fits | ~kept, distance, number))
        run = places_around(fits, kept)
        if np.any(np.diff(fit.s[run]) <= 0.0):
            i = run[int(np.argmax(np.diff(fit.s[run]) <= 0.0))]
            raise NoPassError(
                f'pass {number} would run backwards at {place(before.right.position[i])}',
                'use fewer points or a smaller plane distance',
            )
        angles = Angles(fit.s[run], fit.tilt[run], fit.yaw[run])
        postures = angles.postures(curve, self.cutter, fit.s)
        self.check_strip(before, postures, kept, number)
        return self.finished(curve, angles, fit.iterations[run], fresh=False, number=number)

    def check_strip(self, before: Pass, postures: Postures, kept: BoolArray, number: int) -> None:
        left = scallop.scallop_points(self.surface, postures, self.options.scallop_height, -1.0)
        gap = norm(left.position - before.right.position)
        wrong = kept & ~(gap < HIDDEN)
        wrong[:ENDS] = wrong[-ENDS:] = False
        if wrong.any():
            i = int(np.argmax(wrong))
            raise NoPassError(
                f'pass {number}, point {i + 1} at {place(before.right.position[i])}: the mill '
                'leaves a higher ridge before it reaches the scallop of the previous pass',
                'use a smaller plane distance, a larger tilt or the tilt as the free angle',
            )

    def finished(
        self, curve: GuidingCurve, angles: Angles, iterations: IntArray, fresh: bool, number: int
    ) -> Pass:
        s = np.linspace(0.0, curve.length, self.count(curve))
        postures = angles.postures(curve, self.cutter, s)
        right = scallop.scallop_points(self.surface, postures, self.options.scallop_height)
        kept = kept_places(
            curve, s, plane_distance(postures, right, self.normal), self.options.overrun
        )
        missing = kept & ~right.found
        if missing.any() or not right.found.any():
            i = int(np.argmax(missing))
            raise NoPassError(
                f'pass {number}, point {i + 1} at {place(postures.contact[i])}: the mill '
                f'leaves no scallop of {self.options.scallop_height / UM:g} um within its width',
                'use a larger tilt, a smaller scallop height or a smaller plane distance',
            )
        if not right.found.all():
            run = places_around(right.found, kept)
            s, kept = s[run], kept[run]
            postures = angles.postures(curve, self.cutter, s)
            right = scallop.scallop_points(self.surface, postures, self.options.scallop_height)
        made = Pass(curve, angles, s, postures, right, iterations, fresh, kept)
        self.check_heel(made, number)
        return made

    def check_heel(self, made: Pass, number: int) -> None:
        parts = kept_ranges(made.curve, made.s, made.reach, self.options.overrun)
        if not parts:
            return
        tool = made.tool(finely(made.s, parts))
        depth = gouge_depth(self.surface, tool)
        if float(depth.max()) > self.options.gouge:
            i = int(np.argmax(depth))
            raise HeelError(
                f'pass {number} at {place(tool.contact[i])}: the bottom of the mill enters the '
                f'surface by {depth[i] / UM:.0f} um; the surface is hollow there',
                'use a larger tilt or a smaller mill',
            )

    def diagnosis(
        self,
        before: Pass,
        curve: GuidingCurve,
        fit: scallop.Fit,
        fits: BoolArray,
        distance: float,
        number: int,
    ) -> tuple[str, str]:
        o = self.options
        low, high = o.tilt_limits
        i = int(np.argmin(fits))
        where = f'pass {number}, point {i + 1} at {place(before.right.position[i])}'
        if o.freedom == 'yaw':
            return (
                f'{where}: no yaw at a tilt of {o.tilt / DEG:g} deg fits {distance / MM:.3f} mm',
                'use a smaller tilt for a wider strip',
            )
        wide, narrow = (before.reach + self.left_reach(curve, before, x) for x in (low, high))
        found = f'{fit.tilt[i] / DEG:.2f} deg' if fit.found[i] else 'none'
        return (
            f'{where}: the tilt would have to be {found}, but the limits are {low / DEG:g} '
            f'to {high / DEG:g} deg',
            f'a plane distance of {distance / MM:.3f} mm does not fit: it must be '
            f'{narrow[i] / MM:.3f} to {wide[i] / MM:.3f} mm there, and for the '
            f'whole pass {np.nanmax(narrow) / MM:.3f} to {np.nanmin(wide) / MM:.3f} mm',
        )


@dataclass(frozen=True)
class IsoScallopOptions:
    scallop_height: float = 10.0 * UM  #: S_h [m].
    #: Distance d of the guiding planes [m]. By default every pass has the largest distance that
    #: its tilts allow.
    stepover: float | None = None
    #: Tilt of a first pass with constant tilt. Without a stepover, the tilt that determines the
    #: distance of the planes [rad].
    tilt: float = 3.0 * DEG
    tilt_limits: tuple[float, float] = (0.5 * DEG, 60.0 * DEG)  #: Smallest and largest tilt [rad].
    yaw: float = 0.0  #: Yaw of all passes; the first guess if the yaw is the free angle [rad].
    freedom: scallop.Freedom = 'tilt'  #: The angle that determines the width.
    #: The first pass has the constant half width d/2, or the constant tilt, as in the paper.
    start: Literal['width', 'tilt'] = 'width'
    points: int | None = None  #: Number of scallop points along a pass.
    #: A pass is restarted if the half width differs from d/2 by more than this share [-]. None
    #: selects the recursion of the paper, in which a pass that cannot be found is an error.
    stray: float | None = 0.25
    #: Largest depth to which the bottom of the mill may enter the surface [m].
    gouge: float = 1.0 * UM
    #: Length that is milled beyond the border at both ends of a pass [m].
    overrun: float = 0.5 * MM

    def __post_init__(self) -> None:
        low, high = self.tilt_limits
        demand(
            0.0 < low <= self.tilt <= high <= 0.5 * np.pi,
            InterpError(
                f'tilts of {low / DEG:g} <= {self.tilt / DEG:g} <= {high / DEG:g} deg do not make '
                'sense; they must rise and lie between 0 and 90 deg'
            ),
        )
        refuse_if(
            not self.scallop_height > 0.0 or (self.stepover is not None and self.stepover <= 0.0),
            InterpError('scallop height and plane distance must be positive'),
        )
        refuse_if(
            self.points is not None and self.points < 8,
            InterpError(f'{self.points} points along a pass are too few; give at least 8'),
        )


@dataclass(frozen=True)
class IsoScallopPaths:
    passes: list[Pass]  #: The passes in order.
    notes: list[str] = field(default_factory=list)  #: Which passes were restarted, and why.

    @property
    def iterations(self) -> tuple[float, float, float]:
        """Mean iterations per posture: bracketing of stage 1, solution of stage 1, stage 2."""
        marched = np.concatenate([p.right.marched for p in self.passes])
        refined = np.concatenate([p.right.refined for p in self.passes])
        fitted = [p.iterations for p in self.passes if not p.fresh]
        second = float(np.concatenate(fitted).mean()) if fitted else 0.0
        return float(marched.mean()), float(refined.mean()), second


def iso_scallop_paths(
    surface: Surface,
    cutter: Cutter,
    plane_normal: FloatArray,
    options: IsoScallopOptions,
    progress: Callable[[float], None] = lambda _: None,
) -> IsoScallopPaths:
    """Find passes of constant scallop height on a surface [TL2008].

    Parameters
    ----------
    surface : Surface
        Such as ``BSplineSurface.through(points)``, points (m, n, 3) [m].
    plane_normal : FloatArray
        (3,): direction from each pass to the next one.

    Returns
    -------
    IsoScallopPaths
        ``passes``; each has ``postures`` with ``tip`` and ``axis``, (n, 3) [m, -].

    Raises
    ------
    SurfaceError
        The mill does not fit the surface; the message names the place.

    """
    refuse_if(
        cutter.is_ball,
        SurfaceError(
            'the strip of a ball mill does not depend on its tilt; use a corner radius smaller '
            'than half the diameter'
        ),
    )
    surface.check(cutter.corner_radius)
    normal = np.asarray(plane_normal, float) / np.linalg.norm(plane_normal)
    recursion = PassRecursion(surface, cutter, normal, options)
    return IsoScallopPaths(recursion.all_passes(progress), recursion.notes)


def facts_of(paths: IsoScallopPaths) -> dict[str, Any]:
    """Return the facts about passes along planes for the summary."""
    tilt = np.concatenate([p.angles.tilt for p in paths.passes])
    planes = np.abs(np.diff([p.plane for p in paths.passes]))
    marched, refined, second = paths.iterations
    return {
        'started_afresh': sum(p.fresh for p in paths.passes) - 1,
        'plane_distance': [float(planes.min()), float(planes.max())] if len(planes) else [],
        'tilt': [float(tilt.min()), float(tilt.max())],
        'iterations': {'march': marched, 'scallop': refined, 'posture': second},
    }


def facts_in_words(facts: dict[str, Any]) -> list[str]:
    tilt, steps, counts = facts['tilt'], facts['plane_distance'], facts['iterations']
    apart = f'{steps[0] / MM:.3f} to {steps[1] / MM:.3f} mm apart, ' if steps else ''
    return [
        f'tilt           {tilt[0] / DEG:.2f} to {tilt[1] / DEG:.2f} deg',
        f'planes         {apart}{facts["started_afresh"]} passes restarted the recursion',
        f'iterations     {counts["march"]:.1f} to bracket and {counts["scallop"]:.1f} to solve '
        f'a scallop point, {counts["posture"]:.1f} a posture',
    ]
