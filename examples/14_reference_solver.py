"""Solve the jerk-limited feed problem with a short reference solver; compare with our planner.

    python examples/14_reference_solver.py

plans ``five_blocks.ngc`` with about 100 lines of NumPy and SciPy. The numbers in parentheses are
those of the equations in docs/how_it_works/feedrate.md. The problem is that of our planner (the
"product"). The method differs: linear programs replace the interior-point method.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib import pyplot as plt
from scipy.optimize import linprog
from scipy.sparse import csr_matrix, diags, vstack

from cnc_interp import Machine, Transform, evaluate, plan_path, read_program, smooth_path

PROGRAM = Path(__file__).with_name('five_blocks.ngc')


class Law(NamedTuple):
    """A motion law: s, s_dot and s_ddot at the n + 1 nodes, and the time of each cell [SI]."""

    s: np.ndarray
    v: np.ndarray
    a: np.ndarray
    duration: np.ndarray


def states(m, width):
    """Return b and a at the nodes, and their derivatives by m (2)."""
    n, inner = len(m), np.arange(1, len(m))
    p = 1 / (width[:-1] + width[1:])
    at = np.r_[inner, inner], np.r_[inner - 1, inner]
    db = csr_matrix((np.r_[p * width[1:], p * width[:-1]], at), (n + 1, n))
    da = csr_matrix((np.r_[-p, p], at), (n + 1, n))
    return db @ m, da @ m, db, da


def cell_times(m, width):
    """Return the time of each cell, and the gradient of their sum by m (3)."""
    b, _, db, _ = states(m, width)
    v = np.sqrt(b)
    total = v[:-1] + v[1:]
    slope = np.r_[0, width / total**2] + np.r_[width / total**2, 0]
    slope[1:-1] /= v[1:-1]
    slope[[0, -1]] = 0  # the ends stay at rest
    return 2 * width / total, -(db.T @ slope)


def rows(m, width, jets, limits, caps):
    """Return the rows g, each at most 1, and their Jacobian (4)-(6)."""
    b, a, db, da = states(m, width)
    v = np.sqrt(b)
    dv = diags(np.divide(0.5, v, where=v > 0, out=np.zeros_like(v))) @ db
    total, rise = v[:-1] + v[1:], (a[1:] - a[:-1]) / (2 * width)
    dj = diags(total / (2 * width)) @ (da[1:] - da[:-1]) + diags(rise) @ (dv[:-1] + dv[1:])
    dva, dvb = diags(v) @ da + diags(a) @ dv, diags(1.5 * v) @ db
    g, by_m = [], []
    for end, jet in enumerate(jets):  # left ends of the cells, then right ends
        here = slice(end, len(m) + end)
        for k in range(jet.shape[2]):
            q_s, q_ss, q_sss = jet[1:, :, k] / limits.max_jerk[k]
            g.append(q_s * rise * total + 3 * q_ss * (v * a)[here] + q_sss * (v * b)[here])
            by_m.append(diags(q_s) @ dj + diags(3 * q_ss) @ dva[here] + diags(q_sss) @ dvb[here])
            q_s, q_ss = jet[1:3, :, k] / limits.max_acceleration[k]
            g.append(q_s * a[here] + q_ss * b[here])
            by_m.append(diags(q_s) @ da[here] + diags(q_ss) @ db[here])
    g, by_m = np.concatenate(g), vstack(by_m)
    return np.r_[g, -g, m / caps], vstack([by_m, -by_m, diags(1 / caps)])


def exact_widths(h, m, width):
    """Return the effective widths with which s_dddot is constant in every cell (1)."""
    _, a, _, _ = states(m, width)
    new = h + np.diff(a) * cell_times(m, width)[0] ** 2 / 12
    return np.clip(new, 0.6 * h, 1.6 * h)


def solve(grid, jets, limits, feed, passes=30, settled=1e-4):
    """Minimise the time on a grid; also return time and largest row of each iteration."""
    h = np.diff(grid)
    q_s = np.maximum(np.abs(jets[0][1]), np.abs(jets[1][1]))
    caps = np.minimum(feed, (limits.max_velocity / np.maximum(q_s, 1e-12)).min(axis=1)) ** 2
    middle = (grid[:-1] + grid[1:]) / 2 - grid[0]
    m = (middle * (grid[-1] - grid[0] - middle)) ** (4 / 3)  # constant s_dddot at both ends
    m[[0, -1]], width = 0, h * np.r_[1.5, np.ones(len(h) - 2), 1.5]
    while rows(m, width, jets, limits, caps)[0].max() > 1:
        m *= 0.7
    history = []
    for _ in range(passes):
        times, gradient = cell_times(m, width)
        g, by_m = rows(m, width, jets, limits, caps)
        history.append((times.sum(), g.max()))
        if len(history) > 1 and g.max() < 1.01 and abs(history[-2][0] / times.sum() - 1) < settled:
            break
        region = np.column_stack([-0.5 * m, m])  # where the linear rows are trusted
        step = linprog(gradient, by_m, 1 - g, bounds=region, method='highs-ipm').x
        while (states(m + step, width)[0][1:-1] <= 0).any():
            step /= 2
        m = m + step
        width = exact_widths(h, m, width)
    b, a, _, _ = states(m, width)
    slower = max(1, np.cbrt(g[: -len(m)].max()))  # the last law may still exceed a limit slightly
    return Law(grid, np.sqrt(b) / slower, a / slower**2, times * slower), history


def reference(path, limits, nodes=250):
    """Solve on nodes even along the path, then on nodes even in the time of that law."""
    grid = np.linspace(path.s[0], path.s[-1], nodes)
    for last in (False, True):
        grid = np.union1d(grid, path.s)
        grid = grid[np.r_[True, np.diff(grid) > 1e-7]]
        inside = 1e-6 * np.diff(grid)  # q_sss may jump at a node, so each side has its own
        jets = [np.stack(evaluate(path, s)) for s in (grid[:-1] + inside, grid[1:] - inside)]
        law, history = solve(grid, jets, limits, path.cell_feed.min())
        time = np.r_[0, np.cumsum(law.duration)]
        grid = grid if last else np.interp(np.linspace(0, time[-1], nodes), time, law.s)
    return law, history


def five_blocks():
    """Return the path of the axes along the example, and the limits of its machine."""
    machine = Machine.load('xyzac')
    geometry = Transform.of(machine)
    return smooth_path(read_program(PROGRAM, geometry).blocks, geometry), machine


if __name__ == '__main__':
    route, axes = five_blocks()
    found, steps = reference(route, axes)
    for number, (seconds, largest) in enumerate(steps):
        print(f'{number:2}: {seconds:8.4f} s, largest row {largest:.4f}')
    ours = plan_path(route, axes).law
    print(f'reference {found.duration.sum():.4f} s on {len(found.s)} nodes')
    print(f'product {ours.end_time:.4f} s')
    place, speed, _, _ = ours.evaluate(np.linspace(0, ours.end_time, 2000))
    plt.plot(place * 1e3, speed * 60e3, label='product')
    plt.plot(found.s * 1e3, found.v * 60e3, '.', ms=3, label='reference')
    plt.xlabel('path length (mm)')
    plt.ylabel('feed (mm/min)')
    plt.legend()
    plt.show()
