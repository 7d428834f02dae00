"""
5-axis iso-scallop passes along parallel planes [TL2008]: both stages, pass after pass.

The strips of neighbouring passes share their border. The half width on the left of a pass is the
plane distance minus the half width on the right of the previous pass. This recursion has the
multiplier -1, so errors do not decay. It therefore starts with a constant half width instead of a
constant tilt. It starts afresh, with a small overlap, if a pass cannot be found or strays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.gouge import gouge_depth
from cnc_interp.cam.guiding import GuidingCurve, GuidingPlanes
from cnc_interp.cam.iso_scallop_options import IsoScallopOptions
from cnc_interp.cam.next_posture import Fit, fit_postures, nearest_places, resting
from cnc_interp.cam.passes import (
    Angles,
    Pass,
    constant_tilt,
    constant_width,
    evenly,
    place,
    plane_distance,
)
from cnc_interp.cam.posture import Postures
from cnc_interp.cam.scallop import scallop_points
from cnc_interp.cam.surface import Surface, SurfaceError
from cnc_interp.cam.vectors import norm
from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray
from cnc_interp.core.units import DEG, MM, UM

#: Distance of a pass that starts afresh, as a share of its half width.
CLOSER = 0.985
#: Default distance of the points along a pass [m]; there are at least 25.
SPACING = 0.8 * MM
MOST_PASSES = 5000
#: Largest distance from the scallop of the previous pass [m].
HIDDEN = 20.0 * UM
#: Points at both ends that are exempt, because the angles are free there.
ENDS = 3


@dataclass(frozen=True)
class IsoScallopPaths:
    """
    All passes over a surface, with the inputs they were made from.

    Parameters
    ----------
    surface : Surface
        The surface to machine.
    cutter : Cutter
        The mill.
    options : IsoScallopOptions
        The user's choices.
    plane_normal : ndarray, shape (3,)
        Unit normal N of the guiding planes [-].
    passes : list of Pass
        The passes in order.
    notes : list of str
        Which passes started afresh, and why.

    """

    surface: Surface
    cutter: Cutter
    options: IsoScallopOptions
    plane_normal: FloatArray
    passes: list[Pass]
    notes: list[str] = field(default_factory=list)

    @property
    def iterations(self) -> tuple[float, float, float]:
        """Mean iterations per posture: bracketing of stage 1, solution of stage 1, stage 2."""
        marched = np.concatenate([p.right.marched for p in self.passes])
        refined = np.concatenate([p.right.refined for p in self.passes])
        fitted = [p.iterations for p in self.passes if not p.fresh]
        second = float(np.concatenate(fitted).mean()) if fitted else 0.0
        return float(marched.mean()), float(refined.mean()), second


class NoPassError(SurfaceError):
    """No posture leaves the scallop: the plane distance does not fit the curvature there."""


def iso_scallop_paths(
    surface: Surface,
    cutter: Cutter,
    plane_normal: FloatArray,
    options: IsoScallopOptions,
    progress: Callable[[float], None] | None = None,
) -> IsoScallopPaths:
    """
    Compute all passes over a surface.

    Parameters
    ----------
    surface : Surface
        The surface to machine.
    cutter : Cutter
        The mill.
    plane_normal : ndarray, shape (3,)
        N, the direction in which the passes follow each other [any unit].
    options : IsoScallopOptions
        The user's choices.
    progress : callable, optional
        Is called with the share done, 0 to 1.

    Returns
    -------
    IsoScallopPaths

    Raises
    ------
    SurfaceError
        If surface, mill and choices do not fit; the message names the place.

    """
    if cutter.is_ball:
        raise SurfaceError(
            'the strip of a ball mill does not depend on its tilt; take a corner radius smaller '
            'than half the diameter, or --strategy classical'
        )
    surface.check(cutter.corner_radius)
    normal = np.asarray(plane_normal, float) / np.linalg.norm(plane_normal)
    return _Run(surface, cutter, normal, options).all_passes(progress)


class _Run:
    """The recursion over the passes of one surface."""

    def __init__(
        self, surface: Surface, cutter: Cutter, normal: FloatArray, options: IsoScallopOptions
    ):
        self.surface, self.cutter, self.normal, self.options = surface, cutter, normal, options
        widest = 2.0 * (cutter.tool_radius + cutter.corner_radius)
        extension = widest if options.stepover is None else min(options.stepover, widest)
        self.planes = GuidingPlanes(surface, cutter.corner_radius, normal, extension)
        self.notes: list[str] = []

    def all_passes(self, progress: Callable[[float], None] | None) -> IsoScallopPaths:
        """Add passes from one border to the other."""
        first, last = self.planes.span
        passes = [self.first_pass()]
        while passes[-1].plane + float(passes[-1].reach.min()) < last:
            if len(passes) >= MOST_PASSES:
                raise SurfaceError(f'more than {MOST_PASSES} passes; is the scallop height right?')
            passes.append(self.next_pass(passes[-1], len(passes) + 1))
            if progress:
                progress(min(1.0, (passes[-1].plane - first) / (last - first)))
        if progress:
            progress(1.0)
        return IsoScallopPaths(
            self.surface, self.cutter, self.options, self.normal, passes, self.notes
        )

    def first_pass(self) -> Pass:
        """Place the first pass so that its strip covers the border."""
        width = self.half_width_at(self.planes.span[0])
        plane = self.planes.span[0] + 0.9 * width
        return self.fresh_pass(plane, 1, tilted=self.options.start == 'tilt')

    def half_width_at(self, plane: float) -> float:
        """Return half the distance of the planes; the tilt determines it without a stepover."""
        if self.options.stepover is not None:
            return 0.5 * self.options.stepover
        curve = self.planes.curve(plane)
        angles = constant_tilt(curve, self.options.tilt, self.options.yaw, self.count(curve))
        postures = angles.postures(curve, self.cutter, angles.s)
        right = scallop_points(self.surface, postures, self.options.scallop_height)
        return float(np.nanmin(plane_distance(postures, right, self.normal)))

    def count(self, curve: GuidingCurve) -> int:
        """Return the number of scallop points along a pass."""
        return self.options.points or max(25, int(np.ceil(curve.length / SPACING)))

    def fresh_pass(self, plane: float, number: int, tilted: bool = False) -> Pass:
        """Make a pass that does not depend on the previous pass."""
        o, curve = self.options, self.planes.curve(plane)
        if tilted or o.freedom == 'yaw':
            angles = constant_tilt(curve, o.tilt, o.yaw, self.count(curve))
        else:
            width = self.half_width_at(plane)
            angles = constant_width(
                curve, self.cutter, o.scallop_height, width, o.tilt_limits, o.yaw,
                self.count(curve),
            )  # fmt: skip
        none = np.zeros(self.count(curve), np.int64)
        return self.checked(self.finished(curve, angles, none, fresh=True), number)

    def next_pass(self, before: Pass, number: int) -> Pass:
        """Return the next pass: exact if the last one can be continued, else a new start."""
        reach, stepover = before.reach, self.options.stepover
        middle = self.half_width_at(before.plane) if stepover is None else 0.5 * stepover
        stray = self.options.stray
        problem = ''
        if stray is not None and float(np.abs(reach / middle - 1.0).max()) > stray:
            problem = f'half widths from {reach.min() / MM:.3f} to {reach.max() / MM:.3f} mm'
        else:
            try:
                return self.continued(before, self.distance(before), number)
            except NoPassError as error:
                if stray is None:
                    raise
                problem = str(error)
        plane = before.plane + float(reach.min()) + CLOSER * middle
        if stepover is None:  # the width is that of the new plane
            plane = before.plane + float(reach.min()) + CLOSER * self.half_width_at(plane)
        self.notes.append(f'pass {number} starts afresh: {problem}')
        return self.fresh_pass(plane, number)

    def distance(self, before: Pass) -> float:
        """Return the distance to the next plane: the stepover, or the largest for the tilt [m]."""
        if self.options.stepover is not None:
            return self.options.stepover
        distance = 2.0 * float(before.reach.min())
        for _ in range(2):
            curve = self.planes.curve(before.plane + distance)
            left = self.left_reach(curve, before, self.options.tilt)
            distance = CLOSER * float(np.nanmin(before.reach + left))
        return distance

    def left_reach(self, curve: GuidingCurve, before: Pass, tilt: float) -> FloatArray:
        """Return how far the next pass cuts towards each scallop point, shape (n,) [m]."""
        s = nearest_places(curve, before.right)
        n = len(s)
        postures = resting(
            self.cutter, curve.frames(s), np.full(n, tilt), np.full(n, self.options.yaw)
        )
        left = scallop_points(self.surface, postures, self.options.scallop_height, -1.0)
        return plane_distance(postures, left, self.normal)

    def continued(self, before: Pass, distance: float, number: int) -> Pass:
        """Fit the postures of the next pass to the scallop points of the previous pass."""
        o = self.options
        curve = self.planes.curve(before.plane + distance)
        fixed = o.yaw if o.freedom == 'tilt' else o.tilt
        fit = fit_postures(curve, self.cutter, before.right, o.scallop_height, o.freedom, fixed)
        low, high = o.tilt_limits
        slack = 1e-6
        fits = fit.found & (fit.tilt >= low - slack) & (fit.tilt <= high + slack)
        if not fits.all():
            raise NoPassError(self.diagnosis(before, curve, fit, fits, distance, number))
        if np.any(np.diff(fit.s) <= 0.0):
            i = int(np.argmax(np.diff(fit.s) <= 0.0))
            raise NoPassError(
                f'pass {number} would run backwards at {place(before.right.position[i])}; take '
                'fewer points or a smaller plane distance'
            )
        angles = Angles(fit.s, fit.tilt, fit.yaw)
        self.check_strip(before, angles.postures(curve, self.cutter, fit.s), number)
        made = self.finished(curve, angles, fit.iterations, fresh=False)
        return self.checked(made, number)

    def check_strip(self, before: Pass, postures: Postures, number: int) -> None:
        """Refuse a pass whose strip ends before the scallop to which the pass was fitted."""
        left = scallop_points(self.surface, postures, self.options.scallop_height, -1.0)
        gap = norm(left.position - before.right.position)[ENDS:-ENDS]
        wrong = ~(gap < HIDDEN)
        if wrong.any():
            i = int(np.argmax(wrong)) + ENDS
            raise NoPassError(
                f'pass {number}, point {i + 1} at {place(before.right.position[i])}: the mill '
                'leaves a higher ridge before it reaches the scallop of the pass before; take a '
                'smaller plane distance, a larger tilt or the tilt as the free angle'
            )

    def finished(
        self, curve: GuidingCurve, angles: Angles, iterations: IntArray, fresh: bool
    ) -> Pass:
        """Spread the angles evenly and find the scallop points on the right."""
        s = evenly(curve, self.count(curve))
        postures = angles.postures(curve, self.cutter, s)
        right = scallop_points(self.surface, postures, self.options.scallop_height)
        return Pass(curve, angles, s, postures, right, iterations, fresh)

    def checked(self, made: Pass, number: int) -> Pass:
        """Refuse a pass whose strip has no end or whose mill enters the surface."""
        if not made.right.found.all():
            i = int(np.argmin(made.right.found))
            raise NoPassError(
                f'pass {number}, point {i + 1} at {place(made.postures.contact[i])}: the mill '
                f'leaves no scallop of {self.options.scallop_height / UM:g} um within its width; '
                'take a larger tilt, a smaller scallop height or a smaller plane distance'
            )
        depth = gouge_depth(self.surface, made.postures)
        if float(depth.max()) > self.options.gouge:
            i = int(np.argmax(depth))
            raise SurfaceError(
                f'pass {number}, point {i + 1} at {place(made.postures.contact[i])}: the bottom '
                f'of the mill enters the surface by {depth[i] / UM:.0f} um; the surface is hollow '
                'there: take a larger tilt or a smaller mill'
            )
        return made

    def diagnosis(
        self, before: Pass, curve: GuidingCurve, fit: Fit, fits: BoolArray, distance: float,
        number: int,
    ) -> str:  # fmt: skip
        """Say where no posture was found, and which plane distances are possible there."""
        o = self.options
        low, high = o.tilt_limits
        i = int(np.argmin(fits))
        where = f'pass {number}, point {i + 1} at {place(before.right.position[i])}'
        if o.freedom == 'yaw':
            return (
                f'{where}: no yaw at a tilt of {o.tilt / DEG:g} deg fits {distance / MM:.3f} mm; '
                'take a smaller tilt for a wider strip'
            )
        wide, narrow = (before.reach + self.left_reach(curve, before, x) for x in (low, high))
        found = f'{fit.tilt[i] / DEG:.2f} deg' if fit.found[i] else 'none'
        return (
            f'{where}: the tilt would have to be {found}, the limits are {low / DEG:g} to '
            f'{high / DEG:g} deg; a plane distance of {distance / MM:.3f} mm does not fit, there '
            f'it can be {narrow[i] / MM:.3f} to {wide[i] / MM:.3f} mm, along the whole pass '
            f'{np.nanmax(narrow) / MM:.3f} to {np.nanmin(wide) / MM:.3f} mm'
        )
