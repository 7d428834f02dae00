"""Check that functions act in order, and that lines in step with the spindle follow its angle."""

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from cnc_interp.core import MM, BoolArray, IntArray
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import AWAY, FOLLOWS, TOWARD, Signals
from cnc_interp.proof.limits_again import limits_of_differences
from cnc_interp.proof.path_grid import ROUNDING
from cnc_interp.proof.plain_reader import ReadCall
from cnc_interp.proof.plan_files import MISSING, Columns, PlanFiles, gathered
from cnc_interp.proof.program_shapes import SLACK
from cnc_interp.proof.verdict import DIFFERENCES, Ledger

SHALLOW = 0.5  #: Largest depth that a tapped hole may lack [rev].
KNOWN_ANGLES = 0.9  #: Least share of a line's periods in which the spindle's angle is known [-].
SAME_VALUE = 1e-9  #: Largest relative difference of equal output values [-].


def prove_functions(ledger: Ledger, plan: PlanFiles, machine: Machine) -> None:
    """Check that every function acts in order and at the start of its block.

    Of the machine's table of functions, only the entries that wait for a standstill are used.
    """
    found, signals, count = plan.functions, machine.signals, len(plan.block)
    block, step, sample = (found[name] for name in ('block', 'step', 'sample'))
    told = plan.summary.get('functions', {})
    known = len(block) == 0 or 0 <= step.min() <= step.max() < len(signals.steps)
    ledger.require(known, 'functions.npz names steps that the machine does not have')
    if not known:
        return
    calls, broken = calls_of(found, signals)
    ledger.require(not broken, broken)
    counts = dict(Counter(call.word for call in calls))
    ledger.require(told == counts, f'summary.json says functions {told}, the plan has {counts}')
    if plan.by_probe:
        line = int(plan.blocks['line'][plan.block[count - 1]])
        touched = any(call.word in (TOWARD, AWAY) and call.line == line for call in calls)
        ledger.require(touched, f'{plan.cut}; but line {line}, where it ends, watches no probe')

    def demand(good: BoolArray, text: str) -> None:
        for k in np.flatnonzero(~np.asarray(good, dtype=np.bool_))[:1]:
            name, place = signals.text(signals.steps[step[k]].output, found['value'][k]), sample[k]
            ledger.fail(f'line {found["line_number"][k]}: {name} {text} (setpoint {place})')

    demand(np.diff(block, prepend=0) >= 0, 'is not in the order of the blocks')
    came = sample != MISSING
    unknown = (block >= ledger.known_rows) & bool(plan.cut)
    demand(came | unknown, 'was not executed')
    demand(~came | (np.diff(sample, prepend=0) >= 0), 'was executed out of order')
    inside = np.clip(sample, 0, count - 1)
    here, before = gathered(plan.block, inside), gathered(plan.block, np.maximum(inside - 1, 0))
    at_end = sample == count
    demand(~came | (here >= block) | at_end, 'was executed before its block')
    late = np.where(at_end, here >= block, (sample > 0) & (before >= block))
    demand(~came | ~late, 'was executed after the beginning of its block')
    waiting = np.array([each.rests for each in signals.steps], dtype=np.bool_)[step]
    ahead = (block > 1) & (block < len(plan.blocks['tip'])) & waiting
    rests = plan.blocks['exact_stop'][np.clip(block - 1, 0, len(plan.blocks['tip']) - 1)]
    demand(~ahead | rests, 'is waited for, but the path does not rest there')


@dataclass(frozen=True)
class Call:
    """A function of the program: the steps of one word, at the start of a block."""

    word: str
    line: int
    block: int
    values: tuple[float, ...]  #: Value that each of its steps sets.


def calls_of(found: Columns, signals: Signals) -> tuple[list[Call], str]:
    """Return the functions, and a fault if one lacks a step or a step sets a wrong value."""
    starts = {steps.start: word for word, steps in signals.words.items() if len(steps)}
    names = ('line_number', 'block', 'step')
    places = np.stack([np.asarray(found[name], dtype=np.int64) for name in names], axis=1)
    calls: list[Call] = []
    k = 0
    while k < len(places):
        line, block, step = places[k].tolist()
        word = starts.get(step, '')
        steps = signals.words.get(word, range(0))
        values = tuple(map(float, found['value'][k : k + len(steps)]))
        whole = [[line, block, step] for step in steps]
        if not whole or places[k : k + len(steps)].tolist() != whole:
            name = word or 'a function of the machine'
            return calls, f'line {line}: the steps from number {k} on are not those of {name}'
        for number, value in zip(steps, values, strict=True):
            fixed = signals.steps[number].value
            if not isinstance(fixed, str) and value != fixed:
                output = signals.text(signals.steps[number].output, value)
                return calls, f'line {line}: {word} does not set {output}'
        calls.append(Call(word, line, block, values))
        k += len(steps)
    return calls, ''


def compare_calls(
    plan: PlanFiles,
    signals: Signals,
    read: list[tuple[ReadCall, int]],
    known: Collection[str] = (),
) -> str:
    """Compare functions with those ``read`` from the text; return the first difference.

    ``read``: functions with their program rows. ``known``: words that the reader knows, if not
    all.
    """
    planned = [
        call for call in calls_of(plan.functions, signals)[0] if not known or call.word in known
    ]
    wanted = [each for each in read if signals.words.get(each[0].word)]
    for k in range(max(len(planned), len(wanted))):
        if k == len(wanted):
            return f'{planned[k].word} of line {planned[k].line} in the plan is not in the text'
        (call, row), own = wanted[k], planned[k] if k < len(planned) else None
        at = f'line {call.line}' if call.line else f'function {k + 1}, {call.word},'
        same = own and own.word == call.word and call.line in (0, own.line)
        if own is None or not same:
            other = f'{own.word} of line {own.line}' if own else 'nothing'
            return f'{at} of the program: {call.word} is due, the plan has {other}'
        if own.block != row:
            return f'{at} of the program: {call.word} acts before row {row}, not {own.block}'
        for number, value in zip(signals.words[call.word], own.values, strict=True):
            letter = signals.steps[number].value
            meant = call.given.get(letter, ()) if isinstance(letter, str) else (value,)
            if not np.isclose(value, meant, SAME_VALUE, 0.0).any():
                told = ' or '.join(f'{each:.9g}' for each in meant) or 'no value'
                text = f'the plan sets {signals.text(signals.steps[number].output, value)}'
                return f'{at} of the program: {call.word} has {told}, {text}'
    return ''


def prove_followed(ledger: Ledger, plan: PlanFiles, machine: Machine) -> None:
    """Check the limits, pitch, depth and end of each line in step with the spindle.

    Only a record of a run has such lines; a plan has none.
    """
    found, record, words = plan.functions, plan.followed, machine.signals.words
    if not record or FOLLOWS not in words:
        return
    begins = (found['step'] == words[FOLLOWS].start) & (found['sample'] != MISSING)
    starts, block = np.flatnonzero(begins).tolist(), record['block'][:]
    lines = np.split(np.arange(len(block)), np.flatnonzero(np.diff(block)) + 1)
    text = f'{len(starts)} lines should follow the spindle, but {len(lines)} did'
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
    known = np.isfinite(angle)
    text = f'line {line}: the spindle angle is known in only {known.sum()} periods'
    ledger.require(cut or known.sum() >= KNOWN_ANGLES * len(known), f'{text}, of {len(known)}')
    angle, beside = angle[known], beside[known]
    in_step = (beside > 0.5 * ramp) & ((turns < 0.0) | (beside < turns - 0.5 * ramp))
    sense = np.sign(angle[np.argmax(beside)] - angle[0]) if len(angle) else 1.0
    off = (sense * angle - beside)[in_step]
    error = np.abs(off - np.round(np.median(off))) if len(off) else off
    tolerance = plan.blocks['contour_tolerance'][row[0]]
    ledger.judge('thread', lead * error, tolerance, rows=row[: len(error)])
    ledger.judge('beside the thread', aside, tolerance, rows=row[: len(q)], quiet=True)
    ledger.require(cut or len(off) > 0, f'line {line} was never in step with the spindle')
    end = 0.0 if turns < 0.0 else turns
    ended, deepest = lead * abs(place[-1] - end) <= SLACK, float(place.max())
    ledger.require(cut or ended, f'line {line} did not follow to its end')
    text = f'line {line} went {deepest:.3g} turns deep, not {abs(turns):.3g}'
    ledger.require(cut or deepest >= abs(turns) - SHALLOW, text)
