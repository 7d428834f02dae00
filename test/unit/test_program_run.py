"""One run on the sending side: its phases, its outcomes, and going on after a lost node."""

from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace

import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState, ProbeContact, StreamStatus

from cnc_interp.core import Refusal
from cnc_interp.nodes.program_run import FORGOTTEN, PATIENCE, STARTING, ProgramRun
from cnc_interp.program.motion.probing import Probe
from cnc_interp.run.run_phase import FILLED, SETTLED, TABLE, Code, Phase, PhaseChange
from cnc_interp.run.run_state import AT_REST, RunId, State
from cnc_interp.wire.run_messages import machine_report

HELD, RUNNING, STARVED = MachineState.HELD, MachineState.RUNNING, MachineState.STARVED


class Heard:
    """What the nodes said: all answer and are on the run, nothing is refused."""

    def __init__(self):
        self.machine, self.all_heard = None, True
        self.silent, self.forgot, self.refused = '', '', (Refusal.NONE, '')

    def refusal(self, _run_id):
        return self.refused

    def missing(self, _now, _timeout):
        return self.silent

    def knows(self, stream, _run_id):
        return stream != self.forgot

    def say(self, run, state, time=0.0, **fields):
        """A state of the machine on a run."""
        message = MachineState(
            program_id=run.run_id.program_id, state=state, resting=state != RUNNING, **fields
        )
        message.header.stamp.nanosec = round(time * 1e9)
        self.machine = machine_report(message)


def waiting():
    """A run that is checked and waits for the machine."""
    run, peers = ProgramRun(RunProgram.Goal(text='M30')), Heard()
    run.preparation.prepared = SimpleNamespace(
        notices=(), start=None, waits_first=False, path_length=1.0, probe=None
    )
    assert run.phase is Phase.QUEUED
    run.take_turn(0.0)
    assert run.step(peers, 0.0, 3.0) is None and run.phase is Phase.WAITING
    return run, peers


def streaming():
    """A run that look-ahead and planner have taken."""
    run, peers = waiting()
    peers.machine = machine_report(MachineState(state=MachineState.IDLE))
    assert run.step(peers, 0.0, 3.0) is None and run.phase is Phase.OFFERED
    assert run.step(peers, 0.0, 3.0) is None and run.phase is Phase.STREAMING
    return run, peers


def go_on_at(course):
    """The first time at which the run goes on; states are (time, state, start_wanted)."""
    run, peers = streaming()
    peers.forgot = 'blocks'
    run.step(peers, 0.0, 3.0)
    assert run.phase is Phase.LOST and run.recovery.node == 'lookahead_node'
    for time, code, wanted in course:
        peers.say(run, code, time, start_wanted=wanted, plan_over=code != RUNNING)
        run.step(peers, 0.0, 3.0)
        if run.may_go_on():
            run.begin_again(0.0, 1)
            assert run.phase is Phase.OFFERED and run.run_id.attempt == 1
            return time
    return None


STEP = 0.7 * SETTLED


def test_with_nothing_to_execute_it_goes_on_a_moment_after_cycle_start():
    course = [(0.0, HELD, False), *((0.2 + k * STEP, HELD, True) for k in range(4))]
    assert go_on_at(course) == 0.2 + 2 * STEP


def test_a_machine_that_starts_at_once_executes_first_what_it_has():
    course = [(0.0, HELD, False), (0.1, HELD, True), (0.1 + STEP, RUNNING, False)]
    starved = [(0.5 + k * STEP, STARVED, False) for k in range(4)]
    assert go_on_at(course) is None
    assert go_on_at(course + starved) == 0.5 + 2 * STEP


@pytest.mark.parametrize('code', [HELD, STARVED])
def test_without_cycle_start_it_never_goes_on(code):
    assert go_on_at([(0.0, RUNNING, False), *((k * STEP, code, False) for k in range(9))]) is None


@pytest.mark.parametrize('wanted', [False, True])
def test_a_starved_machine_that_got_a_part_of_its_next_plan_goes_on_after_cycle_start(wanted):
    """Its planner was lost while it filled the buffer again, so the plan is not over."""
    run, peers = streaming()
    peers.forgot = 'segments'
    times = [0.4 * k * FILLED for k in range(7)]
    due = []
    for time in times:
        peers.say(run, STARVED, time, start_wanted=wanted, plan_over=False)
        run.step(peers, 0.0, 3.0)
        due.append(run.may_go_on())
        assert peers.machine.takes(RunId('name', 1, 0)) and not peers.machine.is_free
    assert due == [wanted and time >= 1.2 * FILLED for time in times]


@pytest.mark.parametrize('stream', ['blocks', 'segments'])
def test_a_node_that_was_lost_before_it_was_seen_on_the_run_is_missed(stream):
    """It took the run that began again, and was killed before its acknowledgement was read."""
    run, peers = streaming()
    peers.forgot = stream
    for time in (0.0, 2.0 * SETTLED):
        peers.say(run, HELD, time, start_wanted=True, plan_over=True)
        run.step(peers, 0.0, 3.0)
    assert run.may_go_on()
    run.begin_again(0.0, 1)
    peers.silent = 'feedrate_node'
    assert run.step(peers, 2.0 * PATIENCE, 3.0) is None, 'its return is waited for'
    peers.silent = ''
    for now in (2.1 * PATIENCE, 2.9 * PATIENCE):
        assert run.step(peers, now, 3.0) is None and run.phase is Phase.OFFERED
    assert run.step(peers, 3.0 * PATIENCE + 0.1, 3.0) is None and run.phase is Phase.LOST
    assert run.recovery.node == {'blocks': 'lookahead_node', 'segments': 'feedrate_node'}[stream]
    for time in (5.0, 5.0 + 2.0 * SETTLED):
        peers.say(run, HELD, time, start_wanted=True, plan_over=True)
        run.step(peers, 3.0 * PATIENCE, 3.0)
    assert run.may_go_on()


def rests_by_itself(state, times):
    """The first time at which a run goes on whose machine is in a state in which it rests."""
    run, peers = streaming()
    peers.forgot = 'segments'
    for time in times:
        peers.say(run, MachineState.IDLE, time)
        peers.machine = replace(peers.machine, state=state)
        run.step(peers, 0.0, 3.0)
        if run.may_go_on():
            return time
    return None


@pytest.mark.parametrize('state', [State.PAUSED, State.FILLING, State.IDLE])
def test_a_machine_that_starts_by_itself_needs_no_cycle_start(state):
    """It rests as planned: its buffer fills, or the feed override is 0."""
    assert rests_by_itself(state, [0.4 * k * FILLED for k in range(7)]) == 1.6 * FILLED


def test_a_machine_that_starts_meanwhile_executes_first_what_it_has():
    run, peers = streaming()
    peers.forgot = 'blocks'
    for state, time in ((State.FILLING, 0.0), (State.FILLING, 0.1), (State.RUNNING, 9.0)):
        peers.say(run, RUNNING, time)
        peers.machine = replace(peers.machine, state=state)
        run.step(peers, 0.0, 3.0)
        assert not run.may_go_on()


@pytest.mark.parametrize('state', list(State))
def test_only_a_machine_at_rest_takes_the_rest_of_a_program(state):
    report = replace(machine_report(MachineState()), state=state, plan_over=True)
    for attempt in (0, 1):
        taken = report.takes(RunId('name', attempt, 0))
        assert not taken or state in AT_REST
        if state in (State.PAUSED, State.FILLING):
            assert taken == (attempt > 0)


def test_a_run_that_the_machine_has_not_begun_goes_on_too():
    run, peers = streaming()
    peers.forgot = 'segments'
    for time in (0.0, 0.4, 0.4 + FILLED):
        assert not run.may_go_on()
        peers.machine = machine_report(MachineState(state=MachineState.IDLE, program_id='before'))
        peers.machine = replace(peers.machine, time=time)
        run.step(peers, 0.0, 3.0)
    assert run.may_go_on()
    run.begin_again(0.0, 1)
    assert run.continue_at == 0.0 and run.run_id.attempt == 1


def test_a_run_that_the_machine_has_left_by_reset_never_goes_on_by_itself():
    run, peers = streaming()
    peers.say(run, RUNNING, 0.0)
    run.step(peers, 0.0, 3.0)
    peers.forgot = 'segments'
    for time in (0.1, 1.0, 2.0, 9.0):
        peers.machine = replace(machine_report(MachineState(state=MachineState.IDLE)), time=time)
        run.step(peers, 0.0, 3.0)
        assert run.phase is Phase.LOST and not run.may_go_on()


def test_a_run_waits_for_a_machine_that_is_free_and_not_for_ever():
    run, peers = waiting()
    peers.machine = machine_report(MachineState(state=RUNNING, program_id='other'))
    assert run.step(peers, PATIENCE, 3.0) is None
    assert run.step(peers, PATIENCE + 0.1, 3.0).code is Code.BUSY and run.phase is Phase.ENDED
    run, peers = waiting()
    peers.silent = 'machine_node'
    assert run.step(peers, PATIENCE + 0.1, 3.0).code is Code.STREAM_LOST
    run, peers = waiting()
    # A busy computer took longer to start machine_node, and the first run of all ended.
    peers.silent, peers.all_heard = 'machine_node', False
    assert run.step(peers, STARTING, 3.0) is None
    assert run.step(peers, STARTING + 0.1, 3.0).code is Code.STREAM_LOST
    run, peers = waiting()
    peers.machine = machine_report(MachineState(state=MachineState.JOGGING))
    assert run.step(peers, PATIENCE, 3.0) is None
    assert 'by hand; release the key' in run.step(peers, PATIENCE + 0.1, 3.0).message
    run, peers = waiting()
    peers.machine = machine_report(MachineState(state=MachineState.FAULT))
    assert run.step(peers, 0.0, 3.0).code is Code.STOPPED


def test_a_run_that_nobody_takes_ends():
    run, peers = waiting()
    peers.machine = machine_report(MachineState(state=MachineState.IDLE))
    run.step(peers, 20.0, 3.0)
    peers.forgot = 'blocks'
    assert run.step(peers, 20.0 + PATIENCE, 3.0) is None
    assert run.step(peers, 20.1 + PATIENCE, 3.0).code is Code.BUSY


@pytest.mark.parametrize(
    ('kind', 'unmoved', 'moved'),
    [
        (Refusal.BAD_PATH, Code.REFUSED, Code.REFUSED),
        (Refusal.BAD_MESSAGE, Code.REFUSED, Code.STOPPED),
        (Refusal.NOT_READY, Code.REFUSED, Code.STOPPED),
        (Refusal.GIVEN_UP, Code.STOPPED, Code.STOPPED),
        (Refusal.MACHINE_FAULT, Code.STOPPED, Code.STOPPED),
    ],
)
def test_the_kind_of_a_refusal_decides_the_outcome_once_the_machine_rests(kind, unmoved, moved):
    run, peers = streaming()
    peers.refused = kind, 'why'
    outcome = run.step(peers, 0.0, 3.0)
    assert (outcome.code, outcome.message) == (unmoved, 'why')
    run, peers = streaming()
    peers.refused = kind, 'why'
    peers.say(run, RUNNING)
    assert run.step(peers, 0.0, 3.0) is None
    peers.say(run, HELD)
    assert run.step(peers, 0.0, 3.0).code is moved


def test_a_run_whose_path_was_refused_has_not_succeeded_at_the_end_of_its_sound_part():
    run, peers = streaming()
    peers.refused = Refusal.BAD_PATH, 'block 7'
    peers.say(run, MachineState.IDLE, completed=True)
    assert run.step(peers, 0.0, 3.0).code is Code.REFUSED


def test_a_reset_after_the_end_of_a_run_does_not_undo_its_success():
    run, peers = streaming()
    peers.refused = Refusal.GIVEN_UP, 'given up by reset'
    peers.say(run, MachineState.IDLE, completed=True)
    assert run.step(peers, 0.0, 3.0).code is Code.SUCCEEDED


@pytest.mark.parametrize('code', ['G38.2', 'G38.3'])
def test_a_run_waits_for_the_place_of_the_probe_and_reads_on(code):
    run, peers = streaming()
    first, run.preparation.prepared.probe = run.run_id, Probe(code, 7)
    reason = MachineState.REASON_PROBE
    peers.say(run, MachineState.IDLE, completed=True, reason=reason, commanded_positions=[2.0])
    assert run.step(peers, 0.0, 3.0) is None and run.probed is None, 'its message may be later'
    run.contact = ProbeContact(positions=[1.0])
    assert run.step(peers, 0.1, 3.0) is None
    assert [list(place) for place in run.probed] == [[2.0], [1.0]]
    run.preparation.prepared.blocks = SimpleNamespace(close=lambda: None)
    run.read_on(Future(), MachineState(program_id=first.program_id), 5, 0.2)
    assert run.phase is Phase.CHECKING and run.run_id != first and run.sent_in_parts == 4
    run.preparation.prepared = SimpleNamespace(path_length=1.0, is_own_setup=False, setup=1)
    run.phase = Phase.WAITING
    assert not run.is_stale(2), 'what has run is not read again'


@pytest.mark.parametrize('code', ['G38.2', 'G38.3'])
def test_without_an_answer_only_some_codes_go_on(code):
    run, peers = streaming()
    run.preparation.prepared.probe = Probe(code, 7)
    peers.say(run, MachineState.IDLE, completed=True, commanded_positions=[2.0])
    outcome = run.step(peers, 0.0, 3.0)
    if code == 'G38.2':
        assert outcome.code is Code.STOPPED and 'line 7: G38.2' in outcome.message
    else:
        assert outcome is None and run.probed[1] is None


def test_functions_without_motion_are_done_when_the_machine_has_set_them():
    run, peers = waiting()
    run.preparation.prepared.path_length, run.preparation.prepared.functions = 0.0, [1, 2]
    peers.say(run, MachineState.IDLE)
    assert run.step(peers, 0.0, 3.0) is None and run.phase is Phase.OFFERED
    run.answer = Future()
    assert run.step(peers, 0.05, 3.0) is None
    run.answer.set_result(SimpleNamespace(success=True, message=''))
    assert run.step(peers, 0.05, 3.0) is None, 'its state may be an old one'
    peers.say(run, MachineState.IDLE, functions=2)
    assert run.step(peers, 0.2, 3.0).code is Code.SUCCEEDED
    assert run.phase is Phase.ENDED


def test_a_run_that_the_machine_has_left_ends_and_a_refusal_says_more():
    for refusal in ((Refusal.NONE, ''), (Refusal.GIVEN_UP, 'given up by reset')):
        run, peers = streaming()
        peers.say(run, RUNNING)
        assert run.step(peers, 0.0, 3.0) is None
        peers.machine = machine_report(MachineState(state=MachineState.IDLE))
        assert run.step(peers, 0.9 * FORGOTTEN, 3.0) is None, 'a reason may come yet'
        peers.refused = refusal
        outcome = run.step(peers, 1.1 * FORGOTTEN, 3.0)
        assert outcome.code is Code.STOPPED and (refusal[1] or 'started again') in outcome.message


def test_codes_and_phases_are_complete():
    assert RunProgram.Result().code == Code.STREAM_LOST  # of a node that does not know the goal
    assert all(getattr(RunProgram.Result, code.name) == code for code in Code)
    assert all(getattr(StreamStatus, kind.name) == kind for kind in Refusal if kind < Refusal.GAP)
    assert set(TABLE.values()) == set(Phase) - {Phase.QUEUED}
    assert {step for _, step in TABLE} == set(PhaseChange)
