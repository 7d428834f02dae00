"""
Random programs with rotary words: rejections, end positions, and deviation from the lines.

    python benchmarks/rotary_words.py [--count 1000] [--tcp] [--machines xyzac ...]

Without ``--tcp`` the words are axis positions (tool-tip control off), on every bundled machine
with rotary axes. With ``--tcp`` the words belong to tool tips, with small tilts, so that many
blocks pass near the pole. Every plan is checked with the proof. A separate reader of a few lines
reads the words again and compares them with the executed axes. If ``RS274`` names LinuxCNC's
interpreter (``RS274=$(tools/get_rs274 FOLDER)``), its axis positions at the end of every block are
compared with ours, too (TCP off, machines without extra axes).
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import tempfile
from pathlib import Path

import numpy as np
from whole_plans import Plan, plan_program

from cnc_interp.core import DEG, MM, InterpError
from cnc_interp.machine_model.machine import Machine, machines_directory
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.proof.verify import verify
from cnc_interp.run.plan_writer import block_columns
from cnc_interp.settings.options import Settings

#: Largest tilt of random programs [deg], without and with tool-tip control.
TILT, TILT_TCP = 60.0, 25.0


def rotary_machines() -> list[str]:
    """Return the names of bundled machines with rotary axes."""
    names = sorted(path.stem for path in machines_directory().glob('*.yaml'))
    return [name for name in names if Machine.load(name).has_rotary]


def random_program(rng: np.random.Generator, machine: Machine, tcp: bool) -> str:
    """Return a program of 3 to 8 blocks with random axis words within the travel."""
    names, low, high = machine.axis_names, *machine.travel.T
    names = tuple(n for n, a, b in zip(names, low, high, strict=True) if b - a > 1e-6)
    tilt = TILT_TCP if tcp else TILT
    lines = ['G21 G90 G94'] + (['M428'] if tcp else [])
    start = Transform.of(machine).linear(np.zeros((1, 3)), np.zeros((1, 2)))[0]
    here: dict[str, float] = {}
    for i in range(int(rng.integers(4, 9))):
        words = {}
        for name in names:
            if i and rng.random() < 0.4:
                continue
            k = machine.axis_names.index(name)
            if name in 'XYZ':
                value = rng.uniform(-60.0, 60.0)
                if not tcp:  # counted from the workpiece zero
                    value = np.clip(value, *(machine.travel[k] - start[k]) / MM)
            elif name in 'ABC':
                reach = 200.0 if np.isinf(high[k]) else tilt
                value = rng.choice(
                    [rng.uniform(-reach, reach), 0.0, rng.uniform(-1e-3, 1e-3)],
                    p=[0.75, 0.2, 0.05],
                )
                value = np.clip(value, low[k] / DEG, high[k] / DEG)
            else:
                value = rng.uniform(max(low[k] / MM, -20.0), min(high[k] / MM, 20.0))
            words[name] = round(float(value), 3)
        here.update(words)
        if not words:
            continue
        motion = 'G0' if i == 0 or rng.random() < 0.3 else 'G1'
        feed = '' if motion == 'G0' else f' F{rng.choice([300, 1500, 6000])}'
        lines.append(' '.join([motion, *(f'{n}{v:g}' for n, v in words.items())]) + feed)
    return '\n'.join([*lines, 'M30'])


def files_of(plan: Plan) -> PlanFiles:
    """Return what the proof needs of a plan in memory."""
    samples = plan.setpoints
    columns = ('time', 'position', 'velocity', 'acceleration', 'block', 's')
    blocks = block_columns(plan.program.blocks)
    if 'extra_axes' not in blocks:
        blocks['extra_axes'] = np.zeros((len(plan.program.blocks), 0))
    return PlanFiles(
        {name: getattr(samples, name) for name in columns},
        {},
        blocks,
        {
            'interpolation_period': plan.settings.interpolation_period,
            'flank_height': plan.settings.flank_height,
        },
    )


def words_missed(text: str, plan: Plan, tcp: bool) -> float:
    """Return by how much the last axis words are missed at the end [mm or deg]."""
    last: dict[str, float] = {}
    for line in text.splitlines():
        for word in line.split():
            if word[0] in 'XYZABCUVW':
                last[word[0]] = float(word[1:])
    machine = plan.machine
    q = plan.setpoints.position[-1]
    zero = Transform.of(machine).linear(np.zeros((1, 3)), np.zeros((1, 2)))[0]
    tip = Transform.of(machine).forward(q[None])[0][0]
    worst = 0.0
    for name, word in last.items():
        k = machine.axis_names.index(name)
        if name in 'XYZ':
            value = (tip[k] if tcp else q[k] - zero[k]) / MM
        else:
            value = q[k] / (DEG if name in 'ABC' else MM)
        worst = max(worst, abs(value - word))
    return worst


def beside_linuxcnc(text: str, plan: Plan) -> float | None:
    """Return the largest distance of our block ends from LinuxCNC's [mm, deg]; None without it."""
    program = os.environ.get('RS274')
    machine, blocks = plan.machine, plan.program.blocks
    if not program or machine.extra_names:
        return None
    with tempfile.TemporaryDirectory() as folder:
        part, values, tools = (Path(folder) / name for name in ('part.ngc', 'p.var', 'tool.tbl'))
        part.write_text(text)
        values.touch()
        tools.write_text('T1 P1 Z0\n')
        done = subprocess.run(
            [program, '-t', str(tools), '-v', str(values), '-g', str(part)],
            capture_output=True,
            text=True,
            check=True,
        )
    ends = [
        [float(x) for x in found.split(',')]
        for found in re.findall(r'STRAIGHT_(?:TRAVERSE|FEED)\(([^)]*)\)', done.stdout)
    ]
    # A block that moves nothing is no block of ours.
    ends = [end for before, end in zip([None, *ends], ends, strict=False) if end != before]
    transform = Transform.of(machine)
    zero = transform.linear(np.zeros((1, 3)), np.zeros((1, 2)))[0]
    stands = transform.linear(blocks.tip[1:], blocks.rotary[1:]) - zero
    lines, worst = blocks.line_number[1:], 0.0
    last = np.flatnonzero(np.append(lines[1:] != lines[:-1], True))
    if len(last) > len(ends):
        return np.inf
    ends = ends[len(ends) - len(last) :]
    for k, end in zip(last, ends, strict=True):
        worst = max(worst, float(np.abs(stands[k] / MM - end[:3]).max()))
        for j, name in enumerate(machine.axis_names[3:5]):
            worst = max(worst, abs(blocks.rotary[1 + k, j] / DEG - end[3 + 'ABC'.index(name)]))
    return worst


def main() -> None:
    """Run the comparison and print one line for each machine."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--count', type=int, default=1000)
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--tcp', action='store_true')
    parser.add_argument('--machines', nargs='*', default=rotary_machines())
    options = parser.parse_args()
    for name in options.machines:
        machine, refused, travel, unproven, missed, beside = Machine.load(name), 0, 0, 0, 0.0, 0.0
        stops, compared, apart = 0, 0, 0.0
        for i in range(options.count):
            text = random_program(np.random.default_rng([options.seed, i]), machine, options.tcp)
            try:
                program = read_text(text, f'{i}.ngc', Transform.of(machine), Settings())
                plan = plan_program(program, machine)
            except InterpError as problem:
                if 'holds no motion' in str(problem):
                    continue
                if 'travel' in str(problem):
                    travel += 1
                    continue
                refused += 1
                print(f'{name} {i} refused: {problem}\n{text}')
                continue
            proof = verify(files_of(plan), machine)
            if not proof.ok:
                unproven += 1
                print(f'{name} {i} not proven: {proof.failures[0]}\n{text}')
            missed = max(missed, words_missed(text, plan, options.tcp))
            stops += int(plan.segments.stop.sum()) - 1
            gap = None if options.tcp else beside_linuxcnc(text, plan)
            if gap is not None:
                compared, apart = compared + 1, max(apart, gap)
                if gap > 2e-4:
                    print(f'{name} {i} LinuxCNC ends {gap:.4f} away\n{text}')
            found = [f for f in proof.findings if f.what == 'axes beside their line']
            beside = max([beside, *(f.value for f in found)])
        print(
            json.dumps(
                {
                    'machine': name,
                    'programs': options.count,
                    'refused': refused,
                    'travel': travel,
                    'not proven': unproven,
                    'words missed [mm, deg]': missed,
                    'stops': stops,
                    'axes beside their lines [mm]': beside / MM,
                    'compared with LinuxCNC': compared,
                    'ends beside LinuxCNC [mm, deg]': apart,
                }
            )
        )


if __name__ == '__main__':
    main()
