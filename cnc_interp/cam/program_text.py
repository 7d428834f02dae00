"""Tool paths as part programs: native B-splines, CL data, or G-code with rotary words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from cnc_interp.cam.spline_pass import ARM, SplinePass
from cnc_interp.cam.tool_path import Link, ToolPath
from cnc_interp.convert import convert
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform
from cnc_interp.program import read_program
from cnc_interp.program.writer import ClMove, SiemensMove, cl_data, siemens
from cnc_interp.settings.choices import Settings

Format = Literal['spline', 'cl', 'gcode']
#: Suffix of the file for each dialect.
SUFFIXES: dict[str, str] = {'spline': '.mpf', 'cl': '.apt', 'gcode': '.ngc'}


def write_tool_path(
    steps: Sequence[Link | SplinePass], feedrate: float, chord_tolerance: float, file: Path,
    form: Format, machine: Machine, reading: Settings,
) -> Path:  # fmt: skip
    """Write a tool path as a part program."""
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


def _control_points(steps: Sequence[Link | SplinePass], feedrate: float) -> Iterator[SiemensMove]:
    """Yield lines, and the control points of passes; the first is the end of the previous line."""
    for step in steps:
        if isinstance(step, Link):
            yield SiemensMove(
                step.tip, step.tip + ARM * step.axis, feedrate, np.nan, step.rapid, False
            )
            continue
        knots, points = step.spline.t, step.spline.c
        for i in range(1, len(points)):
            # Block i holds t(i+3) - t(i+2).
            gap = float(knots[i + 3] - knots[i + 2])
            yield SiemensMove(points[i, :3], points[i, 3:], feedrate, gap, False, False)


def _points(path: ToolPath, feedrate: float) -> Iterator[ClMove]:
    """Yield the poses; the first is the start of the program."""
    for i, (tip, axis) in enumerate(zip(path.tip, path.axis, strict=True)):
        yield ClMove(tip, axis, feedrate, i > 0 and bool(path.rapid[i]), False)
