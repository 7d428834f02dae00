"""The passes of one face, cut back where the mill would enter other faces of the part."""

from __future__ import annotations

from dataclasses import dataclass, field

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.milled import kept_ranges
from cnc_interp.cam.neighbours import Neighbours
from cnc_interp.cam.spline_pass import SplinePass, Strips
from cnc_interp.cam.surface import Surface, SurfaceError
from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.units import MM

#: Length that is left out before a note says so [m].
NOTICED = 0.5 * MM


@dataclass(frozen=True)
class MachinedFace:
    """One face and its passes."""

    number: int  #: Number of the face.
    surface: Surface  #: Its surface.
    across: FloatArray  #: (3,): Unit normal N of the guiding planes [-].
    paths: Strips  #: The passes.
    parts: list[list[SplinePass]]  #: The milled parts of each pass that has any.
    seconds: float  #: Computing time [s].
    notes: list[str] = field(default_factory=list)  #: What the user should know.


def cut_back(
    paths: Strips, cutter: Cutter, overrun: float,
    fixed_axis: FloatArray | None, others: Neighbours | None,
) -> tuple[list[list[SplinePass]], list[str]]:  # fmt: skip
    """Fit splines to the milled parts of all passes."""
    found = [SplinePass.of(made, overrun, fixed_axis, others) for made in paths.passes]
    parts = [one for one in found if one]
    if others is None:
        return parts, []
    whole = sum(
        last - first
        for made in paths.passes
        for first, last in kept_ranges(made.curve, made.s, made.reach, overrun)
    )
    milled = sum(part.ends[1] - part.ends[0] for one in parts for part in one)
    if not parts:
        raise SurfaceError(
            'on every pass the mill would enter other faces of the part; take a smaller mill, or '
            '--ignore-neighbours'
        )
    if whole - milled < NOTICED:
        return parts, []
    left_out = (
        f'{(whole - milled) / MM:.0f} of {whole / MM:.0f} mm of passes are left out: there the '
        f'mill of {2.0 * (cutter.tool_radius + cutter.corner_radius) / MM:g} mm would enter other '
        'faces of the part; with another --direction it may reach more'
    )
    return parts, [left_out]
