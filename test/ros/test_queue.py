"""Programs that wait: their order, their motion one after the other, cancelled and refused."""

import time

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState
from limit_use import limit_use
from operated import LIMITS, T, path_of, waves

from cnc_interp.client.run_request import RunRequest
from cnc_interp.client.session import run_session
from cnc_interp.kinematics.axis_path import evaluate

Result = RunProgram.Result
FIRST, SECOND = waves(3), waves(2)


def send(bench, text=None, **goal):
    """Send a goal; returns its handle, and what it is told while it waits."""
    (sent,) = send_together(bench, {'text': text or '', **goal})
    return sent


def send_together(bench, *goals):
    """Send goals before the first is accepted; returns handle and feedback of each."""
    told = [[] for _ in goals]
    accepted = [
        bench.action.send_goal_async(
            RunProgram.Goal(**goal), lambda m, heard=heard: heard.append(m.feedback)
        )
        for goal, heard in zip(goals, told, strict=True)
    ]
    bench.spin_until(lambda: all(each.done() for each in accepted))
    return [(each.result(), heard) for each, heard in zip(accepted, told, strict=True)]


def setpoints_of(bench, result):
    """What the drives were told in one run, on its path from end to end."""
    count = result.samples + round(result.approach_time / T)

    def told():
        return [m for m in bench.executed if m.program_id == result.program_id]

    bench.spin_until(lambda: sum(len(m.sequences) for m in told()) >= count)
    q = np.concatenate([np.reshape(m.positions, (-1, 5)) for m in told()])
    return q, np.concatenate([m.path_positions for m in told()])


@pytest.fixture
def bench(shared_nodes):
    shared_nodes.tidy()
    return shared_nodes


def test_programs_that_wait_run_in_their_order_and_nothing_is_lost_between_them(bench, tmp_path):
    files = []
    for name, text in (('a.ngc', FIRST), ('b.ngc', SECOND), ('c.ngc', FIRST)):
        files.append(tmp_path / name)
        files[-1].write_text(text)
    sent = [send(bench, program=str(file)) for file in files]
    told = 'running a.ngc; then b.ngc, c.ngc'
    bench.spin_until(lambda: any(told in text for _, text in bench.diagnostics))
    results = [bench.result_of(handle) for handle, _ in sent]
    assert [result.code for result in results] == [Result.SUCCEEDED] * 3
    assert [loaded.name for loaded in bench.loaded[-3:]] == ['a.ngc', 'b.ngc', 'c.ngc']
    ahead = [[f.programs_ahead for f in told] for _, told in sent]
    assert set(ahead[0]) == {0} and {1, 0} <= set(ahead[1]) and {2, 1, 0} <= set(ahead[2])
    assert all(list(seen) == sorted(seen, reverse=True) for seen in ahead)

    parts = [setpoints_of(bench, result) for result in results]
    runs = list(dict.fromkeys(m.program_id for m in bench.executed))
    assert runs == [result.program_id for result in results], 'one after the other'
    for (q, s), text in zip(parts, (FIRST, SECOND, FIRST), strict=True):
        path = path_of(text)
        assert np.abs(q[s >= 0.0] - evaluate(path, s[s >= 0.0])[0]).max() < 1e-9
        assert abs(s[-1] - path.s[-1]) < 1e-12
    whole = np.concatenate([q for q, _ in parts])
    assert limit_use(whole, LIMITS) <= 1.001


@pytest.mark.thorough
def test_a_program_cancelled_while_it_waits_leaves_the_queue_and_the_others_move_up(bench):
    first, second, third = (send(bench, text)[0] for text in (FIRST, SECOND, SECOND))
    bench.spin_until(lambda: bench.peers.state.state == MachineState.RUNNING)
    second.cancel_goal_async()
    result = bench.result_of(second)
    assert (result.code, result.samples) == (Result.CANCELED, 0)
    assert bench.next_state().state == MachineState.RUNNING, 'the first is not touched'
    assert bench.result_of(first).code == bench.result_of(third).code == Result.SUCCEEDED


@pytest.mark.thorough
def test_a_wrong_program_is_refused_while_it_waits_and_those_after_it_are_not_started(bench):
    ended = send(bench, waves(6))[0].get_result_async()
    texts = waves(400).replace('M30', 'G1 X1 F0\nM30'), SECOND
    (wrong, _), (following, _) = send_together(bench, *({'text': text} for text in texts))
    assert bench.result_of(wrong).code == Result.BAD_PROGRAM
    result = bench.result_of(following)
    assert result.code == Result.NOT_STARTED and 'did not reach its end' in result.message
    assert not ended.done(), 'told while the first runs'
    bench.spin_until(ended.done)
    assert ended.result().result.code == Result.SUCCEEDED


@pytest.mark.thorough
@pytest.mark.parametrize('how', ['cancel', 'emergency_stop'])
def test_nothing_starts_after_a_program_that_was_stopped(bench, how):
    first, second = send(bench, FIRST)[0], send(bench, SECOND)[0]
    bench.until_at(0.01)
    if how == 'cancel':
        first.cancel_goal_async()
    else:
        assert bench.press(how).success
    code = bench.result_of(first).code
    assert code == (Result.CANCELED if how == 'cancel' else Result.STOPPED)
    result = bench.result_of(second)
    assert (result.code, result.samples) == (Result.NOT_STARTED, 0)
    state = bench.next_state()
    until = time.monotonic() + 1.0
    bench.spin_until(lambda: time.monotonic() > until)
    assert bench.next_state().commanded_positions == state.commanded_positions


@pytest.mark.thorough
def test_run_takes_several_programs(tmp_path):
    first, second = tmp_path / 'a.ngc', tmp_path / 'b.ngc'
    first.write_text(FIRST)
    second.write_text(SECOND)
    results = run_session(RunRequest(first, then=(second,), quiet=True))
    assert [(r.ok, r.program) for r in results] == [(True, str(first)), (True, str(second))]
    assert results[0].blocks_executed > results[1].blocks_executed > 0
