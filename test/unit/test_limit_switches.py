"""Limit switches: a motion on to a switch stops on its path, a motion off it is free."""

import copy

import numpy as np
import pytest
from test_functions_played import Bench as RunBench
from test_homing import HomingBench
from test_jog import Bench, T, use_of

from cnc_interp.core.small_files import read_yaml
from cnc_interp.machine_model.machine import find_machine_file, from_mapping
from cnc_interp.run.run_state import Reason, State

INPUTS = {'limit_x_low': None, 'limit_x_high': None, 'home_x': None}


def machine(name='xyz', **more):
    content = copy.deepcopy(read_yaml(find_machine_file(name)))
    return from_mapping(content | {'signals': {'inputs': INPUTS}} | more)


def pressed(play):
    """Let the upper switch of X be pressed from 15 mm, the lower one below -15 mm."""
    x = play.axes.setpoints[-1][0]
    play.drives.inputs[:2] = x < -0.015, x > 0.015


def test_a_program_that_meets_a_switch_stops_on_its_path_within_the_limits():
    given = machine()
    bench = RunBench('G21 G90\nG0 X0 Y0 Z0\nG1 X40 Y20 F6000\nX0\nM30\n', given)
    places = [np.zeros(3)]
    while not bench.play.state.resting or len(places) < 200:
        pressed(bench.play)
        bench.step()
        places.append(bench.play.axes.setpoints[-1].copy())
        assert len(places) < 20_000
    q = np.array(places)
    assert bench.play.state.state is State.FAULT
    assert 'X is on its upper limit switch' in bench.play.state.text
    assert 0.015 < q[:, 0].max() < 0.030
    assert q[:, 1] == pytest.approx(0.5 * q[:, 0], abs=1e-6)  # on the path
    assert max(use_of(given, q)) <= 1.001


def test_an_axis_on_a_switch_may_be_jogged_off_it_but_not_on():
    bench = Bench(machine())

    def run(time, **shares):
        for _ in range(round(time / (5 * T))):
            pressed(bench.play)
            stopped = bench.state in (State.STOPPING, State.FAULT)
            bench.run(5 * T, **({} if stopped else shares))

    run(3.0, X=0.2)
    run(1.0)
    assert bench.state is State.FAULT and bench.play.state.reason is Reason.DRIVE_FAULT
    stands = bench.q[-1, 0]
    assert stands > 0.015
    bench.play.reset()
    run(1.0, X=0.2)  # on: it stops at once
    run(0.5)
    assert bench.state is State.FAULT and bench.q[-1, 0] - stands < 0.002
    bench.play.reset()
    run(0.5, Y=0.2)  # another axis is free
    assert bench.state is State.JOGGING and bench.q[-1, 1] > 0.01
    run(1.0)
    run(1.0, X=-0.03)
    assert bench.state is State.JOGGING
    run(0.5)
    assert bench.state is State.IDLE and bench.q[-1, 0] < stands - 0.005


def test_a_switch_that_is_also_the_reference_switch_does_not_stop_homing():
    homing = {'switches': {'X': -60.0}}
    bench = HomingBench(machine('xyzac', homing=homing))
    bench.homing.begin([], bench.now)
    for _ in range(4000):
        bench.play.drives.inputs[0] = bench.play.axes.setpoints[-1][0] < -0.060
        bench.run(5 * T)
        if not bench.homing.active:
            break
    assert all(bench.homing.homed) and bench.q[:, 0].min() < -0.060
    bench.rest()
    for _ in range(400):  # afterwards it stops again
        bench.play.drives.inputs[0] = bench.play.axes.setpoints[-1][0] < -0.060
        if bench.state in (State.STOPPING, State.FAULT):
            break
        bench.jog.beat({'X': -0.2}, 0.0, bench.now)
        bench.run(5 * T)
    assert 'X is on its lower limit switch' in bench.play.state.text
