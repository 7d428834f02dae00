"""Lines in step with the spindle: their recorded setpoints against the angles recorded beside."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cnc_interp.core.arrays import IntArray
from cnc_interp.core.units import MM
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import FOLLOWS
from cnc_interp.proof.axis_limits import limits_of_differences
from cnc_interp.proof.functions import MISSING
from cnc_interp.proof.path_grid import ROUNDING
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.proof.program_shapes import SLACK
from cnc_interp.proof.verdict import DIFFERENCES

if TYPE_CHECKING:
    from cnc_interp.proof.verdict import Ledger

SHALLOW = 0.5  #: A tapped hole may be less deep by so many turns [rev].


def prove_followed(ledger: Ledger, plan: PlanFiles, machine: Machine) -> None:
    """Demand limits, pitch from an index on, depth and end of each line; a plan has no record."""
    found, record, words = plan.functions, plan.followed, machine.signals.words
    if not record or FOLLOWS not in words:
        return
    begins = (found['step'] == words[FOLLOWS].start) & (found['sample'] != MISSING)
    starts, block = np.flatnonzero(begins).tolist(), record['block'][:]
    lines = np.split(np.arange(len(block)), np.flatnonzero(np.diff(block)) + 1)
    text = f'{len(starts)} lines were to follow the spindle, {len(lines)} did'
    ledger.require(len(starts) == len(lines), text)
    for number, (k, rows) in enumerate(zip(starts, lines, strict=False), start=1):
        _prove_line(ledger, plan, machine, k, rows, plan.cut != '' and number == len(lines))


def _prove_line(
    ledger: Ledger, plan: PlanFiles, machine: Machine, k: int, rows: IntArray, cut: bool
) -> None:
    found, record = plan.functions, plan.followed
    q, angle = record['position'][rows[0] : rows[-1] + 1], record['angle'][rows]
    row = np.full(len(q) + 6, found['block'][k])
    held = np.pad(q, ((3, 3), (0, 0)), mode='edge')
    for order, (kind, _) in enumerate(DIFFERENCES, start=1):
        used = np.abs(np.diff(held, order, axis=0)) / plan.period**order
        limit = limits_of_differences(machine, order, held)
        for j, name in enumerate(machine.axis_names):
            at = row[: len(used)]
            ledger.judge(kind, used[:, j], limit[:, j], name, ROUNDING, rows=at)
    way, turns, moved = np.zeros(q.shape[1]), float(found['value'][k + 3]), q - q[0]
    way[:3] = found['value'][k : k + 3] * MM
    lead = float(np.linalg.norm(way))
    place = moved @ way / lead**2
    aside = np.linalg.norm(moved - np.outer(place, way), axis=1)
    ramp, line = float(record['ramp'][rows[-1]]), found['line_number'][k]
    later = int(record['later'][rows[0]])
    angle, beside = angle[later:], place[: len(place) - later]
    in_step = (beside > 0.5 * ramp) & ((turns < 0.0) | (beside < turns - 0.5 * ramp))
    sense = np.sign(angle[np.argmax(beside)] - angle[0])
    off = (sense * angle - beside)[in_step]
    error = np.abs(off - np.round(np.median(off))) if len(off) else off
    tolerance = plan.blocks['contour_tolerance'][row[0]]
    ledger.judge('thread', lead * error, tolerance, rows=row[: len(error)])
    ledger.judge('beside the thread', aside, tolerance, rows=row[: len(q)], quiet=True)
    ledger.require(cut or len(off) > 0, f'line {line} was never in step with the spindle')
    end = 0.0 if turns < 0.0 else turns
    ledger.require(
        cut or lead * abs(place[-1] - end) <= SLACK, f'line {line} did not follow to its end'
    )
    deepest = float(place.max())
    ledger.require(
        cut or deepest >= abs(turns) - SHALLOW,
        f'line {line} went {deepest:.3g} turns deep, not {abs(turns):.3g}',
    )
