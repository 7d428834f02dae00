"""Homing: each axis ends beside its switch, in the order of the machine file; what refuses it."""

import copy

import numpy as np
import pytest
from test_jog import MM, Bench, T

from cnc_interp.core import MachineError, StreamError
from cnc_interp.core.small_files import read_yaml
from cnc_interp.machine.homing import BACK, AxisHoming, Homing
from cnc_interp.machine.jog import AHEAD
from cnc_interp.machine_model.machine import Machine, find_machine_file, from_mapping
from cnc_interp.run.run_state import State

A = Machine.load('xyzac').axes[3]
CONTENT = read_yaml(find_machine_file('xyzac'))
GIVEN = {
    'switches': {'X': -60.0, 'Z': 50.0, 'A': -3.0},
    'order': [['Z'], ['X', 'A']],
    'required': True,
}


def machine(**changes):
    return from_mapping(copy.deepcopy(CONTENT) | {'homing': GIVEN | changes})


class HomingBench(Bench):
    """A machine whose axes are homed, period by period."""

    def __init__(self, machine=None, position=None):
        super().__init__(machine or globals()['machine'](), position)
        self.homing = Homing(self.play, self.jog)

    def run(self, time, **shares):
        for _ in range(max(1, round(time / (5 * T)))):
            self.homing.work(self.now)
            super().run(5 * T, **shares)

    def until_done(self):
        for _ in range(4000):
            self.run(5 * T)
            if not self.homing.active:
                break
        self.rest()


def test_axes_end_beside_their_switches_in_order():
    bench = HomingBench()
    assert bench.homing.must_home == ['X', 'Z', 'A']
    assert bench.homing.homed == [False, True, False, False, True]
    assert bench.homing.begin([], bench.now) == ('Z', 'X', 'A')
    bench.until_done()
    assert bench.homing.must_home == [] and all(bench.homing.homed)
    q, at = bench.q, np.array([-60 * MM, 0.0, 50 * MM, np.radians(-3), 0.0])
    # What the axis moves at the slow speed until the switch is seen, and while it stops.
    slow = BACK * bench.machine.max_velocity
    stop = 2.0 * np.sqrt(slow / bench.machine.max_jerk)
    assert (np.abs(q[-1] - at) <= slow * (AHEAD + 0.02 + stop)).all()
    assert q[-1, 0] > at[0] and q[-1, 2] < at[2] and q[-1, 3] > at[3]  # released
    assert q[:, 0].min() < at[0] and q[:, 2].max() > at[2]  # pressed before
    moved = [np.flatnonzero(np.diff(q[:, i])) for i in (2, 0, 3)]
    assert moved[0].max() < moved[1].min() and abs(moved[1].min() - moved[2].min()) <= 5
    # One axis alone, from beyond its switch: it only moves back.
    begin = len(bench.q)
    bench.homing.begin(['X'], bench.now)
    assert bench.homing.must_home == ['X']
    bench.until_done()
    assert all(bench.homing.homed) and not np.ptp(bench.q[begin:, 1:], axis=0).any()
    bench.homing.forget()
    assert bench.homing.must_home == ['X', 'Z', 'A']


def test_axes_with_an_index_stop_beyond_it_and_without_one_it_is_told():
    given = machine(index={'X': -54.0, 'A': -5.5})
    bench = HomingBench(given)
    bench.homing.begin([], bench.now)
    bench.until_done()
    assert all(bench.homing.homed)
    stop = BACK * given.max_velocity[0] * (AHEAD + 0.05)
    assert -54 * MM < bench.q[-1, 0] < -54 * MM + stop and bench.q[-1, 3] > np.radians(-5.5)
    lost = HomingBench(given, np.array([0.0, 0.0, 0.0, A.travel[1] - 0.01, 0.0]))
    lost.homing._switches.pressed = lost.homing._switches.passed = lambda q: np.full(5, False)
    lost.homing._stages = {'A': AxisHoming.INDEX}
    with pytest.raises(StreamError, match='A has reached its end of travel without an index'):
        for _ in range(4000):
            lost.run(5 * T)


def test_a_hold_a_stop_and_a_missing_switch_end_it():
    bench = HomingBench()
    bench.homing.begin([], bench.now)
    bench.run(0.3)
    assert bench.state is State.JOGGING
    bench.play.hold()
    with pytest.raises(StreamError, match='home again'):
        bench.run(0.5)
    bench.rest()
    assert bench.homing.must_home == ['X', 'Z', 'A']
    bench.homing.begin(['Z'], bench.now)  # the hold before does not end it
    bench.run(0.3)
    bench.homing.stop(bench.now)
    bench.rest()
    assert not bench.homing.active and bench.q[-1, 2] < 50 * MM
    for told, at, why in ((0, A.travel[0] + 0.1, 'without'), (1, A.travel[1] - 0.01, 'and its')):
        stuck = HomingBench(position=np.array([0.0, 0.0, 0.0, at, 0.0]))
        stuck.homing._switches.pressed = lambda q, told=told: np.full(5, bool(told))
        stuck.homing.begin(['A'], stuck.now)
        with pytest.raises(StreamError, match=f'A has reached its end of travel {why}'):
            for _ in range(4000):
                stuck.run(5 * T)
        stuck.rest()
        assert stuck.homing.must_home == ['X', 'Z', 'A']


def test_what_cannot_be_homed_is_told():
    bench = HomingBench()
    with pytest.raises(StreamError, match=r'Y has no reference switch .*X Z A'):
        bench.homing.begin(['Y'], 0.0)
    bench.move(X=0.02)
    bench.run(0.1)
    with pytest.raises(StreamError, match='at rest'):
        bench.homing.begin([], bench.now)
    none = HomingBench(from_mapping(copy.deepcopy(CONTENT)))
    assert all(none.homing.homed) and none.homing.must_home == []
    with pytest.raises(StreamError, match='names no reference switches'):
        none.homing.begin([], 0.0)
    assert HomingBench(machine(required=False)).homing.must_home == []


@pytest.mark.parametrize(
    ('changes', 'key'),
    [
        ({'switches': {'Q': 1.0}}, 'homing.switches.Q'),
        ({'switches': {'C': 1.0}, 'order': [['C']]}, 'homing.switches.C'),
        ({'switches': {'X': 900.0}}, 'homing.switches.X'),
        ({'switches': {'X': 'far'}}, 'homing.switches.X'),
        ({'order': [['Z'], ['X']]}, 'homing.order'),
        ({'order': 'ZXA'}, 'homing.order'),
        ({'order': [['Z', 'Z'], ['X', 'A']]}, 'homing.order'),
        ({'order': ['Z', ['X'], 3]}, 'homing.order'),
        ({'required': 1}, 'homing.required'),
        ({'speed': 1}, 'homing'),
        ({'switches': None}, 'homing.switches'),
        ({'index': {'Y': 1.0}}, 'homing.index.Y'),
        ({'index': {'X': 900.0}}, 'homing.index.X'),
    ],
)
def test_a_wrong_entry_is_refused_naming_the_key(changes, key):
    with pytest.raises(MachineError, match=key.replace('.', r'\.')):
        machine(**changes)
