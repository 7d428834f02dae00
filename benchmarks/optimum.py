"""
The offline optimum: minimum time along a path as a nonlinear program, solved by IPOPT.

It uses nothing of the planner's mathematics. The planner chooses b = s_dot^2 over the path; here
the motion is transcribed in time: in every cell of a fine grid the jerk of s is a linear function
of t. With v, a at the start of the cell, its duration T and the jerks j0, j1 at its two ends

    h  = v0 T + a0 T^2/2 + (j0/8 + j1/24) T^3
    v1 = v0 + a0 T + (j0/3 + j1/6) T^2
    a1 = a0 + (j0 + j1) T/2.

The jerk may jump from cell to cell. At POINTS instants of every cell, with q_s, q_ss, q_sss of the
path's septics at the s of that instant, [B2013, Eq. 6-9]

    |q_s v| <= V,  |q_ss v^2 + q_s a| <= A,  |q_sss v^3 + 3 q_ss v a + q_s j| <= J,  0 <= v <= F.

The limits are the machine's, without the 0.1 % that the planner keeps free.

Between these instants a limit may be exceeded, so the first solution is too fast. It is evaluated
at CHECKED instants of every cell. Where a limit is exceeded, the bounds of that row in that cell
are lowered by the excess, and the program is solved again from there, until no limit is exceeded
by more than KEPT. The time-optimal motion lies between both solutions: the first one has too few
constraints, and the corrected one is a little too slow in the corrected cells.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi
import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.core.axis_limits import Limits
from cnc_interp.feedrate.planning_windows import PlannedPiece, plan_path
from cnc_interp.kinematics.axis_path import (
    AxisPath,
    evaluate_cells,
    refine,
    septic_coefficients,
)
from cnc_interp.machine_model.machine import Machine, limits_of

#: Instants of a cell, as shares of its duration, at which the limits are rows of the program.
POINTS = (0.0, 1 / 2, 1.0)
#: Instants of a cell at which the result is checked.
CHECKED = 33
#: Excess of a limit, at the instants checked, that counts as kept; most corrections.
KEPT, ROUNDS = 5e-4, 12
#: How near to bounds and zero multipliers a corrected program may start.
WARM = ('bound_push', 'bound_frac', 'slack_bound_push', 'slack_bound_frac', 'mult_bound_push')


@dataclass(frozen=True)
class Optimum:
    """
    Result of one program, corrected between the instants.

    Parameters
    ----------
    time, excess : float
        Cycle time [s] and largest excess of a limit at the instants checked.
    first_time, first_excess : float
        The same before any correction: too fast.
    first_converged, converged : bool
        The first solve converged; so did all others, and the corrections.

    """

    time: float
    excess: float
    first_time: float
    first_excess: float
    first_converged: bool
    converged: bool


def time_grid(path: AxisPath, law_time: FloatArray, law_s: FloatArray, count: int) -> AxisPath:
    """Cut a path at even times of a known law, and denser toward rest; breaks stay breaks."""
    end = law_time[-1]
    even = np.linspace(0.0, 1.0, count + 1)
    # near rest v ~ t^2: cells grow from there
    fine = end / count * np.cumsum(0.3 * 1.3 ** np.arange(12))
    times = np.concatenate([even * end, fine, end - fine])
    s = np.unique(np.interp(times, law_time, law_s))
    # two grid points that nearly coincide make a cell without duration
    apart = np.abs(s[:, None] - path.s[None, :]).min(axis=1) > 2e-3 * (path.s[-1] / count)
    s = s[apart]
    s = s[np.concatenate([[True], np.diff(s) > 2e-3 * (path.s[-1] / count)])]
    return refine(path, s)


def cell_function(n_axes: int) -> casadi.Function:
    """
    Write one cell's equations and rows.

    Unknowns are scaled by ``scale`` = (v, a, j of s); ``start`` = (v0, a0), ``end`` = (v1, a1),
    ``inside`` = (T, j0, j1). ``septic`` holds the coefficients of every axis in u = s/h, and all
    rows come out divided by their limits.
    """
    start, end, inside = (casadi.SX.sym(n, k) for n, k in (('v', 2), ('w', 2), ('i', 3)))
    h, duration_scale, scale = casadi.SX.sym('h'), casadi.SX.sym('t'), casadi.SX.sym('scale', 3)
    septic, limit = casadi.SX.sym('c', 8, n_axes), casadi.SX.sym('l', 3, n_axes)
    feed = casadi.SX.sym('f')
    v0, a0 = start[0] * scale[0], start[1] * scale[1]
    v1, a1 = end[0] * scale[0], end[1] * scale[1]
    T = inside[0] * duration_scale
    j0, j1 = inside[1] * scale[2], inside[2] * scale[2]
    equations = casadi.vertcat(
        (v0 * T + a0 * T**2 / 2 + (j0 / 8 + j1 / 24) * T**3) / h - 1,
        (v0 + a0 * T + (j0 / 3 + j1 / 6) * T**2 - v1) / scale[0],
        (a0 + (j0 + j1) * T / 2 - a1) / scale[1],
    )
    rows = []
    for share in POINTS:
        t = share * T
        slope = (j1 - j0) * share  # of the jerk, times t
        s = v0 * t + a0 * t**2 / 2 + j0 * t**3 / 6 + slope * t**3 / 24
        v = v0 + a0 * t + j0 * t**2 / 2 + slope * t**2 / 6
        a = a0 + j0 * t + slope * t / 2
        j = j0 + slope
        u = 0.0 if share == 0.0 else 1.0 if share == 1.0 else s / h
        rows.append(v / feed)
        for k in range(n_axes):
            value = [septic[i, k] for i in range(8)]
            q = []
            for order in range(1, 4):
                value = [i * value[i] for i in range(1, len(value))]
                q.append(sum(value[i] * u**i for i in range(len(value))) / h**order)
            rows.append(q[0] * v / limit[0, k])
            rows.append((q[1] * v**2 + q[0] * a) / limit[1, k])
            rows.append((q[2] * v**3 + 3 * q[1] * v * a + q[0] * j) / limit[2, k])
    return casadi.Function(
        'cell',
        [start, end, inside, h, duration_scale, scale, septic, limit, feed],
        [equations, casadi.vertcat(*rows)],
    )


def solve(
    path: AxisPath,
    limits: Machine | Limits,
    law: PlannedPiece | None = None,
    count: int = 500,
    slowed: float = 1.0,
    rounds: int = ROUNDS,
) -> Optimum:
    """
    Minimise the time along a path without inner stops, from rest to rest.

    Parameters
    ----------
    path : AxisPath
        The path.
    limits : Machine or Limits
        Limits of its axes.
    law : PlannedPiece, optional
        A law for the grid and the first guess; the planner's by default.
    count : int
        Cells that an undivided path would be cut into.
    slowed : float
        The first guess is the law driven so many times slower.
    rounds : int
        Most solves; with 1 nothing is corrected.

    """
    motion = (law or plan_path(path, limits)).law
    times = np.append(motion.time, motion.end_time) - motion.time[0]
    grid = time_grid(path, times, np.append(motion.s, path.s[-1]), count)
    h, n, n_axes = np.diff(grid.s), len(grid.s) - 1, grid.cell_left.shape[2]
    septics = np.empty((n, n_axes, 8))
    for i in range(n):
        for k in range(n_axes):
            septic_coefficients(
                grid.cell_left[:, i, k], grid.cell_right[:, i, k], h[i], septics[i, k]
            )
    at = np.interp(grid.s, np.append(motion.s, path.s[-1]), times)
    at[0], at[-1] = 0.0, times[-1]
    # invert s(t) exactly enough for a first guess
    for _ in range(3):
        s, v, _, _ = motion.evaluate(at + motion.time[0])
        inner = (v > 1e-9) & (at > 0) & (at < times[-1])
        at[inner] -= (s[inner] - grid.s[inner]) / v[inner]
    at = np.maximum.accumulate(np.clip(at, 0.0, times[-1]))
    _, v, a, _ = motion.evaluate(at + motion.time[0])
    v[[0, -1]], a[[0, -1]] = 0.0, 0.0
    duration = np.maximum(np.diff(at), 1e-6) * slowed
    v, a = v / slowed, a / slowed**2
    jerk = np.diff(a) / duration
    scale = np.array([v.max(), np.abs(a).max(), np.abs(jerk).max() / 3])

    table = limits_of(limits).by_order
    feed = np.minimum(grid.cell_feed, 100.0)
    nodes, inside = casadi.MX.sym('nodes', 2, n + 1), casadi.MX.sym('inside', 3, n)
    cells = cell_function(n_axes).map(n)
    equations, rows = cells(
        nodes[:, :-1],
        nodes[:, 1:],
        inside,
        h[None],
        duration[None],
        casadi.repmat(casadi.DM(scale), 1, n),
        casadi.DM(septics.transpose(2, 0, 1).reshape(8, n * n_axes)),
        casadi.repmat(casadi.DM(table), 1, n),
        feed[None],
    )
    problem = {
        'x': casadi.vertcat(casadi.vec(nodes), casadi.vec(inside)),
        'f': casadi.dot(inside[0, :].T, casadi.DM(duration)) / duration.sum(),
        'g': casadi.vertcat(casadi.vec(equations), casadi.vec(rows)),
    }
    bounds_low = np.concatenate(
        [np.tile([0.0, -np.inf], n + 1), np.tile([1e-3, -np.inf, -np.inf], n)]
    )
    bounds_high = np.concatenate([np.full(2 * (n + 1), np.inf), np.full(3 * n, np.inf)])
    for rest in (0, 1, 2 * n, 2 * n + 1):
        bounds_low[rest] = bounds_high[rest] = 0.0
    options = {
        'print_time': False,
        'ipopt': {
            'print_level': 0,
            'sb': 'yes',
            'tol': 1e-9,
            'max_iter': 300,
            'mu_strategy': 'adaptive',
            'acceptable_iter': 0,
            'mu_init': 1e-3,
            'bound_relax_factor': 0.0,
        },
    }
    solver = casadi.nlpsol('time', 'ipopt', problem, options)
    again = {
        **options['ipopt'],
        'warm_start_init_point': 'yes',
        'mu_strategy': 'monotone',
        'mu_init': 1e-7,
        **{f'warm_start_{what}': 1e-8 for what in WARM},
    }
    corrector = casadi.nlpsol('again', 'ipopt', problem, {**options, 'ipopt': again})
    guess_nodes = np.column_stack([v / scale[0], a / scale[1]]).ravel()
    guess_inside = np.column_stack([np.ones(n), jerk / scale[2], jerk / scale[2]]).ravel()
    start = {'x0': np.concatenate([guess_nodes, guess_inside])}
    bound = np.ones((n, 3 * n_axes + 1))
    one_sided = np.r_[0.0, np.ones(3 * n_axes)]
    rows_per_cell = len(POINTS)
    first: tuple[float, float, bool] | None = None
    for _ in range(rounds):
        high = np.tile(bound, rows_per_cell)
        low = -high * np.tile(one_sided, rows_per_cell)
        result = solver(
            lbx=bounds_low,
            ubx=bounds_high,
            lbg=np.concatenate([np.zeros(3 * n), low.ravel()]),
            ubg=np.concatenate([np.zeros(3 * n), high.ravel()]),
            **start,
        )
        converged = bool(solver.stats()['success'])
        x = np.asarray(result['x']).ravel()
        state = x[: 2 * (n + 1)].reshape(-1, 2) * scale[:2]
        found = x[2 * (n + 1) :].reshape(-1, 3) * np.array([1.0, scale[2], scale[2]])
        found[:, 0] *= duration
        inside_use, at_points = uses(grid, table, state, found)
        over = float(inside_use.max()) - 1.0
        first = first or (float(found[:, 0].sum()), over, converged)
        if over <= KEPT or not converged:
            break
        # where the instants are not at their bound themselves, lowering it would change nothing
        reached = np.clip(at_points, 0.5 * bound, bound)
        passed = inside_use > 1.0 + KEPT / 2
        bound = np.where(passed, reached / (1.0 + 1.05 * (inside_use - 1.0)), bound)
        solver = corrector
        start = {'x0': result['x'], 'lam_x0': result['lam_x'], 'lam_g0': result['lam_g']}
    return Optimum(
        time=float(found[:, 0].sum()),
        excess=over,
        first_time=first[0],
        first_excess=first[1],
        first_converged=first[2],
        converged=converged and over <= KEPT,
    )


def uses(
    grid: AxisPath, table: FloatArray, state: FloatArray, inside: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """
    Evaluate the use of every limit at many instants of every cell.

    Returns the largest over all instants, and over those that are rows of the program, both of
    shape (n, 3 n_axes + 1) in the order of the rows.
    """
    n, cell = len(inside), np.arange(len(inside))
    n_axes = table.shape[1]
    everywhere, at_points = np.zeros((2, n, 3 * n_axes + 1))
    T, j0, j1 = inside.T
    (v0, a0), h = state[:-1].T, np.diff(grid.s)
    for share in np.unique(np.r_[np.linspace(0.0, 1.0, CHECKED), POINTS]):
        t, slope = share * T, (j1 - j0) * share
        s = v0 * t + a0 * t**2 / 2 + j0 * t**3 / 6 + slope * t**3 / 24
        v = v0 + a0 * t + j0 * t**2 / 2 + slope * t**2 / 6
        a, j = a0 + j0 * t + slope * t / 2, j0 + slope
        at = grid.s[:-1] + np.clip(s, 0.0 if share == 0 else 1e-12 * h, h)
        at = grid.s[1:] if share == 1.0 else at
        along = at - grid.s[cell]
        _, q1, q2, q3 = evaluate_cells(grid.s, grid.cell_left, grid.cell_right, along, cell)
        v, a, j = v[:, None], a[:, None], j[:, None]
        use = np.stack(
            [
                np.abs(q1 * v) / table[0],
                np.abs(q2 * v**2 + q1 * a) / table[1],
                np.abs(q3 * v**3 + 3 * q2 * v * a + q1 * j) / table[2],
            ],
            axis=2,
        )
        use = np.column_stack([v / grid.cell_feed[:, None], use.reshape(n, -1)])
        np.maximum(everywhere, use, out=everywhere)
        if share in POINTS:
            np.maximum(at_points, use, out=at_points)
    return everywhere, at_points
