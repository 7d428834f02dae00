"""A run from a line over the real nodes: what the drives are told is the full run's from there."""

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState
from diagnostic_msgs.msg import KeyValue
from limit_use import limit_use
from operated import LIMITS, PROGRAM, path_of

from cnc_interp.kinematics.axis_path import evaluate

Result = RunProgram.Result
LINES = PROGRAM.splitlines()
#: A program stop in the middle: the motion from there on depends on nothing before it.
TEXT = '\n'.join([*LINES[:15], 'M0', *LINES[15:], ''])
STOP = 16


def executed(bench, reasons, **choices):
    """Run the program; returns positions, path lengths, lines and blocks of all that was told."""
    bench.executed.clear()
    settings = [KeyValue(key=key, value=value) for key, value in choices.items()]
    handle = bench.start(text=TEXT, settings=settings)
    for reason in reasons:
        bench.spin_until(
            lambda wanted=reason: (
                (bench.state.state, bench.state.reason) == (MachineState.HELD, wanted)
            )
        )
        assert bench.press('cycle_start').success
    result = bench.result_of(handle)
    assert (result.code, result.message) == (Result.SUCCEEDED, 'executed to the end')
    bench.spin_until(lambda: bench.state.completed)
    state = bench.next_state()

    def told():
        return [m for m in bench.executed if m.program_id == state.program_id]

    bench.spin_until(lambda: sum(len(m.sequences) for m in told()) >= state.samples)
    q = np.concatenate([np.reshape(m.positions, (-1, 5)) for m in told()])
    assert limit_use(q, LIMITS) <= 1.001
    s, line, block = (
        np.concatenate([getattr(m, name) for m in told()])
        for name in ('path_positions', 'line_numbers', 'sequences')
    )
    return q[block > 0], s[block > 0], line[block > 0]


@pytest.mark.thorough
def test_the_executed_setpoints_are_those_of_the_full_run(shared_nodes):
    bench = shared_nodes
    approach, stop = MachineState.REASON_APPROACH, MachineState.REASON_PROGRAM_STOP
    q, s, line = executed(bench, [stop])
    after = line > STOP
    path = path_of(TEXT)
    for first, reasons in ((9, [approach, stop]), (STOP + 1, [approach]), (22, [approach])):
        ours, place, lines = executed(bench, reasons, from_line=str(first))
        assert lines[0] == first and (np.diff(place) >= -1e-12).all()
        assert np.abs(ours - evaluate(path, place)[0]).max() < 1e-9
        assert np.array_equal(ours[-1], q[-1]) and place[-1] == s[-1]
        if first <= STOP + 1:
            count = int(after.sum())
            assert np.array_equal(ours[-count:], q[after]) and np.array_equal(
                place[-count:], s[after]
            )
            continue
        # Inside, the motion joins that of the full run after its ramp: the same time to the end,
        # and the same speed but for what cells that begin elsewhere cost.
        speed, full = np.gradient(place), np.gradient(s)
        joined = place > place[0] + 0.02
        there = np.interp(place[joined], s, full)
        assert np.abs(speed[joined] - there).max() < 1e-3 * full.max()
        count = int((s > place[joined][0]).sum())
        assert abs(int(joined.sum()) - count) <= 1e-3 * count + 2
