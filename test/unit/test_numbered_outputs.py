"""M62 to M68: outputs by their number with the motion, and waiting for inputs."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from test_functions_played import MACHINE, Bench

from cnc_interp.commands.cli import main
from cnc_interp.machine_model.machine import find_machine_file
from cnc_interp.machine_model.signals import signals

GIVEN = """
signals:
  outputs: {digital_out_0: , analog_out_1: {range: [0, 10]}, digital_out_3: }
  inputs: {digital_in_2: }
  switched_off: {digital_out_0: always, digital_out_3: never}
"""
OUTPUTS = {'digital_out_0': None, 'analog_out_1': {'range': [0, 10]}, 'digital_out_3': None}
SIGNALS = {
    'outputs': OUTPUTS,
    'inputs': {'digital_in_2': None},
    'switched_off': {'digital_out_0': 'always', 'digital_out_3': 'never'},
}
PROGRAM = """G21 G90
G0 X0 Y0 Z0
M62 P0
G1 X5 F3000
M67 E1 Q7.5
X10
M63 P0
M64 P3
X15
M68 E1 Q0
X20
M66 P2 L3 Q5
X25
M65 P3
M30
"""


def machine():
    return replace(MACHINE, signals=signals({'signals': SIGNALS}))


def test_outputs_change_with_the_first_setpoint_of_their_block_and_m66_waits():
    bench = Bench(PROGRAM, machine())
    names = [signal.name for signal in bench.machine.signals.wires]
    came, places = {}, []
    for _ in range(20_000):
        before = bench.drives.outputs.copy()
        bench.step()
        x = bench.play.axes.setpoints[-1][0]
        places.append(x)
        for k in np.flatnonzero(bench.drives.outputs != before):
            came[names[k], float(bench.drives.outputs[k])] = x
        if len(places) > 1000 and places[-1] == places[-1000]:
            bench.drives.inputs[0] = 1.0  # the answer, long after the path rests
        if bench.play.state.completed and len(came) == 6:
            break
    assert bench.play.state.completed
    # A block begins where the corner to it is rounded: within the blend of its first point.
    wanted = {
        ('digital_out_0', 1.0): 0.0,
        ('analog_out_1', 7.5): 5.0,
        ('digital_out_0', 0.0): 10.0,
        ('digital_out_3', 1.0): 10.0,
        ('analog_out_1', 0.0): 15.0,
        ('digital_out_3', 0.0): 25.0,
    }
    assert came.keys() == wanted.keys()
    for what, x in wanted.items():
        assert 1e3 * came[what] == pytest.approx(x, abs=0.6), what
    rests = np.array(places)[:-1][np.diff(places) == 0.0]
    assert (np.abs(rests - 0.02) < 1e-9).sum() >= 999  # M66 waits at X20


def test_m66_asks_the_operator_when_its_time_is_over():
    bench = Bench(PROGRAM.replace('Q5', 'Q0.2'), machine())
    for _ in range(6000):
        bench.step()
    assert 'digital_in_2 has not come within 0.2 s' in bench.play.state.text


def test_a_plan_with_numbered_outputs_is_proven_against_its_text(tmp_path, capsys):
    file = tmp_path / 'io.yaml'
    file.write_text(find_machine_file('xyz').read_text() + GIVEN)
    (tmp_path / 'p.ngc').write_text(PROGRAM)
    out = str(tmp_path / 'out')
    assert main(['plan', str(tmp_path / 'p.ngc'), '--machine', str(file), '--out', out]) == 0
    assert main(['check', out, '--program', str(tmp_path / 'p.ngc')]) == 0, capsys.readouterr()


@pytest.mark.parametrize(
    ('line', 'told'),
    [
        ('M62 P0', 'NOT executed, the machine file has no signal for M64 P0'),
        ('M62', 'M62: give the number of the output as P'),
        ('M66 P0 L1 Q1', 'M66: give the number of the input as P'),
        ('M67 E2 Q5', 'no signal for M68 E2'),
    ],
)
def test_a_machine_without_them_names_the_word(tmp_path, capsys, line, told):
    """M62 P0 was refused by "P0: this word has no meaning here"."""
    (tmp_path / 'p.ngc').write_text(f'G21 G90\nG0 X0 Y0 Z0\n{line}\nG1 X5 F500\nM30\n')
    main(['plan', str(tmp_path / 'p.ngc'), '--machine', 'xyz', '--out', str(tmp_path / 'out')])
    assert told in capsys.readouterr().err
