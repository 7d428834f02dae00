"""RESULTS.md and the table of docs/measured, made from the stored figures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from figures import ROOT, column, load, where

from cnc_interp.core import FloatArray

RESULTS = Path(__file__).with_name('RESULTS.md')
MEASURED = ROOT / 'docs' / 'measured' / 'README.md'
BEGIN, END = '<!-- made by benchmarks/run.py -->', '<!-- to here -->'


def write_tables() -> None:
    """Write both from all figures that are there."""
    lines = [
        '# Results',
        '',
        'Made by `benchmarks/run.py`: each section by one process on one core.',
        'Planning times are CPU seconds. What the columns mean: `README.md` in this folder.',
    ]
    for section, (title, table) in TABLES.items():
        if load(section):
            lines += ['', f'## {title}', '', *table()]
    RESULTS.write_text('\n'.join(lines) + '\n', encoding='utf-8')
    before, rest = MEASURED.read_text(encoding='utf-8').split(BEGIN + '\n')
    after = rest.split(END + '\n')[1]
    text = '\n'.join([before + BEGIN, *summary(), END, after])
    MEASURED.write_text(text, encoding='utf-8')


def closed_form() -> Iterator[str]:
    """Tabulate the strokes that have a closed form."""
    held = load('closed_form')
    yield '| stroke of X | closed form s | optimum / closed form | planned / closed form |'
    yield '|---|---|---|---|'
    for name, f in held.items():
        yield f'| {name} | {f["exact"]:.4f} | {f["optimum"]:.5f} | {f["ours"]:.5f} |'
    yield from ('', where(held))


def strokes() -> Iterator[str]:
    """Tabulate the strokes that ruckig knows."""
    held = load('strokes')
    yield '| stroke of X | ruckig s | planned / ruckig | largest use |'
    yield '|---|---|---|---|'
    for name, f in held.items():
        yield f'| {name} | {f["exact"]:.5f} | {f["ours"]:.5f} | {f["use"]:.2%} |'
    yield from ('', where(held))


def ratio(value: float | None, by: float | None, digits: int) -> str:
    """Write a ratio, or a dash."""
    return '-' if value is None or by is None else f'{value / by:.{digits}f}'


def paths() -> Iterator[str]:
    """Tabulate the comparison on all paths, and what it comes to."""
    held, rivals = load('planning'), load('rivals')
    firsts, optima = load('first'), load('optimum')
    yield (
        '| path | ours s | ours / first optimum | its excess | ours / corrected optimum '
        '| TOPP3 / ours | toppra slowed / ours | stop at corners / ours | motion / planning '
        '| TOPP3 / our planning | largest use | limit active |'
    )
    yield '|---|' + '---|' * 11
    for name, f in held.items():
        best, other = optima.get(name), rivals.get(name)
        judged = '- | - | -'
        if early := firsts.get(name):
            judged = f'{ratio(f["motion"], early["first"], 4)} | {early["first_excess"]:.0e} | '
            judged += ratio(f['motion'], best['optimum'], 4) if best else '-'
        topp3, computing, slowed = '-', '-', '-'
        if other:
            topp3 = ratio(other['topp3'], f['motion'], 4)
            computing = ratio(other['topp3_computing'], f['planning'], 0)
            slowed = ratio(other['slowed'], f['motion'], 1)
        yield (
            f'| {name} | {f["motion"]:.4f} | {judged} | {topp3} | {slowed} '
            f'| {ratio(f["stops"], f["motion"], 2)} | {f["motion"] / f["planning"]:.0f} '
            f'| {computing} | {f["use"]:.2%} | {f["active"]:.0%} |'
        )
    speed = column(held, 'motion') / column(held, 'planning')
    yield ''
    yield (
        f'* {len(held)} paths. **Motion / planning: median {np.median(speed):.0f}, smallest '
        f'{speed.min():.0f}.** Largest use of a limit: {column(held, "use").max():.2%}. Samples '
        f'with an active limit: median {np.median(column(held, "active")):.0%}. {where(held)}'
    )
    for section, text in (('first', 'first optimum'), ('optimum', 'corrected optimum')):
        if len(found := against(section)):
            yield (
                f'* **Ours / {text}**: median {np.median(found):.4f}, smallest {found.min():.4f}, '
                f'largest {found.max():.4f} of {len(found)} paths. {where(load(section))}'
            )
    if rivals:
        yield f'* {where(rivals)[:-1]}: TOPP3, toppra slowed.'


def against(section: str) -> FloatArray:
    """Cycle times over one of the optima, on all paths that have it."""
    held, optima = load('planning'), load(section)
    return np.array(
        [
            held[name]['motion'] / best[section]
            for name, best in optima.items()
            if name in held and best[section] is not None
        ]
    )


def trust() -> Iterator[str]:
    """Tabulate how far the optimum itself depends on its grid and first guess."""
    held = load('trust')
    yield '| the two worst | ours / optimum, grid twice as fine | ours / first | slow start |'
    yield '|---|---|---|---|'
    for name, f in held.items():
        yield (
            f'| {name} | {ratio(f["ours"], f["fine"], 4)} | {f["ours"] / f["fine_first"]:.4f} '
            f'| {ratio(f["ours"], f["slow"], 4)} |'
        )
    yield from ('', where(held))


def speed() -> Iterator[str]:
    """Tabulate planning on dense programs."""
    held = load('speed')
    yield '| path | blocks | cells | motion s | planning s | motion / planning | largest use |'
    yield '|---|---|---|---|---|---|---|'
    for name, f in held.items():
        yield (
            f'| {name} | {f["blocks"]:,} | {f["cells"]:,} | {f["motion"]:.2f} '
            f'| {f["planning"]:.3f} | {f["motion"] / f["planning"]:.0f} | {f["use"]:.2%} |'
        )
    yield from ('', where(held))


ROOMS = ('smoothing', 'kinematics', 'feedrate', 'interpolation')


def growth() -> Iterator[str]:
    """Tabulate the chain's cost over the number of blocks."""
    held = load('growth') | load('million')
    yield (
        '| blocks | motion s | chain s | chain us per block | feed planning us per block '
        '| motion / feed planning | most memory MB |'
    )
    yield '|---|---|---|---|---|---|---|'
    for name, f in held.items():
        count, chain = int(name), sum(f[room] for room in ROOMS)
        yield (
            f'| {count:,} | {f["motion"]:.1f} | {chain:.2f} | {chain / count * 1e6:.0f} '
            f'| {f["feedrate"] / count * 1e6:.0f} | {f["motion"] / f["feedrate"]:.0f} '
            f'| {f["memory"]:.0f} |'
        )
    yield from ('', where(held))


def growth_topp3() -> Iterator[str]:
    """Tabulate copp-py's cost on the same raster."""
    held = load('growth_topp3')
    yield '| blocks | copp-py TOPP3-SOCP, one round, s | us per block | its cycle time s |'
    yield '|---|---|---|---|'
    for name, f in held.items():
        each = f['computing'] / int(name) * 1e6
        yield f'| {int(name):,} | {f["computing"]:.2f} | {each:,.0f} | {f["motion"]:.2f} |'
    yield from ('', where(held))


TABLES = {
    'strokes': ('Strokes of one axis against ruckig', strokes),
    'closed_form': ('The optimum against a closed form', closed_form),
    'planning': ('Cycle time', paths),
    'trust': ('The optimum on other grids', trust),
    'speed': ('Dense programs', speed),
    'growth': ('Growth', growth),
    'growth_topp3': ('Growth of a conic program', growth_topp3),
}


def summary() -> Iterator[str]:
    """Write the table of docs/measured."""
    yield '| what | goal | measured |'
    yield '|---|---|---|'
    for section, text in (('first', ''), ('optimum', ', corrected between its instants')):
        if len(found := against(section)):
            yield (
                f'| cycle time / optimum (IPOPT){text}, {len(found)} '
                f'paths: median, largest | 1.005, 1.01 '
                f'| {np.median(found):.4f}, {found.max():.4f} |'
            )
    if held := load('planning'):
        pace = column(held, 'motion') / column(held, 'planning')
        yield (
            f'| largest use of a limit by differences of the setpoints at 1 ms, {len(held)} paths '
            f'| 100.1 % | {100 * column(held, "use").max():.2f} % |'
        )
        yield (
            f'| motion / feed planning on these paths: median, smallest | 100, 30 '
            f'| {np.median(pace):.0f}, {pace.min():.0f} |'
        )
    if held := load('speed'):
        pace = column(held, 'motion') / column(held, 'planning')
        yield (
            f'| the same on {len(held)} dense 5-axis programs: median, smallest | 100, 30 '
            f'| {np.median(pace):.0f}, {pace.min():.0f} |'
        )
    if held := load('growth') | load('million'):
        counts = ', '.join(f'{int(name):,}' for name in held)
        costs = ', '.join(
            f'{sum(f[room] for room in ROOMS) / int(name) * 1e6:.0f}' for name, f in held.items()
        )
        memory = ', '.join(f'{f["memory"]:.0f}' for f in held.values())
        yield f'| blocks to setpoints, {counts} blocks: us per block | constant | {costs} |'
        yield f'| most memory while doing so, MB | constant | {memory} |'
