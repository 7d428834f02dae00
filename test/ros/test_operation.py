"""Real processes: hold, override, single block, stops, nodes frozen and killed in motion."""

import os
import re
import signal
import time

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

import faulty_node
from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState
from limit_use import limit_use
from operated import LIMITS, MACHINE, PROGRAM, TRANSFORM, Bench, T, blocks_of, path_of, waves
from std_msgs.msg import Float64

from cnc_interp.core import InterpError
from cnc_interp.kinematics.axis_path import evaluate
from cnc_interp.nodes.program_run import LINES_AHEAD
from cnc_interp.nodes.seals import RECEIVERS
from cnc_interp.processes.node_processes import NODES
from cnc_interp.run.run_state import NO_RUN, RunId
from cnc_interp.wire.path_messages import block_messages
from cnc_interp.wire.run_messages import run_id_of

Result = RunProgram.Result
PROGRAM_NODE = 'program_node: program'  #: Name of its diagnostics.


@pytest.fixture
def bench(shared_nodes):
    yield shared_nodes
    shared_nodes.tidy()


@pytest.mark.thorough
def test_hold_and_resume(bench):
    handle = bench.begin()
    for length in (0.01, 0.05, 0.09):
        bench.until_at(length)
        before = bench.state
        bench.states.clear()
        assert bench.press('feed_hold').success
        bench.until_state(MachineState.HELD)
        held = bench.state
        bench.spin_until(lambda plan=before.plan: bench.state.plan > plan)  # the next is there
        bench.spin_for(0.05)
        assert bench.state.state == MachineState.HELD
        assert held.path_position > before.path_position
        assert bench.state.commanded_positions == held.commanded_positions
        assert bench.press('cycle_start').success
    bench.finish(handle)


def test_a_program_started_at_an_override_of_0_begins_when_it_is_raised(bench):
    bench.override.publish(Float64(data=0.0))
    bench.spin_until(lambda: bench.state.feed_override == 0.0)
    bench.text = waves(1)
    handle = bench.start(text=bench.text)
    begun = r'planning <text>: (\d+) of \1 blocks accepted, 0% of the motion needed to start'
    bench.spin_until(lambda: any(re.fullmatch(begun, text) for _, text in bench.diagnostics))
    bench.override.publish(Float64(data=1.0))
    bench.finish(handle)


@pytest.mark.parametrize(
    ('how', 'code', 'says'),
    [
        ('emergency_stop', Result.STOPPED, 'emergency stop'),
        ('reset', Result.STOPPED, 'given up by reset'),
        ('cancel', Result.CANCELED, 'before anything moved'),
    ],
)
def test_a_program_that_is_stopped_before_it_moves_ends_and_does_not_move_after_a_reset(
    bench, how, code, says
):
    """The machine had no setpoint of it, and the goal stayed for ever."""
    bench.override.publish(Float64(data=0.0))
    bench.spin_until(lambda: bench.state.feed_override == 0.0)
    heard = len(bench.diagnostics)
    handle = bench.start(text=waves(1))
    bench.spin_until(lambda: any(t.startswith('planning') for _, t in bench.diagnostics[heard:]))
    stands = list(bench.state.commanded_positions)
    if how == 'cancel':
        handle.cancel_goal_async()
    else:
        assert bench.press(how).success
    result = bench.result_of(handle)
    assert result.code == code and says in result.message and result.samples == 0
    bench.override.publish(Float64(data=1.0))
    assert bench.press('reset').success
    bench.until_state(MachineState.IDLE)
    bench.spin_until(lambda: bench.state.feed_override == 1.0)
    bench.spin_for(1.0)
    assert list(bench.next_state().commanded_positions) == stands
    bench.finish(bench.begin(waves(1)))


@pytest.mark.thorough
def test_a_program_runs_while_the_clock_of_ros_stands():
    still = ['-p', 'use_sim_time:=true']  # nobody publishes /clock
    bench = Bench(arguments=dict.fromkeys(NODES, still))
    try:
        assert bench.run(text=waves(1)).code == Result.SUCCEEDED
    finally:
        bench.close()


@pytest.mark.thorough
def test_override_up_and_down_and_zero(bench):
    handle = bench.begin()
    for length, value in ((0.01, 0.3), (0.02, 1.5), (0.04, 0.0)):
        bench.until_at(length)
        bench.override.publish(Float64(data=value))
    bench.spin_until(lambda: bench.state.path_position > 0.04)
    seen = []

    def rests():
        seen.append(bench.state.path_position)
        return len(seen) > 40 and seen[-1] == seen[-40]

    bench.spin_until(rests)
    # A busy computer may have sent too little before the override came; it goes on by itself.
    assert bench.state.state in (MachineState.RUNNING, MachineState.STARVED)
    bench.override.publish(Float64(data=9.0))
    bench.spin_until(lambda: any('feed_override is 9' in text for _, text in bench.diagnostics))
    bench.override.publish(Float64(data=1.0))
    bench.finish(handle)


@pytest.mark.thorough
def test_rapids_follow_their_override_and_cutting_does_not(bench):
    for value in (7.0, 0.25):
        bench.rapid.publish(Float64(data=value))
    bench.spin_until(lambda: bench.state.rapid_override == 0.25)
    bench.spin_until(lambda: any('rapid_override is 7' in text for _, text in bench.diagnostics))
    handle = bench.begin('G21 G90 G94\nTRAORI\nG0 X50 Y0 Z0 A10 C0\nG1 X60 F3000\nG0 X-50\nM30\n')
    bench.finish(handle)
    q, s = bench.recorded()
    use = (np.abs(np.diff(q, axis=0)) / 0.001 / LIMITS[0]).max(axis=1)
    assert 0.249 < use.max() <= 0.25 * 1.001
    cutting = np.diff(s)[(s[1:] > 0.0) & (s[1:] < 0.01)] / 0.001
    assert cutting.max() == pytest.approx(50e-3, rel=1e-3)


@pytest.mark.thorough
def test_a_restarted_feedrate_node_knows_the_override(bench):
    bench.override.publish(Float64(data=0.5))
    bench.spin_until(lambda: bench.state.feed_override == 0.5)
    bench.kill('feedrate_node')
    bench.children.revive()
    bench.watching = True
    bench.text = 'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A10 C0\nG1 X20 F3000\nM30\n'
    bench.executed.clear()
    _, s = bench.finish(bench.start(text=bench.text))
    assert abs(np.diff(s[s >= 0.0]).max() / 0.001 - 0.5 * 50e-3) < 50e-6


@pytest.mark.thorough
def test_single_block_rests_after_every_block(bench):
    handle = bench.begin()
    bench.until_at(0.03)
    bench.single_block(True)
    lines = []
    for is_on in (True, True, False):
        bench.until_state(MachineState.HELD)
        lines.append(bench.next_state().line_number)
        bench.single_block(is_on)
        assert bench.press('cycle_start').success
        bench.spin_until(lambda: bench.state.state != MachineState.HELD)
    assert lines == list(range(lines[0], lines[0] + 3))
    bench.finish(handle)


@pytest.mark.thorough
def test_single_block_rests_at_the_programmed_ends_of_lines(bench):
    """Lines that are sent while it is on end with exact stops; later ones are rounded again."""
    blocks = blocks_of(PROGRAM)
    bench.single_block(True)
    bench.spin_until(lambda: bench.state.single_block)
    bench.executed.clear()
    handle = bench.start(text=PROGRAM)
    for rests in range(4):
        bench.until_state(MachineState.HELD)
        state = bench.next_state()
        end = blocks.tip[blocks.line_number == state.line_number][-1]
        tip = TRANSFORM.forward(np.array([state.commanded_positions]))[0][0]
        assert np.linalg.norm(tip - end) < 1e-8
        told = f'rests 0.000 mm from the end of line {state.line_number}'
        bench.spin_until(lambda told=told: told in dict(bench.diagnostics)[PROGRAM_NODE])
        bench.single_block(rests < 3)
        assert bench.press('cycle_start').success
        bench.spin_until(lambda: bench.state.state != MachineState.HELD)
    assert bench.result_of(handle).code == Result.SUCCEEDED
    run = bench.heard_whole()
    q = np.concatenate([np.reshape(m.positions, (-1, 5)) for m in bench.told(run)])
    assert limit_use(q, LIMITS) <= 1.001
    tips = TRANSFORM.forward(q)[0]
    ends = blocks.tip[np.append(np.diff(blocks.line_number) > 0, False)][1:]
    near = [np.linalg.norm(tips - end, axis=1).min() for end in ends]
    reached = np.flatnonzero(np.array(near) < 1e-8)
    sent = 4 + LINES_AHEAD  # at least: on a busy computer the machine waits, and asks for more
    assert reached[:sent].tolist() == list(range(sent)), near
    assert len(reached) < len(ends), near


@pytest.mark.thorough
@pytest.mark.parametrize(('optional', 'expected'), [(False, [6]), (True, [6, 10])])
def test_program_stops_wait_for_cycle_start(bench, optional, expected):
    lines = PROGRAM.splitlines()
    text = '\n'.join(
        [*lines[:6], 'M0', *lines[6:9], 'M1', *lines[9:-1], 'M0', 'M30', '']
    )  # the last one ends the program
    path = path_of(text)
    bench.optional_stop(optional)
    handle = bench.begin(text)
    held = []
    for reason in ('program stop', 'optional stop')[: len(expected)]:
        bench.until_state(MachineState.HELD)
        state = bench.next_state()
        held.append(state.line_number)
        assert state.message.startswith(reason)
        assert np.abs(path.s[path.stop] - state.path_position).min() < 1e-9
        assert bench.press('cycle_start').success
        bench.spin_until(lambda: bench.state.state != MachineState.HELD)
    bench.optional_stop(False)
    bench.finish(handle)
    assert held == expected


def test_emergency_stop_ends_on_the_path_and_reset_allows_the_next_run(bench):
    handle = bench.begin()
    bench.until_at(0.03)
    assert bench.press('emergency_stop').success
    result = bench.result_of(handle)
    assert result.code == Result.STOPPED and 'emergency stop' in result.message
    bench.recorded()
    assert not bench.press('cycle_start').success
    assert bench.run(text=PROGRAM).code == Result.STOPPED
    assert bench.press('reset').success
    bench.until_state(MachineState.IDLE)
    bench.finish(bench.begin(waves(1)))


@pytest.mark.thorough
def test_cancelling_holds_on_the_path_and_gives_the_run_up(bench):
    handle = bench.begin()
    bench.until_at(0.03)
    handle.cancel_goal_async()
    result = bench.result_of(handle)
    assert result.code == Result.CANCELED
    assert 0 < result.blocks_executed < len(blocks_of(PROGRAM)) - 1
    bench.until_state(MachineState.IDLE)
    bench.finish(bench.begin())


@pytest.mark.thorough
@pytest.mark.parametrize('node', ['feedrate_node', 'lookahead_node', 'program_node'])
def test_a_frozen_node_leaves_the_machine_on_the_path_and_goes_on(bench, node):
    handle = bench.begin()
    bench.until_at(0.01)
    process = bench.children.nodes[node].process.pid
    os.kill(process, signal.SIGSTOP)
    try:
        if node == 'feedrate_node':
            bench.until_state(MachineState.STARVED)
            bench.spin_until(lambda: bench.state.plan_over)
        else:
            bench.spin_until(lambda: bench.state.path_position > 0.05)
    finally:
        os.kill(process, signal.SIGCONT)
    bench.finish(handle)


@pytest.mark.parametrize(
    'node', ['feedrate_node', pytest.param('lookahead_node', marks=pytest.mark.thorough)]
)
def test_a_killed_node_is_restarted_and_cycle_start_goes_on_from_the_stopped_point(bench, node):
    handle = bench.begin()
    bench.until_at(0.01)
    bench.kill(node)
    if node == 'lookahead_node':  # short enough to be planned to its end without more segments
        bench.press('feed_hold')
    bench.spin_until(lambda: bench.state.plan_over)
    stopped = bench.next_state()
    assert list(bench.children.revive()) == [node]
    bench.spin_until(lambda: any('was restarted' in text for _, text in bench.diagnostics))
    assert bench.next_state().commanded_positions == stopped.commanded_positions
    assert bench.press('cycle_start').success
    bench.finish(handle)


@pytest.mark.thorough
def test_a_node_with_a_fault_of_ours_is_restarted_and_the_same_fault_again_is_told(
    tmp_path, monkeypatch
):
    ask = faulty_node.put_in(monkeypatch, tmp_path)
    bench = Bench()
    try:
        handle = bench.begin()
        bench.until_at(0.01)
        bench.watching = False
        process = bench.children.nodes['feedrate_node'].process
        ask.touch()
        bench.spin_until(lambda: process.exitcode is not None)
        bench.spin_until(lambda: bench.state.plan_over)
        told = bench.children.revive()
        assert told['feedrate_node'].endswith('ZeroDivisionError: float division by zero')
        assert 'in faulty' in bench.children.faults['feedrate_node']
        bench.spin_until(lambda: any('was restarted' in text for _, text in bench.diagnostics))
        assert bench.press('cycle_start').success
        bench.finish(handle)
        process = bench.children.nodes['feedrate_node'].process
        ask.touch()
        bench.spin_until(lambda: process.exitcode is not None)
        with pytest.raises(InterpError, match='feedrate_node ended: ZeroDivisionError'):
            bench.children.revive()
    finally:
        bench.close()


@pytest.mark.thorough
@pytest.mark.parametrize(
    ('fault', 'moves', 'told'),
    [
        (faulty_node.live_deaf, True, 'machine_node does not receive the setpoints'),
        (faulty_node.live_deaf, False, 'machine_node does not receive the setpoints'),
        (
            faulty_node.live_unaware,
            False,
            'feedrate_node does not receive messages of machine_node',
        ),
    ],
)
def test_a_run_of_nodes_that_do_not_hear_each_other_ends(
    tmp_path, monkeypatch, fault, moves, told
):
    """On a computer that was far too busy its goal never ended, for DDS had lost one direction."""
    ask = faulty_node.put_in(monkeypatch, tmp_path, fault)
    bench = Bench()
    try:
        if moves:
            handle = bench.begin()
            bench.until_at(0.01)
        ask.touch()
        if not moves:
            handle = bench.begin()
        result = bench.result_of(handle)
        assert result.code == Result.STOPPED and told in result.message
        if moves:
            bench.recorded()
        ask.unlink()
        if moves:
            assert bench.press('reset').success
        assert bench.run(text=waves(1)).code == Result.SUCCEEDED
    finally:
        bench.close()


def test_a_machine_node_that_is_to_end_in_motion_comes_to_rest_on_the_path(bench):
    handle = bench.begin()
    bench.until_at(0.01)
    bench.watching = False
    machine = bench.children.nodes['machine_node'].process

    def told():
        return [m for m in bench.executed if m.program_id == bench.state.program_id]

    machine.terminate()
    bench.spin_until(lambda: machine.exitcode is not None)
    # A busy computer may have sent too little before the node was told to end.
    rests = (MachineState.HELD, MachineState.STARVED)
    bench.spin_until(lambda: bench.state.state in rests and bench.state.resting)
    bench.spin_until(lambda: sum(len(m.sequences) for m in told()) == bench.state.samples)
    q = np.concatenate([np.reshape(m.positions, (-1, 5)) for m in told()])
    s = np.concatenate([m.path_positions for m in told()])
    bench.start_again('machine_node')
    assert bench.result_of(handle).code in (Result.STREAM_LOST, Result.STOPPED)
    path, on = path_of(PROGRAM), s >= 0.0
    assert machine.exitcode == 0
    assert 0.01 < s[-1] < path.s[-1] - 0.01
    assert np.abs(q[on] - evaluate(path, s[on])[0]).max() < 1e-9
    moved = np.abs(np.diff(q, axis=0))
    # What jerk leaves of the last period before a rest: J T^3 / 6.
    assert (moved[-1] <= 1.001 * MACHINE.max_jerk * T**3 / 6.0).all() and moved[-100:].max() > 1e-6
    assert limit_use(q, LIMITS) <= 1.001


def lose(bench, node):
    """Kill a node, start it again, wait until its run is known to be lost.

    If program_node had not heard yet that the node had the run, the next process takes the run as
    the first one would have done, whichever attempt it is, and nobody is told.
    """
    stream = next(stream for stream, receiver in RECEIVERS.items() if receiver == node)
    bench.diagnostics.clear()
    bench.kill(node)
    bench.peers._status.pop(stream, None)
    assert list(bench.children.revive()) == [node]
    bench.watching = True

    def is_known():
        status = bench.peers._status.get(stream)
        took = status is not None and status.program_id == bench.loaded[-1].program_id
        return took or any('was restarted' in text for _, text in bench.diagnostics)

    bench.spin_until(is_known)
    bench.diagnostics.clear()


@pytest.mark.thorough
@pytest.mark.parametrize('node', ['feedrate_node', 'lookahead_node'])
def test_a_node_lost_while_the_machine_waits_needs_no_cycle_start(bench, node):
    """Nobody has stopped the machine: it stands at override 0, before the motion and in it."""
    bench.override.publish(Float64(data=0.0))
    bench.spin_until(lambda: bench.state.feed_override == 0.0)
    bench.text = PROGRAM
    bench.loaded.clear()
    handle = bench.start(text=bench.text)
    # That the planner is at work may have been told of the program before.
    bench.spin_until(
        lambda: bench.loaded and bench.peers.knows('segments', RunId(bench.loaded[-1].program_id))
    )
    lose(bench, node)
    bench.override.publish(Float64(data=1.0))
    bench.until_at(0.02)
    bench.override.publish(Float64(data=0.0))
    # On a busy computer setpoints may run out just then: it rests all the same.
    bench.spin_until(lambda: bench.state.resting and bench.state.feed_override == 0.0)
    lose(bench, node)
    bench.override.publish(Float64(data=1.0))
    bench.finish(handle)


@pytest.mark.thorough
def test_a_planner_lost_on_the_approach_needs_no_cycle_start(bench):
    """What is buffered ends where the approach does, and the machine waits for the path."""
    handle = bench.begin()
    bench.spin_until(lambda: bench.state.state == MachineState.RUNNING and bench.state.samples)
    lose(bench, 'feedrate_node')
    bench.finish(handle)


@pytest.mark.thorough
def test_one_cycle_start_is_enough_where_the_planner_still_had_something_to_execute():
    """The motion goes on with what is at hand, rests where that ends, and goes on by itself."""
    bench = Bench({'feedrate_node': {'segment_window': 24, 'plan_ahead': 2.0}})
    try:
        handle = bench.begin(waves(24))
        bench.until_at(0.01)
        bench.kill('lookahead_node')
        assert bench.press('feed_hold').success
        bench.until_state(MachineState.HELD)
        run = run_id_of(bench.state)
        bench.spin_until(lambda: bench.state.buffered_time > 0.1)
        bench.children.revive()
        bench.spin_until(lambda: any('was restarted' in text for _, text in bench.diagnostics))
        assert bench.press('cycle_start').success
        result, _ = bench.finish(handle)
        assert result.starvations > 0
        assert run_id_of(bench.state).same_attempt(run.next_attempt())
    finally:
        bench.close()


@pytest.mark.thorough
def test_what_a_killed_program_node_has_sent_is_executed_and_its_goal_ends(bench):
    bench.begin()
    bench.until_at(0.01)
    bench.kill('program_node')
    bench.children.revive()

    def told():
        bench.sent.follow()
        return bench.sent.result is not None

    bench.spin_until(told)
    assert bench.sent.result.code == Result.STREAM_LOST
    assert 'forgotten' in bench.sent.result.message
    bench.spin_until(lambda: bench.state.completed)
    _, s = bench.recorded()
    assert abs(s[-1] - path_of(PROGRAM).s[-1]) < 1e-12


@pytest.mark.thorough
def test_a_goal_sent_at_once_to_a_restarted_program_node_runs_when_the_machine_rests(bench):
    bench.begin()
    bench.until_at(0.01)
    bench.kill('program_node')
    assert list(bench.children.revive()) == ['program_node']
    first = bench.state.program_id
    bench.finish(bench.begin())
    assert bench.state.program_id != first


@pytest.mark.thorough
def test_the_rest_of_a_program_that_was_forgotten_is_given_up_by_reset(bench):
    bench.begin(waves(300))  # more blocks than any window holds
    bench.until_at(0.01)
    bench.kill('program_node')
    assert bench.press('feed_hold').success
    bench.spin_until(lambda: bench.state.plan_over)
    assert list(bench.children.revive()) == ['program_node']
    result = bench.run(text=PROGRAM)
    assert result.code == Result.BUSY and 'reset' in result.message
    assert bench.press('reset').success
    bench.finish(bench.begin())


@pytest.mark.thorough
def test_after_a_run_that_program_node_never_sent_a_program_is_refused(bench):
    for message in block_messages(blocks_of(PROGRAM)[:3], RunId('stranger'), 0, 0.03, end=False):
        bench.blocks.publish(message)
    bench.spin_until(lambda: bench.peers.knows('blocks', RunId('stranger')))
    result = bench.run(text=PROGRAM)
    assert result.code == Result.BUSY and 'restart lookahead_node' in result.message
    bench.kill('lookahead_node')
    bench.children.revive()
    bench.spin_until(lambda: bench.peers.knows('blocks', NO_RUN))
    bench.finish(bench.begin())


@pytest.mark.thorough
def test_only_a_node_that_is_lost_is_called_so_and_no_longer_than_it_is():
    patience = {'peer_timeout': 0.5}
    bench = Bench(dict.fromkeys(('lookahead_node', 'feedrate_node'), patience))
    try:
        # An operator far away feeds the blocks: the look-ahead lives but has nothing to send.
        first, rest = blocks_of(PROGRAM)[:12], blocks_of(PROGRAM)[12:]
        for message in block_messages(first, RunId('by_hand'), 0, 0.03, end=False):
            bench.blocks.publish(message)
        program, lookahead = (
            'lookahead_node: sender of blocks',
            'feedrate_node: sender of segments',
        )
        bench.spin_until(lambda: 'is lost' in dict(bench.diagnostics).get(program, ''))
        silent_for_another = time.monotonic() + 2.0
        bench.spin_until(lambda: time.monotonic() > silent_for_another)
        assert lookahead not in dict(bench.diagnostics)
        process = bench.children.nodes['lookahead_node'].process.pid
        os.kill(process, signal.SIGSTOP)
        bench.spin_until(lambda: 'is lost' in dict(bench.diagnostics).get(lookahead, ''))
        os.kill(process, signal.SIGCONT)
        bench.spin_until(lambda: 'there again' in dict(bench.diagnostics)[lookahead])
        for message in block_messages(rest, RunId('by_hand'), 12, 0.03, end=True):
            bench.blocks.publish(message)
        bench.spin_until(lambda: 'there again' in dict(bench.diagnostics)[program])
        bench.spin_until(lambda: bench.state.program_id == 'by_hand' and bench.state.completed)
    finally:
        bench.close()


@pytest.mark.thorough
def test_a_restarted_machine_node_stands_still_and_runs_the_next_program(bench):
    handle = bench.begin()
    bench.until_at(0.01)
    bench.kill('machine_node')
    assert list(bench.children.revive()) == ['machine_node']
    result = bench.result_of(handle)
    assert result.code in (Result.STREAM_LOST, Result.STOPPED), result.message
    bench.spin_until(lambda: not bench.peers.missing(time.monotonic(), 1.0))
    state = bench.next_state()
    assert (state.state, state.samples) == (MachineState.IDLE, 0)
    bench.finish(bench.begin())


@pytest.mark.thorough
@pytest.mark.parametrize('first', ['machine_node', 'feedrate_node'])
def test_a_run_that_machine_and_planner_have_forgotten_ends_and_the_next_one_runs(bench, first):
    handle = bench.begin()
    bench.until_at(0.01)
    for node in (first, {'feedrate_node': 'machine_node', 'machine_node': 'feedrate_node'}[first]):
        bench.kill(node)
        bench.children.revive()
    assert bench.result_of(handle).code in (Result.STOPPED, Result.STREAM_LOST)
    bench.finish(bench.begin())


@pytest.mark.thorough
@pytest.mark.parametrize('where', ['approach', 'motion'])
def test_a_run_that_nobody_knows_any_more_asks_for_reset(bench, where):
    bench.begin(waves(60))  # not over before both are dead
    if where == 'motion':
        bench.until_at(0.01)
    bench.spin_until(lambda: bench.state.state == MachineState.RUNNING and bench.state.samples)
    bench.kill('program_node')
    bench.kill('feedrate_node')
    bench.spin_until(lambda: bench.state.resting)
    assert sorted(bench.children.revive()) == ['feedrate_node', 'program_node']
    if where == 'motion':
        assert bench.press('cycle_start').success
    bench.spin_until(lambda: any('not known here' in text for _, text in bench.diagnostics))
    if where == 'motion':  # on the approach the machine waits for setpoints
        bench.recorded()
    assert bench.press('reset').success
    bench.until_state(MachineState.IDLE)
