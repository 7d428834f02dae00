"""Geometric errors: tables, and axes that lead a machine with errors where an ideal one goes."""

import ctypes

import numpy as np
import pytest
from geometric_errors import at_poses, figures
from test_jog import Bench
from tiers import examples
from true_machines import TrueMachine

from cnc_interp import check, plan_program, read_text
from cnc_interp.core import UM, MachineError, TravelError
from cnc_interp.core.small_files import read_yaml
from cnc_interp.kinematics.axis_path import evaluate
from cnc_interp.library import smooth_path
from cnc_interp.machine.simulated_probe import ProbingDrives
from cnc_interp.machine_model.machine import find_machine_file, from_mapping
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.proof.own_errors import OwnErrors

CONTENT = read_yaml(find_machine_file('xyzac'))
AT = np.linspace(-500.0, 500.0, 81)
WAVE = (10.0 * np.sin(AT / 20.0)).tolist()


def machine(**errors):
    return from_mapping({**CONTENT, 'errors': {'chain': 'XYZ', **errors}})


def refusal(errors, folder=None):
    with pytest.raises(MachineError) as refused:
        from_mapping({**CONTENT, 'errors': errors}, *([folder] if folder else []))
    return str(refused.value)


def commanded(of, *rows):
    q = np.array(rows, dtype=float)
    return Transform.of(of).errors.commanded(np.hstack([q, np.zeros((len(q), 2))]))[:, :3]


@pytest.mark.parametrize('seed', range(7))
def test_the_true_tip_of_a_random_machine_is_where_it_shall_be(seed):
    error, left = at_poses(TrueMachine(seed), seed)
    assert error > 30 * UM
    assert left <= min(0.5 * UM, 0.01 * error)


@pytest.mark.parametrize('seed', range(examples(2, 20)))
def test_a_compensated_plan_keeps_limits_tolerances_and_time(seed):
    found = figures(seed)
    assert found.left_on_path <= min(0.5 * UM, 0.01 * found.error)
    assert not found.faults
    assert abs(found.time - 1.0) < 0.01


def test_positive_errors_are_taken_back_in_their_directions():
    """A tool that is 10 um too far along +X when Y is anywhere is commanded 10 um less."""
    flat = {'at_mm': [-500, 500], 'EXY_um': [10, 10], 'EZY_um': [-4, -4]}
    assert commanded(machine(Y=flat), (0.1, 0.2, 0.3)) == pytest.approx(
        np.array([[0.1 - 10e-6, 0.2, 0.3 + 4e-6]]), abs=1e-12
    )


@pytest.mark.parametrize(
    ('name', 'place', 'way'),
    [
        ('C0Y_urad', (0.0, 0.2, 0.0), (-1, 0, 0)),
        ('B0Z_urad', (0.0, 0.0, 0.2), (1, 0, 0)),
        ('A0Z_urad', (0.0, 0.0, 0.2), (0, -1, 0)),
    ],
)
def test_squareness_turns_the_second_axis_about_the_first_letter(name, place, way):
    found = commanded(machine(squareness={name: 100.0}), place)[0]
    assert found == pytest.approx(np.array(place) - 0.2 * 100e-6 * np.array(way), abs=1e-8)


@pytest.mark.parametrize(
    ('chain', 'lever'), [('XYZ', 0.2), ('XZY', 0.2), ('YXZ', 0.0), ('YZX', 0.0)]
)
def test_a_rotation_has_the_lever_of_the_axes_towards_the_tool(chain, lever):
    """ECX turns what X carries: with Y after it, X is off by the rotation times Y."""
    table = {'at_mm': [-500, 500], 'ECX_urad': [50, 50]}
    found = commanded(machine(X=table, chain=chain), (0.1, 0.2, 0.3))[0]
    assert found[0] - 0.1 == pytest.approx(50e-6 * lever, abs=1e-8)


def test_what_was_measured_elsewhere_has_the_lever_from_there():
    table = {'at_mm': [-500, 500], 'ECX_urad': [50, 50]}
    found = commanded(machine(X=table, measured_at_mm={'X': [0, 150, 0]}), (0.1, 0.2, 0.3))[0]
    assert found[0] - 0.1 == pytest.approx(50e-6 * 0.05, abs=1e-8)


def test_a_long_tool_makes_the_lever_longer():
    table = {'at_mm': [-500, 500], 'EBZ_urad': [50, 50]}
    found = commanded(machine(Z=table, tool_length_mm=120.0), (0.1, 0.2, 0.3))[0]
    assert found[0] - 0.1 == pytest.approx(50e-6 * 0.12, abs=1e-8)


def test_the_map_is_its_inverse_and_agrees_with_the_proof():
    true = TrueMachine(2)
    q = true.places_of_axes(np.random.default_rng(5), 300, 0.95)
    errors = Transform.of(true.machine).errors
    c = errors.commanded(q)
    assert np.abs(c - q).max() > 20 * UM
    assert np.abs(errors.nominal(c) - q).max() < 1e-15
    assert np.abs(OwnErrors(true.machine).nominal(c) - q).max() < 1e-12


def test_a_path_with_errors_has_continuous_third_derivatives():
    """Across nodes of a table, a long line has none of its own: all of them come from the map."""
    of = machine(X={'at_mm': AT.tolist(), 'EYX_um': WAVE, 'EAX_urad': WAVE})
    text = 'G21 G90 G94 G49\nTRAORI\nG0 X-150 Y0 Z50\nG1 X150 F6000\nM30\n'
    path = smooth_path(read_text(text, 'line', Transform.of(of)).blocks, Transform.of(of))
    jumps = np.abs(path.cell_left[3, 1:] - path.cell_right[3, :-1])[~path.stop[1:-1]]
    assert len(jumps) > 3
    assert jumps.max() < 1e-9 * np.abs(path.cell_left[3]).max()
    s = np.linspace(path.s[0], path.s[-1], 5000)
    q = evaluate(path, s)[0]
    own = OwnErrors(of).nominal(q)
    assert np.abs(np.diff(own[:, 1:3], axis=0)).max() < 1e-9


def test_the_travel_is_checked_for_the_commanded_axes():
    of = machine(X={'at_mm': [-500, 500], 'EXX_um': [-50, -50]})
    text = 'G21 G90 G94 G49\nG0 X0 Y0 Z0\nG1 X{} F6000\nM30\n'
    reads = [read_text(text.format(x), 'line', Transform.of(of)) for x in (459.9, 459.99)]
    assert plan_program(reads[0], of).setpoints.position[:, 0].max() == pytest.approx(0.49995)
    with pytest.raises(TravelError, match='axis X would have to go to 500'):
        plan_program(reads[1], of)


def test_tables_of_zeros_change_nothing_that_is_seen():
    text = 'G21 G90 G94 G49\nTRAORI\nG0 X0 Y0 Z10\nG1 X50 A10 C20 F3000\nY30\nM30\n'
    plans = [
        plan_program(read_text(text, 'part', Transform.of(of)), of)
        for of in (from_mapping(CONTENT), machine(squareness={}))
    ]
    position = [plan.setpoints.position for plan in plans]
    assert np.abs(position[0] - position[1]).max() < 1e-15


def test_lines_in_axes_are_nominal_ones():
    """Without tool-tip programming, a line of words is straight in the axes that words count."""
    of = machine(X={'at_mm': AT.tolist(), 'EYX_um': WAVE, 'EZX_um': WAVE})
    text = 'G21 G90 G94 G49\nG0 X-100 Y10 Z20 A5 C10\nG1 X100 Y40 C30 F6000\nM30\n'
    plan = plan_program(read_text(text, 'line', Transform.of(of)), of)
    assert check(plan).ok
    q = OwnErrors(of).nominal(plan.setpoints.position)
    share = (q[:, 0] - q[0, 0]) / (q[-1, 0] - q[0, 0])
    assert np.abs(q - q[0] - share[:, None] * (q[-1] - q[0])).max() < 1e-9
    bent = plan.setpoints.position[:, 1] - q[:, 1]
    assert np.ptp(bent) > 15 * UM


def test_a_csv_file_beside_the_machine_file_is_a_table(tmp_path):
    rows = '\n'.join(f'{at},{wave},0' for at, wave in zip(AT, WAVE, strict=True))
    (tmp_path / 'x.csv').write_text(f'# laser, 12 May\nat_mm, EXX_um, EAX_urad\n{rows}\n')
    inline = machine(X={'at_mm': AT.tolist(), 'EXX_um': WAVE})
    read = from_mapping({**CONTENT, 'errors': {'chain': 'XYZ', 'X': 'x.csv'}}, tmp_path)
    a, b = (Transform.of(of).errors.packed for of in (inline, read))
    assert np.array_equal(a, b)


@pytest.mark.parametrize(
    ('errors', 'text'),
    [
        ({'X': {'at_mm': [-500, 500], 'EAX_urad': [1, 1]}}, 'errors.chain'),
        ({'chain': 'XYY'}, 'errors.chain'),
        ({'chain': 'XYZ', 'W': {}}, 'errors.W'),
        ({'chain': 'XYZ', 'X': 'none.csv'}, 'cannot be read'),
        ({'chain': 'XYZ', 'X': {'at_mm': [-500, 500], 'EXY_um': [0, 1]}}, 'EXY_um'),
        ({'chain': 'XYZ', 'X': {'at_mm': [-500, 500], 'EXX_um': [0]}}, 'must be a list of 2'),
        ({'chain': 'XYZ', 'X': {'at_mm': [500, -500], 'EXX_um': [0, 0]}}, 'increasing'),
        ({'chain': 'XYZ', 'X': {'at_mm': [0, 100], 'EXX_um': [0, 0]}}, 'does not cover'),
        ({'chain': 'XYZ', 'X': {'at_mm': [-500, 500], 'EXX_um': [0, 9000]}}, 'is the unit right'),
        ({'X': {'at_mm': [-500, 0, 1, 500], 'EXX_um': [0, 0, 9, 9]}}, 'a factor of 4'),
        ({'X': {'at_mm': [-500, -250, 0, 500], 'EXX_um': [0, 0, 1900, 1900]}}, 'is the unit'),
        ({'chain': 'XYZ', 'squareness': {'C0X_urad': 3}}, 'C0X_urad'),
        ({'chain': 'XYZ', 'tool_length_mm': 'long'}, 'tool_length_mm'),
    ],
)
def test_wrong_entries_are_refused_by_their_names(errors, text):
    found = refusal(errors)
    assert text in found
    assert '\n' not in found


@pytest.mark.parametrize(
    ('content', 'text'),
    [('', 'no rows'), ('at_mm,EXX_um\n1\n', 'row 2'), ('at_mm,EXX_um\n1,x\n', "'x' is no number")],
)
def test_wrong_files_are_refused_by_their_rows(tmp_path, content, text):
    (tmp_path / 'x.csv').write_text(content)
    assert text in refusal({'chain': 'XYZ', 'X': 'x.csv'}, tmp_path)


def nominal(of, q):
    return Transform.of(of).errors.nominal(np.asarray(q, dtype=float))


def test_by_hand_an_axis_moves_alone_for_the_operator():
    """The drives of the other axes follow; limits and travel are theirs (``Bench.rest``)."""
    of = TrueMachine(0).machine
    bench = Bench(of)
    start = nominal(of, bench.q[-1:])[0]
    bench.move(X=0.15)
    bench.rest()
    seen = nominal(of, bench.q)
    assert seen[-1, 0] - start[0] == pytest.approx(0.15, abs=1e-9)
    assert np.abs(seen[:, 1:] - start[1:]).max() < 1e-9
    assert np.ptp(bench.q[:, 1:3], axis=0).max() > 2 * UM
    bench.move(relative=False, X=0.1, Y=-0.05)
    bench.rest()
    assert nominal(of, bench.q[-1:])[0, :2] == pytest.approx([0.1, -0.05], abs=1e-9)


@pytest.mark.thorough
def test_keys_along_axes_and_tool_keep_all_limits():
    of = TrueMachine(0).machine
    bench = Bench(of)
    bench.run(1.0, X=1.0, Y=0.7, A=0.4)
    bench.rest()
    tips = [true_tip(of, bench.q[-1:])]
    bench.move(tool=0.02)
    bench.rest()
    tips.append(true_tip(of, bench.q[-1:]))
    axis = Transform.of(of).tool_axis(bench.q[-1:, 3:5])
    assert tips[1] - tips[0] == pytest.approx(0.02 * axis, abs=1e-9)
    bench.run(6.0, X=1.0)
    bench.rest()
    off = of.errors.bounds[0]
    assert 0.5 - 2.0 * off < bench.q[-1, 0] < 0.5
    bench.run(0.3)
    bench.move(relative=False, X=0.5 - 0.5 * off)  # beyond where keys lead
    bench.rest()
    bench.run(0.5, X=1.0)
    bench.rest()
    assert nominal(of, bench.q[-1:])[0, 0] == pytest.approx(0.5 - 0.5 * off, abs=1e-9)
    bench.run(0.5, X=-1.0)
    bench.rest()
    assert bench.q[-1, 0] < 0.45


def true_tip(of, q):
    return Transform.of(of).forward(nominal(of, q))[0]


def test_while_axes_are_homed_they_count_as_the_drives_do():
    of = TrueMachine(0).machine
    bench = Bench(of)
    bench.jog.by_drives = True
    bench.move(relative=False, X=0.1)
    bench.rest()
    assert bench.q[-1] == pytest.approx([0.1, 0.0, 0.0, 0.0, 0.0], abs=1e-9)


@pytest.mark.parametrize('seed', [1, 2])
def test_a_simulated_probe_touches_where_the_true_tip_is(tmp_path, seed):
    true, file = TrueMachine(seed), tmp_path / 'part.yaml'
    assert true.length == 0.0
    c = true.places_of_axes(np.random.default_rng(3), 1, 0.5)
    tip, off = true.tips(c)[0], true.tips(c)[0] - true.tips(c, true=False)[0]
    assert np.linalg.norm(off) > 5 * UM
    normal, touched = off / np.linalg.norm(off), []
    for gap in (-0.2 * UM, 0.2 * UM):
        place = 1e3 * (tip + gap * normal)
        file.write_text(
            'probe: {radius_mm: 0}\n'
            f'surfaces: [{{plane: {place.tolist()}, normal: {normal.tolist()}}}]'
        )
        drives = ProbingDrives(true.machine, 1e-3, c[0], file)
        n = len(c[0])
        setpoint, feedback = np.concatenate([c[0], np.zeros(n)]), np.zeros(4 * n)
        step = ctypes.CFUNCTYPE(*[ctypes.c_int64] * 5)(drives.step)
        for _ in range(400):
            step(drives.memory.ctypes.data, setpoint.ctypes.data, feedback.ctypes.data, n)
        touched.append(drives.inputs[true.machine.signals.probe[1]])
    assert touched == [0.0, 1.0]


def test_what_the_machine_says_are_nominal_axes_and_the_true_tip():
    machine_messages = pytest.importorskip('cnc_interp.wire.machine_messages')
    true = TrueMachine(0)
    c = true.places_of_axes(np.random.default_rng(3), 1, 0.5)
    bench = Bench(true.machine, c[0])
    bench.run(0.3)
    message = machine_messages.machine_state(bench.play, 1e-3)
    expected = OwnErrors(true.machine).nominal(c)[0]
    for said in (message.positions, message.commanded_positions):
        assert np.array(said) == pytest.approx(expected, abs=1e-9)
    assert np.array(message.tip) == pytest.approx(true.tips(c)[0], abs=0.2 * UM)
