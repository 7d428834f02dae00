"""Figures of passes, rotary motion near the pole and simulated surfaces, also as text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cnc_interp.cam.nbuffer import Heights
from cnc_interp.cam.simulation import Section
from cnc_interp.cam.spline_pass import SPACING, MachinedFace, SplinePass
from cnc_interp.cam.strategies import STRATEGIES, Strategy
from cnc_interp.core import DEG, MM, UM, FloatArray, cross, dot, norm
from cnc_interp.machine_model.five_axis import FiveAxis
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform

TURNS = range(1, 61)  #: Turns of the workpiece that are tried, in this order [deg].
#: A pass is near the pole where the outer axis needs a larger share of its largest velocity [-].
NEAR = 2.0
#: A path this near to the pole is moved through it; distance as a share of the tolerance [-].
THROUGH = 0.5


@dataclass(frozen=True)
class PoleTurn:
    axis: str  #: Name of the outer rotary axis.
    passes: int  #: Number of passes that are near the pole.
    distance: float  #: Smallest angle between tool axis and pole in these passes [rad].
    rate: float  #: Largest rate of the axis at the programmed feed over its largest velocity [-].
    about: str  #: X or Y, the workpiece axis to turn about; empty if no turn helps.
    #: Smallest turn of the workpiece after which this axis can follow, in whole degrees [rad].
    angle: float

    @property
    def text(self) -> str:
        said = (
            f'passes near the pole: {self.passes}, down to {self.distance / DEG:.2f} deg from it, '
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
    transform = Transform.of(machine).five_axis
    outer, limit = machine.axis_names[3 + transform.outer], THROUGH * tolerance
    fastest = float(machine.max_velocity[3 + transform.outer])
    turns = [_Turns.of(one, feedrate) for one in passes]
    found = [turn.nearest(transform.pole, limit, fastest) for turn in turns]
    near = [one for one in found if one[1] > NEAR]
    if not near:
        return None
    together = _Turns(
        *(
            np.concatenate(columns)
            for columns in zip(*((turn.start, turn.end, turn.rate) for turn in turns), strict=True)
        )
    )
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
        # The foot of the pole on each great circle, if it lies there; both poles are equivalent.
        side = cross(normal, self.start)
        foot = np.arctan2(side @ pole, self.start @ pole)
        foot = np.where(self.start @ pole < 0.0, foot - np.pi * np.sign(foot), foot)
        foot = np.clip(foot, 0.0, theta)[:, None]
        sine = norm(cross(np.cos(foot) * self.start + np.sin(foot) * side, pole))
        rate = theta * self.rate * np.abs(normal @ pole) / np.maximum(sine, 1e-12) ** 2
        rate = np.where(sine < limit, 0.0, rate)
        return float(np.arcsin(min(sine.min(), 1.0))), float(rate.max()) / fastest

    def reached(self, transform: FiveAxis) -> bool:
        """Return whether the inner axis can reach the largest angles from the pole."""
        inner = 1 - transform.outer
        low, high = transform.machine.travel[3 + inner]
        along = self.start @ transform.pole
        for k in (int(along.argmin()), int(along.argmax())):
            tilts = [pair[inner] for pair in transform.rotary_solutions(self.start[k])]
            if not any(low <= tilt <= high for tilt in tilts):
                return False
        return True


def facts_of(faces: Sequence[MachinedFace], strategy: Strategy) -> dict[str, Any]:
    found = [_facts_of(face) | strategy.facts(face.paths) for face in faces]
    if len(faces) == 1:
        return found[0]
    return {'faces': [{'face': face.number, **one} for face, one in zip(faces, found)]}


def face_facts(summary: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the part of a summary for each face; a single face has the whole summary."""
    found: list[dict[str, Any]] = summary.get('faces', [summary])
    return found


def _facts_of(face: MachinedFace) -> dict[str, Any]:
    paths = face.paths
    return {
        'passes': len(paths.passes),
        'postures': sum(len(p.s) for p in paths.passes),
        'computing_time': face.seconds,
        'length': sum(p.curve.length for p in paths.passes),
        'milled_parts': sum(map(len, face.parts)),
        'milled_length': sum(x.ends[1] - x.ends[0] for parts in face.parts for x in parts),
    }


def results(heights: Heights, section: Section) -> dict[str, Any]:
    return heights.statistics() | ridges_of(section)


def ridges_of(section: Section) -> dict[str, Any]:
    if not len(section.ridges):
        return {}
    low, middle, high = np.percentile(section.ridges, [5.0, 50.0, 95.0]).tolist()
    return {
        'ridges': len(section.ridges),
        'ridge_5': low,
        'ridge_50': middle,
        'ridge_95': high,
        'ridge_highest': float(section.ridges.max()),
    }


def describe(summary: dict[str, Any]) -> str:
    lines = []
    if 'surface' in summary:
        lines.append(f'surface        {summary["surface"]}')
    for face in face_facts(summary):
        if 'face' in face:
            lines.append(f'face           {face["face"]}')
        if 'passes' in face:
            lines += [_passes_in_words(face), *STRATEGIES[summary['strategy']].words(face)]
    if 'program' in summary:
        lines.append(f'program        {summary["program"]}, {summary["blocks"]} blocks')
    if 'pole' in summary:
        lines.append(f'pole           {PoleTurn(**summary["pole"]).text}')
    if 'cycle_time' in summary:
        lines.append(f'cycle time     {summary["cycle_time"]:.3f} s')
    for face in face_facts(summary):
        for name in ('programmed', 'planned', 'executed'):
            if name in face:
                of = f'face {face["face"]}: ' if 'face' in face else ''
                lines.append(f'{name:<15}{of}{heights_in_words(face[name])}')
    return '\n'.join(lines)


def _passes_in_words(face: dict[str, Any]) -> str:
    several = face['milled_parts'] != face['passes']
    parts = f' in {face["milled_parts"]} parts' if several else ''
    return (
        f'passes         {face["passes"]}{parts}, {face["milled_length"] / MM:.0f} mm; '
        f'{face["postures"]} postures in {face["computing_time"]:.2f} s'
    )


def heights_in_words(found: dict[str, Any]) -> str:
    um = {k: v / UM for k, v in found.items() if isinstance(v, float)}
    text = (
        f'{um["lowest"]:.2f} to {um["highest"]:.2f} um, Sa {um["Sa"]:.2f}, Sq {um["Sq"]:.2f}, '
        f'Sz {um["Sz"]:.2f} um; deeper than 0.5 um {found["gouged"]:.2%}, uncut '
        f'{found["uncut"]:.2%}'
    )
    if 'ridges' in found:
        text += (
            f'\n{"":15}ridges {um["ridge_5"]:.2f} / {um["ridge_50"]:.2f} / {um["ridge_95"]:.2f} '
            f'um (5, 50, 95 % of {found["ridges"]}), highest {um["ridge_highest"]:.2f} um'
        )
    if 'tiles' in found:
        tiles = found['tiles']
        known = (
            f', {tiles["known_before"]} of them known from an earlier start'
            if tiles['known_before']
            else ''
        )
        text += (
            f'\n{"":15}{tiles["needles"]} needles ({tiles["rows"]} x {tiles["columns"]}) in '
            f'{tiles["tiles"]} tiles{known}\n{"written":<15}{tiles["folder"]}: index.html, '
            'heights.zarr'
        )
    return text
