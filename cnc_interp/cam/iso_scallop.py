"""5-axis iso-scallop passes along parallel planes [TL2008]: the choices, and all passes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.iso_scallop_options import IsoScallopOptions
from cnc_interp.cam.pass_recursion import PassRecursion
from cnc_interp.cam.passes import Pass
from cnc_interp.cam.surface import Surface, SurfaceError
from cnc_interp.core.arrays import FloatArray


@dataclass(frozen=True)
class IsoScallopPaths:
    """All passes over a surface, with the inputs they were made from."""

    surface: Surface  #: The surface to machine.
    cutter: Cutter  #: The mill.
    options: IsoScallopOptions  #: The user's choices.
    plane_normal: FloatArray  #: (3,): Unit normal N of the guiding planes [-].
    passes: list[Pass]  #: The passes in order.
    notes: list[str] = field(default_factory=list)  #: Which passes started afresh, and why.

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
    progress: Callable[[float], None] | None = None,
) -> IsoScallopPaths:
    """Compute all passes over a surface."""
    if cutter.is_ball:
        raise SurfaceError(
            'the strip of a ball mill does not depend on its tilt; take a corner radius smaller '
            'than half the diameter, or --strategy classical'
        )
    surface.check(cutter.corner_radius)
    normal = np.asarray(plane_normal, float) / np.linalg.norm(plane_normal)
    recursion = PassRecursion(surface, cutter, normal, options)
    passes = recursion.all_passes(progress)
    return IsoScallopPaths(surface, cutter, options, normal, passes, recursion.notes)
