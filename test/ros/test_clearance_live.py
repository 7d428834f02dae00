"""A clamp in the way of every kind of motion, over the real nodes: nothing ever touches it."""

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import Jog, MachineState
from cnc_interp_msgs.srv import MoveAxes
from diagnostic_msgs.msg import KeyValue
from limit_use import limit_use
from operated import LIMITS, MACHINE, TRANSFORM, Bench, Result

from cnc_interp.collision.path_clearance import PathClearance
from cnc_interp.collision.scene_file import read_scene
from cnc_interp.core import MM
from cnc_interp.nodes import qos

pytestmark = pytest.mark.thorough

CLEARANCE = 0.1 * MM
SCENE = """
bodies:
  - {name: clamp, link: workpiece, box_mm: {low: [50, -20, -20], high: [70, 20, 45]}}
tools:
  1: {diameter_mm: 6, flute_mm: 12, holder_mm: [[20, 5], [40, 15]]}
"""
ROUND_IT = 'G21 G90 G94\nG0 X0 Y0 Z60 A0 C0\nX20\nZ10\nG1 F3000 Y30\n'


@pytest.fixture(scope='module')
def bench(tmp_path_factory):
    file = tmp_path_factory.mktemp('scene') / 'scene.yaml'
    file.write_text(SCENE)
    scene = {'scene': f"'{file}'"}
    running = Bench({'feedrate_node': scene, 'machine_node': {**scene, 'start_height': 0.1}})
    running.beats = running.node.create_publisher(Jog, 'jog', qos.BEATS)
    running.clearance = PathClearance(MACHINE, read_scene(file))
    running.spin_until(running.beats.get_subscription_count)
    yield running
    codes = running.close()
    assert codes == dict.fromkeys(codes, 0)


@pytest.fixture(autouse=True)
def above_the_part(bench):
    """Begin over the part, 60 mm above the clamp's foot; prove all motion at the end."""
    bench.tidy()
    bench.spin_for(0.3)
    bench.executed.clear()
    start = np.array(bench.next_state().commanded_positions)
    move(bench, place(*where(bench)[:2], 90))
    move(bench, place(0, 0, 90))
    move(bench, place(0, 0, 60))
    yield
    bench.spin_until(lambda: bench.next_state().resting)
    rest = bench.state.commanded_positions
    bench.spin_until(lambda: np.array_equal(bench.executed[-1].positions[-5:], rest))
    q = np.concatenate([np.reshape(m.positions, (-1, 5)) for m in bench.executed])
    assert limit_use(q, LIMITS, start) <= 1.001
    assert min(gap(bench, row) for row in q[::10]) > CLEARANCE


def place(x, y, z):
    tip = np.array([[x, y, z]]) * MM
    return np.concatenate([TRANSFORM.linear(tip, np.zeros((1, 2)))[0], np.zeros(2)])


def where(bench):
    tip, _ = TRANSFORM.forward(np.array([bench.next_state().commanded_positions]))
    return tip[0] / MM


def gap(bench, q):
    pairs = [('holder', 'clamp'), ('shank', 'clamp'), ('cutter', 'clamp')]
    return min(bench.clearance.distance(pair, np.array(q)) for pair in pairs)


def move(bench, to):
    answer = bench.mover.call_async(
        MoveAxes.Request(axes=list(MACHINE.axis_names), values=list(map(float, to)))
    )
    bench.spin_until(answer.done)
    assert answer.result().success, answer.result().message
    bench.spin_until(lambda: bench.next_state().state == MachineState.IDLE)


def told(bench, part):
    return [text for name, text in bench.diagnostics if name == part]


def refused(bench, line, **goal):
    """Run a program that hits the clamp in a line; return where it ended [mm]."""
    result = bench.run(**goal)
    assert result.code != Result.SUCCEEDED
    assert 'hit: ' in result.message and 'clamp' in result.message, result.message
    assert line is None or f'line {line}, ' in result.message, result.message
    bench.spin_until(lambda: bench.next_state().resting)
    assert any('clamp' in text for text in told(bench, 'feedrate_node: collision'))
    return where(bench)


def test_a_short_program_is_refused_before_anything_moves(bench):
    assert refused(bench, 6, text=ROUND_IT + 'G1 X60 Y0\nY50\nM30\n')[2] == pytest.approx(60.0)


def test_a_long_program_ends_before_the_line_that_hits_and_rests_on_its_path(bench):
    to_and_fro = 'Y20\nY30\n' * 100
    x, y, z = refused(bench, 206, text=f'{ROUND_IT}{to_and_fro}X60 Y0\nY50\nM30\n')
    assert (x, z) == pytest.approx((20.0, 10.0), abs=0.1) and 19.9 < y < 30.1, 'on its path'


def test_a_return_that_homes_through_the_clamp_is_refused(bench):
    """G53 leads past the clamp in machine coordinates, as to the place of a tool change."""
    beyond = place(100, 0, 10) / MM
    line = f'G53 G0 X{beyond[0]:.4f} Y{beyond[1]:.4f} Z{beyond[2]:.4f}\n'
    refused(bench, 6, text=ROUND_IT + line + 'M30\n')


def test_the_approach_is_checked(bench):
    move(bench, place(100, 0, 60))
    move(bench, place(100, 0, 10))
    refused(bench, None, text='G21 G90 G94\nG0 X0 Y0 Z10 A0 C0\nG1 Y30 F3000\nM30\n')


def test_a_line_by_hand_is_checked(bench):
    move(bench, place(20, 0, 60))
    move(bench, place(20, 0, 10))
    refused(bench, None, text='G90 G0 X100', mdi=True)
    assert bench.run(text='G90 G0 X10', mdi=True).code == Result.SUCCEEDED


def test_the_start_at_a_line_is_checked(bench):
    """Lines 6 to 8 lead round the clamp; the way straight to line 9 leads through it."""
    program = ROUND_IT + 'Y60\nX100\nY0\nX110\nM30\n'
    move(bench, place(20, 0, 60))
    move(bench, place(20, 0, -10))
    refused(bench, None, text=program, settings=[KeyValue(key='from_line', value='9')])


def test_the_way_back_to_the_path_is_checked(bench):
    """Held, moved by hand round the clamp to its other side, and started again."""
    handle = bench.start(text=ROUND_IT + 'F300 X10\nX20\nM30\n')
    running = MachineState.RUNNING
    bench.spin_until(lambda: bench.state.state == running and bench.state.line_number >= 6)
    assert bench.press('feed_hold').success
    bench.until_state(MachineState.HELD)
    for to in (place(20, 30, 60), place(100, 0, 60), place(100, 0, -20)):
        answer = bench.mover.call_async(
            MoveAxes.Request(axes=list(MACHINE.axis_names), values=list(map(float, to)))
        )
        bench.spin_until(answer.done)
        assert answer.result().success, answer.result().message
        bench.spin_until(
            lambda to=to: np.allclose(bench.next_state().commanded_positions, to, atol=1e-8)
        )
    assert bench.press('cycle_start').success
    result = bench.result_of(handle)
    assert result.code != Result.SUCCEEDED and 'clamp' in result.message


def test_jogging_stops_before_the_clamp_and_tells_what_is_left(bench):
    move(bench, place(20, 0, 10))

    def beat(share):
        bench.beats.publish(Jog(axes=['X'], shares=[share]))
        bench.spin_for(0.05)

    def blocked():
        beat(0.1)
        return any('stopped before a contact' in text for text in told(bench, JOG))

    bench.spin_until(blocked)
    bench.spin_until(lambda: bench.next_state().state == MachineState.IDLE)
    text = next(text for text in told(bench, JOG) if 'stopped before a contact' in text)
    rests = np.array(bench.next_state().commanded_positions)
    left = float(text.split(' mm are left')[0].split()[-1])
    assert left == pytest.approx(gap(bench, rests) / MM, rel=0.01)
    assert 0.1 < left < 12.0, 'it stops no farther away than it must'
    bench.spin_for(0.3)  # the key is let go
    bench.spin_until(lambda: beat(-0.1) or where(bench)[0] < 10.0)
    bench.beats.publish(Jog())


JOG = 'machine_node: jog'
