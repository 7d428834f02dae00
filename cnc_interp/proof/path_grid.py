"""The proof of `path.npz`: its columns are recomputed from setpoints, program and q(s)."""

from collections.abc import Iterator

import numpy as np

from cnc_interp.core import MM, FloatArray, IntArray
from cnc_interp.proof import plan_files
from cnc_interp.proof.limits_again import limits_at
from cnc_interp.proof.overrides import Overrides, scaled
from cnc_interp.proof.own_chain import forward_of
from cnc_interp.proof.own_errors import OwnErrors
from cnc_interp.proof.plan_files import (
    NO_LENGTH,
    PATH_CELLS,
    PlanFiles,
    gathered,
    held,
    spans,
)
from cnc_interp.proof.verdict import Ledger

ROUND_TRIP = 1e-8  #: Largest distance of setpoints, forward kinematics and path file [m, rad].
SAME = 1e-6  #: Largest accepted relative difference of figures that are computed twice [-].
ROUNDED = 1e-14  #: Bound of rounding errors in axis positions [m, rad].
# Speeds that differ by less agree [-], and those that differ by less than this [m/s].
SAME_SPEED, SMALL_SPEED = 1e-3, 1e-6
# First and second derivatives that jump by less are continuous [1, 1/m, or rad/m, rad/m2].
JUMPS = {1: 1e-6, 2: 1e-2}
#: If a path is longer than the travel of its tip by this factor, the tip counts as at rest [-].
TURNS = 1e6
#: Above this turn of the tool axis per distance of the tip, path length includes the turn. The
#: feed of the tip itself is then proven at the setpoints [1/m].
SWIVEL = 10.0 / MM
ROUNDING = 1.001  #: An excess of up to 0.1 % of a limit is rounding.


def prove_grid(ledger: Ledger, overrides: Overrides) -> None:
    plan, machine = ledger.plan, ledger.machine
    path, s, rows = plan.path, np.asarray(plan.path['s']), np.asarray(plan.path['block'])
    points, transform, errors = len(s), forward_of(machine), OwnErrors(machine)
    rising = bool((np.diff(s) > 0.0).all())
    width = np.maximum(np.diff(s), ROUNDED)
    largest = np.zeros((4, len(machine.axis_names)))
    for a, b in spans(points - 1):
        largest = np.maximum(largest, np.abs(path['cell_left'][:, a:b]).max(axis=1))
    jumps = dict.fromkeys(JUMPS, 0)
    written = _written_feeds(plan, rows)
    for a, b in spans(points):
        own, tip, axis = rows[a:b], *transform.forward(errors.nominal(path['q'][a:b]))
        gap = np.linalg.norm(tip - path['tip'][a:b], axis=1)
        apart = np.linalg.norm(axis - path['axis'][a:b], axis=1)
        gap = np.maximum(gap, plan.flank_height * apart)
        ledger.check('path pose against its axes', gap, ROUND_TRIP, rows=own)
        # Cells end at the inner points first ... last; the others begin there.
        first, last = max(a, 1), min(b, points - 1)
        left, right = path['cell_left'][:, first:last], path['cell_right'][:, first - 1 : last - 1]
        torn = np.abs(left[0] - right[0]).max(axis=1, initial=0.0)
        ledger.check('axes across path cells', torn, ROUND_TRIP, rows=rows[first:last])
        inner = ~path['stop'][first:last]
        shorter = np.minimum(width[first:last], width[first - 1 : last - 1])[:, None]
        for order, rounding in JUMPS.items():
            jump = np.abs(left[order] - right[order])
            room = SAME * largest[order] + rounding + ROUNDED / shorter**order
            share = np.where(inner, (jump / room).max(axis=1, initial=0.0), 0.0)
            jumps[order] += int(np.count_nonzero(~(share <= 1.0)))
        _prove_cells(ledger, rows, (a, b))
        _prove_feeds(ledger, rows, (a, b), overrides)
        _prove_programmed_feed(ledger, rows, (a, b), written)
    ledger.require(rising, 'path.npz: s must increase at every grid point')
    for order, count in jumps.items():
        text = f'path.npz: derivatives of order {order} jump at'
        ledger.require(not count, f'{text} {count} grid points without a stop')
    if rising:
        _prove_setpoints(ledger, s, rows)


def _prove_cells(ledger: Ledger, rows: IntArray, part: tuple[int, int]) -> None:
    (a, b), path, machine, cells = part, ledger.plan.path, ledger.machine, len(rows) - 1
    last = min(b, cells)
    left, right = path['cell_left'][:, a:last], path['cell_right'][:, a:last]
    ends = np.concatenate([left[0], path['cell_right'][:1, cells - 1 : cells][0]])[: b - a]
    apart = np.abs(ends - path['q'][a:b]).max(axis=1)
    ledger.check('axes against path cells', apart, ROUND_TRIP, rows=rows[a:b])
    feed = path['feed'][a : last + 1]
    for side, speed in ((left, feed[:-1]), (right, feed[1:])):
        rate, limit = np.abs(side[1]) * speed[:, None], limits_at(machine, 1, side[0])
        for j, name in enumerate(machine.axis_names):
            ledger.check(
                'planned velocity', rate[:, j], limit[:, j], name, ROUNDING, rows=rows[a:last]
            )


def _prove_feeds(
    ledger: Ledger, rows: IntArray, part: tuple[int, int], overrides: Overrides
) -> None:
    (a, b), path, machine, cells = part, ledger.plan.path, ledger.machine, len(rows) - 1
    feed, near = path['feed'][a:b], held(path['programmed_feed'], a, b, 1, 1)
    around = np.maximum(near[1:-1], np.maximum(near[2:], near[:-2]))
    steps = gathered(
        ledger.plan.setpoints['s'], overrides.first.clip(0, len(ledger.plan.position) - 1)
    )
    place = held(path['s'], a, b, 1, 1)
    around = scaled(around, overrides.near(place, steps, rows[a:b]))
    ledger.check('planned feed', feed, around, allowed=ROUNDING, rows=rows[a:b])
    # [B2013, Eq. 10], on both sides of a grid point.
    bound = near[1:-1].copy()
    first, last = max(a, 1), min(b, cells)
    for cell, side in (
        (path['cell_left'][:, a:last], slice(0, last - a)),
        (path['cell_right'][:, first - 1 : b - 1], slice(first - a, b - a)),
    ):
        with np.errstate(divide='ignore'):
            for k in (1, 2, 3):
                reach = (limits_at(machine, k, cell[0]) / np.abs(cell[k])) ** (1.0 / k)
                bound[side] = np.minimum(bound[side], reach.min(axis=1))
    limit = path['feed_limit'][a:b]
    with np.errstate(invalid='ignore'):
        apart = np.where(limit == bound, 0.0, np.abs(limit - bound))
    ledger.check('feed limit of path', apart, SAME * bound, rows=rows[a:b])


def _written_feeds(plan: PlanFiles, rows: IntArray) -> tuple[IntArray, FloatArray]:
    """Return the program rows of the path, and the highest feed in and around each [m/s]."""
    blocks = plan.blocks
    length = np.linalg.norm(np.diff(blocks['tip'], axis=0, prepend=blocks['tip'][:1]), axis=1)
    free = blocks['rapid'] | np.isfinite(blocks['duration']) | (blocks['interpolation'] != 0)
    turn = np.linalg.norm(np.diff(blocks['axis'], axis=0, prepend=blocks['axis'][:1]), axis=1)
    free |= (length <= NO_LENGTH) | (turn > SWIVEL * length) | np.isnan(blocks['feed'])
    feed = np.where(free, np.inf, blocks['feed'])
    named = np.unique(rows)
    first = np.maximum(np.r_[named[:1], named[:-1]], 1)
    last = np.maximum(np.r_[named[1:], named[-1:]], first)
    spans_of_rows = np.stack([first, last + 1], axis=1).ravel()
    return named, np.asarray(np.maximum.reduceat(np.r_[feed, -np.inf], spans_of_rows)[::2])


def _prove_programmed_feed(
    ledger: Ledger, rows: IntArray, part: tuple[int, int], written: tuple[IntArray, FloatArray]
) -> None:
    (a, b), path, (named, feed) = part, ledger.plan.path, written
    way = np.linalg.norm(np.diff(held(path['tip'], a, b, 1, 1), axis=0), axis=1)
    with np.errstate(divide='ignore', invalid='ignore'):
        longer = np.fmax(np.diff(held(path['s'], a, b, 1, 1)) / way, 1.0)
    longer[longer > TURNS] = np.inf
    allowed = feed[np.searchsorted(named, rows[a:b])] * np.maximum(longer[:-1], longer[1:])
    programmed = np.where(np.isfinite(allowed), path['programmed_feed'][a:b], 0.0)
    ledger.check('programmed feed of path', programmed, allowed, allowed=ROUNDING, rows=rows[a:b])


def _prove_setpoints(ledger: Ledger, grid: FloatArray, rows: IntArray) -> None:
    plan, path, count = ledger.plan, ledger.plan.path, len(ledger.plan.position)
    others, other = 0, -1
    for a, b in spans(count):
        s = held(plan.setpoints['s'], a, b, 0, 1)  # with the next sample
        outside = np.maximum(grid[0] - s, s - grid[-1]).clip(0.0)[: b - a]
        ledger.check('path position against the path', outside, ROUND_TRIP, first=a)
        back = np.maximum(-np.diff(s), 0.0)
        ledger.check('path position backwards', back, ROUND_TRIP, first=a)
        cell = np.clip(np.searchsorted(grid, s[: b - a], 'right') - 1, 0, len(grid) - 2)
        apart, position = np.empty(b - a), plan.position[a:b]
        for first, last in _near_cells(cell):
            k, part = cell[first:last], slice(first, last)
            low = int(k.min())
            left, right = (
                path[name][:, low : int(k.max()) + 1][:, k - low] for name in PATH_CELLS
            )
            width = grid[k + 1] - grid[k]
            share = ((s[part] - grid[k]) / width).clip(0.0, 1.0)
            found = _septic(left, right, width, share)
            apart[part] = np.abs(found - position[part]).max(axis=1)
        ledger.check('setpoint beside the path', apart, ROUND_TRIP, first=a)
        # At a grid point the sample may belong to the cell before it.
        near = [np.clip(cell + step, 0, len(grid) - 1) for step in (-1, 0, 1)]
        wrong = np.flatnonzero(~np.any([rows[k] == plan.block[a:b] for k in near], axis=0))
        if len(wrong):
            others, other = others + len(wrong), a + int(wrong[0]) if other < 0 else other
        _prove_speeds(ledger, grid, rows, (a, b))
    text = 'setpoints.npz and path.npz name different blocks at'
    ledger.require(not others, f'{text} {others} samples, the first is {other}')
    stops = np.flatnonzero(plan.blocks['exact_stop'])
    stops = stops[(stops >= rows[0]) & (stops < len(plan.blocks['exact_stop']))]
    place = np.minimum(np.searchsorted(rows, stops, 'right'), len(rows) - 1)
    left_out = stops[~np.asarray(path['stop'])[place]]
    lines = plan.blocks['line'][left_out].tolist()[:5]
    ledger.require(not lines, f'path.npz has no stop after lines {lines}')


def _near_cells(cell: IntArray) -> Iterator[tuple[int, int]]:
    first = 0
    while first < len(cell):
        far = np.abs(cell[first:] - cell[first]) > plan_files.CHUNK
        last = first + int(np.argmax(far)) if far.any() else len(cell)
        yield first, last
        first = last


def _prove_speeds(ledger: Ledger, grid: FloatArray, rows: IntArray, part: tuple[int, int]) -> None:
    (a, b), plan = part, ledger.plan
    s, path = plan.setpoints['s'], plan.path
    last = b == len(s)
    # A grid point belongs to the period in which it is passed.
    low = 0 if a == 0 else int(np.searchsorted(grid, s[a]))
    high = len(grid) if last else int(np.searchsorted(grid, s[b]))
    if low >= high:
        return
    # Before the first sample and after the last one the axes rest.
    speed = np.diff(held(s, a, b, 2, 2)) / plan.period
    # Bounds of the speed in each inner period, from the mean speeds in and around it. Between
    # samples the speed may differ as far as the jerk limits allow: it may even fall to 0.
    around = np.stack([speed[:-2], speed[1:-1], speed[2:]])
    spread = np.abs(np.diff(around, axis=0)).sum(axis=0)
    least, most = around.min(axis=0) - spread, around.max(axis=0) + spread
    periods = b - a - last
    at = np.searchsorted(s[a:b], grid[low:high], 'right') - 1
    at = np.clip(at, 0, max(periods - 1, 0)) + 1
    if periods == 0:  # the last sample alone: its period is the one before
        at -= 1
    feed, stops = path['feed'][low:high], np.flatnonzero(path['stop'][low:high])
    off = np.maximum(feed - most[at], least[at] - feed).clip(0.0)
    allowed = SAME_SPEED * np.maximum(most[at], 0.0) + SMALL_SPEED
    allowed += plan.period**2 * _path_jerk(ledger, low, high)
    own = rows[low:high]
    ledger.check('feed of path against the setpoints', off, allowed, rows=own)
    ledger.check('stop of path', least[at[stops]].clip(0.0), allowed[stops], rows=own[stops])


def _path_jerk(ledger: Ledger, first: int, last: int) -> FloatArray:
    """Return the larger of the path jerks that axes allow before and after grid points [m/s3]."""
    path, cells = ledger.plan.path, len(ledger.plan.path['s']) - 1
    found = np.zeros(last - first)
    for name, shift in (('cell_left', 0), ('cell_right', -1)):
        cell = path[name][:, max(first + shift, 0) : min(last + shift, cells)]
        with np.errstate(divide='ignore'):
            jerk = (limits_at(ledger.machine, 3, cell[0]) / np.abs(cell[1])).min(axis=1)
        begin = max(-first - shift, 0)
        side = found[begin : begin + len(jerk)]
        np.maximum(side, jerk, out=side)
    return found


def _septic(
    left: FloatArray, right: FloatArray, width: FloatArray, share: FloatArray
) -> FloatArray:
    scale = width[None, :, None] ** np.arange(4.0)[:, None, None]
    factorial = np.array([1.0, 1.0, 2.0, 6.0])
    start, end = left * scale, right * scale
    taylor = start / factorial[:, None, None]
    # Derivatives of u^0 ... u^7 at u = 1.
    slopes = np.array(
        [
            [np.prod(np.arange(n, n - m, -1.0)) if n >= m else 0.0 for n in range(8)]
            for m in range(4)
        ]
    )
    misfit = end - np.einsum('mn,nka->mka', slopes[:, :4], taylor)
    upper = np.einsum('nm,mka->nka', np.linalg.inv(slopes[:, 4:]), misfit)
    u = share[:, None]
    value = np.zeros_like(u)
    for coefficient in np.concatenate([taylor, upper])[::-1]:
        value = value * u + coefficient
    return np.asarray(value)
