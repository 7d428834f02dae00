"""The two solutions (branches) of the rotary axes: which one holds, and which one to begin on."""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import BlockError
from cnc_interp.machine_model.transform import Transform

#: The sine of the angle to the pole of a tool axis that lies on it is smaller [-].
ON_POLE = 1e-9


def on_pole(transform: Transform, axis: FloatArray) -> bool:
    """Tell whether a tool axis, shape (3,), lies on the pole."""
    return float(np.linalg.norm(np.cross(axis, transform.pole))) < ON_POLE


def branch_at(transform: Transform, rotary: FloatArray) -> float:
    """Return the branch on which rotary positions lie."""
    axis = transform.tool_axis(rotary[None])[0]
    gaps = [
        np.abs(np.sin(0.5 * (rotary - pair))).max() for pair in transform.rotary_solutions(axis)
    ]
    return 1.0 if not gaps or gaps[0] <= gaps[-1] else -1.0


def start_positions(
    transform: Transform, axis: FloatArray, rotary: FloatArray, near: FloatArray, line_number: int
) -> tuple[FloatArray, float]:
    """
    Choose rotary positions (2,) [rad] and branch (+1 or -1) of a start pose.

    ``axis`` (3,): its tool axis; ``rotary`` (2,): positions that the program names, else NaN;
    ``near`` (2,): the solution nearest to these counts then [rad]. Zeros without rotary axes.
    Raises BlockError if the orientation cannot be reached within the travel.
    """
    machine = transform.machine
    if not machine.has_rotary:
        return np.zeros(2), 1.0
    if np.isfinite(rotary).all():
        named = np.array(rotary, dtype=float)
        return named, branch_at(transform, named)
    low, high = machine.travel[~machine.is_linear].T
    outer = transform.outer
    free = on_pole(transform, axis)
    found = []
    for branch, pair in zip((1.0, -1.0), transform.rotary_solutions(axis), strict=False):
        if free:
            pair[outer] = near[outer]
        pair = pair + 2.0 * np.pi * np.round((near - pair) / (2.0 * np.pi))
        if (pair >= low).all() and (pair <= high).all():
            found.append((float(np.abs(pair - near).sum()), -branch, pair))
    if not found:
        raise BlockError(
            f'no rotary position of machine {machine.name} within its travel reaches '
            f'the tool axis ({axis[0]:.4f}, {axis[1]:.4f}, {axis[2]:.4f})',
            line_number,
        )
    _, minus_branch, pair = min(found, key=lambda option: option[:2])
    return np.asarray(pair), -minus_branch


#: Least length of the direction of a tool axis [-], and how exactly a fixed one is met [-].
LEAST_LENGTH, SAME_AXIS = 1e-6, 1e-9


def positions_of_pose(
    transform: Transform, tip: FloatArray, axis: FloatArray | None, stands: FloatArray
) -> FloatArray:
    """
    Return the axis positions of a tool pose, (n_axes,) [m, rad].

    ``tip`` (3,): in W, NaN keeps a coordinate [m]; ``axis`` (3,): direction in W of any length,
    None keeps the rotary axes; ``stands`` (n_axes,): the nearest solution counts, extra axes stay.
    Raises BlockError if the direction is out of travel, ValueError if it has no length or the
    tool cannot turn to it.
    """
    here, present = (found[0] for found in transform.forward(stands[None, :]))
    tip = np.where(np.isnan(tip), here, tip)
    own = 5 if transform.machine.has_rotary else 3
    rotary = np.zeros(2) if own == 3 else stands[3:5]
    if axis is not None:
        length = float(np.linalg.norm(axis))
        if not LEAST_LENGTH < length < np.inf:
            raise ValueError('the direction of the tool axis has no length')
        wanted = axis / length
        if own == 3 and np.abs(wanted - present).max() > SAME_AXIS:
            raise ValueError('the tool of this machine does not turn; leave out I J K')
        if own == 5:
            rotary, _ = start_positions(transform, wanted, np.full(2, np.nan), rotary, 0)
    linear = transform.linear(tip[None, :], rotary[None, :])[0]
    extra = stands[own:]
    if len(extra):
        linear = linear - extra @ transform.extra_direction
    return np.concatenate([linear, rotary[: own - 3], extra])
