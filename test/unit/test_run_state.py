"""The state of a run: its table, what it waits for, and its copy in messages and docs."""

import re
from itertools import product
from pathlib import Path

import pytest
from cnc_interp_msgs.msg import MachineState

from cnc_interp.core import StreamError
from cnc_interp.nodes.machine_node import LEVELS
from cnc_interp.run.run_state import (
    AT_REST,
    TEXTS,
    TRANSITIONS,
    Event,
    Reason,
    RunState,
    State,
    WaitsFor,
)
from cnc_interp.wire.run_messages import NUMBERS, machine_report, state_of

MOVING = set(State) - AT_REST
ROOT = Path(__file__).parents[2]
OPERATION = ROOT / 'docs' / 'operate' / 'operation.md'
STYLE = ROOT / 'cnc_interp' / 'page' / 'style.css'


def test_every_pair_of_state_and_event():
    for state, event in product(State, Event):
        before = RunState(state)
        if (state, event) in TRANSITIONS:
            assert before.after(event).state is TRANSITIONS[state, event]
        else:
            with pytest.raises(StreamError):
                before.after(event)


def test_the_docs_explain_each_state():
    rows = [line.split('|') for line in OPERATION.read_text(encoding='utf-8').splitlines()]
    told = {row[1].strip() for row in rows if len(row) == 4}
    assert told >= {state.value for state in State}


@pytest.mark.parametrize('state', State)
def test_every_state_is_read_from_the_messages_again(state):
    run = RunState(state)
    message = MachineState(
        state=NUMBERS[state],
        resting=run.resting,
        waits_for=run.waits_for,
        plan_over=run.plan_over,
        resume_positions=[0.0] * 5 if state is State.AWAY else [],
    )
    assert state_of(message) is state


def test_what_fills_its_buffer_before_the_first_block_is_no_alarm():
    filling = RunState(State.RUNNING).after(Event.FILL)
    assert filling.state not in LEVELS and filling.reason is Reason.NONE
    assert filling.may_start and not filling.may_resume
    assert filling.waits_for is WaitsFor.SETPOINTS
    report = machine_report(MachineState(state=NUMBERS[filling.state], resting=True))
    assert report.moves and not report.is_free


def test_setpoints_refused_during_a_stop_do_not_hide_its_reason():
    stops = RunState(State.RUNNING).after(Event.STOP, Reason.EMERGENCY_STOP)
    rests = stops.after(Event.REFUSE, detail='the machine is stopping').after(Event.REST)
    assert (rests.state, rests.reason) == (State.FAULT, Reason.EMERGENCY_STOP)
    assert 'reset' in rests.text and 'stopping' not in rests.text


def test_the_page_has_a_colour_for_every_state_of_a_run():
    coloured = set(re.findall(r'\.state\.(\w+)', STYLE.read_text(encoding='utf-8')))
    assert coloured - {'silent'} == {s.value for s in State} - {'idle', 'inactive'}


def test_the_table_by_its_meaning():
    reached = {State.INACTIVE}
    for _ in State:
        reached |= {after for (before, _), after in TRANSITIONS.items() if before in reached}
    assert reached == set(State)
    assert {e for s, e in TRANSITIONS if s is State.FAULT} == {
        Event.RESET,
        Event.DEACTIVATE,
        Event.FAIL,
        Event.STOP,
        Event.REFUSE,
    }
    assert {e for s, e in TRANSITIONS if s is State.INACTIVE} == {Event.ACTIVATE, Event.REFUSE}
    for state in MOVING:  # whatever moves can fail; it is not switched off, reset or replanned
        assert TRANSITIONS[state, Event.STOP] is State.STOPPING
        assert TRANSITIONS[state, Event.FAIL] is State.FAULT
        assert not {e for s, e in TRANSITIONS if s is state} & {
            Event.DEACTIVATE,
            Event.RESET,
            Event.BEGIN,
            Event.REPLAN,
        }
    # Motion begins by START and by JOG only, and never without the table: from rest on the path
    # or idle, by hand from a hold or idle.
    begins = {(s, e) for (s, e), to in TRANSITIONS.items() if s in AT_REST and to in MOVING}
    assert {e for _, e in begins} == {Event.START, Event.JOG}
    assert {s for s, e in begins if e is Event.JOG} == {State.IDLE, State.HELD}


def test_motion_by_hand_leaves_an_idle_machine_and_no_alarm():
    jogging = RunState(State.IDLE).after(Event.JOG)
    assert not jogging.leaves_plan and not jogging.may_start and not jogging.may_resume
    assert jogging.after(Event.FINISH) == jogging.after(Event.REFUSE).after(Event.REST)
    assert jogging.after(Event.STARVE).after(Event.REST).state is State.IDLE
    held = jogging.after(Event.HOLD, Reason.FEED_HOLD)
    assert held.leaves_plan and not held.after(Event.REST).text and not held.text
    assert held.after(Event.REST).reason is Reason.FEED_HOLD
    assert held.after(Event.REST).after(Event.JOG) == jogging
    with pytest.raises(StreamError, match='feed override'):
        RunState(State.RUNNING).after(Event.PAUSE, Reason.OVERRIDE).after(Event.JOG)


def test_motion_by_hand_away_from_a_hold_ends_held_without_a_plan():
    held = held_by(Event.WAIT, Reason.PROGRAM_STOP)
    away = held.after(Event.JOG)
    assert away.state is State.AWAY and not (away.resting or away.leaves_plan or away.plan_over)
    rests = away.after(Event.FINISH)
    assert rests == RunState(State.HELD, Reason.AWAY, plan_over=True) and not rests.completed
    assert rests == away.after(Event.STARVE, Reason.STARVED).after(Event.REST)
    stopped = away.after(Event.HOLD, Reason.FEED_HOLD)
    assert stopped.leaves_plan and stopped.after(Event.REST).reason is Reason.FEED_HOLD
    assert away.after(Event.REFUSE, detail='bad').after(Event.REST).state is State.FAULT
    assert away.after(Event.STOP).after(Event.REST).state is State.FAULT
    with pytest.raises(StreamError, match='when they rest'):
        away.after(Event.RESUME)
    with pytest.raises(StreamError, match='feed hold takes it back'):
        rests.after(Event.RESUME).after(Event.JOG)


def held_by(event, reason):
    return RunState(State.RUNNING).after(event, reason)


def test_a_hold_waits_for_cycle_start_then_for_a_new_plan_then_for_setpoints():
    state = held_by(Event.HOLD, Reason.FEED_HOLD)
    assert not state.resting and state.leaves_plan and state.waits_for is WaitsFor.NOTHING
    state = state.after(Event.REST)
    assert state.resting and state.plan_over and state.waits_for is WaitsFor.CYCLE_START
    assert state.may_resume and not state.may_start
    state = state.after(Event.RESUME)
    assert state.waits_for is WaitsFor.NEW_PLAN and state.may_start
    state = state.after(Event.REPLAN)
    assert state.waits_for is WaitsFor.SETPOINTS and state.start_wanted
    assert state.reason is Reason.FEED_HOLD
    state = state.after(Event.START)
    assert state == RunState(State.RUNNING)


def test_another_hold_takes_cycle_start_back():
    state = held_by(Event.WAIT, Reason.PROGRAM_STOP).after(Event.RESUME).after(Event.HOLD)
    assert state.waits_for is WaitsFor.CYCLE_START and state.reason is Reason.PROGRAM_STOP
    starved = held_by(Event.STARVE, Reason.STARVED).after(Event.REST).after(Event.RESUME)
    assert starved.after(Event.HOLD, Reason.FEED_HOLD).waits_for is WaitsFor.CYCLE_START


def test_a_pause_for_the_override_starts_by_itself():
    state = held_by(Event.PAUSE, Reason.OVERRIDE)
    assert state.waits_for is WaitsFor.OVERRIDE and state.may_start and not state.plan_over
    assert state.after(Event.RESUME) == state and not state.may_resume


@pytest.mark.parametrize('event', [Event.HOLD, Event.STARVE])
def test_a_refused_stream_ends_in_a_fault_at_rest(event):
    state = RunState(State.RUNNING).after(Event.REFUSE, detail='a setpoint is not finite')
    assert state.state is State.RUNNING, 'what is sound is executed'
    state = state.after(event, Reason.FEED_HOLD).after(Event.REST)
    assert (state.state, state.reason) == (State.FAULT, Reason.STREAM_REFUSED)
    assert state.text == 'a setpoint is not finite' and state.waits_for is WaitsFor.RESET
    at_rest = held_by(event, Reason.FEED_HOLD).after(Event.REST)
    assert at_rest.after(Event.REFUSE, detail='a setpoint is not finite') == state


def test_what_is_not_possible_is_said_in_the_operators_words():
    idle, fault = RunState(State.IDLE), RunState(State.IDLE).after(Event.STOP, Reason.DRIVE_FAULT)
    for state, event, words in (
        (idle, Event.HOLD, 'nothing to hold'),
        (idle, Event.RESUME, 'nothing to continue'),
        (fault, Event.RESUME, 'nothing to continue.*fault of a drive'),
        (RunState(State.RUNNING), Event.RESET, 'still moving'),
        (RunState(), Event.HOLD, 'drives are off'),
    ):
        with pytest.raises(StreamError, match=words):
            state.after(event)


def test_every_reason_has_a_text():
    assert set(TEXTS) == set(Reason)
    for reason in Reason:
        assert bool(RunState(State.FAULT, reason, '12').text) is (reason is not Reason.NONE)


def test_the_messages_have_the_same_constants():
    messages = pytest.importorskip('cnc_interp_msgs.msg', reason='needs ROS 2')
    state = messages.MachineState
    for name, kind in (('REASON', Reason), ('WAITS_FOR', WaitsFor)):
        assert {entry.name: entry.value for entry in kind} == {
            entry.name: getattr(state, f'{name}_{entry.name}') for entry in kind
        }
    assert state.STOPPED == state.STOPPING
