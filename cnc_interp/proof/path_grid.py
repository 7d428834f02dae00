"""
The proof of `path.npz`: every column follows from the setpoints, from the program or from q(s).

Setpoint i lies on the path at ``s[i]``: on the septic polynomial that takes value and three
derivatives of both ends of its cell. This module shares no code with the planner.
"""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.proof.verdict import Ledger

# Largest accepted distance between setpoints, forward kinematics and the path file [m, rad].
ROUND_TRIP = 1e-8
# Largest accepted relative difference of figures that are computed twice [-].
SAME = 1e-6
# Values of axes are rounded by less [m, rad].
ROUNDED = 1e-14
# Speeds that differ by less agree [-], and those that differ by less than this [m/s].
SAME_SPEED, SMALL_SPEED = 1e-3, 1e-6
# First and second derivatives that jump by less are continuous [1, 1/m, or rad/m, rad/m2].
JUMPS = {1: 1e-6, 2: 1e-2}
# Setpoints compared with the path at a time.
BATCH = 1 << 16
# An excess of up to 0.1 % of a limit is rounding.
ROUNDING = 1.001


def prove_grid(ledger: Ledger, plan: PlanFiles, machine: Machine) -> None:
    """
    Check the grid of the planner: poses, continuity, setpoints, feeds, limits and stops.

    Parameters
    ----------
    ledger : Ledger
        Takes what is found.
    plan : PlanFiles
        Plan with a path.
    machine : Machine
        Machine with the forward kinematics to use.

    """
    path, s = plan.path, plan.path['s']
    rows = np.asarray(path['block'], dtype=np.int64)
    tip, axis = Transform.of(machine).forward(path['q'])
    gap = np.linalg.norm(tip - path['tip'], axis=1)
    gap = np.maximum(gap, plan.flank_height * np.linalg.norm(axis - path['axis'], axis=1))
    ledger.check('path pose against its axes', gap, ROUND_TRIP, rows=rows)
    ledger.require(bool((np.diff(s) > 0.0).all()), 'path.npz: s must increase at every grid point')
    left, right, feed = path['cell_left'], path['cell_right'], path['feed']
    torn = np.abs(left[0, 1:] - right[0, :-1]).max(axis=1, initial=0.0)
    ledger.check('axes across path cells', torn, ROUND_TRIP, rows=rows[1:-1])
    inner = ~np.asarray(path['stop'], dtype=bool)[1:-1]
    width = np.maximum(np.diff(s), ROUNDED)
    for order, rounding in JUMPS.items():
        jump = np.abs(left[order, 1:] - right[order, :-1])
        room = SAME * np.abs(left[order]).max(axis=0) + rounding
        room = room + ROUNDED / np.minimum(width[1:], width[:-1])[:, None] ** order
        share = np.where(inner, (jump / room).max(axis=1, initial=0.0), 0.0)
        ledger.require(
            bool((share <= 1.0).all()),
            f'path.npz: derivatives of order {order} jump at {np.count_nonzero(share > 1.0)} grid '
            'points without a stop',
        )
    ends = np.concatenate([left[0], right[0, -1:]])
    ledger.check(
        'axes against path cells', np.abs(ends - path['q']).max(axis=1), ROUND_TRIP, rows=rows
    )
    for j, name in enumerate(machine.axis_names):
        rate = np.maximum(np.abs(left[1, :, j]) * feed[:-1], np.abs(right[1, :, j]) * feed[1:])
        limit = float(machine.max_velocity[j])
        ledger.check('planned velocity', rate, limit, name, ROUNDING, rows=rows[:-1])
    _prove_feeds(ledger, plan, machine, rows)
    if (np.diff(s) > 0.0).all():
        _prove_setpoints(ledger, plan, rows)


def _prove_feeds(ledger: Ledger, plan: PlanFiles, machine: Machine, rows: IntArray) -> None:
    """Check the planned feed against the programmed one, and the feed limit against Eq. 10."""
    path = plan.path
    feed, programmed = path['feed'], path['programmed_feed']
    around = np.maximum(
        programmed, np.maximum(np.r_[programmed[1:], 0.0], np.r_[0.0, programmed[:-1]])
    )
    ledger.check('planned feed', feed, around, allowed=ROUNDING, rows=rows)
    # [B2013, Eq. 10], on both sides of a grid point.
    bound = programmed / float(plan.summary.get('largest_override', 1.0))
    for cells, side in (
        (path['cell_left'], slice(None, -1)),
        (path['cell_right'], slice(1, None)),
    ):
        with np.errstate(divide='ignore'):
            for k, limits in enumerate(machine.limits, start=1):
                reach = (limits / np.abs(cells[k])) ** (1.0 / k)
                bound[side] = np.minimum(bound[side], reach.min(axis=1))
    limit = path['feed_limit']
    with np.errstate(invalid='ignore'):
        apart = np.where(limit == bound, 0.0, np.abs(limit - bound))
    ledger.check('feed limit of path', apart, SAME * bound, rows=rows)
    # Eq. 10 leaves out tangential acceleration and jerk, so a correct law may exceed it.
    bounded = limit > 0.0
    ledger.remarks['largest_feed_over_limit'] = float(
        np.max(feed[bounded] / limit[bounded], initial=0.0)
    )


def _prove_setpoints(ledger: Ledger, plan: PlanFiles, rows: IntArray) -> None:
    """Check that the setpoints lie on the path where they say, with its rows, feed and stops."""
    path, grid, s = plan.path, plan.path['s'], plan.setpoints['s']
    ledger.check('path position against the path', np.maximum(grid[0] - s, s - grid[-1]).clip(0.0),
                 ROUND_TRIP)  # fmt: skip
    ledger.check('path position backwards', np.maximum(-np.diff(s), 0.0), ROUND_TRIP)
    cell = np.clip(np.searchsorted(grid, s, 'right') - 1, 0, len(grid) - 2)
    apart = np.empty(len(s))
    for first in range(0, len(s), BATCH):
        part = slice(first, first + BATCH)
        k = cell[part]
        width = grid[k + 1] - grid[k]
        share = ((s[part] - grid[k]) / width).clip(0.0, 1.0)
        found = _septic(path['cell_left'][:, k], path['cell_right'][:, k], width, share)
        apart[part] = np.abs(found - plan.position[part]).max(axis=1)
    ledger.check('setpoint beside the path', apart, ROUND_TRIP)
    # At a grid point the sample may belong to the cell before it.
    near = [np.clip(cell + step, 0, len(grid) - 1) for step in (-1, 0, 1)]
    other = np.flatnonzero(~np.any([rows[k] == plan.block for k in near], axis=0))
    ledger.require(
        not len(other),
        f'block of setpoints.npz and of path.npz differ at {len(other)} samples, the first is '
        f'{other[:1]}',
    )
    speed = np.diff(s) / plan.period
    least, most = _speeds_around(speed)
    at = np.clip(np.searchsorted(s, grid, 'right') - 1, 0, len(speed) - 1)
    off = np.maximum(path['feed'] - most[at], least[at] - path['feed']).clip(0.0)
    allowed = SAME_SPEED * np.maximum(most[at], 0.0) + SMALL_SPEED
    ledger.check('feed of path against the setpoints', off, allowed, rows=rows)
    stop = np.flatnonzero(path['stop'])
    ledger.check('stop of path', least[at[stop]].clip(0.0), allowed[stop], rows=rows[stop])
    stops = np.flatnonzero(plan.blocks['exact_stop'])
    stops = stops[(stops >= rows[0]) & (stops < len(plan.blocks['exact_stop']))]
    place = np.minimum(np.searchsorted(rows, stops, 'right'), len(rows) - 1)
    left_out = stops[~np.asarray(path['stop'], dtype=bool)[place]]
    ledger.require(
        not len(left_out),
        f'path.npz has no stop after lines {plan.blocks["line"][left_out].tolist()[:5]}',
    )


def _speeds_around(speed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return bounds of the speed in each period, from mean speeds in it and around it [m/s]."""
    held = np.pad(speed, 1, mode='constant')  # at rest before and after
    around = np.stack([held[:-2], held[1:-1], held[2:]])
    spread = np.abs(np.diff(around, axis=0)).sum(axis=0)
    return around.min(axis=0) - spread, around.max(axis=0) + spread


def _septic(
    left: FloatArray, right: FloatArray, width: FloatArray, share: FloatArray
) -> FloatArray:
    """Return the septic polynomials that have these jets at both ends, shape (k, n)."""
    scale = width[None, :, None] ** np.arange(4.0)[:, None, None]
    factorial = np.array([1.0, 1.0, 2.0, 6.0])
    start, end = left * scale, right * scale
    taylor = start / factorial[:, None, None]
    # Derivatives of u^0 ... u^7 at u = 1.
    slopes = np.array([
        [np.prod(np.arange(n, n - m, -1.0)) if n >= m else 0.0 for n in range(8)]
        for m in range(4)
    ])  # fmt: skip
    misfit = end - np.einsum('mn,nka->mka', slopes[:, :4], taylor)
    upper = np.einsum('nm,mka->nka', np.linalg.inv(slopes[:, 4:]), misfit)
    u = share[:, None]
    value = np.zeros_like(u)
    for coefficient in np.concatenate([taylor, upper])[::-1]:
        value = value * u + coefficient
    return np.asarray(value)
