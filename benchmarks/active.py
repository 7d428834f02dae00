"""Share of the time in which at least one limit is active; whether any limit is exceeded."""

from __future__ import annotations

import numpy as np

from cnc_interp.core.axis_limits import Limits
from cnc_interp.feedrate.planning_windows import PlannedPiece
from cnc_interp.kinematics.axis_path import evaluate
from cnc_interp.machine_model.machine import Machine, limits_of
from cnc_interp.run.setpoints import BEFORE, largest_shares

PERIOD = 1e-3


def share_active(planned: PlannedPiece, limits: Machine | Limits, level: float = 0.99) -> float:
    """Share of the samples at which the largest use of all limits and of F reaches ``level``."""
    law, path = planned.law, planned.path
    time = np.arange(law.time[0], law.end_time, PERIOD)
    piece = law.piece_at(time)
    s, v, a, j = law.evaluate(time, piece)
    cell = law.cell[piece]
    q, q1, q2, q3 = evaluate(path, s, cell)
    table = limits_of(limits).along(q)
    use = np.maximum.reduce(
        [
            (np.abs(q1 * v[:, None]) / table[0]).max(axis=1),
            (np.abs(q2 * v[:, None] ** 2 + q1 * a[:, None]) / table[1]).max(axis=1),
            (
                np.abs(q3 * v[:, None] ** 3 + 3 * q2 * (v * a)[:, None] + q1 * j[:, None])
                / table[2]
            ).max(axis=1),
            v / path.cell_feed[cell],
        ]
    )
    return float((use >= level).mean())


def largest_use(planned: PlannedPiece, limits: Machine | Limits) -> float:
    """Largest use of any limit by first, second and third differences of the setpoints."""
    time = np.arange(-BEFORE, np.ceil(planned.law.end_time / PERIOD) + 5) * PERIOD
    q = evaluate(planned.path, planned.law.evaluate(time)[0])[0]
    return float(largest_shares(q, limits_of(limits), PERIOD).max())
