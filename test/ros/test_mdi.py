"""Lines by hand (MDI) over the real nodes: what they move, what they keep, what is refused."""

import json
import signal
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import MachineState, ModalState
from cnc_interp_msgs.srv import MoveAxes
from limit_use import limit_use
from nodes_under_test import hear_ctrl_c
from operated import LIMITS, TRANSFORM, Result

from cnc_interp.nodes import qos

ZERO = np.array([0.04, -0.07, 0.06]) + [0.0, 0.15e-3, 0.08]  # m + d of the reference machine


@pytest.fixture(scope='module')
def bench(shared_nodes):
    running = shared_nodes
    running.modes = running.listen('modal_state', ModalState, qos.LOADED)
    running.active = running.listen('active_modes', ModalState, qos.LOADED)
    running.spin_until(lambda: running.modes)
    return running


def stands(bench):
    """Where the machine rests, IDLE."""
    bench.spin_until(lambda: bench.next_state().state == MachineState.IDLE)
    return np.array(bench.state.commanded_positions)


def jog(bench, **values):
    """Move axes by hand by a distance."""
    asked = MoveAxes.Request(axes=list(values), values=list(values.values()), relative=True)
    answer = bench.mover.call_async(asked)
    bench.spin_until(answer.done)
    assert answer.result().success, answer.result().message
    goal = np.array(answer.result().positions)
    bench.spin_until(lambda: np.allclose(bench.state.commanded_positions, goal, atol=1e-9))


def line(bench, text):
    """Give a line; return what was answered, and the way of the axes."""
    before = stands(bench)
    result = bench.run(text=text, mdi=True)
    way = stands(bench) - before
    if result.samples:
        prove(bench, result, before)
    return result, way


def prove(bench, result, before):
    """What the drives were told begins where the machine stood and keeps all limits."""

    def told():
        return [m for m in bench.executed if m.program_id == result.program_id]

    bench.spin_until(lambda: sum(len(m.sequences) for m in told()) >= bench.state.samples)
    q = np.concatenate([np.reshape(m.positions, (-1, 5)) for m in told()])
    assert np.abs(q[0] - before).max() < 1e-12
    assert limit_use(q, LIMITS, before) <= 1.001
    return q


def done(bench, text):
    result, way = line(bench, text)
    assert result.code == Result.SUCCEEDED, result.message
    return way


def until_on_the_way(bench):
    """Spin until a line has moved the tool by more than 5 mm."""
    bench.spin_until(
        lambda: bench.state.state == MachineState.RUNNING and bench.state.path_position > 0.005
    )


def codes(bench):
    return set(bench.modes[-1].codes)


def kept_modes(bench):
    """Codes and feedrate that are kept; they are told again after a line that does nothing."""
    known = len(bench.modes)
    done(bench, '(nothing)')
    bench.spin_until(lambda: len(bench.modes) > known)
    return codes(bench), str(bench.modes[-1].feedrate)  # nan where there is none


def test_a_line_moves_by_its_words_from_where_the_machine_stands(bench):
    assert not done(bench, 'G21 G91').any()
    assert done(bench, 'G1 X10 F3000') == pytest.approx([0.01, 0, 0, 0, 0], abs=1e-12)
    jog(bench, Y=0.003, A=0.1)
    assert done(bench, 'Y5') == pytest.approx([0, 0.005, 0, 0, 0], abs=1e-12)
    assert done(bench, 'G0 C-2.5') == pytest.approx([0, 0, 0, 0, np.radians(-2.5)], abs=1e-12)
    assert {'G91', 'G21', 'G0', 'G94', 'G54', 'G17'} <= codes(bench)
    assert bench.modes[-1].feedrate == pytest.approx(0.05)
    assert not done(bench, 'G90').any()
    done(bench, 'G1 X-5 Y2 Z1')
    at = stands(bench)
    assert at[:3] == pytest.approx(ZERO + [-0.005, 0.002, 0.001], abs=1e-12)
    assert not done(bench, 'M30').any() and bench.modes[-1].feedrate != 0.05


def test_with_tool_tip_programming_the_tip_moves(bench):
    done(bench, 'G91 G43.4')
    jog(bench, A=0.2, C=0.4)
    tip, axis = TRANSFORM.forward(stands(bench)[None])
    done(bench, 'G1 X4 Z2 F2000')
    tip_after, axis_after = TRANSFORM.forward(stands(bench)[None])
    assert (tip_after - tip)[0] == pytest.approx([0.004, 0, 0.002], abs=1e-12)
    assert axis_after == pytest.approx(axis, abs=1e-12)
    done(bench, 'M30')


def test_the_modes_of_a_program_are_told_as_the_machine_comes_to_them(bench):
    """All blocks are read and sent long before: at M0 those after it must not be told."""
    text = (
        'G21 G90 G94 G54 M61 Q2 S5000 M3\nG0 X0 Y0 Z0\nG1 X2 F3000\nM0\n'
        'G61 M8 S6000\nG1 X4 F1500\nM30\n'
    )
    bench.active.clear()
    handle = bench.start(text=text)
    bench.spin_until(lambda: bench.state.reason == MachineState.REASON_PROGRAM_STOP)
    held = bench.next_state()

    def told():
        return [message for message in bench.active if message.program_id == held.program_id]

    bench.spin_until(lambda: told() and 'G1' in told()[-1].codes)
    for modes in told():
        assert {'G54', 'G64', 'M3'} <= set(modes.codes) and 'M8' not in modes.codes
        assert (modes.spindle_speed, modes.tool) == (5000.0, 2)
    assert told()[-1].feedrate == pytest.approx(0.05)
    assert bench.press('cycle_start').success
    assert bench.result_of(handle).code == Result.SUCCEEDED
    bench.spin_until(lambda: 'M8' in told()[-1].codes)
    last = told()[-1]
    assert {'G1', 'G61', 'M3'} <= set(last.codes) and last.feedrate == pytest.approx(0.025)
    assert last.spindle_speed == 6000.0


@pytest.mark.parametrize(
    ('text', 'code', 'why'),
    [
        ('G91 G1 X5000 F100', Result.REFUSED, 'travel'),
        ('G20 G1 X1 Q77 F5', Result.BAD_PROGRAM, 'MDI:1'),
        ('G91 G1 X1', Result.BAD_PROGRAM, 'no feedrate'),
        ('G90\nG91', Result.BAD_PROGRAM, 'one line'),
    ],
)
def test_a_refused_line_changes_nothing(bench, text, code, why):
    before, modes = stands(bench), kept_modes(bench)
    result, way = line(bench, text)
    assert result.code == code and why in result.message and '\n' not in result.message
    assert not way.any() and kept_modes(bench) == modes
    assert np.array_equal(stands(bench), before)


@pytest.mark.thorough
def test_hold_goes_on_and_cancel_leaves_the_path(bench):
    done(bench, 'G91 G1 F2000')
    before = stands(bench)
    handle = bench.start(text='X-40', mdi=True)
    until_on_the_way(bench)
    assert bench.press('feed_hold').success
    bench.until_state(MachineState.HELD)
    held = np.array(bench.next_state().commanded_positions)
    assert 0.005 < before[0] - held[0] < 0.039
    refused = bench.run(text='X1', mdi=True)
    assert refused.code == Result.BUSY and 'program is running' in refused.message
    assert bench.press('cycle_start').success
    result = bench.result_of(handle)
    assert result.code == Result.SUCCEEDED
    assert stands(bench) - before == pytest.approx([-0.04, 0, 0, 0, 0], abs=1e-12)
    prove(bench, result, before)
    modes = kept_modes(bench)
    handle = bench.start(text='G61 F1900 X40', mdi=True)
    until_on_the_way(bench)
    bench.spin_until(handle.cancel_goal_async().done)
    assert bench.result_of(handle).code == Result.CANCELED
    at = stands(bench)
    assert before[0] - 0.035 < at[0] < before[0] - 0.001
    assert at[1:] == pytest.approx(before[1:], abs=1e-12)
    # A probing cycle that missed left G91, and the next G0 X15 was a distance.
    assert kept_modes(bench) == modes
    assert done(bench, 'X1') == pytest.approx([0.001, 0, 0, 0, 0], abs=1e-12)
    done(bench, 'M30')


@pytest.mark.thorough
def test_beside_motion_by_hand_and_programs_a_line_is_refused(bench):
    asked = MoveAxes.Request(axes=['C'], values=[1.0], relative=True, speed=0.2)
    bench.spin_until(bench.mover.call_async(asked).done)
    bench.until_state(MachineState.JOGGING)
    result = bench.run(text='G90', mdi=True)
    assert result.code == Result.BUSY and 'by hand' in result.message
    stands(bench)
    handle = bench.begin()
    bench.until_at(0.005)
    result = bench.run(text='G91', mdi=True)
    assert result.code == Result.BUSY and 'program is running' in result.message
    bench.finish(handle)
    assert 'G90' in codes(bench)


def test_other_settings_than_those_of_the_node_are_refused(bench):
    result = bench.run(text='G90', mdi=True, contour_tolerance=1e-3)
    assert result.code == Result.REFUSED and 'settings' in result.message


def cnc_interp(bench, *lines):
    command = [sys.executable, '-m', 'cnc_interp', 'mdi', *lines]
    command += ['--namespace', bench.namespace, '--domain', str(bench.domain)]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=hear_ctrl_c
    )


@pytest.mark.thorough
def test_the_command_line_gives_lines(bench):
    before = stands(bench)
    told = cnc_interp(bench, 'G91', 'G1 X-1.5 F500', '--json').communicate()
    first, second = json.loads(told[0])
    assert first['ok'] and second['ok'], told
    assert second['position']['X'] == pytest.approx(before[0] - 0.0015, abs=1e-12)
    assert {'G1', 'G91', 'F500'} <= set(second['modes'].split())
    command = cnc_interp(bench, 'X1 Q5', 'X1')
    told = command.communicate()[0].splitlines()
    assert command.returncode == 2 and len(told) == 2 and 'MDI:1: Q5' in told[0]
    assert 'G91' in told[1]
    command = cnc_interp(bench, 'X-30')
    until_on_the_way(bench)
    command.send_signal(signal.SIGINT)
    assert command.wait(60.0) == 130
    at = stands(bench)
    assert before[0] - 0.031 < at[0] < before[0] - 0.002
    done(bench, 'M30')
