"""Interface to the kinematics of a machine: axis positions <-> tool poses in the workpiece.

Code that uses only ``Transform`` works for any machine. Code that uses ``five_axis`` needs
a machine with X Y Z axes, and not an arm.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from cnc_interp.core import BlockError, FloatArray
from cnc_interp.machine_model.error_map import ErrorMap
from cnc_interp.machine_model.five_axis import FiveAxis
from cnc_interp.machine_model.joint_chain import JointChain
from cnc_interp.machine_model.machine import Machine


class Transform(Protocol):
    """The kinematics of a machine. Axis positions q have a column for each axis."""

    @property
    def packed(self) -> FloatArray:
        """The geometry for kernels: one row, or for an arm a row for each joint."""

    @property
    def machine(self) -> Machine:
        """The machine with its axes and limits."""

    @property
    def errors(self) -> ErrorMap:
        """The map between commanded and nominal axes; all other methods use nominal axes."""

    def forward(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return tool tips [m] and unit tool axes [-] in W, (n, 3) each, for axis positions q."""

    def rates(
        self, tip: FloatArray, axis: FloatArray, step: FloatArray, turn: FloatArray
    ) -> FloatArray:
        """Return the axis rates per path length at n poses of a path, (n, m).

        The arguments are rows of tool tip [m], tool axis, unit step of the tip, and turn of the
        tool axis [rad/m]. The m columns belong to the first m axes. Rates are NaN where a pose is
        singular or out of reach.
        """

    def linear(self, tip: FloatArray, rotary: FloatArray) -> FloatArray:
        """Return X Y Z of the program (n, 3) [m] for tool tips and rotary positions."""

    def counted(self, q: FloatArray, tip: FloatArray) -> FloatArray:
        """Return the program coordinates for axis positions q (n_axes,) and their tool tip."""

    def tool_axis(self, rotary: FloatArray) -> FloatArray:
        """Return the tool axes (n, 3) for positions of the programmed rotary axes."""

    @property
    def five_axis(self) -> FiveAxis:
        """The transformation in closed form; raises MachineError if the machine is an arm."""

    @staticmethod
    def of(machine: Machine) -> Transform:
        return FiveAxis.of(machine) if machine.arm is None else JointChain.of(machine)


def reached(transform: Transform, commanded: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return tool tips and tool axes like ``forward``, but for commanded axes (n, n_axes)."""
    return transform.forward(transform.errors.nominal(commanded))


NO_PART = 1e-12  #: Smaller components of a tool axis count as zero [-].


class ToolLine(NamedTuple):
    """Line ``q + x direction`` of axis positions that moves the tip by x along the tool axis."""

    direction: FloatArray  #: (n_axes,): Axis travel per x; x > 0 leads off the workpiece.
    travel: FloatArray  #: (2,): Range of x in which all axes stay within their travel [m].


def tool_line(transform: Transform, stands: FloatArray) -> ToolLine:
    n = len(stands)
    tip, axis = transform.forward(stands + np.eye(4, n, -1))
    direction = np.zeros(n)
    direction[:3] = np.linalg.solve((tip[1:] - tip[0]).T, axis[0])
    direction[np.abs(direction) < NO_PART] = 0.0
    moves = direction != 0.0
    ends = (transform.machine.travel[moves] - stands[moves, None]) / direction[moves, None]
    ends = np.sort(ends, axis=1)
    return ToolLine(direction, np.array([ends[:, 0].max(), ends[:, 1].min()]))


def start_positions(
    transform: FiveAxis, axis: FloatArray, rotary: FloatArray, near: FloatArray, line_number: int
) -> tuple[FloatArray, float]:
    """Return the rotary positions (2,) [rad] and the branch (+1 or -1) of a start pose.

    ``rotary`` (2,): programmed positions, or NaN to choose the solution nearest to ``near``.
    Raises BlockError if the orientation cannot be reached within the travel.
    """
    machine = transform.machine
    if not machine.has_rotary:
        return np.zeros(2), 1.0
    if np.isfinite(rotary).all():
        named = np.array(rotary, dtype=float)
        return named, transform.branch_at(named)
    low, high = machine.travel[~machine.is_linear].T
    free = near if transform.on_pole(axis) else None
    found = []
    for branch, pair in zip((1.0, -1.0), transform.branches(axis, near, free), strict=False):
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


#: Least length of a given tool axis [-], and tolerance if the tool axis cannot turn [-].
LEAST_LENGTH, SAME_AXIS = 1e-6, 1e-9


def positions_of_pose(
    transform: Transform, tip: FloatArray, axis: FloatArray | None, stands: FloatArray
) -> FloatArray:
    """Return the axis positions (n_axes,) [m, rad] at a tool pose.

    Where ``tip`` is NaN or ``axis`` is None, the current value applies. ``axis`` may have any
    length. Among several solutions, that nearest to ``stands`` is returned. Raises BlockError if
    ``axis`` needs more travel, and ValueError if it is zero or the tool cannot turn to it.
    """
    here, present = (found[0] for found in transform.forward(stands[None, :]))
    tip = np.where(np.isnan(tip), here, tip)
    if axis is not None:
        length = float(np.linalg.norm(axis))
        if not LEAST_LENGTH < length < np.inf:
            raise ValueError('the direction of the tool axis has no length')
    if isinstance(transform, JointChain):
        return transform.reached(tip, present if axis is None else axis / length, stands)
    own = 5 if transform.machine.has_rotary else 3
    rotary = np.zeros(2) if own == 3 else stands[3:5]
    if axis is not None:
        wanted = axis / length
        if own == 3 and np.abs(wanted - present).max() > SAME_AXIS:
            raise ValueError('the tool of this machine does not turn; leave out I J K')
        if own == 5:
            rotary, _ = start_positions(transform.five_axis, wanted, np.full(2, np.nan), rotary, 0)
    linear = transform.linear(tip[None, :], rotary[None, :])[0]
    extra = stands[own:]
    if len(extra):
        linear = linear - extra @ transform.machine.extra_direction
    return np.concatenate([linear, rotary[: own - 3], extra])
