"""
Random Sinumerik programs, read by the package nc-gcode-interpreter and by us.

    OTHER/python benchmarks/sinumerik_words.py --write FOLDER [--count 1000] [--first 0]
    python benchmarks/sinumerik_words.py --compare FOLDER

OTHER is a Python environment with that package; it need not have ours. Each seed generates lines,
rapids, arcs, TRANS, ATRANS, variables, arrays, expressions, FOR, WHILE, IF and ELSE, as far as
version 0.1.9 of the package reads them. The package computes products and sums from left to right,
so each has parentheses. R parameters, functions, jumps, G91, ``=IC()`` and .5 without a zero are
left out. We must reach each position of the package in order, and without arcs no other position.
The script prints all differences.
"""

from __future__ import annotations

import argparse
import csv
import random
from collections import Counter
from pathlib import Path

import numpy as np

KINDS = {'line': 0.4, 'arc': 0.12, 'shift': 0.08, 'set': 0.2, 'flow': 0.2}


class Writer:
    """Writes a program line by line."""

    def __init__(self, seed: int):
        self.r = random.Random(seed)
        self.lines = [
            'DEF REAL VA=1.5, VB=-2',
            'DEF REAL VC[3]',
            'DEF INT VI, VJ, VK',
            'VC[0]=3',
            'VC[1]=-4.25',
            'VC[2]=0.5',
            'G1 X1 Y1 Z1 F1000',
        ]
        self.deep = 0

    def value(self, deep: int = 0) -> str:
        r = self.r
        if r.random() < 0.45 or deep > 2:
            return r.choice(
                (
                    f'{r.uniform(-30, 30):.3f}',
                    str(r.randint(-20, 20)),
                    'VA',
                    'VB',
                    f'VC[{r.randint(0, 2)}]',
                )
            )
        code = r.choice('+-*/')
        right = str(r.randint(1, 4)) if code in '*/' else self.value(deep + 1)
        right = f'(0{right})' if right[0] == '-' else right
        return f'({self.value(deep + 1)}{code}{right})'

    def axes(self) -> str:
        letters = sorted(self.r.sample('XYZ', self.r.choice((1, 2, 3))))
        return ' '.join(f'{letter}={self.value()}' for letter in letters)

    def say(self, *lines: str) -> None:
        number = f'N{10 * len(self.lines)} ' if self.r.random() < 0.3 else ''
        self.lines += [number + lines[0], *lines[1:]]

    def line(self) -> None:
        self.say(self.r.choice(('G0 ', 'G1 ', '')) + self.axes())

    def arc(self) -> None:
        r, size = self.r, round(self.r.uniform(1, 12), 3)
        x, y = round(r.uniform(-20, 20), 3), round(r.uniform(-20, 20), 3)
        code = r.choice(('G2', 'G3'))
        how = f'I={size} J=0' if r.random() < 0.5 else f'CR={size}'
        self.say(
            f'G1 X={x} Y={y}', f'{code} X={x + 2 * size:.3f} Y={y} {how}', f'G1 X={x - 1:.3f}'
        )

    def shift(self) -> None:
        code = self.r.choice(('TRANS', 'TRANS', 'ATRANS'))
        self.say(f'{code} X={self.value()} Y={self.value()}', 'G1 X=1.0 Y=2.0 Z=0.25')

    def set(self) -> None:
        self.say(f'{self.r.choice(("VA", "VB", "VC[1]"))}={self.value()}')
        if self.r.random() < 0.5:  # so that sums do not grow
            self.say(f'VA={self.r.randint(-9, 9)}', 'VB=2.25')

    def flow(self) -> None:
        if self.deep > 1:
            return
        r, name = self.r, 'IJK'[self.deep]
        self.deep += 1
        kind = r.random()
        if kind < 0.35:
            self.lines.append(f'FOR V{name}={r.randint(0, 2)} TO {r.randint(1, 4)}')
            self.lines.append(f'G1 X=(V{name}*{r.randint(2, 5)})')
            self.some()
            self.lines.append('ENDFOR')
        elif kind < 0.6:
            self.lines += [
                f'V{name}=0',
                f'WHILE V{name}<{r.randint(1, 4)}',
                f'V{name}=(V{name}+1)',
            ]
            self.some()
            self.lines.append('ENDWHILE')
        else:
            relation = r.choice(('<', '>', '<=', '>=', '=='))
            self.lines.append(f'IF {r.choice(("VA", "VB"))}{relation}{r.randint(-20, 20)}')
            self.some()
            if r.random() < 0.6:
                self.lines.append('ELSE')
                self.some()
            self.lines.append('ENDIF')
        self.deep -= 1

    def some(self) -> None:
        for kind in self.r.choices(list(KINDS), list(KINDS.values()), k=self.r.randint(1, 3)):
            getattr(self, kind)()
        self.line()


def write(folder: Path, first: int, count: int) -> None:
    """Write programs, and beside each the places that the package reads."""
    from nc_gcode_interpreter import nc_to_dataframe  # type: ignore[import-not-found]

    (folder / 'cases').mkdir(parents=True, exist_ok=True)
    for seed in range(first, first + count):
        writer = Writer(seed)
        for _ in range(writer.r.randint(2, 8)):
            writer.some()
        text = '\n'.join(writer.lines) + '\n'
        (folder / 'cases' / f'{seed}.mpf').write_text(text)
        with (folder / 'cases' / f'{seed}.csv').open('w', newline='') as file:
            table = csv.DictWriter(file, 'XYZ', extrasaction='ignore')
            table.writeheader()
            table.writerows(nc_to_dataframe(text)[0].rows(named=True))


def compare(folder: Path) -> None:
    """Compare, and print what differs and a table."""
    import suites

    counts: Counter[str] = Counter()
    for case, verdict, why in suites.sinumerik(folder):
        text = (folder / 'cases' / f'{case}.mpf').read_text()
        if verdict == suites.AGREES and 'G2' not in text and 'G3' not in text:
            tips = suites.read(folder / 'cases' / f'{case}.mpf', 'xyz', {}, 0.01)[0].tip * 1e3
            moved = 1 + int((np.abs(np.diff(tips, axis=0)).max(axis=1) > suites.NEAR).sum())
            if abs(moved - int(why.split()[0])) > 1:  # the start may count as a place
                verdict, why = 'places of ours alone', f'{moved} and {why}'
        counts[verdict] += 1
        if verdict != suites.AGREES:
            print(case, verdict, why, flush=True)
    print(dict(counts))


def main() -> None:
    """Write programs with their places, or compare them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--write', type=Path)
    parser.add_argument('--compare', type=Path)
    parser.add_argument('--count', type=int, default=1000)
    parser.add_argument('--first', type=int, default=0)
    options = parser.parse_args()
    if options.write:
        write(options.write, options.first, options.count)
    if options.compare:
        compare(options.compare)


if __name__ == '__main__':
    main()
