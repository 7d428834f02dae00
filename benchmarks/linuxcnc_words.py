"""
Random programs with LinuxCNC's words, read by LinuxCNC's interpreter and by ours.

    RS274=... python benchmarks/linuxcnc_words.py [--count 5000] [--first 0] [--show SEED]
    RS274=... python benchmarks/linuxcnc_words.py --expressions [--count 10000]

Each seed generates lines, arcs and helices in three planes, G90 G91, G20 G21, G93, canned cycles,
G92, G10 L2 and L20, work offsets, tool lengths, G53 G28 G30, variables, expressions, loops and
subprograms. Ends, arcs, feeds and durations are compared as by ``check --program``. The script
prints each difference with its seed, and a table at the end. With ``--expressions`` each seed
generates one random expression.
"""

from __future__ import annotations

import argparse
import json
import random
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from cnc_interp.core import InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import Blocks, JobSetup, Tool, read_text
from cnc_interp.program.job import WORK_OFFSETS
from cnc_interp.proof.compared_moves import RowsByPlace
from cnc_interp.proof.linuxcnc_reader import LinuxCNCError, Setup, read_by_linuxcnc
from cnc_interp.proof.plain_reader import ReadCall, ReadMove
from cnc_interp.run.plan_writer import block_columns
from cnc_interp.settings.options import Settings

PLANES = {'G17': ('XYZ', 'IJ'), 'G18': ('ZXY', 'KI'), 'G19': ('YZX', 'JK')}
CYCLES = 'G81', 'G82', 'G83', 'G73', 'G85', 'G86', 'G89', 'G84', 'G74'
LENGTHS = {1: 0.010, 2: 0.025}  # [m]
ALIKE, DIFFERENT = 'alike', 'DIFFERENT'
#: Seeds of expressions in which LinuxCNC's COS[90] is -2.5e-20, of which MOD -3.5 makes 3.5.
ROUNDED = {7261}
TOGETHER = 25  #: Expressions that LinuxCNC evaluates in one process.
KINDS = {
    'line': 0.22,
    'rapid': 0.10,
    'arc': 0.18,
    'plane': 0.06,
    'distance': 0.04,
    'unit': 0.03,
    'feed_mode': 0.03,
    'cycle': 0.12,
    'g92': 0.03,
    'offset': 0.05,
    'choose': 0.03,
    'tool': 0.02,
    'other': 0.02,
    'variable': 0.03,
    'flow': 0.06,
    'subprogram': 0.05,
}


@dataclass
class Writer:
    """Writes a program line by line; numbers are those of its unit."""

    r: random.Random
    lines: list[str] = field(
        default_factory=lambda: [
            'G17 G21 G90 G94 G40 G49 G80 G54 F500',
            'M3 S1000',
            'G0 X0 Y0 Z10',
        ]
    )
    unit: float = 1.0  # [mm]
    plane: str = 'G17'
    incremental: bool = False
    timed: bool = False
    variables: list[int] = field(default_factory=list)
    words: int = 0  # numbers of O words
    called: list[str] = field(default_factory=list)  # subprograms

    def say(self, *lines: str) -> None:
        """Write lines."""
        self.lines += lines

    def number(self) -> str:
        """Return a number, at times as an expression."""
        digits = self.r.choice((0, 1, 2, 3)) + (self.unit > 1.0)
        value, chance = round(self.r.uniform(-30, 30) / self.unit, digits), self.r.random()
        if chance < 0.08 and self.variables:
            return f'[#{self.r.choice(self.variables)}+{abs(value):g}]'
        if chance < 0.12:
            return f'[{value:g}*1.5]' if value >= 0 else f'[0-{-value:g}]'
        return f'{value:g}'

    def axes(self) -> str:
        """Return words of some axes."""
        letters = self.r.sample('XYZ', self.r.choice((1, 1, 2, 2, 3)))
        return ' '.join(f'{letter}{self.number()}' for letter in sorted(letters))

    def feed(self) -> str:
        """Return a feed, or nothing where it may be left out."""
        given = self.timed or self.r.random() < 0.3
        return f' F{self.r.choice((100, 200.5, 900, 50))}' if given else ''

    def line(self) -> None:
        """Write a line."""
        self.say(f'G1 {self.axes()}{self.feed()}')

    def rapid(self) -> None:
        """Write a rapid."""
        self.say(f'G0 {self.axes()}')

    def arc(self) -> None:
        """Write an arc, a helix or whole turns, by its centre or its radius."""
        (a, b, c), (i, j) = PLANES[self.plane]
        r, radius = self.r, round(self.r.uniform(1, 12) / self.unit, 3)
        code, kind = r.choice(('G2', 'G3')), r.random()
        rise = f' {c}{self.number()}' if r.random() < 0.3 else ''
        turns = f' P{r.randint(1, 4)}' if r.random() < 0.15 else ''
        size = radius * r.choice((1, -1))
        ends = f'{a}{radius:.4f} {b}{radius:.4f}'
        if kind < 0.3:
            where = f'{i}{radius} {j}0{rise}{turns}'
        elif kind < 0.6:
            where = f'{a}{2 * size:.4f} {b}0 {i}{size:.4f} {j}0{rise}{turns}'
        elif kind < 0.8:
            where = f'{ends} R{r.choice((1, -1, 1.7)) * radius:.4f}{rise}'
        else:
            where = f'{ends} {i}{radius:.4f} {j}0{rise}{turns}'
        self.say(f'{"" if self.incremental else "G91 "}{code} {where}{self.feed()}')
        self.say('G91' if self.incremental else 'G90')

    def cycle(self) -> None:
        """Write a canned cycle with some holes."""
        if self.timed or self.incremental:
            return
        (a, b, c), r, unit = PLANES[self.plane][0], self.r, self.unit
        code = r.choice(CYCLES)
        code = 'G81' if self.plane != 'G17' and code in ('G84', 'G74') else code
        if code in ('G84', 'G74'):
            self.say('M5', f'{"M3" if code == "G84" else "M4"} S100')
        text = f'{r.choice(("G98", "G99"))} {code} {a}{self.number()} {b}{self.number()}'
        text += f' {c}{-r.randint(1, 20) / unit:.3f} R{r.choice((2, 5, 12)) / unit:.3f}'
        if code in ('G83', 'G73'):
            text += f' Q{r.choice((1, 3, 7)) / unit:.3f}'
        if code in ('G82', 'G89', 'G86'):
            text += f' P{r.choice((0, 0.5))}'
        if r.random() < 0.2 and code != 'G74':
            text += f' L{r.randint(1, 3)}'
        self.say(text + self.feed())
        self.say(*(f'{r.choice(a + b)}{self.number()}' for _ in range(r.randint(0, 2))), 'G80')
        if r.random() < 0.5:
            self.say('G0 X0 Y0 Z5')

    def switch(self, kind: str) -> None:
        """Write a word that sets or moves something."""
        r = self.r
        if kind == 'plane':
            self.plane = r.choice(list(PLANES))
            self.say(self.plane)
        elif kind == 'distance':
            self.incremental = not self.incremental
            self.say('G91' if self.incremental else 'G90')
        elif kind == 'unit':
            self.unit = 26.4 - self.unit
            self.say('G20' if self.unit > 1.0 else 'G21', f'F{r.choice((10, 20, 33))}')
        elif kind == 'feed_mode':
            self.timed = not self.timed
            self.say(*(['G93'] if self.timed else ['G94', f'F{r.choice((100, 300))}']))
        elif kind == 'g92':
            here = f'G92 X{self.number()} Z{self.number()}'
            self.say(r.choice((here, 'G92.1', 'G92.2', 'G92.3')))
        elif kind == 'offset':
            self.say(f'G10 {r.choice(("L2", "L20"))} P{r.randint(1, 6)} {self.axes()}')
        elif kind == 'choose':
            self.say(r.choice(('G54', 'G55', 'G56', 'G59', 'G59.1', 'G59.3')))
        elif kind == 'tool':
            choices = ['T1 M6', 'G43'], ['G43 H2'], ['G49'], [f'G43.1 Z{self.number()}']
            self.say(*r.choice(choices))
        elif kind == 'other':
            self.say(
                r.choice(
                    (
                        f'G53 G0 {self.axes()}',
                        f'G28 Z{self.number()}',
                        'G4 P0.1',
                        'M8',
                        f'G30 X{self.number()}',
                        'G61',
                        'G64 P0.01',
                        'G64',
                    )
                )
            )
        else:
            number, value = r.randint(1, 30), self.number()
            self.say(f'#{number}={value}' if r.random() < 0.6 else f'#{number}=[{value}/3]')
            self.variables.append(number)

    def flow(self) -> None:
        """Write a loop or a choice."""
        self.words += 1
        o, chance, feed = f'o{self.words}', self.r.random(), ' F150' * self.timed
        if chance < 0.2:
            leaves = self.r.choice(('break', 'continue'))
            self.say(
                '#41=0',
                f'{o} do',
                '#41=[#41+1]',
                f'G1 Y[#41*{self.number()}]{feed}',
                f'o{1000 + self.words} if [#41 eq {self.r.randint(1, 3)}]',
                f'{o} {leaves}',
                f'o{1000 + self.words} endif',
                f'G0 {self.axes()}',
                f'{o} while [#41 lt {self.r.randint(1, 4)}]',
            )
        elif chance < 0.4:
            self.say(
                f'{o} repeat [{self.r.randint(1, 3)}]',
                f'G91 G1 {self.axes()}{feed}',
                f'{o} endrepeat',
                'G91' if self.incremental else 'G90',
            )
        elif chance < 0.7:
            self.say(
                f'{o} if [{self.number()} gt {self.number()}]',
                f'G1 {self.axes()}{feed}',
                f'{o} else',
                f'G0 {self.axes()}',
                f'{o} endif',
            )
        else:
            self.say(
                '#40=0',
                f'{o} while [#40 lt {self.r.randint(1, 4)}]',
                f'G1 X[#40*3]{feed}',
                '#40=[#40+1]',
                f'{o} endwhile',
            )

    def subprogram(self) -> None:
        """Write a subprogram, and calls of it with values, which may call one before."""
        self.words += 1
        o, r, feed = f'o{self.words}', self.r, ' F150' * self.timed
        if r.random() < 0.3:
            o = f'o<part{self.words}>'
        inner = [f'G1 X#1{feed}', f'G1 Y[#2+{r.randint(0, 5)}]{feed}', f'G0 {self.axes()}']
        if self.called and r.random() < 0.5:
            inner.append(f'{r.choice(self.called)} call [#2] [{self.number()}]')
        if r.random() < 0.3:
            inner += [f'o{1000 + self.words} if [#1 gt #2]', f'{o} return [#1]']
            inner += [f'o{1000 + self.words} endif']
        end = f'{o} endsub' + r.choice(('', ' [#1+#2]'))
        self.say(f'{o} sub', *r.sample(inner[:3], r.randint(1, 3)), *inner[3:], end)
        self.called.append(o)
        for _ in range(r.randint(1, 3)):
            self.say(f'{o} call [{self.number()}] [{self.number()}]')
            if r.random() < 0.3:
                self.say('G0 Z#<_value>')


def made(seed: int) -> str:
    """Return the program of a seed."""
    writer = Writer(random.Random(seed))
    for kind in writer.r.choices(list(KINDS), list(KINDS.values()), k=writer.r.randint(4, 22)):
        if kind in ('line', 'rapid', 'arc', 'cycle', 'flow', 'subprogram'):
            getattr(writer, kind)()
        else:
            writer.switch(kind)
    return '\n'.join([*writer.lines, 'M2']) + '\n'


#: Operators and functions of LinuxCNC's expressions.
OPERATORS = tuple('+ - * / ** MOD AND OR XOR EQ NE GT GE LT LE'.split())  # noqa: SIM905
FUNCTIONS = tuple('ABS SQRT SIN COS TAN ASIN ACOS EXP LN FIX FUP ROUND'.split())  # noqa: SIM905


def expression(r: random.Random, depth: int = 0) -> str:
    """Return a random expression: a chain of operands, the deeper the shorter."""
    text = operand(r, depth)
    for _ in range(r.choice((0, 1, 1, 2, 3)) if depth < 3 else 0):
        text += f' {r.choice(OPERATORS)} {operand(r, depth)}'
    return text


def operand(r: random.Random, depth: int) -> str:
    """Return a number, a parameter, or what stands in brackets."""
    chance = r.random()
    if depth > 2 or chance < 0.5:
        return f'{r.choice((0, 1, 2, 3, 5, 7, 0.5, 1.25, 90, -1, -2, -3.5))}'
    if chance < 0.65:
        return f'{r.choice(("", "", "-"))}#{r.randint(1, 3)}'
    if chance < 0.8:
        return f'[{expression(r, depth + 1)}]'
    if chance < 0.86:
        return f'ATAN[{expression(r, depth + 1)}]/[{expression(r, depth + 1)}]'
    return f'{r.choice(FUNCTIONS)}[{expression(r, depth + 1)}]'


class Readers:
    """Both readers on a machine whose zeros are all in one point, with two tools."""

    def __init__(self) -> None:
        self.machine = replace(Machine.load('xyz'), offsets=np.zeros((3, 3)))
        self.transform, self.setup = Transform.of(self.machine), Setup(tool_lengths=LENGTHS)
        zeros = {name: dict.fromkeys('XYZ', 0.0) for name in WORK_OFFSETS}
        self.job = JobSetup(zeros, {number: Tool(length) for number, length in LENGTHS.items()})

    def by_us(self, text: str) -> Blocks:
        return read_text(text, 'p.ngc', self.transform, Settings(), self.job).blocks

    def by_linuxcnc(self, text: str, rows: int) -> list[ReadMove | ReadCall]:
        return list(read_by_linuxcnc(text, self.machine.axis_names, False, rows, self.setup))

    def expressions(self, seeds: range) -> Iterator[tuple[int, str, str]]:
        """Evaluate random expressions by both readers; yield seed, what came of it, and values.

        LinuxCNC reads many of them at once, and each alone where it refuses one.
        """
        for first in range(seeds.start, seeds.stop, TOGETHER):
            some = range(first, min(first + TOGETHER, seeds.stop))
            wanted = {seed: expression(random.Random(seed)) for seed in some}
            ours = {seed: self._ours(text) for seed, text in wanted.items()}
            known = [seed for seed in some if not isinstance(ours[seed], str)]
            theirs = dict(zip(known, self._theirs([wanted[seed] for seed in known]), strict=False))
            for seed in some:
                value = theirs.get(seed)
                if value is None or len(theirs) < len(known):
                    value = next(iter(self._theirs([wanted[seed]])))
                told = f'{wanted[seed]}  {ours[seed]}  {value}'
                what = _came_of(ours[seed], value)
                if what == DIFFERENT and seed in ROUNDED:
                    what = 'alike but for rounding'
                yield seed, what, told

    def _ours(self, wanted: str) -> float | str:
        try:
            return 1e3 * float(self.by_us(_evaluating([wanted])).tip[-1, 0])
        except InterpError as problem:
            return cause_of(str(problem).splitlines()[0])

    def _theirs(self, wanted: list[str]) -> list[float | str]:
        """Return the values of LinuxCNC, or why it refuses the first one that it refuses."""
        values: list[float | str] = []
        try:
            for move in self.by_linuxcnc(_evaluating(wanted), 4 * len(wanted))[1:]:
                assert isinstance(move, ReadMove)
                values.append(1e3 * float(move.end[0]))
        except LinuxCNCError as problem:
            return [*values, cause_of(str(problem))]
        return values

    def programs(self, seeds: range) -> Iterator[tuple[int, str, str]]:
        """Read random programs by both readers; yield seed, what came of it, and faults."""
        for seed in seeds:
            yield (seed, *self.program(seed))

    def program(self, seed: int) -> tuple[str, str]:
        text, refused, rows = made(seed), '', 4000
        try:
            blocks = self.by_us(text)
            rows = len(blocks)
            columns = {'extra_axes': np.zeros((rows, 0))} | block_columns(blocks)
        except InterpError as problem:
            refused = cause_of(str(problem).splitlines()[0])
        try:
            moves = self.by_linuxcnc(text, rows)
        except LinuxCNCError as problem:
            why = f'refused by LinuxCNC, {cause_of(str(problem))}'
            return 'refused by both' if refused else why, ''
        if refused:
            return f'refused by us, {refused}', ''
        found = RowsByPlace(columns, self.machine).follow(moves)
        what = ALIKE
        if found.faults and (rounded := re.sub(r'(?<=Q)[\d.]+', _a_little_more, text)) != text:
            # LinuxCNC pecks once more where only rounding is left.
            moves = self.by_linuxcnc(rounded, rows)
            found = RowsByPlace(columns, self.machine).follow(moves)
            what = 'alike but for a peck of rounding'
        return DIFFERENT if found.faults else what, '\n  '.join(found.faults[:2])


def _evaluating(wanted: list[str]) -> str:
    """Return a program whose motions lead to the values of expressions, each to one."""
    lines = (f'#4=[{each}]\nG0 X[#4] Y{k}\n' for k, each in enumerate(wanted))
    return f'G21 G90\n#1=4\n#2=-6\n#3=0.75\n{"".join(lines)}M2\n'


def _came_of(ours: float | str, theirs: float | str) -> str:
    if isinstance(ours, str) and isinstance(theirs, str):
        return 'refused by both'
    if isinstance(ours, str):
        return f'refused by us: {ours}'
    if isinstance(theirs, str):
        return f'refused by LinuxCNC: {theirs}'
    return ALIKE if abs(ours - theirs) <= 1e-4 + 1e-9 * abs(theirs) else DIFFERENT


def _a_little_more(peck: re.Match[str]) -> str:
    return f'{float(peck[0]) + 1e-6:.6f}'


def cause_of(text: str) -> str:
    """Return a message without its numbers and words."""
    return re.sub(r'-?\d+\.?\d*|(?<=Spindle not turning in ).*', '#', text.split(': ', 1)[-1])[:80]


def main() -> None:
    """Compare programs; print what differs, and a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--count', type=int, default=5000)
    parser.add_argument('--first', type=int, default=0)
    parser.add_argument('--expressions', action='store_true', help='one expression for each seed')
    parser.add_argument('--show', type=int, help='print the program of a seed, and what it does')
    options = parser.parse_args()
    if options.show is not None:
        options.first, options.count = options.show, 1
        print(made(options.show))
    counts: Counter[str] = Counter()
    readers = Readers()
    seeds = range(options.first, options.first + options.count)
    judged = readers.expressions if options.expressions else readers.programs
    for seed, what, *told in judged(seeds):
        counts[what] += 1
        if what == DIFFERENT:
            print(seed, *told, sep='\n  ', flush=True)
    print(json.dumps(dict(counts.most_common()), indent=1))


if __name__ == '__main__':
    main()
