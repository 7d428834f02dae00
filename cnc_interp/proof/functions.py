"""The functions of a program: each came out once, in order, at the begin of its block."""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from cnc_interp.core.arrays import BoolArray
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import AWAY, TOWARD, Signals
from cnc_interp.proof.plan_files import Columns, PlanFiles, gathered

if TYPE_CHECKING:
    from cnc_interp.proof.verdict import Ledger

MISSING = -1  #: In place of the setpoint of a function that did not come out.
_COMMENT = re.compile(r'\([^()]*\)|;.*')
_WORD = re.compile(r'(?<![A-Z_])([SMT])\s*(\d+\.?\d*)|G\s*(31|38\.[2-5]|9[67])(?![\d.])')


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
            ledger.require(
                False, f'line {found["line_number"][k]}: {name} {text} (setpoint {place})'
            )

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
    return [
        (int(line), first[k], float(value) if first[k] in 'ST' else 0.0)
        for line, k, value in zip(
            found['line_number'], found['step'].tolist(), found['value'], strict=True
        )
        if k in first
    ]


def compare_words(plan: PlanFiles, machine: Machine, text: str) -> list[str]:
    read: Counter[tuple[int, str, float]] = Counter()
    by_surface = False  # S is no speed of the spindle then (G96)
    for number, line in enumerate(text.upper().splitlines(), start=1):
        found = _WORD.findall(_COMMENT.sub(' ', line))
        modes = [code for *_, code in found if code in ('96', '97')]
        by_surface = modes[-1] == '96' if modes else by_surface
        for letter, value, code in found:
            word = f'M{float(value):g}' if letter == 'M' else letter
            if code or (by_surface and letter == 'S'):
                word = {'38.4': AWAY, '38.5': AWAY, '96': '', '97': '', '': ''}.get(code, TOWARD)
            if word in machine.signals.words:
                read[number, word, float(value) if letter in 'ST' else 0.0] += 1
    planned = Counter(_words(plan.functions, machine.signals))
    return [
        f'line {line} of the program: {word} stands there {read[key]} times, in the plan '
        f'{planned[key]} times'
        for key in sorted({*read, *planned})
        for line, word, _ in [key]
        if read[key] != planned[key]
    ]
