"""Tool path: passes in the order of cutting, one way or zigzag, with safe links between them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.gouge import Neighbours
from cnc_interp.cam.spline_pass import ARM, SplinePass, sampled
from cnc_interp.cam.surface import SAMPLES, Surface, SurfaceError
from cnc_interp.convert.conversion import convert
from cnc_interp.core import (
    MM,
    BoolArray,
    FloatArray,
    IntArray,
    InterpError,
    demand,
    norm,
    refuse_if,
    unit,
)
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_program
from cnc_interp.program.writer import WrittenMove, cl_data, siemens
from cnc_interp.settings.options import Settings

Linking = Literal['zigzag', 'one-way']

HOP = 0.25  #: Gap between the mill and the part on a low link, as a share of the clearance.
UPRIGHT = 0.2  #: Smallest cosine between the tool axis and the direction of the safe level [-].


@dataclass(frozen=True)
class LinkOptions:
    #: Zigzag reverses every second pass after a short lift; otherwise all passes have one
    #: direction, and the tool returns on a safe level.
    linking: Linking = 'zigzag'
    #: Lift between passes, and height of the safe level above the surface [m].
    clearance: float = 2.0 * MM

    def __post_init__(self) -> None:
        demand(self.clearance > 0.0, InterpError('clearance must be positive'))


@dataclass(frozen=True)
class Link:
    tip: FloatArray  #: (3,): Tool tip at the end [m].
    axis: FloatArray  #: (3,): Unit tool axis at the end [-].
    rapid: bool  #: True for a rapid move.


def link(
    passes: Sequence[Sequence[SplinePass]],
    surface: Surface,
    cutter: Cutter,
    options: LinkOptions,
    around: Neighbours | None = None,
    up: FloatArray | None = None,
) -> list[Link | SplinePass]:
    u, v = surface.grid(SAMPLES, SAMPLES)
    ours = surface.contains(u, v)
    points = surface.at(u[ours], v[ours])
    if up is None:
        up = unit(points.normal.mean(axis=0))
    body = points.position
    if around is not None:
        body = np.concatenate([body, around.points])
    obstacles = Neighbours(np.ascontiguousarray(body), np.zeros(len(body), np.int64))
    widest = cutter.tool_radius + cutter.corner_radius
    # The lowest point of a leaning mill lies below its tip by less than its radius.
    safe = float((body @ up).max()) + widest + options.clearance
    steps: list[Link | SplinePass] = []

    def over(tip: FloatArray, axis: FloatArray) -> FloatArray:
        """Return the tip after the mill has retracted along its axis to the safe level."""
        rise = float(axis @ up)
        refuse_if(
            rise < UPRIGHT,
            SurfaceError(
                'the tool axis leans too far to lift the tool along it above the part; make a '
                'separate program for this face'
            ),
        )
        return np.asarray(tip + max((safe - float(tip @ up)) / rise, options.clearance) * axis)

    parts = _in_order(passes, options)
    for k, (one, low) in enumerate(parts):
        tip, axis = one.poses(np.array(one.ends))
        before, after = tip + options.clearance * axis
        last = steps[-1] if steps else None
        hop = (
            isinstance(last, Link)
            and low
            and _clear(last, before, axis[0], cutter, obstacles, HOP * options.clearance)
        )
        if isinstance(last, Link) and not hop:
            steps.append(Link(over(last.tip, last.axis), last.axis, True))
        if not hop:
            steps.append(Link(over(before, axis[0]), axis[0], True))
        steps += [Link(before, axis[0], True), Link(tip[0], axis[0], False), one]
        steps.append(Link(after, axis[1], False))
        if k == len(parts) - 1:
            steps.append(Link(over(after, axis[1]), axis[1], True))
    return steps


def _in_order(
    passes: Sequence[Sequence[SplinePass]], options: LinkOptions
) -> list[tuple[SplinePass, bool]]:
    found = []
    for k, parts in enumerate(passes):
        turned = options.linking == 'zigzag' and k % 2
        ordered = [part.reversed for part in parts[::-1]] if turned else list(parts)
        found += [(part, i > 0 or options.linking == 'zigzag') for i, part in enumerate(ordered)]
    return found


def _clear(
    start: Link,
    tip: FloatArray,
    axis: FloatArray,
    cutter: Cutter,
    obstacles: Neighbours,
    gap: float,
) -> bool:
    share = np.linspace(0.0, 1.0, 2 + int(float(norm(tip - start.tip)) / gap))[:, None]
    tips = start.tip + share * (tip - start.tip)
    axes = unit(start.axis + share * (axis - start.axis))
    return bool(np.all(obstacles.depth(cutter, tips, axes) < -gap))


@dataclass(frozen=True)
class ToolPath:
    tip: FloatArray  #: (n, 3): Tool tips [m].
    axis: FloatArray  #: (n, 3): Unit tool axes [-].
    rapid: BoolArray  #: (n,): True where the move to this pose is a rapid.
    number: IntArray  #: (n,): Number of the pass, from 1; 0 for links.

    @staticmethod
    def of(steps: Sequence[Link | SplinePass], chord_tolerance: float) -> ToolPath:
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


Format = Literal['spline', 'cl', 'gcode']
SUFFIXES: dict[str, str] = {'spline': '.mpf', 'cl': '.apt', 'gcode': '.ngc'}


def write_tool_path(
    steps: Sequence[Link | SplinePass],
    feedrate: float,
    chord_tolerance: float,
    file: Path,
    form: Format,
    machine: Machine,
    reading: Settings,
) -> Path:
    path = file.with_suffix(SUFFIXES[form])
    if form == 'spline':
        text = siemens(_control_points(steps, feedrate), [])
    else:
        text = cl_data(_points(ToolPath.of(steps, chord_tolerance), feedrate), 'PASSES', [])
    path.write_text(text, encoding='ascii')
    if form == 'gcode':
        program = read_program(path, Transform.of(machine), reading)
        text = convert(program, machine, Settings(), 'gcode', chord_tolerance).text
        path.write_text(text, encoding='ascii')
    return path


def _control_points(steps: Sequence[Link | SplinePass], feedrate: float) -> Iterator[WrittenMove]:
    """Yield lines and control points of passes; the line before a pass ends at its first one."""
    for step in steps:
        if isinstance(step, Link):
            second = step.tip + ARM * step.axis
            yield WrittenMove(step.tip, feedrate, step.rapid, False, second=second)
            continue
        knots, points = step.spline.t, step.spline.c
        for i in range(1, len(points)):
            # Block i holds t(i+3) - t(i+2).
            gap = float(knots[i + 3] - knots[i + 2])
            yield WrittenMove(
                points[i, :3], feedrate, False, False, second=points[i, 3:], knot_interval=gap
            )


def _points(path: ToolPath, feedrate: float) -> Iterator[WrittenMove]:
    for i, (tip, axis) in enumerate(zip(path.tip, path.axis, strict=True)):
        yield WrittenMove(tip, feedrate, i > 0 and bool(path.rapid[i]), False, axis=axis)
