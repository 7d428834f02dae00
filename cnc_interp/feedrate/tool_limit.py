"""A limit on the error that the drives leave at the tool: rows for the jerk stage, and a check.

In slow motion the axes have the error e = c1 q' + c2 q'' - sign(q') away, and the tip the error J
e with J = dp/dq (``drives/tool_error.py``). Only the component across the path counts, along
normals n of the tip path. With q' = q_s s_dot and q'' = q_s s_ddot + q_ss s_dot^2, a normal has
the row

    |n J (c2 q_s) s_ddot + n J (c2 q_ss) b + n J (c1 q_s) s_dot - n J (sign(q_s) away)| <= E.

The tool axis at flank height h has such rows, too. Because the tip is compared with the nearest
place of the path, the axis is off by h (J_o - o_s (t J)) e, where t is the direction of the tip.
With four normals, an octagon replaces the circle of radius E.

These rows neglect transients after a jerk step or a reversal, and the flexible mode. Therefore the
drives are simulated on each law. Where the error exceeds the limit, the limit of the rows is
lowered and the stretch is solved again, as after any other excess between the nodes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d

from cnc_interp.core import MM, BoolArray, FloatArray
from cnc_interp.drives.compensation import compensated_model
from cnc_interp.drives.tool_error import ErrorSeries, ToolMotion, error_series
from cnc_interp.feedrate.motion_law import MotionLaw, Stretch, axis_motion
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.notices import WARNING
from cnc_interp.settings.options import Settings

FEELER = 1e-6  #: Half of the step of an axis in a difference of poses [m or rad].
NORMALS = 4  #: Number of directions in which the error of tip and of axis is limited.
FIRST_PART, LEAST_PART = 0.97, 0.2  #: Part of the limit for rows: at first, and least [-].
RELAXED = 1e-3  #: Part by which the limit is relaxed for cells of an older plan [-].
STEADY_PART = 0.8  #: Largest part of a row's limit that friction and backlash may take [-].
AIM, EXCESS_FACTOR = 0.985, 1.3  #: Use that a correction aims at; factor on the excess.
NEARBY = 0.02  #: An error is attributed to cells within this time before and after it [s].
RUN_UP = 0.6  #: Time before a start in motion for which the drives are simulated [s].
STANDS = 0.5  #: Travel of the tip per path length below which only the tool axis moves [-].


@dataclass(frozen=True)
class ToolLimit:
    """The limit, and the state of the drives at the start of the path."""

    machine: Machine  #: The machine with its true drives.
    model: Machine | None  #: The model whose drives are compensated.
    period: float  #: Interpolation period [s].
    largest: float  #: Largest error of the tip, and of the tool axis at flank height [m].
    flank_height: float  #: Height at which the tool axis is measured [m].
    series: ErrorSeries  #: The errors of the axes in slow motion.
    motion: ToolMotion | None = None  #: The drives; None at a start not simulated yet.
    wait: float = 0.0  #: Time from the start of the path to the next setpoint [s].

    @staticmethod
    def of_settings(machine: Machine, settings: Settings) -> ToolLimit:
        """Return the limit that the settings request; raises the errors of ``wanted_tool``."""
        assert settings.tool_error is not None, 'there is a limit'
        name = settings.compensation
        model = compensated_model(name, machine) if name else None
        period, height = settings.interpolation_period, settings.flank_height
        return ToolLimit.of(machine, period, settings.tool_error, height, model)

    @staticmethod
    def of(
        machine: Machine,
        period: float,
        largest: float,
        flank_height: float,
        model: Machine | None = None,
    ) -> ToolLimit:
        series = error_series(machine, model)
        return ToolLimit(machine, model, period, largest, flank_height, series)

    @property
    def warnings(self) -> list[str]:
        """Warnings for the operator: a limit below the effect of friction and backlash."""
        taken = float(np.linalg.norm(self.series.away[self.machine.is_linear]))
        if taken <= self.largest:
            return []
        instead = 'raise the limit' + ', or use --compensate' * (self.model is None)
        return [
            f'{WARNING}friction and backlash of the linear axes cause up to {taken / MM:.3f} mm '
            f'at any speed, more than --tool-error {self.largest / MM:g} mm: there the motion is '
            f'slow and not proven; {instead}'
        ]

    def begun(self, path: AxisPath, start: tuple[float, float]) -> ToolLimit:
        """Return the limit with the drives simulated up to the start of a path, if necessary."""
        if self.motion is not None:
            return self
        q, q_s, q_ss = path.cell_left[:3, 0]
        velocity, acceleration = q_s * start[0], q_ss * start[0] ** 2 + q_s * start[1]
        count = round(RUN_UP / self.period) if start[0] > 0.0 else 0
        # As if the motion before had been like this, with the acceleration for a moment only.
        time = self.period * np.arange(-count, 0)[:, None]
        recent = np.maximum(time, -NEARBY)
        rates = velocity + acceleration * recent
        before = q + velocity * time + acceleration * recent * (time - 0.5 * recent)
        at = before[0] if count else q
        motion = self.motion_from(np.ascontiguousarray(at))
        motion.push(before, rates)
        return replace(self, motion=motion, wait=0.0)

    def motion_from(self, position: FloatArray) -> ToolMotion:
        return ToolMotion(self.machine, self.period, position, self.model)

    def afresh(self, path: AxisPath) -> ToolLimit:
        return replace(self, motion=None).begun(path, (0.0, 0.0))

    def after(self, stretch: Stretch, last: int) -> ToolLimit:
        """Return the limit with drives simulated along a stretch up to the grid point ``last``."""
        if self.motion is None or last == 0:
            return self
        law, motion = stretch.law(0.0, last), self.motion.copy()
        time = self._times(law)
        motion.push(*axis_motion(stretch.path, law, time)[:2])
        wait = self.wait + self.period * len(time) - law.end_time
        return replace(self, motion=motion, wait=wait)

    def _times(self, law: MotionLaw) -> FloatArray:
        """Return the times of setpoints on a law [s], counted from the start of the path."""
        count = max(int(np.ceil((law.end_time - self.wait) / self.period - 1e-9)), 0)
        return self.wait + self.period * np.arange(count)

    def rows(self, left: FloatArray, right: FloatArray) -> FloatArray:
        """Return the rows at the left nodes of cells for a limit of 1: (8, 4, n), tip then axis.

        The 4 values are the factors of s_ddot, s_dot^2 and s_dot, and the constant. ``left,
        right``: jets at both ends.
        """
        q, q_s, q_ss = left[:3]
        across = self._across(q, q_s)
        sign = np.sign(q_s + right[1])
        by_a, by_v = self.series.by_acceleration, self.series.by_velocity
        errors = np.stack([by_a * q_s, by_a * q_ss, by_v * q_s, -sign * self.series.away])
        return np.ascontiguousarray(np.einsum('vnk,fnk->vfn', across, errors) / self.largest)

    def stretch_rows(
        self, left: FloatArray, right: FloatArray, kept: FloatArray | None
    ) -> ToolRows:
        return ToolRows(self, self.rows(left, right), kept)

    def _across(self, q: FloatArray, q_s: FloatArray) -> FloatArray:
        """Return the error along each normal per error of each axis, shape (8, n, n_axes)."""
        tip, axis, o = self._jacobians(q)
        way, turn = np.einsum('nck,nk->nc', tip, q_s), np.einsum('nck,nk->nc', axis, q_s)
        speed = np.linalg.norm(way, axis=1)
        moves = speed > STANDS
        along = np.where(moves[:, None], way / np.where(moves, speed, 1.0)[:, None], 0.0)
        # Where the tip is further along the path, by its own way or that of the axis.
        turning = np.maximum(np.einsum('nc,nc->n', turn, turn), 1e-300)[:, None]
        ahead = np.where(
            moves[:, None],
            np.einsum('nc,nck->nk', along, tip) / np.where(moves, speed, 1.0)[:, None],
            np.einsum('nc,nck->nk', turn, axis) / turning,
        )
        lean = self.flank_height * (axis - turn[:, :, None] * ahead[:, None, :])
        normals = np.where(moves[:, None], _normals(along), _everywhere(len(q)))
        parts = (normals, tip), (_normals(o), lean)
        return np.concatenate([np.einsum('vnc,nck->vnk', *part) for part in parts])

    def _jacobians(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return dp/dq and do/dq, shape (n, 3, n_axes), and the tool axis, shape (n, 3)."""
        forward = Transform.of(self.machine).forward
        n, count = q.shape
        tip, axis = np.empty((n, 3, count)), np.empty((n, 3, count))
        for k in range(count):
            step = np.zeros(count)
            step[k] = FEELER
            there, back = forward(q + step), forward(q - step)
            tip[:, :, k], axis[:, :, k] = (
                (one - other) / (2.0 * FEELER) for one, other in zip(there, back, strict=True)
            )
        return tip, axis, forward(q)[1]

    def use(self, stretch: Stretch, predicted: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Simulate the drives on a law; return simulated and predicted errors, (2, n).

        Both are the largest near each cell, divided by the limit; ``predicted`` (2, n): use of the
        limit according to the rows, at the left nodes.
        """
        assert self.motion is not None, 'begun is called before'
        law, motion = stretch.law(0.0, len(stretch.duration)), self.motion.copy()
        time = self._times(law)
        moving = motion.push(*axis_motion(stretch.path, law, time)[:2])
        resting = motion.settle(stretch.path.cell_right[0, -1])
        axis = np.concatenate([moving.axis, resting.axis]) * self.flank_height
        errors = np.stack([np.concatenate([moving.tip, resting.tip]), axis])
        starts = np.append(law.time, law.end_time)[stretch.nodes[:-1]]
        # An axis is where its setpoint was earlier by the lag.
        lag = self.series.lag + self.period * motion.late
        lag += motion.lag if self.model is not None else 0.0
        shown = self.wait + self.period * np.arange(errors.shape[1]) - lag
        rows = np.stack([np.interp(shown, starts, row) for row in predicted])
        first = np.clip(np.searchsorted(shown, starts), 0, len(shown) - 1)
        around = 2 * round(NEARBY / self.period) + 1
        simulated, by_rows = (
            np.maximum.reduceat(maximum_filter1d(of, around, axis=1), first, axis=1)
            for of in (errors / self.largest, rows)
        )
        return simulated, by_rows


class ToolRows:
    """The rows of one stretch, and the parts of the limit that corrections lower."""

    def __init__(self, limit: ToolLimit, rows: FloatArray, kept: FloatArray | None):
        self._limit, self.rows = limit, rows
        self.part = np.full((2, rows.shape[2]), FIRST_PART)  #: For tip and axis in each cell [-].
        if kept is not None:
            self.part[:, : kept.shape[1]] = np.minimum(kept + RELAXED, 1.0)

    def within_parts(self) -> FloatArray:
        rows: FloatArray = self.rows / np.repeat(self.part, NORMALS, axis=0)[:, None]
        rows[:, 3] = np.clip(rows[:, 3], -STEADY_PART, STEADY_PART)
        return rows

    def lower(self, stretch: Stretch) -> tuple[float, BoolArray]:
        """Lower the limit where a law exceeds it; return the largest use and the lowered cells."""
        nodes, factors = stretch.nodes[:-1], self.rows
        v, a = stretch.v[nodes], stretch.a[nodes]
        terms = factors[:, 0] * a + factors[:, 1] * v * v + factors[:, 2] * v + factors[:, 3]
        predicted = np.abs(terms).reshape(2, NORMALS, -1).max(axis=1)
        simulated, predicted = self._limit.use(stretch, predicted)
        reached = np.clip(predicted, 0.5 * self.part, self.part)
        less = np.maximum(reached * AIM / (1.0 + EXCESS_FACTOR * (simulated - 1.0)), LEAST_PART)
        found = np.minimum(np.where(simulated > 1.0, less, self.part), self.part)
        fell = (found < self.part).any(axis=0)
        self.part = found
        return float(simulated.max()), fell


def _normals(direction: FloatArray) -> FloatArray:
    """Return four unit vectors across each direction, 45 deg apart, shape (4, n, 3)."""
    helper = np.zeros_like(direction)
    np.put_along_axis(helper, np.argmin(np.abs(direction), axis=1)[:, None], 1.0, axis=1)
    first = np.cross(direction, helper)
    first /= np.maximum(np.linalg.norm(first, axis=1), 1e-300)[:, None]
    second = np.cross(direction, first)
    half = np.sqrt(0.5)
    return np.stack([first, second, half * (first + second), half * (first - second)])


def _everywhere(n: int) -> FloatArray:
    found = np.concatenate([np.eye(3), np.full((1, 3), np.sqrt(1.0 / 3.0))])
    return np.repeat(found[:, None], n, axis=1)
