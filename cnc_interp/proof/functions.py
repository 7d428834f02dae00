"""The functions of a program came out in order, and lines in step follow the spindle's angle."""

import re
from collections import Counter

import numpy as np

from cnc_interp.core import MM, BoolArray, IntArray
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import AWAY, FOLLOWS, TOWARD, Signals
from cnc_interp.proof.axis_limits import limits_of_differences
from cnc_interp.proof.path_grid import ROUNDING
from cnc_interp.proof.plan_files import Columns, PlanFiles, gathered
from cnc_interp.proof.program_shapes import SLACK
from cnc_interp.proof.verdict import DIFFERENCES, Ledger

SHALLOW = 0.5  #: A tapped hole may be less deep by so many turns [rev].
MISSING = -1  #: In place of the setpoint of a function that did not come out.
_COMMENT = re.compile(r'\([^()]*\)|;.*')
_WORD = re.compile(r'(?<![A-Z_])([SMT])\s*(\d+\.?\d*)|G\s*(0?4|31|38\.[2-5]|9[67])(?![\d.])')


#: Functions of G codes that are not those of a probe toward the part.
_OF_G = {'38.4': AWAY, '38.5': AWAY, '96': '', '97': '', '': '', '4': 'G4', '04': 'G4'}


def prove_functions(ledger: Ledger, plan: PlanFiles, machine: Machine) -> None:
    """Demand order and place of all functions; of the machine's table only the waits count."""
    found, signals, count = plan.functions, machine.signals, len(plan.block)
    block, step, sample = (found[name] for name in ('block', 'step', 'sample'))
    told = plan.summary.get('functions', {})
    known = len(block) == 0 or 0 <= step.min() <= step.max() < len(signals.steps)
    ledger.require(known, 'functions.npz names steps that the machine does not have')
    if not known:
        return
    counts = dict(Counter(word for _, word, _ in _words(found, signals)))
    ledger.require(told == counts, f'summary.json says functions {told}, the plan has {counts}')

    def demand(good: BoolArray, text: str) -> None:
        for k in np.flatnonzero(~np.asarray(good, dtype=np.bool_))[:1]:
            name, place = signals.text(signals.steps[step[k]].output, found['value'][k]), sample[k]
            ledger.fail(f'line {found["line_number"][k]}: {name} {text} (setpoint {place})')

    demand(np.diff(block, prepend=0) >= 0, 'is out of order')
    came = sample != MISSING
    demand(came | (block >= ledger.known_rows), 'did not come out')
    demand(~came | (np.diff(sample, prepend=0) >= 0), 'came out of order')
    inside = np.clip(sample, 0, count - 1)
    here, before = gathered(plan.block, inside), gathered(plan.block, np.maximum(inside - 1, 0))
    at_end = sample == count
    demand(~came | (here >= block) | at_end, 'came out before its block')
    late = np.where(at_end, here >= block, (sample > 0) & (before >= block))
    demand(~came | ~late, 'came out after the begin of its block')
    waiting = np.array([each.rests for each in signals.steps], dtype=np.bool_)[step]
    ahead = (block > 1) & (block < len(plan.blocks['tip'])) & waiting
    rests = plan.blocks['exact_stop'][np.clip(block - 1, 0, len(plan.blocks['tip']) - 1)]
    demand(~ahead | rests, 'is waited for, but the path does not rest there')


def _words(found: Columns, signals: Signals) -> list[tuple[int, str, float]]:
    first = {steps.start: word for word, steps in signals.words.items() if len(steps)}
    rows = zip(found['line_number'], found['step'].tolist(), found['value'], strict=True)
    return [
        (int(line), first[k], float(value) if first[k] in 'ST' else 0.0)
        for line, k, value in rows
        if k in first
    ]


def compare_words(plan: PlanFiles, machine: Machine, text: str) -> list[str]:
    read: Counter[tuple[int, str, float]] = Counter()
    by_surface = False  # S is no speed of the spindle then (G96)
    restoring = set()  # lines that set what M70 has saved, whatever that was
    for number, line in enumerate(text.upper().splitlines(), start=1):
        found = _WORD.findall(_COMMENT.sub(' ', line))
        modes = [code for *_, code in found if code in ('96', '97')]
        by_surface = modes[-1] == '96' if modes else by_surface
        for letter, value, code in found:
            word = f'M{float(value):g}' if letter == 'M' else letter
            if code or (by_surface and letter == 'S'):
                word = _OF_G.get(code, TOWARD)
            if word == 'M72':
                restoring.add(number)
            if word in machine.signals.words:
                read[number, word, float(value) if letter in ('S', 'T') else 0.0] += 1
    planned = Counter(_words(plan.functions, machine.signals))
    return [
        f'line {line} of the program: {word} stands there {read[key]} times, in the plan '
        f'{planned[key]} times'
        for key in sorted({*read, *planned})
        for line, word, _ in [key]
        if read[key] != planned[key] and line not in restoring
    ]


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
    ended, deepest = lead * abs(place[-1] - end) <= SLACK, float(place.max())
    ledger.require(cut or ended, f'line {line} did not follow to its end')
    text = f'line {line} went {deepest:.3g} turns deep, not {abs(turns):.3g}'
    ledger.require(cut or deepest >= abs(turns) - SHALLOW, text)
