"""
Runs from random lines of the public programs, compared with the full run.

``python benchmarks/start_lines.py [--lines 1000] [--seed 1] [--most-lines 20000]`` takes a random
program and a random line of it until so many runs have begun. Of each it is proven that

- the rows from the line on are those of the whole program, in every column, and the first one is
  the first motion at or after the line;
- the words that are told as the state there set it: from the same position, with them before the
  rest of the text, the same rows are read (within 1 nm; G-code whose rest reads alone);
- the path from the place on has the bits of the full path;
- the motion from there, at rest, becomes that of the full run; from the next rest on bit for bit.

The programs of ``shared/programs`` beside the repository and of ``examples`` are taken, without
those of more than ``--most-lines`` lines: their whole text is read and smoothed for each line.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np
from programs import CASES, ROOT, commit, program_file

from cnc_interp.core import MM, MM_PER_MIN, FloatArray, InterpError, ProgramError
from cnc_interp.feedrate.feed_planner import FeedPlanner, PlannedPiece
from cnc_interp.feedrate.limit_use import limits_at
from cnc_interp.feedrate.plan_options import PlanOptions
from cnc_interp.kinematics.axis_path import AxisPath, cut
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform, positions_of_pose
from cnc_interp.program import Blocks, JobSetup, ProgramStream, open_program
from cnc_interp.program.execution.context import Execution
from cnc_interp.program.notices import Notices
from cnc_interp.program.readers.gcode import GcodeReader
from cnc_interp.program.text.dialects import PLAIN
from cnc_interp.program.text.source import Source
from cnc_interp.run.path_chain import PathChain, batches
from cnc_interp.run.start_place import StartFinder, StartPlace
from cnc_interp.settings.options import Settings

EXAMPLES = {
    'pyramid.ngc': 'xyzac',
    'pyramid.apt': 'xyzac',
    'pocket_corner.apt': 'xyzac',
    'two_curves.mpf': 'xyzac',
}
#: Motion that is planned from the place on [s], and path cells planned at a time.
LOOK, CELLS = 2.0, 500
#: Motions are the same where their speeds differ by less, as a share of the largest one [-].
SAME = 1e-3


@dataclass
class Case:
    """A program, its full run, and how it is read."""

    file: Path
    machine: Machine
    settings: Settings
    setup: JobSetup
    lines: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.lines = self.file.read_bytes().decode('utf-8', 'replace').splitlines()
        self.transform = Transform.of(self.machine)
        stream = open_program(self.file, self.transform, self.settings, self.setup)
        self.dialect, self.blocks = stream.dialect, stream.read().blocks
        chain = PathChain(self.transform, self.settings)
        parts = [chain.push(batch).path for batch in batches(self.blocks)]
        self.path = AxisPath.join([p for p in [*parts, chain.finish().path] if p is not None])
        self.law = planned(self.path, self.machine, np.inf)

    def stream(self, line: int, which: int) -> ProgramStream:
        """Return the program as a run from a line reads it."""
        settings = replace(self.settings, from_line=line, line_pass=which)
        return open_program(self.file, self.transform, settings, self.setup)


def planned(path: AxisPath, machine: Machine, seconds: float) -> PlannedPiece:
    """Plan from rest along a path, at least for a time [s]."""
    planner = FeedPlanner(limits_at(machine, 1e-3), PlanOptions(bound=False))
    pieces: list[PlannedPiece] = []
    for first in range(0, len(path.s) - 1, CELLS):
        pieces += planner.push(cut(path, first, min(first + CELLS, len(path.s) - 1)))
        if pieces and pieces[-1].law.end_time > seconds:
            return PlannedPiece.join(pieces)
    return PlannedPiece.join(pieces + planner.finish())


def inside(case: Case, line: int, which: int) -> tuple[Blocks, StartFinder, AxisPath]:
    """Read and smooth a program from its top; return what a run from a line executes."""
    stream, parts, executed = case.stream(line, which), [], []
    finder = StartFinder(case.transform, case.settings.flank_height, stream.start)
    chain = PathChain(case.transform, case.settings)
    for blocks in stream:
        parts.append(blocks)
        finder.blocks(blocks)
        for batch in batches(blocks):
            executed.append(finder.path(chain.push(batch).path))
    executed.append(finder.path(chain.finish().path, last=True))
    finder.found()
    path = AxisPath.join([part for part in executed if part is not None])
    return Blocks.concatenate(parts), finder, path


def verdict(same: bool | np.bool_) -> str:
    """Return the word that is counted."""
    return 'the same' if same else 'DIFFERENT'


def same_rows(ours: Blocks, theirs: Blocks, but: tuple[str, ...] = ()) -> bool:
    """Tell whether all columns are the same, bit for bit."""
    return len(ours) == len(theirs) and all(
        np.array_equal(getattr(ours, c.name), getattr(theirs, c.name), equal_nan=True)
        for c in fields(Blocks)
        if c.name not in but
    )


def words_set_the_state(case: Case, line: int, place: StartPlace) -> str:
    """Read the words of the state and the rest of the text from the same position; compare."""
    row, words = place.block.row, place.block.words
    if case.dialect == 'cl' or row == 1:
        return 'not compared (CL data, or the first motion)'
    codes = [word for word in words if not re.fullmatch(r'F.*|T\d+|M6', word)]
    feeds = [word for word in words if word.startswith('F')]
    text = '\n'.join([*codes, *feeds, *case.lines[line - 1 :], ''])
    source = Source.of_text(text, 'rest' + case.file.suffix)
    state = case.transform, case.settings, case.setup, source, Notices(), PLAIN
    reader = GcodeReader(Execution(*state))
    here = case.blocks[row - 1 : row]
    q = positions_of_pose(case.transform, here.tip[0], here.axis[0], place.position)
    reader.at.stand_at(q)
    try:
        again = Blocks.concatenate(list(reader.blocks()))[1:]
    except InterpError:
        return 'not compared (the rest alone is no program)'
    theirs = case.blocks[row:]
    if len(again) != len(theirs):
        return f'DIFFERENT in number from line {line} of {case.file.name}'
    off = max(
        float(np.abs(getattr(again, name) - getattr(theirs, name)).max())
        for name in ('tip', 'axis', 'contour_tolerance', 'orientation_tolerance')
    )
    feed = np.allclose(again.feedrate, theirs.feedrate, rtol=1e-9, equal_nan=True)
    return 'the same' if off < 1e-9 and feed else f'DIFFERENT from line {line} of {case.file.name}'


def join_of(case: Case, path: AxisPath) -> tuple[float, float, str]:
    """Return way and time until the motion is that of the full run, and that from a rest on."""
    full, seconds = case.law.law, LOOK
    while True:
        law = planned(path, case.machine, seconds).law
        ends = law.end_time <= seconds
        times = np.arange(law.time[0], min(law.end_time, seconds), 1e-3)
        s, speed = (x for x in law.evaluate(times)[:2])
        there = speed_at(full, s)
        apart = np.flatnonzero(np.abs(speed - there) > SAME * there.max() + 1e-9)
        last = int(apart[-1]) if len(apart) else 0
        if ends or last < len(s) - 200:
            break
        seconds *= 4.0
    rests = path.s[1:-1][path.stop[1:-1]]
    known = float(law.s[-1])
    rests = rests[rests < known - 1e-6]
    rest = 'none near'
    if len(rests):
        ours, theirs = (
            np.column_stack([x.s, x.s_dot])[(x.s >= rests[0]) & (x.s < known - 1e-6)]
            for x in (law, full)
        )
        count = min(len(ours), len(theirs))
        rest = verdict(count > 0 and np.array_equal(ours[:count], theirs[:count]))
    return float(s[last] - s[0]), float(times[last]), rest


def speed_at(law: object, s: FloatArray) -> FloatArray:
    """Return the speed of a law at places [m/s]."""
    begin = max(int(np.searchsorted(law.s, s[0])) - 2, 0)
    end = min(int(np.searchsorted(law.s, s[-1])) + 2, len(law.s) - 1)
    times = np.arange(law.time[begin], law.time[end] + law.duration[end], 2e-4)
    place, speed = law.evaluate(times)[:2]
    found: FloatArray = np.interp(s, place, speed)
    return found


def compare(case: Case, line: int, which: int, counts: Counter[str]) -> tuple[float, float] | None:
    """Compare the run from a line with the full run; None if the start is refused."""
    try:
        blocks, finder, path = inside(case, line, which)
    except ProgramError as problem:
        if '--pass' in str(problem) and not which:
            passes = int(str(problem).rsplit(' ', 1)[-1])
            one = int(np.random.default_rng(line).integers(passes)) + 1
            return compare(case, line, one, counts)
        counts['refused: ' + str(problem).split(': ', 1)[-1].split(';')[0][:60]] += 1
        return None
    place = finder.found()
    row = place.block.row
    counts[f'rows {verdict(same_rows(blocks, case.blocks))}'] += 1
    told = case.blocks.line_number[1:]
    if not which and (np.diff(told) >= 0).all():
        first = int(np.argmax(told >= line)) + 1
        counts[f'first row {verdict(row == max(first, 1))}'] += 1
    counts[f'words {words_set_the_state(case, line, place)}'] += 1
    after = np.flatnonzero(case.path.s > path.s[0])
    cells, s = len(after) - 1, path.s[-len(after) :]
    bits = np.array_equal(s, case.path.s[after]) and all(
        np.array_equal(
            getattr(path, name)[:, -cells:][:, :cells],
            getattr(case.path, name)[:, -cells:][:, :cells],
        )
        for name in ('cell_left', 'cell_right')
    )
    counts[f'path {verdict(bits)}'] += 1
    way, time, rest = join_of(case, path)
    counts[f'law after the next rest {rest}'] += 1
    return way, time


def main() -> int:
    """Compare runs from random lines."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--lines', type=int, default=1000)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--most-lines', type=int, default=20_000)
    options = parser.parse_args()
    files = [(program_file(name), case) for name, case in CASES.items()]
    cases = []
    for file, given in files:
        if len(file.read_bytes().splitlines()) <= options.most_lines:
            feed = None if given.feed is None else given.feed * MM_PER_MIN
            try:
                cases.append(
                    Case(file, Machine.load(given.machine), Settings(feedrate=feed), given.setup)
                )
            except InterpError as problem:
                print(f'left out: {problem}', file=sys.stderr)
    for name, machine in EXAMPLES.items():
        settings = Settings(feedrate=3000 * MM_PER_MIN)
        cases.append(Case(ROOT / 'examples' / name, Machine.load(machine), settings, JobSetup()))
    random, counts, ways = np.random.default_rng(options.seed), Counter[str](), []
    while len(ways) < options.lines:
        case = cases[random.integers(len(cases))]
        line = int(random.integers(1, len(case.lines) + 1))
        found = compare(case, line, 0, counts)
        if found is not None:
            ways.append(found)
            if len(ways) % 50 == 0:
                print(len(ways), dict(counts), file=sys.stderr, flush=True)
    way, time = np.array(ways).T
    print(f'{len(ways)} runs from lines of {len(cases)} programs, at {commit()}')
    for what, count in sorted(counts.items()):
        print(f'{count:6} {what}')
    for name, values, unit in (('way', way / MM, 'mm'), ('time', time, 's')):
        middle, high, most = np.quantile(values, [0.5, 0.99, 1.0])
        print(
            f'{name} until the motion is that of the full run: median {middle:.3g} {unit}, '
            f'99 % {high:.3g} {unit}, most {most:.3g} {unit}'
        )
    return int(any('DIFFERENT' in what for what in counts))


if __name__ == '__main__':
    sys.exit(main())
