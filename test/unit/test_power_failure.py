"""A power failure stops the machine on its path; its positions are known at the next start."""

import copy

import numpy as np
import pytest
from test_functions_played import Bench as RunBench
from test_homing import machine as homed_machine
from test_jog import Bench, use_of

from cnc_interp.core import InterpError
from cnc_interp.core.small_files import read_yaml
from cnc_interp.machine.homing import Homing
from cnc_interp.machine.kept_positions import keep_positions, kept_positions
from cnc_interp.machine_model.machine import Machine, find_machine_file, from_mapping
from cnc_interp.run.run_state import Reason, State

SIGNALS = {'inputs': {'power_fails': None}}


def machine():
    content = copy.deepcopy(read_yaml(find_machine_file('xyz')))
    return from_mapping(content | {'signals': SIGNALS})


def test_a_program_stops_on_its_path_within_the_limits_and_stays_so_until_power_is_back():
    given = machine()
    bench = RunBench('G21 G90\nG0 X0 Y0 Z0\nG1 X40 Y20 F6000\nX0\nM30\n', given)
    places = [np.zeros(3)]
    while not bench.play.state.resting or len(places) < 200:
        if bench.play.axes.setpoints[-1][0] > 0.010:
            bench.drives.inputs[0] = 1.0
        bench.step()
        places.append(bench.play.axes.setpoints[-1].copy())
        assert len(places) < 20_000
    q, play = np.array(places), bench.play
    assert play.state.state is State.FAULT and play.state.reason is Reason.DRIVE_FAULT
    assert 'the power fails' in play.state.text and play.power_fails
    assert 0.010 < q[:, 0].max() < 0.030
    assert q[:, 1] == pytest.approx(0.5 * q[:, 0], abs=1e-6)  # on the path
    assert max(use_of(given, q)) <= 1.001
    play.reset()
    play.read()
    assert play.state.state is State.FAULT  # the mains are still gone
    bench.drives.inputs[0] = 0.0
    play.reset()
    play.read()
    assert play.state.state is State.IDLE and not play.power_fails


def test_at_rest_the_machine_goes_to_fault_at_once():
    bench = Bench(machine())
    bench.play.drives.inputs[0] = 1.0
    bench.run(0.05)
    assert bench.state is State.FAULT and 'the power fails' in bench.play.state.text


def test_positions_come_back_to_the_last_digit_without_the_axes_that_are_unknown(tmp_path):
    xyzac, file = Machine.load('xyzac'), str(tmp_path / 'kept.yaml')
    q = np.array([0.1234567890123, -0.2, 1e-9 / 3.0, -0.7, 123.456])
    known = [True, True, True, False, True]
    keep_positions(file, xyzac, q, known)
    found = kept_positions(file, xyzac)
    assert np.array_equal(np.isfinite(found), known)
    assert found[known] == pytest.approx(q[known], rel=1e-15)
    assert np.isnan(kept_positions('', xyzac)).all()
    assert np.isnan(kept_positions(str(tmp_path / 'none.yaml'), xyzac)).all()


@pytest.mark.parametrize('text', ['X: here', 'Q: 1.0', '[1, 2]', 'X: .nan', 'X: [', ''])
def test_a_file_that_names_no_positions_is_rejected_in_one_line(tmp_path, text):
    file = tmp_path / 'kept.yaml'
    file.write_text(text, encoding='utf-8')
    with pytest.raises(InterpError, match='delete it and home the axes') as told:
        kept_positions(str(file), Machine.load('xyzac'))
    assert '\n' not in str(told.value)


def test_axes_whose_positions_were_kept_need_not_be_homed():
    bench = Bench(homed_machine())
    homing = Homing(bench.play, bench.jog)
    homing.know(['X', 'Y', 'Z'])
    assert homing.must_home == ['A']
    homing.forget()
    assert homing.must_home == ['X', 'Z', 'A']
