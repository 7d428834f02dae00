"""Measured against predicted run times of a real machine: `../shared/suites/nist-box`.

Each of the programs OP1 to OP3 is predicted by a machine file fitted to the other two. Then OP5 is
predicted from all of them, section by section.

    python benchmarks/run_times.py --suite ../shared/suites/nist-box --op5 FILE

Start and stop of the spindle grow with the square of its speed, which is 12,000 rev/min in
all that was measured. A section ends where its next tool change, or M30, begins: so the last one
has no stop of the spindle. Where the machine stands first is not known: its first rapid takes no
time.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from cnc_interp.machine_model.machine import Machine
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


def compared(
    name: str, program: TimedProgram, runs: list[dict[str, Any]], machine: Machine
) -> list[float]:
    off = []
    sections = section_times(program, machine, program.motion(machine))
    for number, (_, _, motion, rest) in enumerate(sections):
        told = [run['sections'][number] for run in runs]
        real = median(section['to_s'] - section['from_s'] for section in told)
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
    off = []
    for name, runs in measured.items():
        print(f'{name}, by the others:')
        others = [pair for other, pairs in traces.items() if other != name for pair in pairs]
        fitted = fit(others, machine).machine
        program = traces[name][0][0]
        off += compared(name, program, runs, fitted)
    print(f'off: median {np.median(np.abs(off)):.2%}, largest {np.abs(off).max():.2%}')
    if options.op5 is None:
        return
    print('OP5, by all of them:')
    fitted = fit([pair for pairs in traces.values() for pair in pairs], machine).machine
    off = [
        x for name in measured for x in compared(name, traces[name][0][0], measured[name], fitted)
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
