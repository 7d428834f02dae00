"""A handwheel: each count is one step of the selected axes, within all limits and the travel."""

import copy

import numpy as np
import pytest
from test_jog import MM, Bench, T

from cnc_interp.core import StreamError
from cnc_interp.core.small_files import read_yaml
from cnc_interp.machine.handwheel import Handwheel
from cnc_interp.machine_model.machine import find_machine_file, from_mapping
from cnc_interp.run.run_state import State

NAMES = ['handwheel', 'handwheel_step', 'handwheel_x', 'handwheel_z']


class WheelBench(Bench):
    def __init__(self, *names):
        content = copy.deepcopy(read_yaml(find_machine_file('vmc')))
        given = {'signals': {'inputs': dict.fromkeys(names or NAMES)}}
        super().__init__(from_mapping(content | given))
        self.wheel, self.asked = Handwheel(self.play, self.jog), 0

    def set(self, **values):
        for name, value in values.items():
            self.play.drives.inputs[self.machine.signals.input(name)] = value

    def run(self, time, **shares):
        for _ in range(max(1, round(time / (5 * T)))):
            self.wheel.work()
            super().run(5 * T, **shares)

    def rest(self):
        self.run(0.2)  # a count may wait for the end of the motion before
        super().rest()

    def turn(self, counts, by=1.0, every=0.02):
        inputs, k = self.play.drives.inputs, self.machine.signals.input('handwheel')
        for _ in range(counts):
            inputs[k] += by
            self.run(every)


def test_the_selected_axes_move_by_one_step_for_each_count():
    bench = WheelBench()
    bench.set(handwheel=1234.0, handwheel_step=0.1, handwheel_x=1)
    bench.run(0.1)  # where the wheel stands at the start moves nothing
    assert not bench.q.any()
    bench.turn(30)
    bench.rest()  # which also recomputes the use of all limits from the setpoints
    assert bench.q[-1] == pytest.approx([3.0 * MM, 0.0, 0.0], abs=1e-9)
    bench.set(handwheel_step=0.01, handwheel_x=0, handwheel_z=1)
    bench.turn(5, by=-2.0)
    bench.rest()
    assert bench.q[-1] == pytest.approx([3.0 * MM, 0.0, -0.1 * MM], abs=1e-9)
    assert bench.state is State.IDLE


def test_nothing_moves_while_no_axis_is_selected_and_nothing_is_made_up_for():
    bench = WheelBench()
    bench.set(handwheel_step=0.1)
    bench.run(0.1)
    bench.turn(10)
    bench.set(handwheel_x=1)
    bench.run(0.2)
    assert not bench.q.any()


def test_a_fast_wheel_keeps_the_limits_and_stops_at_the_end_of_the_travel():
    bench = WheelBench()
    bench.set(handwheel_step=1.0, handwheel_x=1)
    bench.run(0.1)
    bench.turn(100, by=10.0, every=0.01)  # asks for a metre per tenth of a second
    bench.rest()
    assert bench.q[-1, 0] == pytest.approx(bench.machine.travel[0, 1], abs=1e-9)
    bench.turn(1, by=-1.0)  # back at once, not after all those counts
    bench.rest()
    assert bench.q[-1, 0] == pytest.approx(bench.machine.travel[0, 1] - 1.0 * MM, abs=1e-9)


def test_turning_back_in_motion_ends_where_the_counts_say():
    bench = WheelBench()
    bench.set(handwheel_step=0.5, handwheel_x=1)
    bench.run(0.1)
    bench.turn(40)
    bench.turn(60, by=-1.0)
    bench.rest()
    assert bench.q[-1, 0] == pytest.approx(-10.0 * MM, abs=1e-9)
    assert bench.q[:, 0].max() > 0.0


def test_without_a_step_input_a_count_is_a_hundredth():
    bench = WheelBench('handwheel', 'handwheel_x')
    bench.set(handwheel_x=1)
    bench.run(0.1)
    bench.turn(10)
    bench.rest()
    assert bench.q[-1, 0] == pytest.approx(0.1 * MM, abs=1e-9)


def test_counts_in_a_fault_are_rejected_in_one_line_and_forgotten():
    bench = WheelBench()
    bench.set(handwheel_step=0.1, handwheel_x=1)
    bench.run(0.1)
    bench.play.stop()
    bench.run(0.1)
    bench.set(handwheel=5.0)
    with pytest.raises(StreamError, match='jog is not possible'):
        bench.wheel.work()
    bench.play.reset()
    bench.run(0.2)
    assert not np.ptp(bench.q[-100:], axis=0).any() and not bench.q[-1].any()


def test_a_machine_without_a_handwheel_has_none():
    bench = Bench()
    Handwheel(bench.play, bench.jog).work()
    assert bench.state is State.IDLE
