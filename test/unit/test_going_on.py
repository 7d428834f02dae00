"""When the rest of a program is sent again behind a lost node: not while the machine may move."""

import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState

from cnc_interp.core.errors import Refusal
from cnc_interp.nodes.program_run import SETTLED, ProgramRun

HELD, RUNNING, STARVED = MachineState.HELD, MachineState.RUNNING, MachineState.STARVED


def waits_for(code, wanted):
    if code == RUNNING:
        return MachineState.WAITS_FOR_NOTHING
    held = code == HELD and not wanted
    return MachineState.WAITS_FOR_CYCLE_START if held else MachineState.WAITS_FOR_NEW_PLAN


class Heard:
    """What the nodes said: the look-ahead was restarted and has forgotten the run."""

    def __init__(self):
        self.state = None
        self.restarted = False

    def refusal(self, _run_id):
        return Refusal.NONE, ''

    def missing(self, _now, _timeout):
        return ''

    def knows(self, stream, _run_id):
        return not (self.restarted and stream == 'blocks')


def go_on_at(course):
    """The first time at which the run goes on; states are (time, state, start_wanted)."""
    run, peers = ProgramRun(RunProgram.Goal(text='M30')), Heard()
    for restarted in (False, True):
        peers.restarted = restarted
        run.watch(peers, 0.0, 3.0)
    assert run.lost == 'lookahead_node'
    for time, code, wanted in course:
        peers.state = MachineState(
            program_id=run.run_id.program_id,
            state=code,
            start_wanted=wanted,
            plan_over=code != RUNNING,
            resting=code != RUNNING,
            waits_for=waits_for(code, wanted),
        )
        peers.state.header.stamp.nanosec = round(time * 1e9)
        run.watch(peers, 0.0, 3.0)
        if run.may_go_on():
            return time
    return None


STEP = 0.7 * SETTLED


def test_with_nothing_to_execute_it_goes_on_a_moment_behind_cycle_start():
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
