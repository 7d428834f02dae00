"""Outputs that follow the speed of the tip, in every period: overrides, holds, stop tails."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from test_functions_played import MACHINE, Bench, T

from cnc_interp.core import MachineError
from cnc_interp.machine.axis_motion import AxisMotion
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import signals
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.run.run_state import State
from cnc_interp.run.setpoints import Setpoints

SPEEDS, SHARES = [60.0, 600.0, 6000.0], [0.0, 0.5, 1.0]  # mm/min
POWER = {'range': [0, 100], 'by_speed': {'mm_per_min': SPEEDS, 'share': SHARES}}
GIVEN = {
    'outputs': {'power': POWER, 'dynamic': None},
    'functions': {'S': {'power': 'S'}, 'M3': {'dynamic': 0}, 'M4': {'dynamic': 1}},
    'switched_off': {'power': 'always', 'dynamic': 'always'},
}
PROGRAM = 'G21 G90\nG0 X0 Y0 Z0\n{}\nG1 X20 F6000\nY15\nX0\nM30\n'


def bench_of(power, text=PROGRAM.format('S80')):
    given = GIVEN | {'outputs': {'power': power, 'dynamic': None}}
    return Bench(text, replace(MACHINE, signals=signals({'signals': given})))


def compared(bench, most=4000, act=lambda bench: None):
    """Run; return setpoints with the power in each period."""
    places, power, on = [], [], []
    for _ in range(most):
        act(bench)
        bench.step()
        places.append(bench.play.axes.setpoints[-1].copy())
        power.append(float(bench.drives.outputs[0]))
        on.append(float(bench.play.spindle.commanded[0]))
        if bench.play.state.completed:
            break
    return np.array(places), np.array(power), np.array(on)


def expected(places, commanded):
    """Return what the power must be: from the way of the tip around each setpoint."""
    way = np.linalg.norm(places[2:] - places[:-2], axis=1) / (2.0 * T) * 60e3
    return commanded[1:-1] * np.interp(way, SPEEDS, SHARES), way


def test_power_is_the_share_of_the_speed_at_corners_under_an_override_and_in_a_hold():
    def operate(bench):
        speed = np.abs(bench.play.axes.setpoints[-1] - bench.play.axes.setpoints[-2]).max() / T
        if bench.periods > 100 and not bench.held and speed > 0.09:
            bench.play.hold()
            bench.held = True

    bench = bench_of(POWER)
    bench.held = False
    places, power, on = compared(bench, 1500, operate)
    assert bench.play.state.state is State.HELD
    wanted, way = expected(places, on)
    assert power[-1] == 0.0  # at rest
    assert way.max() > 5000.0 and on.max() == 80.0
    # The speed changes by the acceleration in a period; around a setpoint by half of that.
    slack = 80.0 * MACHINE.max_acceleration.max() * T * 60e3 * (0.5 / 540.0)
    moving = way > 0.0
    assert np.abs(power[1:-1] - wanted)[moving].max() < slack
    fast = way > 700.0  # the table is less steep there
    assert np.abs(power[1:-1] - wanted)[fast].max() < 0.1 * slack


def test_a_machine_without_such_outputs_plays_the_same():
    plain = bench_of({'range': [0, 100]})
    places, power, _ = compared(plain)
    same, less, _ = compared(bench_of(POWER))
    assert (places == same).all() and power.max() == 80.0
    assert (less <= power).all() and less.min() < power.min() + 1e-9


@pytest.mark.parametrize(('word', 'constant'), [('M3', True), ('M4', False)])
def test_an_output_follows_only_while_another_one_is_on(word, constant):
    """As grbl: M3 has constant power, M4 the power of the speed."""
    only = POWER | {'by_speed': POWER['by_speed'] | {'with': 'dynamic'}}
    bench = bench_of(only, PROGRAM.format(f'S80 {word}'))
    places, power, on = compared(bench)
    running = (on == 80.0)[1:-1]
    wanted, way = expected(places, on)
    cruise = running & (way > 1000.0)
    assert cruise.sum() > 100
    if constant:
        assert (power[on == 80.0] == 80.0).all()
    else:
        assert power[1:-1][cruise] == pytest.approx(wanted[cruise], abs=1.0)
        assert power[on == 80.0].min() < 1.0


def test_the_speed_is_that_of_the_tip_over_the_workpiece_on_five_axes():
    machine = Machine.load('xyzac')
    rng = np.random.default_rng(5)
    q, v = rng.uniform(-0.3, 0.3, (50, 5)), rng.uniform(-1.0, 1.0, (50, 5))
    rows = Setpoints(np.zeros(50), q, v, 0.0 * v, 0.0 * v, np.zeros(50, int), np.zeros(50))
    found = AxisMotion(machine, T, 0.0, np.zeros(5)).tip_speeds(rows)
    forward, d = Transform.of(machine).forward, 1e-6
    way = forward(q + d * v)[0] - forward(q - d * v)[0]
    assert found == pytest.approx(np.linalg.norm(way, axis=1) / (2.0 * d), rel=1e-5)


@pytest.mark.parametrize(
    'table',
    [
        {'mm_per_min': [0, 100]},
        {'mm_per_min': [100, 0], 'share': [0, 1]},
        {'mm_per_min': [0, 100], 'share': [0, 1.5]},
        {'mm_per_min': [0, 100], 'share': [0, 1], 'with': 'nothing'},
    ],
)
def test_a_table_that_cannot_be_meant_is_refused(table):
    given = GIVEN | {'outputs': {'power': POWER | {'by_speed': table}, 'dynamic': None}}
    with pytest.raises(MachineError, match='by_speed'):
        signals({'signals': given})
