"""Run a command with many option values, as a grid or a search; write a table and a page."""

import hashlib
import io
import itertools
import shlex
from collections.abc import Callable, Iterable, Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution

from cnc_interp.batch.batch_page import csv_text
from cnc_interp.batch.batch_run import Store
from cnc_interp.batch.processes import EndedCall, Loss, Processes
from cnc_interp.batch.task import engine
from cnc_interp.core import UM, InterpError
from cnc_interp.core.small_files import read_json, write_whole
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.report import html
from cnc_interp.report.series import AT_LIMIT, at_limits, axis_use
from cnc_interp.run.plan_figures import collision_text

#: Points per option in a generation of the search; significant digits of option values.
GENERATION, DIGITS = 5, 4
SAME = 1e-9  #: Lengths that differ less are the same [m].
#: Motions whose simulated surface is evaluated: the first one that the summary contains.
SIMULATED = ('executed', 'planned')
SWEPT = (('plan',), ('cam', 'iso-scallop'))  #: Commands that can be swept.


@dataclass(frozen=True)
class Range:
    option: str  #: Its name, without the dashes.
    values: tuple[str, ...]  #: All values (grid), or the lowest and the highest (search).


@dataclass(frozen=True)
class Point:
    words: tuple[str, ...]  #: The command without its folder.
    values: tuple[tuple[str, str], ...]  #: Swept options with their values.

    @property
    def command(self) -> tuple[str, ...]:
        return (*self.words, *(f'--{option}={value}' for option, value in self.values))

    @property
    def key(self) -> str:
        digest = hashlib.sha256(engine().encode())
        for word in self.command:
            digest.update(word.encode() + b'\0')
            path = Path(word.rpartition('=')[2])
            if path.is_file():
                digest.update(path.read_bytes())
        return digest.hexdigest()[:32]


@dataclass(frozen=True)
class Found:
    cycle_time: float | None = None  #: Time of the motion [s].
    #: Largest error: the deepest cut into a surface, or a plan's largest contour deviation [m].
    error: float | None = None
    #: For each axis and kind of limit: share of the time in which the axis is at this limit [-].
    at_limit: dict[str, float] | None = None
    fault: str = ''  #: Why no motion was planned; '' if one was.
    #: The highest ridge between passes, if the command makes a surface [m].
    scallop: float | None = None
    collision: str = ''  #: Result of the clearance check, for a command with a scene.


Main = Callable[[Sequence[str]], int]


#: Arguments of a process: the function of the command line, its words, the working directory, and
#: the folder for its files.
Call = tuple[Main, tuple[str, ...], Path, Path]


def run_point(call: Call) -> Found:
    said, printed = io.StringIO(), io.StringIO()
    main, (first, *more), here, out = call
    alone = ['--workers=1'] if first == 'plan' else []  # the points keep the processors busy
    with chdir(here), redirect_stderr(said), redirect_stdout(printed):
        try:
            code = main([first, *alone, *more, f'--out={out}', '--json'])
        except SystemExit as problem:  # wrong options
            code = int(problem.code or 0)
    lines = said.getvalue().strip().splitlines()
    if code == 2:
        return Found(fault=lines[-1].removeprefix('cnc-interp: ') if lines else 'refused')
    summary = read_json(out / 'summary.json')
    plan = out / 'plan' if (out / 'plan').is_dir() else out
    if code:
        return Found(fault='not proven', collision=collision_text(summary))
    surface = next((summary[name] for name in SIMULATED if name in summary), None)
    shares, told = shares_at_limits(plan), collision_text(summary)
    if surface is None:
        error = summary['contour_deviation_bound']
        return Found(summary['cycle_time'], error, shares, collision=told)
    deepest, ridge = max(0.0, -surface['lowest']), surface.get('ridge_highest')
    return Found(summary['cycle_time'], deepest, shares, scallop=ridge, collision=told)


def shares_at_limits(folder: Path) -> dict[str, float]:
    """Return the share of the time in which each axis, or the feed, is at its limit [-]."""
    plan = read_plan(folder).in_memory()
    machine = Machine.load(str(plan.summary['machine']))
    holds = at_limits(axis_use(plan, machine.limits), machine.axis_names)
    found = {name: float(held.mean()) for name, held in holds.items()}
    way = np.asarray(plan.setpoints['s'])
    cell = np.searchsorted(plan.path['s'], way, 'right') - 1
    wanted = np.asarray(plan.path['programmed_feed'])[np.clip(cell, 0, len(plan.path['s']) - 2)]
    found['feed'] = float((np.gradient(way, plan.period) > AT_LIMIT * wanted).mean())
    return dict(sorted(found.items(), key=lambda item: -item[1]))


class Sweep:
    """Runs each point once, and stores its result.

    ``words``: the swept command, without ``--out``; ``progress``: receives the number of finished
    points, and of points known from an earlier start. Raises InterpError if the command cannot be
    swept.
    """

    def __init__(
        self,
        main: Main,
        words: Sequence[str],
        folder: Path,
        workers: Processes,
        progress: Callable[[int, int], None],
    ):
        self._words = _checked(words)
        self._main, self._folder, self._workers = main, folder.resolve(), workers
        self._progress = progress
        self.found: dict[Point, Found] = {}
        self._done = self._known = 0
        self._store = Store(folder / 'points', lambda content: Found(**content))

    def grid(self, ranges: Sequence[Range]) -> None:
        names = [one.option for one in ranges]
        all_values = itertools.product(*(one.values for one in ranges))
        self.run([(), *(tuple(zip(names, values, strict=True)) for values in all_values)])

    def search(self, ranges: Sequence[Range], most: int) -> None:
        """Run the command unchanged, then search for the fastest motion in ``most`` points."""
        names = [one.option for one in ranges]
        bounds = [(float(one.values[0]), float(one.values[-1])) for one in ranges]
        self.run([()])

        def times(members: Iterable[Any]) -> list[float]:
            points = [
                tuple(
                    (name, f'{value:.{DIGITS}g}')
                    for name, value in zip(names, member, strict=True)
                )
                for member in members
            ]
            found = self.run(points)
            return [np.inf if one.cycle_time is None else one.cycle_time for one in found]

        generations = max(1, most // (GENERATION * len(ranges)))
        differential_evolution(
            lambda member: times([member])[0],
            bounds,
            popsize=GENERATION,
            maxiter=generations - 1,
            workers=lambda _, members: times(members),
            updating='deferred',
            polish=False,
            rng=1,
            tol=0.0,
        )

    def run(self, values: Sequence[tuple[tuple[str, str], ...]]) -> list[Found]:
        points = [Point(self._words, one) for one in values]
        known = {point: self._store.find(point.key) for point in points if point not in self.found}
        new = [point for point, one in known.items() if one is None]
        self._known += len(known) - len(new)
        self._progress(self._done, self._known)
        calls = [partial(self._call, point) for point in new]
        for ended in self._workers.run(run_point, calls):
            point, one = new[ended.number], _found(ended)
            known[point] = one
            self._store.keep(point.key, one)
            self._done += 1
            self._progress(self._done, self._known)
        self.found |= {point: found for point, found in known.items() if found is not None}
        return [self.found[point] for point in points]

    def _call(self, point: Point) -> Call:
        return self._main, point.command, Path.cwd(), self.folder_of(point)

    def folder_of(self, point: Point) -> Path:
        return self._folder / 'points' / point.key

    def keep(self, point: Point) -> Path:
        best = self._folder / 'best'
        best.unlink(missing_ok=True)
        best.symlink_to(self.folder_of(point).relative_to(self._folder))
        return best


def _found(ended: EndedCall[Found]) -> Found:
    if isinstance(ended.result, Loss):
        return Found(fault=' '.join([ended.result.name.lower().replace('_', ' '), ended.why]))
    return ended.result


def _checked(words: Sequence[str]) -> tuple[str, ...]:
    if not any(tuple(words[: len(swept)]) == swept for swept in SWEPT):
        raise InterpError(
            'a sweep needs a command after --: plan PROGRAM ..., or cam iso-scallop SURFACE ...'
        )
    if any(word.partition('=')[0] == '--out' for word in words):
        raise InterpError('leave out the --out of the command; each point has its own folder')
    more = ('--run',) if words[0] == 'cam' and '--run' not in words else ()
    return (*words, *more)


def without_effect(found: dict[Point, Found], option: str) -> bool:
    """Return whether an option has no effect on the motion, whatever the other options are."""
    groups: dict[Any, set[Any]] = {}
    for point, one in found.items():
        if point.values and one.cycle_time is not None:
            others = tuple(pair for pair in point.values if pair[0] != option)
            groups.setdefault(others, set()).add((one.cycle_time, one.error, one.scallop))
    return bool(groups) and max(map(len, groups.values())) == 1


def front(found: dict[Point, Found]) -> list[Point]:
    """Return the Pareto-optimal points in time, scallop and error, the fastest point first."""
    best: dict[Point, tuple[float, float, float]] = {}
    known = [
        ((one.cycle_time, one.scallop or 0.0, one.error or 0.0), point)
        for point, one in found.items()
        if one.cycle_time is not None
    ]
    for figures, point in sorted(known, key=lambda row: row[0]):
        # The points before this one are as fast or faster.
        limits = figures[1] + SAME, figures[2] + SAME
        if not any(other[1] <= limits[0] and other[2] <= limits[1] for other in best.values()):
            best[point] = figures
    return list(best)


#: Number of limits that are named: those that restrict the motion for the longest time.
NAMED = 3
LOCAL_STYLE = 'td, th { text-align: left; } code { font-size: 12px; }'


def as_it_is(found: dict[Point, Found]) -> Point:
    return next(point for point in found if not point.values)


def values_text(point: Point) -> str:
    return ', '.join(f'{name} {value}' for name, value in point.values) or 'as it is'


def lengths_text(one: Found) -> str:
    told = (('scallop', one.scallop), ('error', one.error))
    return ', '.join(f'{name} {value / UM:.3f} um' for name, value in told if value is not None)


def why(one: Found) -> str:
    shares = list((one.at_limit or {}).items())[:NAMED]
    return ', '.join(f'{name} {share:.0%}' for name, share in shares if share >= 0.005)


def write_table(found: dict[Point, Found], file: Path) -> None:
    """Write every point as CSV; times in s, errors in um."""
    names = list(dict.fromkeys(name for point in found for name, _ in point.values))
    rows = []
    for point, one in found.items():
        values = dict(point.values)
        lengths = [None if x is None else x / UM for x in (one.scallop, one.error)]
        own = (one.cycle_time, *lengths, why(one), one.fault, one.collision)
        rows.append([*(values.get(n) for n in names), *own])
    heads = 'cycle_time_s', 'scallop_um', 'error_um', 'at_limit', 'fault', 'collision'
    write_whole(file, csv_text([*names, *heads], rows))


def write_page(found: dict[Point, Found], file: Path) -> None:
    best, start = front(found), as_it_is(found)
    names = list(dict.fromkeys(name for point in found for name, _ in point.values))
    body = [
        f'<h1>{len(found)} points</h1><p><code>cnc-interp {escape(shlex.join(start.words))}</code>'
        '</p>',
        html.section(
            'Time and accuracy',
            'The figure shows all points that give a motion. For a point on the line, no other '
            'point is at least as good in time, scallop and error at once.',
            html.drawing(_scatter(found, best, start)),
        ),
        html.section(
            'The best',
            'At a limit: share of the time in which an axis, or the feed, is at its limit, so '
            'that the motion cannot be faster.',
            _table(found, best, start),
        ),
    ]
    for name in names:
        drawn = html.drawing(_over(found, name))
        body.append(
            html.section(
                f'--{escape(name)}',
                'The figure shows each point at its value of this option.',
                drawn,
            )
        )
    body.append(_faults(found))
    html.write(file, 'sweep', '\n'.join(body), LOCAL_STYLE)


def _moving(found: dict[Point, Found]) -> list[Point]:
    return [point for point, one in found.items() if one.cycle_time is not None]


def _scatter(found: dict[Point, Found], best: list[Point], start: Point) -> Any:
    from plotly import graph_objects as go

    scallops = any(one.scallop is not None for one in found.values())

    def height(one: Found) -> float:
        return ((one.scallop if scallops else one.error) or 0.0) / UM

    def trace(points: list[Point], name: str, **more: Any) -> Any:
        points = [point for point in points if found[point].cycle_time is not None]
        return go.Scatter(
            x=[found[p].cycle_time for p in points],
            y=[height(found[p]) for p in points],
            text=[
                f'{escape(values_text(p))}<br>{lengths_text(found[p])}<br>{escape(why(found[p]))}'
                for p in points
            ],
            hovertemplate='%{x:.3f} s; %{text}<extra></extra>',
            name=name,
            **more,
        )

    moving = _moving(found)
    by_error = {
        'color': [(found[point].error or 0.0) / UM for point in moving],
        'size': 9,
        'colorscale': 'Blues',
        'line': {'color': html.BLUE, 'width': 1},
        'colorbar': {'title': {'text': 'error [um]'}},
    }
    plain = {'color': html.BLUE, 'opacity': 0.5}
    figure = go.Figure(
        [
            trace(moving, 'all', mode='markers', marker=by_error if scallops else plain),
            trace(
                best,
                'best',
                mode='lines+markers',
                line={'color': html.ORANGE, 'shape': 'hv'},
                marker={'symbol': 'circle-open', 'size': 13},
            ),
            trace(
                [start],
                'as it is',
                mode='markers',
                marker={'color': html.RED, 'size': 11, 'symbol': 'x'},
            ),
        ]
    )
    title = 'highest ridge [um]' if scallops else 'largest error [um]'
    own = {'xaxis_title': 'cycle time [s]', 'yaxis_title': title, 'yaxis_rangemode': 'tozero'}
    return html.laid_out(figure, 420, hovermode='closest', **own)


def _over(found: dict[Point, Found], name: str) -> Any:
    from plotly import graph_objects as go

    points = [point for point in _moving(found) if name in dict(point.values)]
    figure = go.Figure(
        go.Scatter(
            x=[dict(point.values)[name] for point in points],
            y=[found[point].cycle_time for point in points],
            text=[values_text(point) for point in points],
            hovertemplate='%{text}<br>%{y:.3f} s<extra></extra>',
            mode='markers',
            marker={'color': html.BLUE, 'opacity': 0.5},
        )
    )
    own = {'xaxis_title': f'--{name}', 'yaxis_title': 'cycle time [s]'}
    return html.laid_out(figure, 260, hovermode='closest', **own)


def _table(found: dict[Point, Found], best: list[Point], start: Point) -> str:
    rows = []
    for point in [*best, start] if start not in best else best:
        one = found[point]
        if one.cycle_time is None:
            continue
        lengths = ('' if x is None else f'{x / UM:.3f}' for x in (one.scallop, one.error))
        command = f'<code>cnc-interp {escape(shlex.join(point.command))}</code>'
        rows.append(
            (
                escape(values_text(point)),
                f'{one.cycle_time:.3f}',
                *lengths,
                escape(why(one)),
                command,
            )
        )
    heads = 'values', 'time [s]', 'scallop [um]', 'error [um]', 'at a limit', 'command'
    return html.table(heads, rows)


def _faults(found: dict[Point, Found]) -> str:
    lines = [
        f'<li>{escape(values_text(point))}: {escape(one.fault)}</li>'
        for point, one in found.items()
        if one.fault
    ]
    if not lines:
        return ''
    return f'<section class="faults"><h2>Not possible</h2><ul>{"".join(lines)}</ul></section>'
