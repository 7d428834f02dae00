"""Stage 1: scallop points, where the envelope of the mill leaves the iso-scallop surface.

[TL2008, 3.1] in one unknown. At the angle phi of the corner circle the profile of the corner torus
is a circle about Q = C_L + R e. The envelope touches it where the tool normal m is perpendicular
to V_Q and to the circle of centres: m = unit(V_Q x e'). P = Q + r_c m then satisfies Eq. 3.2 and
3.3. Eq. 3.1 is ``height(P) = S_h``. This equation is solved from phi = 0, the contact point.

Stage 2: the posture of the next pass that leaves a given scallop point [TL2008, 3.2]. The unknowns
are the place s on the next guiding curve and one angle, the tilt or the yaw. Let v = P - C_L and
e* its direction in the plane of the corner circle. With Q* = C_L + R e*:

    |P - Q*| = r_c        P lies on the corner torus        (Eq. 3.13)
    T_sc . (P - Q*) = 0   the envelope follows the scallop  (Eq. 3.14)

For a flat mill (r_c = 0) P lies on its edge instead. Up to six roots exist. The valid root has P
on the front of the tool, on the side of the previous pass, and a tilt between 0 and 90 deg.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cnc_interp.cam.cutter import Cutter, Postures
from cnc_interp.cam.guiding import CurveFrames, GuidingCurve
from cnc_interp.cam.surface import Surface
from cnc_interp.core import (
    DEG,
    MM,
    UM,
    BoolArray,
    FloatArray,
    IntArray,
    cross,
    dot,
    norm,
    scaled,
    unit,
)

Angle = float | FloatArray

#: Largest distance of scallop points from the iso-scallop surface; residual of stage 2 [m].
CLOSE = 1e-11
WIDEST = 1.55  #: Largest angle of the corner circle at which the envelope is sought [rad].


@dataclass(frozen=True)
class Scallops:
    #: (n, 3): P [m]; NaN where ``found`` is false, like ``tangent`` and ``normal``.
    position: FloatArray
    #: (n, 3): Unit tangent of the scallop curve and unit normal of the surface [-].
    tangent: FloatArray
    normal: FloatArray
    angle: FloatArray  #: (n,): phi on the corner circle [rad].
    #: (n,): False where the mill does not reach the scallop height within its width.
    found: BoolArray
    #: (n,): Iterations to bracket phi, and iterations to solve for it.
    marched: IntArray
    refined: IntArray

    def half_width(self, postures: Postures) -> FloatArray:
        return np.abs(dot(self.position - postures.frames.position, postures.frames.across))


def envelope_point(postures: Postures, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    e, e_d = postures.rim(angle)
    centre = postures.centre + postures.cutter.tool_radius * e
    m = unit(cross(postures.velocity(centre), e_d))
    return np.asarray(centre + postures.cutter.corner_radius * m), m


def estimated_half_width(
    cutter: Cutter, tilt: Angle, yaw: Angle, curvature: FloatArray, height: float
) -> FloatArray:
    """Estimate half widths from the curvatures of tool and surface, 2 w = sqrt(8 h / kappa)."""
    sine = np.sin(tilt)
    swept = (cutter.tool_radius + cutter.corner_radius * sine) / np.maximum(sine, 1e-9)
    swept = swept * np.cos(yaw) ** 2 + cutter.corner_radius * np.sin(yaw) ** 2
    return np.asarray(np.sqrt(2.0 * height / np.maximum(1.0 / swept + curvature, 1e-3)))


def scallop_points(
    surface: Surface, postures: Postures, height: float, side: float = 1.0
) -> Scallops:
    frames, n = postures.frames, len(postures)
    u, v = frames.u.copy(), frames.v.copy()

    def miss(angle: FloatArray) -> FloatArray:
        nonlocal u, v
        point, _ = envelope_point(postures, side * angle)
        u, v, above = surface.project(point, u, v)
        return above - height

    cutter = postures.cutter
    sine = np.sin(postures.tilt)
    reach = np.maximum(cutter.tool_radius + cutter.corner_radius * sine, 1e-9)
    width = estimated_half_width(cutter, postures.tilt, postures.yaw, frames.curvature, height)
    guess = np.clip(1.05 * width / reach, 1e-4, 1.2)
    low, below = np.zeros(n), np.full(n, -height)
    high = guess
    marched, refined = np.ones(n, np.int64), np.zeros(n, np.int64)
    above = miss(high)
    while True:
        short = ~(above > 0.0) & (high < WIDEST)
        if not short.any():
            break
        marched += short
        low, below = np.where(short, high, low), np.where(short, above, below)
        high = np.where(short, np.minimum(1.25 * high, WIDEST), high)
        above = np.where(short, miss(high), above)
    found = above > 0.0
    angle, kept = high.copy(), np.zeros(n)
    for _ in range(40):
        # Illinois method: the value at the end that stays is halved.
        gap = np.where(found, above - below, 1.0)
        angle = np.where(found, (low * above - high * below) / gap, angle)
        value = miss(angle)
        active = found & (np.abs(value) > CLOSE)
        refined += active
        if not active.any():
            break
        up = value > 0.0
        below = np.where(up & (kept > 0.0), 0.5 * below, below)
        above = np.where(~up & (kept < 0.0), 0.5 * above, above)
        high, above = np.where(up, angle, high), np.where(up, value, above)
        low, below = np.where(up, low, angle), np.where(up, below, value)
        kept = np.where(up, 1.0, -1.0)
    point, m = envelope_point(postures, side * angle)
    u, v, _ = surface.project(point, u, v)
    normal = surface.at(u, v).normal
    tangent = unit(cross(m, normal))
    tangent = scaled(np.sign(dot(tangent, frames.feed)), tangent)
    found = found & np.isfinite(point).all(axis=1) & np.isfinite(normal).all(axis=1)
    missing = np.where(found, 0.0, np.nan)[:, None]
    return Scallops(
        point + missing, tangent + missing, normal + missing, angle, found, marched, refined
    )


Freedom = Literal['tilt', 'yaw']

#: Further guesses of the free angle, if the first guess fails [rad].
OTHER_GUESSES = (2.0 * DEG, 8.0 * DEG, 25.0 * DEG, 60.0 * DEG)
#: Steps of finite differences, and largest Newton steps, for arc length [m] and angle [rad].
STEPS, LARGEST_STEP = (1e-8, 1e-7), (1.0 * MM, 0.3)


@dataclass(frozen=True)
class Fit:
    """Postures on the next guiding curve, one for each scallop point."""

    s: FloatArray  #: (n,): Arc lengths on the guiding curve [m].
    #: (n,): Angles [rad].
    tilt: FloatArray
    yaw: FloatArray
    found: BoolArray  #: (n,): False where no valid root was reached.
    iterations: IntArray  #: (n,): Number of Newton steps.


def resting(cutter: Cutter, frames: CurveFrames, tilt: Angle, yaw: Angle) -> Postures:
    zero = np.zeros(len(frames))
    return Postures(cutter, frames, zero + tilt, zero + yaw, zero, zero)


def conditions(postures: Postures, scallops: Scallops) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the residuals of Eq. 3.13 and 3.14 (times 1 mm), and whether a root here is valid."""
    cutter, u = postures.cutter, postures.axis
    v = scallops.position - postures.centre
    along = dot(v, u)
    e = v - scaled(along, u)
    across = norm(e)
    e = scaled(1.0 / across, e)
    away = v - cutter.tool_radius * e
    distance = norm(away)
    if cutter.corner_radius > 0.0:
        first, second = distance - cutter.corner_radius, dot(scallops.tangent, unit(away)) * MM
        below = (dot(away, e) >= 0.0) & (along <= 0.0)
    else:
        first, second = along, across - cutter.tool_radius
        below = np.ones(len(v), bool)
    front = (dot(e, postures.front) > 0.0) & (dot(e, postures.turned[1]) < 0.0)
    upright = (postures.tilt > 0.0) & (postures.tilt <= 0.5 * np.pi)
    return first, second, below & front & upright


def fit_postures(
    curve: GuidingCurve,
    cutter: Cutter,
    scallops: Scallops,
    height: float,
    freedom: Freedom,
    fixed_angle: float,
) -> Fit:
    s = nearest_places(curve, scallops)
    guess = first_guess(curve, cutter, scallops, height, freedom, fixed_angle, s)
    fit = _newton(curve, cutter, scallops, freedom, fixed_angle, s, guess)
    for other in OTHER_GUESSES:
        again = ~fit.found & scallops.found
        if not again.any():
            break
        retry = _newton(
            curve, cutter, scallops, freedom, fixed_angle, s, np.full_like(guess, other)
        )
        better = again & retry.found
        fit = Fit(
            np.where(better, retry.s, fit.s),
            np.where(better, retry.tilt, fit.tilt),
            np.where(better, retry.yaw, fit.yaw),
            fit.found | better,
            fit.iterations + np.where(again, retry.iterations, 0),
        )
    return fit


def nearest_places(curve: GuidingCurve, scallops: Scallops) -> FloatArray:
    s = np.linspace(0.0, curve.length, max(64, int(curve.length / (0.5 * MM))))
    uv = curve.parameters(s)
    guide = curve.surface.at(uv[:, 0], uv[:, 1]).offset(curve.offset).position
    gaps = np.nan_to_num(scallops.position)[:, None, :] - guide[None, :, :]
    nearest = s[np.argmin(dot(gaps, gaps), axis=1)]
    for _ in range(2):
        frames = curve.frames(nearest)
        move = dot(np.nan_to_num(scallops.position) - frames.position, frames.feed)
        nearest = nearest + np.clip(move, -MM, MM)
    return np.asarray(nearest)


def first_guess(
    curve: GuidingCurve,
    cutter: Cutter,
    scallops: Scallops,
    height: float,
    freedom: Freedom,
    fixed_angle: float,
    s: FloatArray,
) -> FloatArray:
    """Guess the free angle from the cylinder with the local curvature [TL2008, 3.2]."""
    frames = curve.frames(s)
    width = np.abs(dot(np.nan_to_num(scallops.position) - frames.position, frames.across))
    # The width of a convex surface's strip grows with the distance from it.
    width = width / np.maximum(1.0 + curve.offset * frames.curvature, 0.1)
    wanted = 2.0 * height / np.maximum(width, 1.0 * UM) ** 2 - frames.curvature
    if freedom == 'tilt':
        return cutter.tilt_of_curvature(wanted, (0.002, 1.53))
    across = cutter.effective_radius(fixed_angle)
    radius = 1.0 / np.maximum(wanted, 1e-3)
    share = (radius - cutter.corner_radius) / (across - cutter.corner_radius)
    return np.asarray(np.arccos(np.sqrt(np.clip(share, 0.01, 0.99))))


Misses = tuple[FloatArray, FloatArray, BoolArray]


def newton_step(
    misses: Sequence[Misses], steps: tuple[float, float], largest: tuple[float, float]
) -> tuple[FloatArray, FloatArray]:
    """Return the Newton moves, given the residuals here and after a step of each unknown."""
    (first, second, _), *moved = misses
    (a, c), (b, d) = (
        ((x - first) / step, (y - second) / step)
        for (x, y, _), step in zip(moved, steps, strict=True)
    )
    with np.errstate(invalid='ignore', divide='ignore'):
        determinant = a * d - b * c
        found = (b * second - d * first) / determinant, (c * first - a * second) / determinant
    x, y = (np.clip(np.nan_to_num(x), -most, most) for x, most in zip(found, largest, strict=True))
    return x, y


def _newton(
    curve: GuidingCurve,
    cutter: Cutter,
    scallops: Scallops,
    freedom: Freedom,
    fixed_angle: float,
    s: FloatArray,
    angle: FloatArray,
) -> Fit:
    n = len(s)
    fixed = np.full(n, fixed_angle)

    def at(place: FloatArray, value: FloatArray) -> Postures:
        tilt, yaw = (value, fixed) if freedom == 'tilt' else (fixed, value)
        return resting(cutter, curve.frames(place), tilt, yaw)

    iterations = np.zeros(n, np.int64)
    right = np.zeros(n, bool)
    done = np.zeros(n, bool)
    for _ in range(30):
        misses = [
            conditions(at(*places), scallops)
            for places in ((s, angle), (s + STEPS[0], angle), (s, angle + STEPS[1]))
        ]
        right = misses[0][2]
        done = np.abs(misses[0][:2]).max(axis=0) < CLOSE
        if not np.any(~done & scallops.found):
            break
        iterations += ~done
        move, turn = newton_step(misses, STEPS, LARGEST_STEP)
        s = np.where(done, s, s + move)
        angle = np.where(done, angle, np.clip(angle + turn, -0.2, 1.8))
    tilt, yaw = (angle, fixed) if freedom == 'tilt' else (fixed, angle)
    return Fit(s, tilt, yaw, done & right & scallops.found, iterations)
