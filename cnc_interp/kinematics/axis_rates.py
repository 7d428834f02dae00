"""How fast the axes move along a line: q_s of programmed poses, before any path is built."""

from __future__ import annotations

from functools import partial

import numpy as np
from numba import njit

from cnc_interp.core.arrays import FloatArray
from cnc_interp.kinematics.transform import Transform
from cnc_interp.kinematics.transform_kernels import linear_jets, rotary_jets
from cnc_interp.smoothing.machine_traits import MachineTraits


def traits_of(transform: Transform) -> MachineTraits:
    """Return what smoothing must know of a machine."""
    machine = transform.machine
    pole = tuple(float(x) for x in transform.pole) if machine.has_rotary else None
    return MachineTraits(
        axis_rates=partial(jerk_rates, transform),
        pole=pole,  # type: ignore[arg-type]
        pole_cone=machine.singular_cone,
        geometry=transform if machine.has_rotary else None,
        max_jerk=machine.max_jerk if machine.has_rotary else None,
    )


def jerk_rates(
    transform: Transform, tip: FloatArray, axis: FloatArray, step: FloatArray, turn: FloatArray
) -> FloatArray:
    """Return how far the axes move per metre of tool tip path, each over its jerk limit."""
    machine = transform.machine
    if not machine.has_rotary:
        return np.asarray(step / machine.max_jerk[:3])
    rows = (np.ascontiguousarray(column) for column in (tip, axis, step, turn))
    return np.asarray(rates(transform.packed, transform.outer, *rows) / machine.max_jerk[:5])


@njit(cache=True, nogil=True, error_model='numpy')  # at the pole they are not finite
def rates(
    packed: FloatArray, outer: int, tip: FloatArray, axis: FloatArray, step: FloatArray,
    turn: FloatArray,
) -> FloatArray:  # fmt: skip
    """Return q_s of the branch with the positive tilt, shape (n, 5); rows as in ``jerk_rates``."""
    found = np.full((len(tip), 5), np.nan)
    for i in range(len(tip)):
        o, w = axis[i], turn[i]
        slope = (
            w[1] * o[2] - w[2] * o[1],
            w[2] * o[0] - w[0] * o[2],
            w[0] * o[1] - w[1] * o[0],
        )
        tool = (
            (o[0], slope[0], 0.0, 0.0),
            (o[1], slope[1], 0.0, 0.0),
            (o[2], slope[2], 0.0, 0.0),
        )
        tilt, turned, sine_squared = rotary_jets(packed, tool, 1.0, 0.0, 0.0)
        if sine_squared <= 0.0:
            continue
        first, second = (tilt, turned) if outer == 1 else (turned, tilt)
        point = (
            (tip[i, 0], step[i, 0], 0.0, 0.0),
            (tip[i, 1], step[i, 1], 0.0, 0.0),
            (tip[i, 2], step[i, 2], 0.0, 0.0),
        )
        x, y, z = linear_jets(packed, point, first, second)
        found[i, 0], found[i, 1], found[i, 2] = x[1], y[1], z[1]
        found[i, 3], found[i, 4] = first[1], second[1]
    return found
