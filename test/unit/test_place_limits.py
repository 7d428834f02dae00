"""Limits that depend on the position of an axis: read, planned, stopped, jogged and proven."""

from __future__ import annotations

import copy
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from feedrate_paths import XYZAC, Limits, line_path, polyline_path, random_polyline
from tiers import examples

from cnc_interp.core import MM, FloatArray, MachineError, StreamError
from cnc_interp.core.axis_limits import LimitsByPlace
from cnc_interp.core.limit_kernels import largest_between, limits_along
from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import PlannedPiece, plan_path
from cnc_interp.feedrate.stop_law import stop_law
from cnc_interp.kinematics.axis_path import evaluate
from cnc_interp.machine.axis_motion import refuse_setpoints
from cnc_interp.machine.jog_motion import JogMotion
from cnc_interp.machine.slides import Slides
from cnc_interp.machine_model.machine import Machine, find_machine_file, from_mapping
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import open_program
from cnc_interp.proof.limits_again import limits_of_differences
from cnc_interp.proof.verify import verify_plan
from cnc_interp.run.planning_chain import plan_to_files
from cnc_interp.settings.options import Settings

RAM = Machine.load('ram_mill')
CONTENT = yaml.safe_load(find_machine_file('ram_mill').read_text())
T = 1e-3

#: Where the limits of X change, and the limits there as parts of the largest ones.
PLACES = np.array([0.0, 0.1, 0.2, 0.35])
PARTS = {
    'velocity': [[1.0, 0.4, 0.4, 1.0], [1.0] * 4, [1.0] * 4],
    'acceleration': [[1.0] * 4, [1.0, 0.1, 0.1, 1.0], [1.0] * 4],
    'jerk': [[1.0] * 4, [1.0] * 4, [1.0, 0.2, 0.2, 1.0]],
}


def placed(limits: Limits, parts: list[list[float]], places: FloatArray = PLACES) -> Limits:
    """Let the limits of X depend on its position."""
    of_x = LimitsByPlace(*(limits.by_order[:, :1] * parts), places)
    return limits.having(by_place={0: of_x})


def uses(
    piece: PlannedPiece, limits: Limits, parts: list[list[float]]
) -> tuple[FloatArray, FloatArray]:
    """Use of velocity, acceleration and jerk of X from q(s(t)), shape (3, K), and the times."""
    law = piece.law
    time = np.sort(np.concatenate([law.time, np.linspace(law.time[0], law.end_time, 4000)]))
    row = law.piece_at(time)
    s, v, a, j = law.evaluate(time, row)
    q, q_s, q_ss, q_sss = (jet[:, 0] for jet in evaluate(piece.path, s, law.cell[row]))
    motion = q_s * v, q_ss * v**2 + q_s * a, q_sss * v**3 + 3 * q_ss * v * a + q_s * j
    largest = limits.max_velocity[0], limits.max_acceleration[0], limits.max_jerk[0]
    return np.array(
        [
            np.abs(x) / (most * np.interp(q, PLACES, part))
            for x, most, part in zip(motion, largest, parts, strict=True)
        ]
    ), time


@pytest.mark.parametrize('kind', PARTS)
def test_a_line_uses_the_limit_of_every_place_and_no_more(kind):
    parts = PARTS[kind]
    piece = plan_path(line_path(0.3), placed(XYZAC, parts))
    use, time = uses(piece, XYZAC, parts)
    assert use.max() <= 1.0
    # s_dddot is constant in a cell, so a limit is reached at one end of it at least
    edges = np.searchsorted(time, piece.law.time[1:])
    bound = np.array([part.max() for part in np.split(use.max(axis=0), edges)])
    assert np.mean(bound > 0.998) > 0.94
    whole = plan_path(line_path(0.3), XYZAC)
    assert piece.law.end_time > whole.law.end_time


@pytest.mark.parametrize('seed', range(3))
def test_corners_keep_the_limits_of_every_place(seed):
    parts = [[1.0, 0.5, 0.5, 1.0], [1.0, 0.4, 0.7, 1.0], [0.5, 0.3, 0.3, 1.0]]
    points = random_polyline(np.random.default_rng(seed), 12)
    piece = plan_path(polyline_path(points), placed(XYZAC, parts))
    assert uses(piece, XYZAC, parts)[0].max() <= 1.0


def test_a_table_that_says_the_same_everywhere_changes_no_bit():
    points = random_polyline(np.random.default_rng(5), 12)
    far = placed(XYZAC, [[1.0] * 4] * 3, PLACES + 100.0)  # no grid point more
    found, same = plan_path(polyline_path(points), XYZAC), plan_path(polyline_path(points), far)
    assert np.array_equal(found.law.s_dot, same.law.s_dot)
    assert np.array_equal(found.law.time, same.law.time)


def test_limits_without_places_are_constants():
    table = Machine.load('xyzac').limits.table
    assert table.shape == (7, 5, 1)
    assert np.array_equal(
        limits_along(table, np.zeros((1, 5)))[:, 0], Machine.load('xyzac').limits.by_order
    )


@pytest.mark.parametrize('kind', PARTS)
def test_a_stop_from_any_moment_keeps_the_limits_of_every_place(kind):
    parts = PARTS[kind]
    limits = placed(XYZAC, parts)
    law = (piece := plan_path(line_path(1.0), limits)).law
    missing = 0
    moments = np.arange(0.02, law.end_time, 0.02 * examples(8, 1))
    for s, v, a, _ in np.array(law.evaluate(moments)).T.tolist():
        if s > 0.4:
            break
        stop = stop_law(piece.path, (s, v, a), limits.table, 0.0)
        # where none is found the motion goes on as planned to the next moment
        missing = missing + 1 if stop is None else 0
        assert missing <= 1
        if stop is not None:
            assert uses(stop, XYZAC, parts)[0].max() <= 1.0


def test_the_bound_is_one_for_a_slower_law_within_the_same_limits():
    parts = [[1.0, 0.4, 0.4, 1.0], [1.0, 0.3, 0.3, 1.0], [1.0] * 4]
    piece = plan_path(line_path(0.3), placed(XYZAC, parts), PlanOptions(bound=True))
    whole = plan_path(line_path(0.3), XYZAC, PlanOptions(bound=True))
    assert whole.least_time < piece.least_time < piece.law.end_time


def test_the_largest_limit_between_two_positions_may_lie_at_a_place_between_them():
    of_second = LimitsByPlace(*np.array([[1.0, 5.0, 2.0]] * 3 + [[0.0, 1.0, 2.0]]))
    limits = Limits.constant(*np.ones((3, 2))).having(by_place={1: of_second})
    table = limits.table
    found = [largest_between(table, 2, 1, *ends) for ends in ((0.5, 1.5), (1.5, 9.0))]
    assert found == [5.0, 3.5] and largest_between(table, 2, 0, 0.0, 1.5) == 1.0
    machine = SimpleNamespace(limits=limits)
    q = np.array([[0.0, 0.5], [0.0, 1.5]])
    assert limits_of_differences(machine, 1, q).tolist() == [[1.0, 5.0]]


def test_a_machine_file_with_places_in_si():
    assert RAM.limits.table.shape == (7, 3, 4)
    q = np.array([[-0.05, 0.0, -0.55], [0.0, 0.0, -0.4], [0.4, 0.0, 0.0]])
    velocity, acceleration, jerk = RAM.limits.along(q)
    assert velocity[:, 0] == pytest.approx([1 / 6, 1 / 3, 0.5])
    assert acceleration[:, 2] == pytest.approx([1.2, 2.1, 3.0])
    assert jerk[:, 2] == pytest.approx([6.0, 18.0, 30.0])
    assert (jerk[:, :2] == 30.0).all() and (velocity[:, 1:] == 0.5).all()
    assert RAM.limits.lowest.max_jerk.tolist() == [30.0, 30.0, 6.0]


@pytest.mark.parametrize(
    ('axis', 'change', 'says'),
    [
        ('X', {'at_mm': [-50, 400, 400, 850]}, 'X.at_mm: must be increasing positions'),
        ('X', {'at_mm': [-50, 50, 750, 800]}, 'X.at_mm: does not cover the travel -50 ... 850'),
        ('X', {'velocity_m_per_min': [10, 0, 30, 10]}, 'X.velocity_m_per_min: must be positive'),
        ('X', {'velocity_m_per_min': [10, 30, 40, 10]}, 'X.velocity_m_per_min: 40 is above 30'),
        ('X', {'velocity_m_per_min': [10, 0.05, 30, 10]}, '0.05 is outside 0.06'),
        ('X', {'velocity_m_per_min': [10, 30]}, 'X.velocity_m_per_min: must be a list of 4'),
        ('X', {'at_mm': None}, 'X: give at_mm'),
        ('X', {'force_N': [1, 2, 3, 4]}, 'X.force_N: unknown'),
        ('B', {}, 'B: the machine has no such axis'),
        ('endless', {}, 'X: the axis is endless; give it travel_mm'),
    ],
)
def test_a_wrong_table_is_refused_in_one_line(axis, change, says):
    content = copy.deepcopy(CONTENT)
    if axis == 'endless':
        del content['limits']['X']['travel_mm']
    else:
        content['limits_by_position'].setdefault(axis, {}).update(change)
    with pytest.raises(MachineError) as refused:
        from_mapping(content)
    assert says in str(refused.value) and '\n' not in str(refused.value)


PROGRAM = """G21 G90 G94
G0 X-440 Y0 Z100
G1 X440 Y20 Z-140 F30000
G1 X-300 Z-140 Y0
G1 Z200
"""


@pytest.fixture(scope='module')
def planned(tmp_path_factory):
    """Plan files of a program on the machine with places."""
    folder = tmp_path_factory.mktemp('ram')
    (folder / 'ram.ngc').write_text(PROGRAM)
    plan_to_files(
        open_program(folder / 'ram.ngc', Transform.of(RAM), Settings()), RAM, folder / 'out'
    )
    return folder / 'out'


def shares(q: FloatArray, axis: int, order: int, key: str, unit: float) -> FloatArray:
    """Third (or other) differences over the limit that the machine file gives at their middle."""
    letter = 'XYZ'[axis]
    given = CONTENT['limits_by_position'][letter]
    held = np.pad(q[:, axis], 3, mode='edge')
    middle = np.convolve(held, np.ones(order + 1) / (order + 1), mode='valid')
    limit = np.interp(middle, np.array(given['at_mm']) * MM, np.array(given[key]) * unit)
    return np.abs(np.diff(held, order)) / T**order / limit


def test_a_plan_is_at_the_limits_of_its_places_and_proven(planned):
    proof = verify_plan(planned, RAM)
    assert proof.ok, proof.failures
    with np.load(planned / 'setpoints.npz') as samples:
        q = samples['position']
    for axis, order, key, unit in (
        (0, 1, 'velocity_m_per_min', 1 / 60),
        (2, 2, 'acceleration_m_per_s2', 1.0),
        (2, 3, 'jerk_m_per_s3', 1.0),
    ):
        share = shares(q, axis, order, key, unit)
        assert 0.998 < share.max() < 1.001
        name = ('velocity', 'acceleration', 'jerk')[order - 1]
        assert proof.largest(name, 'XYZ'[axis]).ratio == pytest.approx(share.max(), abs=1e-3)


def test_a_plan_for_the_largest_limits_is_not_proven(planned, tmp_path):
    rigid = RAM.having(by_place={})
    (tmp_path / 'ram.ngc').write_text(PROGRAM)
    program = open_program(tmp_path / 'ram.ngc', Transform.of(rigid), Settings())
    plan_to_files(program, rigid, tmp_path / 'out')
    assert verify_plan(tmp_path / 'out', rigid).ok
    proof = verify_plan(tmp_path / 'out', RAM)
    assert {'jerk of Z', 'acceleration of Z', 'velocity of X'} <= {
        ' '.join(failure.split()[:3]) for failure in proof.failures
    }
    with np.load(tmp_path / 'out' / 'setpoints.npz') as samples:
        q = samples['position']
    before = np.repeat(q[:1], 3, axis=0)
    refuse_setpoints(rigid, T, before, q)
    with pytest.raises(StreamError, match='times its largest'):
        refuse_setpoints(RAM, T, before, q)
    with np.load(planned / 'setpoints.npz') as samples:
        q = samples['position']
    refuse_setpoints(RAM, T, np.repeat(q[:1], 3, axis=0), q)


def test_jog_keeps_the_limits_of_every_place():
    motion = JogMotion(Slides.of_axes(RAM), T, np.array([0.0, 0.0, -0.5]))
    motion.go(np.array([0.8, 0.1, 0.0]), 1.0)
    before, rows = np.tile([0.0, 0.0, -0.5], (3, 1)), []
    while not motion.over:
        rows.append(motion.piece(50).samples.position)
    refuse_setpoints(RAM, T, before, np.concatenate(rows))
