"""Measured against predicted run times of a real machine: `../shared/suites/nist-box`.

Each of the programs OP1 to OP3 is predicted by a machine file fitted to the other two. Then each
section of OP5 is predicted by a file fitted to all three.

    python benchmarks/run_times.py --suite ../shared/suites/nist-box --op5 FILE

The times to start and stop the spindle grow with the square of its speed, which is 12,000 rev/min
in all measurements. A section ends where the next tool change, or M30, begins, so the last section
does not include a stop of the spindle. The first position of the machine is not known, so the
first rapid counts neither in the measured time nor in the predicted one.

The last table compares mean feeds in windows of some seconds without functions, sorted by the kind
of motion that takes most of their time.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.machine_model.machine import Machine
from cnc_interp.program.blocks import WITHIN_MOTION
from cnc_interp.run.time_fit import (
    Fitted,
    Motion,
    TimedProgram,
    TimeFit,
    TracedRun,
    measured_override,
)
from cnc_interp.run.time_records import Trace, load_traces
from cnc_interp.settings.options import Settings

#: The machine before the fit: a bundled one, with its reference point at the top of Z.
MACHINE = 'vmc'
#: Work offsets: G54 as in the machine file. The end position in G58 is not known.
SETUP = 'work_offsets:\n  G58: {X: 0.0, Y: 0.0, Z: 0.0}\n  G54: {X: 400.0, Y: 250.0, Z: -400.0}\n'

KINDS = 'rapids', 'arcs', 'blocks below 1 mm', 'longer blocks'


def section_times(
    program: TimedProgram, machine: Machine, motion: Motion
) -> Iterator[tuple[int, int, float, float]]:
    """Yield first and last line of each section, its motion and its time at standstill [s]."""
    functions = program.functions
    rests = functions.standstill(machine.signals, machine.standstill)
    words = {words.start: word for word, words in machine.signals.words.items()}
    word = np.array([words.get(step, '') for step in functions.step.tolist()])
    changes = np.unique(functions.line_number[word == 'M6'])
    ends = [*changes[1:].tolist(), int(functions.line_number[word == 'M30'][0])]
    for first, last in zip((changes + 1).tolist(), ends, strict=True):
        inside = (functions.line_number >= first) & (functions.line_number < last)
        if last == ends[-1]:
            inside &= word != 'M5'
        planned = float(np.diff(motion.until(np.array([first, last])))[0])
        yield first, last, planned, float(rests[inside].sum())


def fit(traces: list[tuple[TimedProgram, Trace]], machine: Machine) -> Fitted:
    runs = [TracedRun.of(program, trace) for program, trace in traces]
    found = TimeFit(machine, runs, lambda text: print(f'    {text}', flush=True)).solve()
    for key, (value, width) in found.values.items():
        print(f'    {key:50s} {value:9.4g} +- {width:.2g}')
    return found


def first_rapid(program: TimedProgram, trace: Trace) -> float:
    """Return how long the first motion takes [s]."""
    begin, end = np.searchsorted(trace.line, program.lines[0] + np.array([0, 1]))
    return float(trace.time[end] - trace.time[begin])


def by_kind(pairs: list[tuple[TimedProgram, Trace]], motion: Motion) -> FloatArray:
    """Return length, measured and planned time in windows of each kind, (4, 3) [m, s, s]."""
    blocks = pairs[0][0].blocks
    step = np.linalg.norm(np.diff(blocks.tip, axis=0, prepend=blocks.tip[:1]), axis=1)
    piece = blocks.corner == WITHIN_MOTION
    piece[1:] |= piece[:-1]
    kind = np.zeros(motion.last + 1, dtype=np.int64)
    kind[blocks.line_number] = np.select([blocks.rapid, piece, step < 1e-3], [0, 1, 2], 3)
    length = replace(motion, line=blocks.line_number, duration=step)
    found = np.zeros((len(KINDS), 3))
    for run in (TracedRun.of(*pair) for pair in pairs):
        times = [
            run.planned(replace(motion, duration=motion.duration * (kind[motion.line] == k)))
            for k in range(len(KINDS))
        ]
        row = run.planned(length), run.measured, run.planned(motion)
        np.add.at(found, np.argmax(times, axis=0), np.column_stack(row))
    return found


def compared(
    name: str,
    pairs: list[tuple[TimedProgram, Trace]],
    runs: list[dict[str, Any]],
    machine: Machine,
    kinds: FloatArray,
) -> list[float]:
    """Print and return how far the sections are off, and add windows to their ``kinds``."""
    off, program = [], pairs[0][0]
    motion_plan = program.motion(machine)
    kinds += by_kind(pairs, motion_plan)
    sections = section_times(program, machine, motion_plan)
    for number, (_, _, motion, rest) in enumerate(sections):
        told = [run['sections'][number] for run in runs]
        real = median(section['to_s'] - section['from_s'] for section in told)
        if number == 0:
            real -= median(first_rapid(*pair) for pair in pairs)
        off.append((motion + rest) / real - 1.0)
        print(
            f'| {name} | T{told[0]["tool"]} | {real:.1f} | {motion + rest:.1f} | {motion:.1f} '
            f'| {rest:.1f} | {off[-1]:+.1%} |'
        )
    return off


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--suite', type=Path, default=Path('../shared/suites/nist-box'))
    parser.add_argument('--op5', type=Path, help='the program to predict')
    parser.add_argument('--setup', type=Path, default=Path('out/run_times_setup.yaml'))
    options = parser.parse_args()
    options.setup.parent.mkdir(parents=True, exist_ok=True)
    options.setup.write_text(SETUP, encoding='utf-8')
    settings, machine = Settings(setup=options.setup), Machine.load(MACHINE)
    measured: dict[str, Any] = json.loads((options.suite / 'runs.json').read_text())
    traces: dict[str, list[tuple[TimedProgram, Trace]]] = {}
    for name in measured:
        files = sorted(options.suite.glob(f'{name}_part*_blocks.csv'))
        found = [load_traces(file, options.suite / f'{name}.nc')[0] for file in files]
        plain = TimedProgram.load(options.suite / f'{name}.nc', machine, settings)
        program = plain.overridden(median(measured_override(plain, trace) for trace in found))
        print(f'{name}: feed override {program.override:.1%}')
        traces[name] = [(program, trace) for trace in found]
    off, kinds = [], np.zeros((len(KINDS), 3))
    for name, runs in measured.items():
        print(f'{name}, by the others:')
        others = [pair for other, pairs in traces.items() if other != name for pair in pairs]
        fitted = fit(others, machine).machine
        off += compared(name, traces[name], runs, fitted, kinds)
    print(f'off: median {np.median(np.abs(off)):.2%}, largest {np.abs(off).max():.2%}')
    for kind, (length, real, planned) in zip(KINDS, kinds, strict=True):
        feeds = f'{1e3 * length / real:.2f} | {1e3 * length / planned:.2f}'
        print(f'| {kind} | {real:.0f} s | {feeds} mm/s | {planned / real - 1.0:+.1%} |')
    if options.op5 is None:
        return
    print('OP5, by all of them:')
    fitted = fit([pair for pairs in traces.values() for pair in pairs], machine).machine
    off = [
        x for name in measured for x in compared(name, traces[name], measured[name], fitted, kinds)
    ]
    print(f'off: median {np.median(np.abs(off)):.2%}, largest {np.abs(off).max():.2%}')
    program = TimedProgram.load(options.op5, machine, settings)
    total = 0.0
    for first, last, motion, rest in section_times(program, fitted, program.motion(fitted)):
        total += motion + rest
        print(f'| {first} to {last} | {motion + rest:.1f} | {motion:.1f} | {rest:.1f} |')
    print(f'sections of OP5 together {total:.1f} s')


if __name__ == '__main__':
    main()
