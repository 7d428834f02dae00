"""State shared by all pages: latest messages of the nodes, program, plan and history."""

from __future__ import annotations

import asyncio
import re
import time
from collections import deque
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import LoadedProgram, ModalState

from cnc_interp.client.hand_move import LineHistory
from cnc_interp.client.operator_client import SWITCHES, Answer, MachineState, OperatorClient
from cnc_interp.client.setup_client import (
    SetupClient,
    of_axes,
)
from cnc_interp.core import FloatArray, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.page.preview import PlannedHit, Planner, Preview
from cnc_interp.page.program_folder import ProgramFolder
from cnc_interp.page.scene import tube
from cnc_interp.page.start_choice import StartChoice, WayAhead, WayThere
from cnc_interp.program.job import WORK_OFFSETS
from cnc_interp.program.notices import warnings_of
from cnc_interp.run.clearance_stage import REFUSE, setup_text
from cnc_interp.settings.options import Settings, changed, texts_of
from cnc_interp.wire.run_messages import goal_of, in_program, settings_from, user_name

if TYPE_CHECKING:
    from cnc_interp.collision.drawing import DrawnBody

SPAN, STEP = 30.0, 0.1  #: Length of the history in the charts, and time between its points [s].
REST = 1.0  #: After this time at rest the charts freeze, so that they show the last motion [s].
KINDS = ('velocity', 'acceleration', 'jerk')  #: The charts show values as shares of their limit.


def is_text(text: str) -> bool:
    strange = sum(text.count(mark) for mark in ('\0', '\ufffd'))
    return '\0' not in text and strange <= len(text) / 50


@dataclass(frozen=True)
class Moment:
    """A point of the charts: largest use of limits in a time step, and feeds at its end; SI."""

    time: float
    feed: float
    programmed: float
    limit: float
    use: FloatArray


@dataclass
class Job:
    name: str  #: Its name.
    lines: list[str]  #: Its text; empty if it is too long to be shown.
    path: Path  #: File with the text.
    settings: Settings  #: Settings with which it is planned and run.
    number: int = 0  #: Counts the programs of the desk, from 1.
    plan: Preview | None = None  #: Its plan, once there is one.
    status: str = 'planning'  #: Current activity, or why it cannot be run.
    failed: bool = False  #: Whether it cannot be run.
    fault_lines: tuple[int, ...] = ()  #: Lines that are wrong.
    proven: bool | None = None  #: Result of the last check.
    #: Text of the setup that it is planned with; empty if its settings name a setup.
    setup: str = ''

    def is_run(self, program: LoadedProgram, settings: Settings) -> bool:
        same_text = self.name == program.name and self.lines == program.text.splitlines()
        return same_text and texts_of(self.settings) == texts_of(settings)

    def refuse(self, reason: str) -> None:
        """Store the reasons why it cannot be run, and the program lines that they name."""
        first, *others = reason.splitlines()
        self.status, self.failed = first, True
        if others:
            self.status += f' (and {len(others)} more, see the messages)'
        named = re.compile(rf'{re.escape(self.name)}:(\d+):.*?(?:\(also lines? ([\d, ]+).*)?')
        found = [match for text in (first, *others) if (match := named.fullmatch(text))]
        numbers = ' '.join(part for match in found for part in match.groups() if part)
        self.fault_lines = tuple(sorted(set(map(int, re.findall(r'\d+', numbers)))))

    def goal(self, start: StartChoice, operator: str) -> RunProgram.Goal:
        text = self.path.read_text(encoding='utf-8')
        settings = replace(self.settings, from_line=start.line, line_pass=start.which)
        goal = goal_of(Path(self.name), settings, changed(settings), text)
        goal.operator_name = operator
        if self.plan is not None and not start.line:
            goal.predicted_time = self.plan.run_time
        return goal


class Desk:
    def __init__(self, namespace: str, domain: int, folder: Path):
        self.folder = ProgramFolder(folder)
        self.history: deque[Moment] = deque(maxlen=round(SPAN / STEP) + 1)
        self._moved = 0.0
        self._stopped = False  # by an emergency stop or a fault
        self.machine: Machine | None = None
        self.bodies: tuple[DrawnBody, ...] = ()  #: Bodies of the machine's scene.
        self._first_tool = 0  # the tool that the scene puts in the spindle
        self.job: Job | None = None
        self.settings = Settings()
        self.start = StartChoice()
        self.operator = user_name()  #: The operator named in the next run.
        self._ways: WayAhead | None = None
        self.lines = LineHistory()
        self.switched = dict.fromkeys(SWITCHES, False)
        self.tube, self.tube_number = b'', 0
        # path lengths at the points of the tube [m], and lines of the blocks that lead there
        self._drawn, self._drawn_lines = np.zeros(0), np.zeros(0, dtype=np.int64)
        self._jobs = self.laid = 0  # programs planned, and loaded here
        self._planner = Planner()
        self._running: Job | None = None
        self._adopted = ''
        self._tasks: set[asyncio.Task[None]] = set()
        #: Event loop of the pages, while they exist.
        self.loop: asyncio.AbstractEventLoop | None = None
        #: Callbacks with which the pages show a new state in that loop.
        self.pages: set[Callable[[], None]] = set()
        self._peak = np.zeros((3, 0))
        self.nodes = OperatorClient('panel', namespace, domain, self._see_state)
        self.setup = SetupClient(self.nodes, 'page')
        self.nodes.start()  # its thread calls this desk, so the desk must be complete

    # The machine --------------------------------------------------------------------------------

    def _see_state(self, state: MachineState) -> None:
        self.switched['single_block'] = state.single_block
        stopped = state.state in (MachineState.STOPPING, MachineState.FAULT)
        if self._stopped and not stopped:
            self._clear_alarms()  # the machine was reset, by any client
        self._stopped = stopped
        with suppress(RuntimeError):  # the loop has ended just now
            if self.loop is not None:
                self.loop.call_soon_threadsafe(self._tell_pages)
        now = time.monotonic()
        use = np.array([getattr(state, f'recent_{kind}_use') for kind in KINDS])
        self._peak = use if self._peak.shape != use.shape else np.maximum(self._peak, use)
        self._moved = now if state.feedrate > 0.0 or self._peak.any() else self._moved
        if self.history and (now - self.history[-1].time < STEP or now - self._moved > REST):
            return
        self.history.append(Moment(now, state.feedrate, *self.feeds(state), self._peak))
        self._peak = np.zeros_like(use)

    def plan_of(self, state: MachineState) -> Preview | None:
        program, job = self.nodes.program, self._running
        if job is None or job.plan is None or program is None:
            return None
        same = state.program_id == program.program_id == self._adopted
        return job.plan if same else None

    def shows_run(self, state: MachineState) -> bool:
        return self.job is self._running and state.program_id == self._adopted

    def shown_plan(self, state: MachineState) -> Preview | None:
        return self.plan_of(state) if self.shows_run(state) else None

    def drawn_until(self, s: float) -> int:
        """Return the index of the last drawn point before a path length [m]."""
        return max(0, int(np.searchsorted(self._drawn, s, side='right')) - 1)

    def drawn_line(self, point: int) -> int:
        """Return the program line that leads to a drawn point; 0 if there is none."""
        lines = self._drawn_lines
        return int(lines[point]) if 0 <= point < len(lines) else 0

    def feeds(self, state: MachineState) -> tuple[float, float]:
        """Return programmed feed and axis limit at the current position; NaN if unknown."""
        plan = self.plan_of(state)
        if plan is None or state.path_position <= 0.0 or state.state == MachineState.IDLE:
            return np.nan, np.nan
        place = plan.at(state.path_position)
        return place.programmed_feed, place.feed_limit

    def _tell_pages(self) -> None:
        self.watch()
        for show in self.pages:
            asyncio.get_running_loop().call_soon(show)

    def watch(self) -> None:
        """Detect a change of the machine; show programs that other clients have started."""
        if self.machine is None and self.nodes.machine:
            machine = Machine.load(self.nodes.machine)
            if self.nodes.scene:
                from cnc_interp.collision.drawing import drawn_bodies
                from cnc_interp.collision.scene_file import read_scene

                file = Path(self.nodes.setup_file) if self.nodes.setup_file else None
                scene = read_scene(Path(self.nodes.scene), setup_text(file))
                self.bodies = tuple(drawn_bodies(scene, machine))
                self._first_tool = scene.first_tool
            self.machine = machine
            self._ways = WayAhead(Transform.of(self.machine))
            self._planner.machine = self.nodes.machine
        self._plan_with_new_setup()
        program = self.nodes.program
        if self.machine is None or program is None or program.program_id == self._adopted:
            return
        self._adopted = program.program_id
        if program.mdi:  # the loaded program stays
            self._running = None
            return
        # The plan is always that of the whole program, wherever the run starts.
        settings = replace(settings_from(program.settings, Settings()), from_line=0, line_pass=0)
        if self.job is not None and self.job.is_run(program, settings):
            self._running = self.job
            return
        self._running = self._lay(program.name, program.text, settings)

    # The program --------------------------------------------------------------------------------

    async def load(self, name: str, text: str) -> Answer:
        if not is_text(text):
            return Answer(False, f'{name} is not a text file: choose a file with a program')
        if in_program(self.nodes.state):
            why = 'a program is running: load another one when it has ended, or press queue next'
            return Answer(False, why)
        self._lay(name, text, self._for_nodes())
        return Answer(True, f'{name} loaded')

    async def queue(self, name: str, text: str) -> Answer:
        if not in_program(self.nodes.state):
            return Answer(False, 'no program is running: load this one and press cycle start')
        if not is_text(text):
            return Answer(False, f'{name} is not a text file: choose a file with a program')
        job = Job(name, [], self._planner.keep(name, text), self._for_nodes())
        return await asyncio.wrap_future(
            self.nodes.start_program(job.goal(StartChoice(), self.operator))
        )

    async def listed(self, take: Callable[[str, str], Awaitable[Answer]], name: str) -> Answer:
        """Read a program of the folder; ``take`` then loads or queues it."""
        try:
            text = await asyncio.to_thread(self.folder.read, name)
        except InterpError as problem:
            return Answer(False, str(problem))
        answer = await take(name, text)
        if answer.ok:
            await asyncio.to_thread(self.folder.opened, name)
        return answer

    async def save(self, name: str, text: str) -> Answer:
        """Save a program in the folder, and load it unless one runs."""
        try:
            await asyncio.to_thread(self.folder.save, name, text)
        except InterpError as problem:
            return Answer(False, str(problem))
        await asyncio.to_thread(self.folder.opened, name)
        if in_program(self.nodes.state):
            return Answer(True, f'{name} saved')
        return await self.load(name, text)

    async def empty_queue(self) -> Answer:
        count = self.nodes.cancel_waiting()
        none = 'no program of this page is waiting'
        return Answer(count > 0, f'{count} removed from the queue' if count else none)

    async def choose(self, settings: Settings) -> Answer:
        if in_program(self.nodes.state):
            return Answer(False, 'a program is running: change the settings when it has ended')
        self.settings = settings
        if self.job is not None:
            settings = self._for_nodes()
            setup = self._setup_text(settings)
            self._set_job(replace(self.job, settings=settings, plan=None, setup=setup))
        return Answer(True, 'settings taken')

    def _for_nodes(self) -> Settings:
        state, scene = self.nodes.state, Path(self.nodes.scene) if self.nodes.scene else None
        settings = replace(self.settings, scene=scene)
        if state is None:
            return settings
        return replace(settings, interpolation_period=state.interpolation_period)

    def _setup_text(self, settings: Settings) -> str:
        """Return the setup of the machine as text; empty if the settings name a setup."""
        table = self.setup.table
        return '' if settings.setup is not None or table is None else str(table.text)

    def _plan_with_new_setup(self) -> None:
        job = self.job
        if job is None or in_program(self.nodes.state):
            return
        setup, table = self._setup_text(job.settings), self.setup.table
        if setup != job.setup:
            again = self._set_job(replace(job, plan=None, setup=setup))
            if self._running is job and table and table.changed_by.startswith(f'{job.name} line '):
                self._running = (
                    again  # the display continues with the run that has changed the setup
                )

    def _lay(self, name: str, text: str, settings: Settings) -> Job:
        path, setup = self._planner.keep(name, text), self._setup_text(settings)
        self.start, self.laid = StartChoice(), self.laid + 1
        return self._set_job(Job(path.name, text.splitlines(), path, settings, setup=setup))

    def _set_job(self, job: Job) -> Job:
        self._jobs += 1
        # Reports of other nodes than the machine were about the previous program.
        self.nodes.alarms.hide(lambda alarm: 'machine_node' not in alarm.source)
        job.number, job.status, job.proven = self._jobs, 'planning', None
        job.failed, job.fault_lines = False, ()
        self.job = job
        self._begin(self._plan(job))
        return job

    def _begin(self, work: Any) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _plan(self, job: Job) -> None:
        see_progress = partial(setattr, job, 'status')
        try:
            plan = await self._planner.plan(job.path, job.settings, see_progress, job.setup)
        except InterpError as problem:
            job.refuse(str(problem))
            for line in reversed(str(problem).splitlines()) if self.job is job else ():
                self.nodes.alarms.add('error', 'program', line)
            return
        if self.job is not job:
            return
        size = float(np.ptp(plan.tip, axis=0).max())
        radius = max(size, 0.02) / 250
        given = plan.tip, plan.feed, plan.usual_feed, radius
        self.tube, drawn = await asyncio.to_thread(tube, *given)
        self._drawn, self._drawn_lines = plan.s[drawn], plan.line[drawn]
        self.tube_number += 1
        job.plan, job.status = plan, 'planned'
        for hit in reversed(plan.hits):
            self.nodes.alarms.add('error', 'program', f'{job.name}:{hit.line}: {hit.text}')
        if plan.hits and job.settings.collision == REFUSE:
            job.refuse('\n'.join(f'{job.name}:{hit.line}: {hit.text}' for hit in plan.hits))
        warnings = warnings_of(plan.notices)
        self.nodes.alarms.forget(job.name)
        for notice in plan.notices:
            self.nodes.alarms.add('error' if notice in warnings else 'notice', job.name, notice)

    async def check(self) -> Answer:
        job = self.job
        if job is None:
            return Answer(False, 'no program is loaded: press load')
        if job.plan is None:
            return Answer(False, job.status if job.failed else 'the program is being planned')
        job.status = 'checking'
        self._begin(self._check(job))
        return Answer(True, 'checking')

    async def _check(self, job: Job) -> None:
        try:
            proof = await self._planner.check()
        except InterpError as problem:
            job.refuse(str(problem))
            return
        job.proven = bool(proof['ok'])
        job.failed = not job.proven
        job.status = 'every setpoint proven' if job.proven else 'NOT proven: see cnc-interp check'

    # Commands -----------------------------------------------------------------------------------

    async def cycle_start(self) -> Answer:
        state = self.nodes.state
        if state is not None and state.may_resume:
            return await self.trigger('cycle_start')
        if in_program(state):
            return Answer(False, 'a program is running already')
        if self.nodes.silent:
            return Answer(False, f'{self.nodes.silent} does not answer')
        if self.job is None:
            return Answer(False, 'no program is loaded: press load')
        if self.job.failed:
            return Answer(False, self.job.status)
        started = self.nodes.start_program(self.job.goal(self.start, self.operator), self._see_end)
        return await asyncio.wrap_future(started)

    async def choose_start(self, line: int, which: int) -> Answer:
        job = self.job
        if job is None:
            return Answer(False, 'no program is loaded: press load')
        if in_program(self.nodes.state):
            return Answer(False, 'a program is running: choose the line when it has ended')
        if line > len(job.lines):
            return Answer(False, f'{job.name} has {len(job.lines)} lines')
        self.start = StartChoice(line, which)
        return Answer(True, 'chosen')

    def _see_end(self, result: RunProgram.Result) -> None:
        """Clear the start line after a run; if its start was rejected, store the reason."""
        program = self.nodes.program
        begun = program is not None and program.program_id == result.program_id
        if begun or not self.start.line:
            self.start = StartChoice()
        else:
            self.start = replace(self.start, refused=str(result.message))

    def way_ahead(self) -> WayThere | None:
        state = self.nodes.state
        if state is None or self._ways is None:
            return None
        return self._ways.at(state, self.nodes.program)

    @property
    def tool(self) -> int:
        """The number of the tool in the spindle."""
        return self.setup.setup.tool or self._first_tool

    @property
    def planned_hit(self) -> PlannedHit | None:
        """The first hit of the program on the desk."""
        plan = self.job.plan if self.job is not None else None
        return plan.hits[0] if plan is not None and plan.hits else None

    def hit(self) -> tuple[tuple[str, ...], str]:
        """Return the bodies of a hit, live or else in the plan, and a sentence about the hit."""
        if live := tuple(self.nodes.hits.values()):
            return live[0]
        first = self.planned_hit
        return ((), '') if first is None else (first.bodies, first.text)

    def start_line(self) -> int:
        run = self._shown_run()
        return int(run.start_line) if run and in_program(self.nodes.state) else self.start.line

    def start_position(self) -> float:
        """Return the path length at which the current run has started [m]."""
        run = self._shown_run()
        return float(run.start_at) if run else 0.0

    def _shown_run(self) -> LoadedProgram | None:
        state = self.nodes.state
        return self.nodes.program if state is not None and self.shows_run(state) else None

    def modes(self) -> tuple[str, ModalState | None]:
        """Return the modal state in effect: of the executed block, or of MDI."""
        state, active = self.nodes.state, self.nodes.active_modes
        if state is None or not (state.program_id and in_program(state)):
            return 'MDI', self.nodes.modes
        mine = active is not None and active.program_id == state.program_id
        return 'executed', active if mine else None

    def codes(self) -> tuple[str, ...]:
        modes = self.modes()[1]
        return tuple(modes.codes) if modes is not None else ()

    def offset(self) -> str:
        named = [code for code in self.codes() if code in WORK_OFFSETS]
        return named[0] if named else self.setup.setup.offset

    async def zero(self, letter: str) -> Answer:
        return await asyncio.wrap_future(self.setup.ask('touch_off', **of_axes({letter: 0.0})))

    async def trigger(self, name: str) -> Answer:
        answer = await asyncio.wrap_future(self.nodes.ask(name))
        if answer.ok and name == 'reset':
            self._clear_alarms()
        return answer

    def _clear_alarms(self) -> None:
        """Clear the alarms, except the warnings of the program that is shown."""
        kept = self.job.name if self.job is not None else ''
        self.nodes.alarms.hide(lambda alarm: alarm.source != kept)

    async def set_switch(self, name: str, on: bool) -> Answer:
        answer = await asyncio.wrap_future(self.nodes.ask(name, data=on))
        if answer.ok:
            self.switched[name] = on
        return answer

    def end_planning(self) -> None:
        """End the planning while the event loop of the page still runs."""
        self._planner.close()

    def close(self) -> None:
        self.end_planning()
        self.nodes.close()
