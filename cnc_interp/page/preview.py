"""Plan and check a program beside the machine, with the commands that a user would type."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, IntArray, InterpError
from cnc_interp.core.compile_time import COMPILING
from cnc_interp.processes.temporary_folder import TemporaryFolder
from cnc_interp.program.notices import WARNING
from cnc_interp.run.plan_figures import bound_text
from cnc_interp.settings.command_line import command_words
from cnc_interp.settings.options import Settings

DRAWN = 20000  #: Largest number of points drawn.
STAGES = 24  #: Number of stages at which the cut stock is drawn.
PROGRESS = re.compile(r'\w+ \d+%.*')  #: A line of progress of a command.
NOTE = re.compile(r'note: |line \d+: .*' + WARNING)  #: A line about the program.
STRANGE = re.compile(r'[^\w .,()+#-]')  #: Characters that are removed from the name of a program.
LONGEST_NAME = 60  #: Characters of such a name, of at most four bytes each.
NICENESS = 5  #: Niceness of the planning process: lower priority than the nodes.


@dataclass(frozen=True)
class Place:
    #: Programmed feed and limit of the axes [m/s].
    programmed_feed: float
    feed_limit: float
    time: float  #: Time since the start of the program [s].
    block_end: float  #: Path length at the end of the block [m].


@dataclass(frozen=True)
class PlannedHit:
    line: int  #: Line of the program.
    bodies: tuple[str, ...]  #: Names of both bodies.
    positions: tuple[float, ...]  #: Axis positions there [m, rad].
    text: str  #: Description of the hit: bodies, amount and place.


@dataclass(frozen=True)
class Preview:
    s: FloatArray  #: (N,): Path length on the planner's grid [m].
    #: (N, 3): Tool tip [m] and tool axis [-] in W.
    tip: FloatArray
    axis: FloatArray
    #: (N,): Planned and programmed feed, and the limit of the axes [m/s].
    feed: FloatArray
    programmed_feed: FloatArray
    feed_limit: FloatArray
    time: FloatArray  #: (N,): Time at which the point is reached [s].
    #: (N,): Path length at the end of the block that leads to the point [m].
    block_end: FloatArray
    rapid: BoolArray  #: (N,): Whether that block is a rapid.
    line: IntArray  #: (N,): Its line of the program.
    cycle_time: float  #: Duration of the whole program [s].
    run_time: float = 0.0  #: Duration with tool changes, dwells and the spindle [s].
    tools: tuple[dict[str, Any], ...] = ()  #: Times by tool, as in summary.json.
    notices: tuple[str, ...] = ()  #: Words that had no effect or were simplified.
    hits: tuple[PlannedHit, ...] = ()  #: Hits of the program, if the plan has a scene.
    bound: str = ''  #: Lower bound of the motion time, as text.
    #: Stages of the remaining stock: path length from which each is valid [m], and STL file.
    stages: tuple[bytes, ...] = ()
    stage_from: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def length(self) -> float:
        return float(self.s[-1])

    @cached_property
    def usual_feed(self) -> float:
        """The largest planned feed outside rapids; if all motion is rapid, the largest [m/s]."""
        cutting = self.feed[~self.rapid]
        return float((cutting if cutting.max(initial=0.0) > 0.0 else self.feed).max(initial=0.0))

    def at(self, s: float) -> Place:
        k = int(np.searchsorted(self.s, s, side='right').clip(1, len(self.s) - 1))
        return Place(
            programmed_feed=float(self.programmed_feed[k - 1]),
            feed_limit=float(self.feed_limit[k - 1]),
            time=float(np.interp(s, self.s, self.time)),
            block_end=float(self.block_end[k]),
        )

    def stage_at(self, s: float) -> int:
        """Return the number of the stock's stage at a path length [m]; -1 if there is none."""
        return int(np.searchsorted(self.stage_from, s, 'right')) - 1

    @staticmethod
    def read(directory: Path, notices: tuple[str, ...] = ()) -> Preview:
        """Read the plan files, thinned to the resolution of a screen."""
        with np.load(directory / 'path.npz') as path, np.load(directory / 'setpoints.npz') as run:
            s = path['s']
            rows = thinned(len(s))
            block = path['block']
            last = np.append(np.flatnonzero(np.diff(block)), len(block) - 1)
            block_end = s[last[np.searchsorted(last, rows)]]
            way, first = np.unique(run['s'], return_index=True)
            time = np.interp(s[rows], way, run['time'][first])
            columns = {
                name: path[name][rows]
                for name in ('tip', 'axis', 'feed', 'programmed_feed', 'feed_limit')
            }
        with np.load(directory / 'blocks.npz') as blocks:
            rapid, line = blocks['rapid'][block[rows]], blocks['line'][block[rows]]
        summary = json.loads((directory / 'summary.json').read_text(encoding='utf-8'))
        return Preview(
            s=s[rows],
            time=time,
            block_end=block_end,
            rapid=rapid,
            line=line,
            cycle_time=summary['cycle_time'],
            run_time=summary['cycle_time'] + summary['standstill'],
            tools=tuple(summary['tools']),
            notices=notices,
            hits=tuple(
                PlannedHit(hit['line'], tuple(hit['bodies']), tuple(hit['positions']), hit['text'])
                for hit in summary.get('collision', {}).get('hits', ())
            ),
            bound=bound_text(summary),
            **columns,
            **(_stages(directory) if summary.get('collision', {}).get('stock') else {}),
        )


def _stages(directory: Path) -> dict[str, Any]:
    from cnc_interp.collision.mesh_file import stl_of  # loaded with a stock only

    with np.load(directory / 'stock_stages.npz') as file:
        parts = np.split(file['corners'], np.cumsum(file['triangles'])[:-1])
        stages = tuple(stl_of(corners, 'cnc_interp, metres') for corners in parts)
        return {'stages': stages, 'stage_from': file['s']}


def thinned(count: int) -> IntArray:
    return np.unique(np.linspace(0, count - 1, min(count, DRAWN)).astype(int))


class Planner:
    """Plans and proves one program at a time. A new program ends the work on the previous one."""

    def __init__(self) -> None:
        self.machine = ''  # by file or bundled name; empty before it is known
        self._folder = TemporaryFolder()
        self._plan = Path(self._folder.name) / '.plan'  # no program has this name
        self._process: asyncio.subprocess.Process | None = None

    def keep(self, name: str, text: str) -> Path:
        safe = STRANGE.sub('_', name.rpartition('/')[2])[-LONGEST_NAME:].lstrip('.')
        path = Path(self._folder.name) / (safe or 'program.ngc')
        path.write_text(text.replace('\0', '\ufffd'), encoding='utf-8')  # a message ends at \0
        return path

    async def plan(
        self,
        program: Path,
        settings: Settings,
        see_progress: Callable[[str], None],
        setup: str = '',
    ) -> Preview:
        """Plan a program from ``keep``; InterpError has the messages of `plan`, one per line."""
        if setup:
            file = Path(self._folder.name) / '.offsets and tools.yaml'
            file.write_text(setup, encoding='utf-8')
            settings = replace(settings, setup=file)
        words = ['plan', str(program), '--machine', self.machine, '--out', str(self._plan)]
        fine: tuple[int, ...] = (0,)
        if settings.scene is not None:  # planned in any case, because the page shows the hits
            settings, fine = replace(settings, collision='warn'), (0, 1)
            words += ['--stock-stages', str(STAGES)]
        _, said = await self._run([*words, *command_words(settings)], see_progress, fine)
        notes = [line.removeprefix('note: ') for line in said if NOTE.match(line)]
        # In a thread: a long plan takes seconds, and pages without messages disconnect.
        return await asyncio.to_thread(Preview.read, self._plan, tuple(notes))

    async def check(self) -> dict[str, Any]:
        out, _ = await self._run(['check', str(self._plan), '--json'], lambda _: None, fine=(0, 1))
        proof: dict[str, Any] = json.loads(out)
        return proof

    async def _run(
        self, words: list[str], see_progress: Callable[[str], None], fine: tuple[int, ...] = (0,)
    ) -> tuple[str, list[str]]:
        self.stop()
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            '-m',
            'cnc_interp',
            *words,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            preexec_fn=lambda: os.nice(NICENESS),  # the nodes come first
        )
        self._process = process
        assert process.stdout is not None
        assert process.stderr is not None
        lines: list[str] = []

        async def hear(said: asyncio.StreamReader) -> None:
            async for line in said:
                lines.append(line.decode(errors='replace').rstrip())
                if PROGRESS.fullmatch(lines[-1]) or lines[-1] == COMPILING:
                    see_progress(lines[-1])

        out, _ = await asyncio.gather(process.stdout.read(), hear(process.stderr))
        await process.wait()
        if self._process is not process:
            raise InterpError('another program was loaded')
        self._process = None
        if process.returncode not in fine:
            said = '\n'.join(lines) or f'exit code {process.returncode}'
            _, found, reasons = said.rpartition('cnc-interp: ')  # one in a line
            reasons = reasons if found else lines[-1] if lines else said
            raise InterpError(reasons.replace(f'{self._folder.name}/', ''))
        return out.decode(), lines

    def stop(self) -> None:
        if self._process is not None and self._process.returncode is None:
            with contextlib.suppress(ProcessLookupError):  # it has ended just now
                self._process.kill()
        self._process = None

    def close(self) -> None:
        self.stop()
        self._folder.cleanup()
