"""
The classical iso-scallop path [TL2008, 1], for comparison in figures of the documentation.

Its tool angles are constant, and each pass follows from the scallop of the previous one. The
guided point moves over the guiding surface until the mill leaves the same scallop point with the
same tangent. Such passes may turn back or cross themselves; the result says where.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from cnc_interp.cam.cutter import Cutter, Postures
from cnc_interp.cam.gouge import gouge_depth
from cnc_interp.cam.guiding import CurveFrames, GuidingPlanes
from cnc_interp.cam.passes import constant_tilt
from cnc_interp.cam.scallop import Scallops, conditions, newton_step, resting, scallop_points
from cnc_interp.cam.surface import Surface, SurfaceError, SurfacePoint, place
from cnc_interp.core import (
    DEG,
    MM,
    UM,
    BoolArray,
    FloatArray,
    cross,
    dot,
    norm,
    refuse_if,
    scaled,
    unit,
)

SPACING = 0.8 * MM  #: Distance of the points of a pass [m].
CLOSE = 1e-10  #: Largest residual of the conditions [m].
#: Largest Newton step [m].
FARTHEST = 1.0 * MM
MOST_PASSES = 2000
SWEEPS = 2  #: Number of times that the feed direction is taken from the pass itself.


NEAR = 1.0 * UM  #: Distance of the points that show the change of direction of a curve [m].


@dataclass(frozen=True)
class SurfaceCurve:
    surface: Surface  #: The surface to machine.
    offset: float  #: Corner radius r_c [m].
    parameters: BSpline  #: u and v by the approximate arc length of K.
    length: float  #: Value of that arc length at the end; it begins at 0 [m].

    @staticmethod
    def through(surface: Surface, offset: float, u: FloatArray, v: FloatArray) -> SurfaceCurve:
        position = surface.at(u, v).offset(offset).position
        s = np.concatenate([[0.0], np.cumsum(norm(np.diff(position, axis=0)))])
        spline = make_interp_spline(s, np.stack([u, v], axis=1), k=5)
        return SurfaceCurve(surface, offset, spline, float(s[-1]))

    def _feed(self, s: FloatArray) -> tuple[SurfacePoint, FloatArray, FloatArray]:
        u, v = self.parameters(s).T
        u_s, v_s = self.parameters(s, 1).T
        point = self.surface.at(u, v)
        guide = point.offset(self.offset)
        run = scaled(u_s, guide.d_u) + scaled(v_s, guide.d_v)
        return point, unit(run), norm(run)

    def frames(self, s: FloatArray) -> CurveFrames:
        """Return K and its frame at places (n,) [m]; the rates are by arc length of K."""
        point, feed, speed = self._feed(s)
        ahead, behind = self._feed(s + NEAR)[1], self._feed(s - NEAR)[1]
        n, n_s = point.normal, point.offset(self.offset).normal_rate(feed)
        f_s = scaled(0.5 / (NEAR * speed), ahead - behind)
        t = cross(feed, n)
        u, v = self.parameters(s).T
        return CurveFrames(
            point.offset(self.offset).position,
            n,
            feed,
            t,
            n_s,
            f_s,
            cross(f_s, n) + cross(feed, n_s),
            u,
            v,
            point.curvature(t),
        )


def crossing(u: FloatArray, v: FloatArray) -> int:
    n = len(u) - 1
    if n < 3:
        return -1
    du, dv = np.diff(u), np.diff(v)

    def side(i: slice, j: slice, shift: int) -> FloatArray:
        x = u[j.start + shift : j.stop + shift][None, :] - u[i][:, None]
        y = v[j.start + shift : j.stop + shift][None, :] - v[i][:, None]
        return np.asarray(du[i][:, None] * y - dv[i][:, None] * x)

    whole = slice(0, n)
    apart = side(whole, whole, 0) * side(whole, whole, 1) < 0.0
    cut = apart & apart.T
    near = np.abs(np.arange(n)[:, None] - np.arange(n)[None, :]) < 2
    hit = (cut & ~near).any(axis=1)
    return int(np.argmax(hit)) if hit.any() else -1


@dataclass(frozen=True)
class ClassicalPass:
    curve: SurfaceCurve  #: Path of the guided point K.
    s: FloatArray  #: (n,): Places of the postures [m].
    postures: Postures  #: The postures there.
    right: Scallops  #: Scallop points on the side of the next pass.

    @property
    def reach(self) -> FloatArray:
        return self.right.half_width(self.postures)

    def tool(self, s: FloatArray) -> Postures:
        p = self.postures
        return resting(p.cutter, self.curve.frames(s), p.tilt[0], p.yaw[0])


@dataclass(frozen=True)
class ClassicalPaths:
    passes: list[ClassicalPass]  #: The passes in order.
    loop: str  #: Where and how the next pass would loop; empty if the surface is covered.
    notes: Sequence[str] = ()


def classical_paths(
    surface: Surface,
    cutter: Cutter,
    plane_normal: FloatArray,
    scallop_height: float,
    tilt: float,
    start: float | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> ClassicalPaths:
    surface.check(cutter.corner_radius)
    normal = np.asarray(plane_normal, float) / np.linalg.norm(plane_normal)
    run = _Run(surface, cutter, normal, scallop_height, 0.5 * np.pi if cutter.is_ball else tilt)
    return run.all_passes(start, progress)


class _Run:
    def __init__(
        self, surface: Surface, cutter: Cutter, normal: FloatArray, height: float, tilt: float
    ):
        self.surface, self.cutter, self.normal = surface, cutter, normal
        self.height, self.tilt = height, tilt
        self.beyond = cutter.tool_radius + cutter.corner_radius

    def all_passes(self, start: float | None, progress: Callable[[float], None]) -> ClassicalPaths:
        passes = [self.first_pass(start)]
        while self.covers_more(passes[-1]):
            refuse_if(
                len(passes) >= MOST_PASSES,
                SurfaceError(f'more than {MOST_PASSES} passes; is the scallop height right?'),
            )
            u, v, found = self.followed(passes[-1])
            loop = self.loop(passes[-1], u, v, found)
            if loop:
                return ClassicalPaths(passes, f'pass {len(passes) + 1} {loop}')
            passes.append(self.made(u[found], v[found], len(passes) + 1))
            progress(self.share(passes[-1]))
        return ClassicalPaths(passes, '')

    def first_pass(self, start: float | None) -> ClassicalPass:
        planes = GuidingPlanes(self.surface, self.cutter.corner_radius, self.normal, self.beyond)
        if start is None:
            curve = planes.curve(planes.span[0])
            angles = constant_tilt(curve, self.tilt, 0.0, 41)
            postures = angles.postures(curve, self.cutter, angles.s)
            right = scallop_points(self.surface, postures, self.height)
            start = planes.span[0] + 0.9 * float(np.nanmin(right.half_width(postures)))
        curve = planes.curve(start)
        s = np.linspace(0.0, curve.length, max(25, int(curve.length / SPACING)))
        u, v = curve.parameters(s).T
        return self.made(u, v, 1)

    def made(self, u: FloatArray, v: FloatArray, number: int) -> ClassicalPass:
        raw = SurfaceCurve.through(self.surface, self.cutter.corner_radius, *self.longer(u, v))
        s = np.linspace(0.0, raw.length, max(25, int(raw.length / SPACING)))
        curve = SurfaceCurve.through(raw.surface, raw.offset, *raw.parameters(s).T)
        s = np.linspace(0.0, curve.length, len(s))
        postures = resting(self.cutter, curve.frames(s), self.tilt, 0.0)
        right = scallop_points(self.surface, postures, self.height)
        if not right.found.all():
            i = int(np.argmin(right.found))
            raise SurfaceError(
                f'pass {number} at {place(postures.contact[i])}: the mill leaves no scallop of '
                f'{self.height / UM:g} um within its width; take a larger tilt'
            )
        if self.cutter.is_ball:  # its bottom is a point
            return ClassicalPass(curve, s, postures, right)
        depth = gouge_depth(self.surface, postures)
        if float(depth.max()) > UM:
            i = int(np.argmax(depth))
            raise SurfaceError(
                f'pass {number} at {place(postures.contact[i])}: the bottom of the mill enters '
                f'the surface by {depth[i] / UM:.0f} um; take a larger tilt or a smaller mill'
            )
        return ClassicalPass(curve, s, postures, right)

    def longer(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        far = self.surface.contains(u, v, self.beyond)
        kept = slice(int(np.argmax(far)), len(far) - int(np.argmax(far[::-1])))
        u, v = u[kept], v[kept]
        for _ in range(2):
            position = self.surface.at(u, v).position
            step = float(norm(position[1] - position[0]))
            count = 0
            ends = u[:1], v[:1]
            while self.surface.contains(ends[0], ends[1], 0.8 * self.beyond)[0] and count < 400:
                count += 1
                share = count * SPACING / step
                ends = u[:1] - share * (u[1] - u[0]), v[:1] - share * (v[1] - v[0])
            out = np.arange(count, 0, -1) * SPACING / step
            u, v = (np.concatenate([x[0] - out * (x[1] - x[0]), x])[::-1] for x in (u, v))
        return u, v

    def covers_more(self, before: ClassicalPass) -> bool:
        frames = before.postures.frames
        u, v, _ = self.surface.project(before.right.position, frames.u, frames.v)
        return bool(self.surface.contains(u, v, 0.0).any())

    def share(self, made: ClassicalPass) -> float:
        u, v = self.surface.grid(9, 9)
        level = self.surface.at(u, v).position @ self.normal
        here = float(np.median(made.postures.contact @ self.normal))
        return float(np.clip((here - level.min()) / np.ptp(level), 0.0, 1.0))

    def followed(self, before: ClassicalPass) -> tuple[FloatArray, FloatArray, BoolArray]:
        frames, right = before.postures.frames, before.right
        along = right.tangent
        point = self.surface.at(frames.u, frames.v)
        a, b = point.components(scaled(2.0 * before.reach, frames.across))
        u, v = frames.u + a, frames.v + b
        found = np.ones(len(u), bool)
        for _ in range(1 + SWEEPS):
            u, v, found = self.solved(right, along, u, v)
            if found.sum() < 8:
                break
            # The feed direction follows the pass itself.
            here = self.surface.at(u, v).offset(self.cutter.corner_radius).position
            turned = np.gradient(here, axis=0)
            along = np.where(dot(turned, along)[:, None] > 0.0, turned, along)
        return u, v, found

    def solved(
        self, right: Scallops, along: FloatArray, u: FloatArray, v: FloatArray
    ) -> tuple[FloatArray, FloatArray, BoolArray]:
        steps, largest = self.surface.growth(1e-8), self.surface.growth(FARTHEST)
        valid = done = np.zeros(len(u), bool)
        for _ in range(25):
            misses = [
                conditions(self.resting(a, b, along), right)
                for a, b in ((u, v), (u + steps[0], v), (u, v + steps[1]))
            ]
            valid = misses[0][2] | self.cutter.is_ball
            done = np.abs(misses[0][:2]).max(axis=0) < CLOSE
            if done.all():
                break
            du, dv = newton_step(misses, steps, largest)
            u, v = np.where(done, u, u + du), np.where(done, v, v + dv)
        return u, v, done & valid

    def resting(self, u: FloatArray, v: FloatArray, along: FloatArray) -> Postures:
        point = self.surface.at(u, v)
        n = point.normal
        feed = unit(along - scaled(dot(along, n), n))
        t, zero, none = cross(feed, n), np.zeros(len(u)), np.zeros((len(u), 3))
        frames = CurveFrames(
            point.offset(self.cutter.corner_radius).position,
            n,
            feed,
            t,
            none,
            none,
            none,
            u,
            v,
            zero,
        )
        return resting(self.cutter, frames, self.tilt, 0.0)

    def loop(self, before: ClassicalPass, u: FloatArray, v: FloatArray, found: BoolArray) -> str:
        """Say where the next pass turns back, has a corner or crosses itself; empty if none."""
        ours = self.surface.contains(u, v, 0.0)
        if (ours & ~found).any():
            i = int(np.argmax(ours & ~found))
            return f'cannot be found at {place(before.right.position[i])}'
        position = self.surface.at(u, v).position
        chord, old = np.diff(position, axis=0), np.diff(before.postures.contact, axis=0)
        both = ours[1:] & ours[:-1] & found[1:] & found[:-1]
        back = both & (dot(chord, old) < 0.0)
        if back.any():
            return f'turns back at {place(position[int(np.argmax(back))])}'
        turn = dot(unit(chord[1:]), unit(chord[:-1]))
        tight = both[1:] & both[:-1] & (turn < np.cos(60.0 * DEG))
        if tight.any():
            return f'has a corner at {place(position[int(np.argmax(tight)) + 1])}'
        i = crossing(u[ours & found], v[ours & found])
        return '' if i < 0 else f'crosses itself at {place(position[ours & found][i])}'
