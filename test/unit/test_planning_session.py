"""The planning of a run, step by step: late revisions, a left plan, given up, begun again."""

import sys
from threading import Event
from types import SimpleNamespace

import numpy as np
import pytest

from cnc_interp.core import PlanningError, Refusal
from cnc_interp.nodes import planning_session
from cnc_interp.nodes.feedrate_node import PlanningThread
from cnc_interp.nodes.planning_session import (
    LEAD,
    LONGER,
    MARGIN,
    REFILLED,
    REFILLING,
    TABLE,
    Activity,
    Change,
    PathEnd,
    PlanningSession,
    PlanningTask,
    Received,
)
from cnc_interp.run.chunk_cutter import FunctionQueue
from cnc_interp.run.overrides import OperatorSettings
from cnc_interp.run.run_phase import MachineReport
from cnc_interp.run.run_planner import Revision
from cnc_interp.run.run_state import NO_RUN, RunId, State
from cnc_interp.run.setpoints import Wait
from cnc_interp.wire.window_protocol import WindowedSender

RUN = RunId('run')
SLOW = OperatorSettings(override=0.5)
T = 1e-3


class Plan:
    """A plan of a hundred chunks, ten setpoints each."""

    def __init__(self, settings):
        self.settings, self.left, self.planned = settings, 100, 1.0
        self.has_path = self.can_plan = False

    @property
    def can_sample(self):
        return self.left > 0

    def follow(self, settings):
        """Something is planned already: other settings need a revision."""


class Stream:
    """A stream with a plan."""

    def __init__(self, settings):
        self.current, self.finds = Plan(settings), True
        self.functions = FunctionQueue()

    def adopt(self, plan):
        before, self.current = self.current, plan
        return before


class Planner:
    """A planner that samples a chunk at a time; its last chunk is the end of the program."""

    def __init__(self, stands, place, settings):
        self.stands, self.place, self.stream = stands, place, Stream(settings)
        self.pushed, self.finished, self.resumed = [], False, None

    def push(self, segments, pauses):
        self.pushed += segments

    def finish(self):
        self.finished = True

    def work(self, plan, sample, executed):
        plan.left -= 1
        wait = Wait.NOTHING if plan.left else Wait.END
        return [SimpleNamespace(samples=range(10), wait=wait)]

    def revise(self, number, settings):
        if not self.stream.finds:
            return None
        chunk = SimpleNamespace(samples=range(10), wait=Wait.NOTHING)
        return Revision(number, Plan(settings), [chunk])

    def resume(self, s, stands, settings):
        self.resumed, self.led_from, self.stream.current.settings = s, stands, settings
        return []


class Port:
    """The surroundings of a session: a sender with a window, and what was asked of them."""

    def __init__(self):
        self.outlet, self.sender = self, WindowedSender(0.5)
        self.refused, self.opened, self.planners = [], 0, []

    def make_planner(self, first, stands, place, settings):
        self.planners.append(Planner(stands, place, settings))
        return self.planners[-1]

    def read(self, segments):
        return segments, set()

    def join(self, run_id, first):
        self.before, self.sender = self.sender, WindowedSender(0.5)
        self.sender.begin(run_id, first)

    def take_back(self):
        self.sender = self.before

    def consumed(self, count):
        self.opened += count

    def refuse(self, kind, reason):
        self.refused.append((kind, reason))


def report(run_id=NO_RUN, state=State.IDLE, **changes):
    said = {'plan_over': False, 'start_wanted': False, 'completed': False, 'path_position': 0.0}
    stands = {'stands': np.zeros(5), 'time': 0.0, 'message': ''}
    return MachineReport(run_id, state, **{**said, **changes}, **stands)


class Bench:
    """A session whose tasks are done when the test says so."""

    def __init__(self):
        self.port, self.now = Port(), 0.0
        self.session = PlanningSession(self.port, T, 10.0)
        self.executed, self.receives, self.turned_away = 0, None, False

    def step(self):
        self.now += 0.1
        receives = self.receives or self.session.run_id
        received = Received(receives, self.executed, self.turned_away)
        return self.session.step(self.now, received)

    def finish(self, task):
        self.session.finish(task, task.work, self.now)

    def send(self, window=10**6):
        """Send what the window lets through; it arrives."""
        sender = self.port.sender
        sender.acknowledge(sender.run_id, sender.sent, window, self.now)
        sender.due(self.now)

    def work(self):
        """Do tasks until there is none."""
        while (task := self.step()) is not None:
            self.finish(task)

    def begin(self, run_id=RUN, segments=3, place=-1.0):
        self.session.begin(run_id, place)
        for k in range(segments):
            self.session.take(k, last=k == segments - 1)

    def planning(self, window):
        """Plan a run with so many setpoints sent."""
        self.begin()
        self.session.see_machine(report())
        for _ in range(20):
            self.finish(self.step())
        self.send(window)
        return self.port.planners[-1]


@pytest.fixture
def bench(monkeypatch):
    """A bench whose machine never has too little motion for a revision."""
    monkeypatch.setattr(planning_session, 'REFILLED', -np.inf)
    return Bench()


def test_a_run_waits_until_the_machine_rests_and_ends_when_it_was_executed(bench):
    bench.begin()
    session = bench.session
    assert bench.step() is None and session.activity is Activity.WAITING
    session.see_machine(report(RunId('other'), State.RUNNING))
    assert bench.step() is None and session.activity is Activity.WAITING
    session.see_machine(report())
    for _ in range(200):
        bench.work()
        bench.send()
    (planner,) = bench.port.planners
    assert planner.pushed == [0, 1, 2] and planner.finished and bench.port.opened == 3
    assert session.path_end is PathEnd.QUEUED and bench.port.sender.sent == 1000
    assert session.activity is Activity.PLANNING
    session.see_machine(report(RUN, completed=True))
    assert bench.step() is None and session.activity is Activity.ENDED
    assert bench.port.refused == []


def test_a_revision_joins_a_little_ahead_of_the_machine_and_not_after_the_buffer(bench):
    planner = bench.planning(window=150)
    session, sender = bench.session, bench.port.sender
    bench.executed, session.settings = 20, SLOW
    task = bench.step()
    assert session.activity is Activity.REVISING
    bench.executed += 10  # the machine goes on meanwhile
    assert bench.step() is None
    bench.finish(task)
    joins = 20 + round(LEAD / T) + 1
    assert session.activity is Activity.JOINING and planner.stream.current.settings == SLOW
    assert session.run_id == RunId('run', plan=1) and session.joins_at == joins
    assert (bench.port.sender.run_id, bench.port.sender.next_number) == (
        session.run_id,
        joins + 10,
    )
    bench.receives = RUN
    bench.finish(bench.step())
    assert session.activity is Activity.JOINING, 'it has not answered'
    assert bench.port.sender.next_number == joins + 20, 'the new plan is sampled on meanwhile'
    bench.receives = session.run_id
    assert bench.step() is not None and session.activity is Activity.PLANNING
    assert bench.port.sender is not sender


def test_a_late_revision_is_dropped_and_the_next_one_gets_the_time_it_takes(bench):
    planner = bench.planning(window=400)
    sender = bench.port.sender
    bench.session.settings = SLOW
    task = bench.step()
    bench.executed += round((LEAD - 0.5 * MARGIN) / T)
    bench.step()
    bench.finish(task)
    assert planner.stream.current.settings != SLOW and bench.port.sender is sender
    assert bench.session.activity is Activity.PLANNING
    bench.executed -= 40
    bench.finish(bench.step())  # at once; the late one took 0.1 s
    ahead = (bench.session.joins_at - bench.executed - 1) * T
    assert ahead == pytest.approx(LONGER * 0.1 + MARGIN, abs=1.001 * T)


def test_after_a_late_revision_a_quick_one_brings_the_next_one_nearer_again(bench):
    bench.planning(window=600)
    session = bench.session
    leads = []
    for late, settings in ((LEAD, SLOW), (0.0, SLOW), (0.0, OperatorSettings(0.7))):
        session.settings = settings
        bench.step()
        leads.append((session._join_after() - bench.executed) * T)
        task = session.task
        bench.executed += round(late / T)
        if late:
            bench.step()  # takes 0.1 s
        bench.finish(task)
        if late:
            bench.executed -= round(late / T)
            continue
        bench.receives = session.run_id
        bench.executed, bench.now = session.joins_at, bench.now + 1.0
        bench.finish(bench.step())
        for _ in range(60):
            bench.finish(bench.step())
            bench.send()
    longest = LONGER * 0.1 + MARGIN
    assert leads == pytest.approx([LEAD, longest, 0.5 * longest], abs=1.001 * T)


def test_where_the_machine_has_passed_the_plan_before_goes_on(bench):
    planner = bench.planning(window=150)
    session, sender, end = bench.session, bench.port.sender, bench.session.path_end
    session.settings = SLOW
    bench.finish(bench.step())
    bench.receives = RUN
    void = bench.step()
    bench.turned_away = True
    task, left = bench.step(), planner.stream.current.left
    void.work()  # another thread does it, and may begin only now
    bench.finish(void)
    assert planner.stream.current.left == left, 'the plan that goes on has lost nothing'
    assert session.task is task, 'what was sampled of the plan that did not join is void'
    assert session.activity is Activity.REVISING, 'it is tried again'
    assert (session.run_id, session.joins_at, session.path_end) == (RUN, 0, end)
    assert bench.port.sender is sender and planner.stream.current.settings != SLOW
    bench.turned_away = False
    bench.finish(task)
    assert session.run_id == RunId('run', plan=2), 'answers to plan 1 may still be on their way'


def test_the_end_of_the_path_that_comes_while_a_plan_joins_is_kept(bench):
    """The plan that goes on must end with it: a machine waited for setpoints at its end."""
    planner = bench.planning(window=150)
    session = bench.session
    session.path_end, session.settings = PathEnd.OPEN, SLOW
    bench.finish(bench.step())
    bench.receives = RUN
    session.end_path()
    bench.turned_away = True
    bench.step()
    assert session.path_end is PathEnd.KNOWN
    assert planner.stream.current.settings != SLOW


def test_a_revision_that_was_not_found_is_tried_again_a_moment_later(bench):
    planner = bench.planning(window=60)
    planner.stream.finds, bench.session.settings = False, SLOW
    bench.finish(bench.step())
    bench.now -= 0.0999
    task = bench.step()
    assert bench.session.activity is Activity.PLANNING
    bench.finish(task)
    planner.stream.finds = True
    bench.finish(bench.step())
    assert bench.session.activity is Activity.JOINING and planner.stream.current.settings == SLOW


def test_changes_in_quick_succession_wait_until_the_machine_has_motion_again():
    bench = Bench()
    bench.planning(window=10**6)
    for _ in range(70):
        bench.finish(bench.step())
        bench.send()
    sent = bench.port.sender.sent
    bench.executed, bench.session.settings = sent - round(REFILLED / T) - 1, SLOW
    late = bench.step()
    assert bench.session.activity is Activity.REVISING
    bench.executed += round(LEAD / T)
    bench.step()
    bench.finish(late)
    bench.now -= 0.1
    bench.finish(bench.step())
    assert bench.session.activity is Activity.PLANNING, 'too little is sent to try it at once'
    bench.now += REFILLING
    bench.step()
    assert bench.session.activity is Activity.REVISING, 'it does not wait for ever'


def test_when_the_last_setpoint_is_sent_nothing_is_revised(bench):
    bench.begin()
    bench.session.see_machine(report())
    for _ in range(200):
        bench.work()
        bench.send()
    bench.executed, bench.session.settings = 990, SLOW
    assert bench.step() is None and bench.session.activity is Activity.PLANNING


@pytest.mark.parametrize('state', [State.HELD, State.STARVED])
def test_a_machine_that_left_the_plan_gets_another_one_from_where_it_rests(bench, state):
    planner = bench.planning(window=60)
    session, left = bench.session, {'plan_over': True, 'path_position': 0.012}
    session.see_machine(report(RUN, State.RUNNING, **left))
    assert session.activity is not Activity.RESUMING
    bench.finish(bench.step())
    session.settings = SLOW
    session.see_machine(report(RUN, state, **left))
    task = bench.step()
    assert session.activity is Activity.RESUMING and session.run_id == RunId('run', plan=1)
    assert bench.port.sender.run_id == session.run_id and session.sent_before == 60
    bench.finish(task)
    assert (planner.resumed, planner.stream.current.settings) == (0.012, SLOW)
    # The machine still reports the plan that is over.
    session.see_machine(report(RUN, state, **left))
    bench.finish(bench.step())
    assert session.activity is Activity.PLANNING and session.run_id.plan == 1


def test_a_machine_that_was_reset_has_given_the_run_up(bench):
    bench.planning(window=60)
    bench.session.see_machine(report(RUN, State.RUNNING))
    bench.session.see_machine(report())
    bench.step()
    assert bench.session.activity is Activity.ENDED
    assert [kind for kind, _ in bench.port.refused] == [Refusal.GIVEN_UP]
    assert not bench.port.sender.run_id, 'nothing is sent again'
    assert bench.step() is None and len(bench.port.refused) == 1


def test_a_machine_that_has_not_begun_the_run_yet_has_not_given_it_up(bench):
    bench.planning(window=60)
    bench.session.see_machine(report(RunId('before'), completed=True))
    assert bench.step() is not None and bench.port.refused == []


def test_a_path_that_cannot_be_planned_is_refused_and_what_is_sampled_is_sent(bench):
    planner = bench.planning(window=60)

    def fail(*_):
        raise PlanningError('block 7 has no finite path')

    planner.work = fail
    bench.finish(bench.step())
    assert bench.session.activity is Activity.ENDED
    assert bench.port.refused == [(Refusal.BAD_PATH, 'block 7 has no finite path')]
    assert bench.port.sender.unsent > 0 and bench.session.planner is planner
    bench.session.see_machine(report(RUN, State.IDLE))
    assert bench.step() is None and len(bench.port.planners) == 1


def test_a_run_begun_again_goes_on_from_where_the_machine_rests_now(bench):
    bench.planning(window=60)
    old = bench.step()
    again = RUN.next_attempt()
    bench.begin(again, place=0.010)
    held = {'plan_over': False, 'path_position': 0.013}
    bench.session.see_machine(report(RUN, State.HELD, **held))
    assert bench.step() is None, 'it may still start with the old plan'
    bench.session.see_machine(report(RUN, State.HELD, start_wanted=True, **held))
    task = bench.step()
    bench.finish(old)
    assert bench.session.task is task, 'a task of the run before is void'
    assert bench.port.planners[-1].place == 0.013


def test_a_first_attempt_does_not_begin_on_a_machine_that_is_held(bench):
    bench.begin(place=-1.0)
    bench.session.see_machine(report(RunId('other'), State.HELD, plan_over=True))
    assert bench.step() is None and bench.session.activity is Activity.WAITING
    bench.session.see_machine(report(RunId('other'), State.STARVED, plan_over=True))
    assert bench.step() is not None
    assert bench.port.planners[-1].place == -1.0, 'not the place in the other program'


def test_every_activity_can_be_reached_and_left():
    reached = set(TABLE.values())
    assert reached == set(Activity) - {Activity.NONE}
    assert {step for _, step in TABLE} == set(Change)
    assert all((activity, Change.BEGIN) in TABLE for activity in Activity)


def test_the_planning_thread_does_one_task_after_another(monkeypatch):
    monkeypatch.setattr(sys, 'setswitchinterval', lambda _: None)
    thread, begun, early = PlanningThread(), Event(), []
    thread.submit(PlanningTask(lambda: early.append(begun.wait(0.05)), None))
    thread.submit(PlanningTask(begun.set, None))
    assert begun.wait(10.0) and early == [False]
    thread.close()
