"""Drives with a largest torque: read, planned, stopped, revised, jogged and proven."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
import whole_plans
import yaml
from feedrate_paths import line_path, polyline_path, random_polyline
from programs import zigzag

from cnc_interp.core import FloatArray, MachineError, StreamError
from cnc_interp.core.axis_limits import DriveLoad
from cnc_interp.feedrate.planning_windows import PlannedPiece, plan_path
from cnc_interp.feedrate.stop_law import stop_law
from cnc_interp.kinematics.axis_path import evaluate
from cnc_interp.machine.axis_motion import refuse_setpoints
from cnc_interp.machine.jog_motion import JogMotion
from cnc_interp.machine.slides import Slides
from cnc_interp.machine_model.machine import Machine, find_machine_file, from_mapping
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import open_program
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.proof.verify import verify_plan
from cnc_interp.report.plots import axes_figure
from cnc_interp.report.series import series_of
from cnc_interp.run.motion_plan import MotionStream
from cnc_interp.run.overrides import OperatorSettings
from cnc_interp.run.planning_chain import plan_to_files
from cnc_interp.run.setpoints import Setpoints, Wait
from cnc_interp.settings.options import Settings

RAM = Machine.load('ram_mill')
CONTENT = yaml.safe_load(find_machine_file('ram_mill').read_text())
XYZAC = Machine.load('xyzac')
#: Weak drives on three axes: inertia, torque, Coulomb and viscous friction.
LOADS = {
    0: DriveLoad(400.0, 800.0, 120.0, 600.0),
    1: DriveLoad(300.0, 600.0, 150.0, 0.0),
    4: DriveLoad(2.0, 8.0, 1.2, 2.0),
}
LOADED = XYZAC.having(load=LOADS)
T = 1e-3


def torque(load: DriveLoad, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Torque over the largest one; a velocity that is rounding alone has no friction."""
    moves = np.where(np.abs(velocity) < 1e-9, 0.0, np.sign(velocity))
    asked = load.inertia * acceleration + load.viscous * velocity + load.coulomb * moves
    return np.abs(asked) / load.torque


def torques(piece: PlannedPiece) -> tuple[FloatArray, FloatArray]:
    """Torques of the loaded axes from q(s(t)), shape (K,) each, and the times."""
    law = piece.law
    time = np.sort(np.concatenate([law.time, np.linspace(law.time[0], law.end_time, 4000)]))
    row = law.piece_at(time)
    s, v, a, _ = (x[:, None] for x in law.evaluate(time, row))
    _, q_s, q_ss, _ = evaluate(piece.path, s[:, 0], law.cell[row])
    motion = q_s * v, q_ss * v**2 + q_s * a
    shares = [torque(load, *(x[:, axis] for x in motion)) for axis, load in LOADS.items()]
    return np.max(shares, axis=0), time


def of_setpoints(q: FloatArray, load: DriveLoad) -> FloatArray:
    """Torques over the largest one by differences of an axis from rest to rest."""
    q = np.pad(q, 3, mode='edge')
    velocity, acceleration = (q[2:] - q[:-2]) / (2 * T), np.diff(q, 2) / T**2
    share = torque(load, velocity, acceleration)
    steps = np.diff(q)
    turns = steps[1:] * steps[:-1] < 0.0  # friction has both signs there
    return np.where(turns, torque(replace(load, coulomb=0.0), velocity, acceleration), share)


@pytest.mark.thorough
def test_a_line_uses_the_whole_torque_and_no_more():
    piece = plan_path(line_path(0.6), LOADED)
    share, time = torques(piece)
    assert share.max() <= 1.0
    row = piece.law.piece_at(time)
    _, v, a, j = piece.law.evaluate(time, row)
    others = np.abs([v / 0.5, a / 2.5, j / 5.0])
    # at every moment the torque, the velocity or the jerk is at its limit
    edges = np.searchsorted(time, piece.law.time[1:])
    most = np.maximum(share, others.max(axis=0))
    assert np.mean(np.array([part.max() for part in np.split(most, edges)]) > 0.997) > 0.94
    free = plan_path(line_path(0.6), XYZAC)
    # the largest acceleration that the drive reaches at every velocity, both ways
    least = np.minimum(XYZAC.max_acceleration, LOADED.limits.lowest.max_acceleration)
    slow = plan_path(line_path(0.6), XYZAC.having(max_acceleration=least))
    assert free.law.end_time < piece.law.end_time < slow.law.end_time


def test_friction_helps_to_brake():
    share, time = torques(piece := plan_path(line_path(0.6), LOADED))
    assert share.max() > 0.998
    a = piece.law.evaluate(time, piece.law.piece_at(time))[2]
    assert -a.min() > 1.1 * a.max()


@pytest.mark.parametrize('seed', range(3))
def test_corners_and_turns_keep_the_torques(seed):
    points = random_polyline(np.random.default_rng(seed), 12)
    piece = plan_path(polyline_path(points, 0.3), LOADED)
    free = plan_path(polyline_path(points, 0.3), XYZAC)
    assert torques(piece)[0].max() <= 1.0 < torques(free)[0].max()
    assert piece.law.end_time > free.law.end_time


def test_a_torque_out_of_reach_hardly_changes_the_law():
    path = polyline_path(random_polyline(np.random.default_rng(5), 12))
    strong = XYZAC.having(load={axis: DriveLoad(1.0, 1e4, 0.1, 0.1) for axis in range(5)})
    found, same = plan_path(path, XYZAC), plan_path(path, strong)
    assert same.law.end_time == pytest.approx(found.law.end_time, rel=1e-4)


def test_a_stop_from_any_moment_keeps_the_torques():
    path = polyline_path(random_polyline(np.random.default_rng(1), 6), 0.3)
    law = (piece := plan_path(path, LOADED)).law
    found = 0
    moments = np.arange(0.02, law.end_time, 0.02)
    for s, v, a, _ in np.array(law.evaluate(moments)).T.tolist():
        stop = stop_law(piece.path, (s, v, a), LOADED.limits.table, 0.0)
        if stop is not None:
            found += 1
            assert torques(stop)[0].max() <= 1.0
    assert found > 0.5 * len(moments)


def test_revisions_and_tails_of_a_stream_keep_the_torques():
    rng = np.random.default_rng(3)
    path = whole_plans.path_of(zigzag(0), Transform.of(LOADED), Settings())
    stream = MotionStream(LOADED, T)
    stream.push(path)
    stream.end_leg(Wait.END)
    sent, revisions = [], 0
    while not sent or sent[-1].wait is not Wait.END:
        if sent:
            count = sum(len(chunk.samples) for chunk in sent)
            wanted = OperatorSettings(float(rng.choice([0.1, 0.5, 1.2, 1.5])))
            revision = stream.revision(count - 1, wanted)
            if revision is not None:
                stream.adopt(revision)
                revisions += 1
        for _ in range(int(rng.integers(2, 8))):
            while not stream.current.can_sample and stream.current.can_plan:
                stream.current.plan()
            sent += stream.current.sample() if stream.current.can_sample else []
    assert revisions > 3
    run = Setpoints.concatenate([chunk.samples for chunk in sent]).position
    ways, rows = [run], 0
    for chunk in sent:
        rows += len(chunk.samples)
        if len(chunk.tail):
            ways.append(np.concatenate([run[:rows], chunk.tail.position]))
    assert len(ways) > 0.8 * len(sent)
    for way in ways:
        shares = [of_setpoints(way[:, axis], load) for axis, load in LOADS.items()]
        assert np.max(shares) <= 1.001


PROGRAM = """G21 G90 G94
G0 X-300 Y0 Z100
G1 X300 Y200 Z-40 F30000
G1 X200 Y0
G1 Y200
G1 X150
G3 X50 Y200 I-50 J0
G1 Y199
G1 Y200
G1 Z100
"""


@pytest.fixture(scope='module')
def planned(tmp_path_factory):
    """Plan files of a program on the mill whose Y drive has a largest force."""
    folder = tmp_path_factory.mktemp('loaded')
    (folder / 'ram.ngc').write_text(PROGRAM)
    program = open_program(folder / 'ram.ngc', Transform.of(RAM), Settings())
    summary = plan_to_files(program, RAM, folder / 'out')
    return folder / 'out', summary


def positions(folder):
    with np.load(folder / 'setpoints.npz') as samples:
        return samples['position']


def test_setpoints_use_the_whole_force_and_the_proof_agrees(planned):
    folder, _ = planned
    proof = verify_plan(folder, RAM)
    assert proof.ok, proof.failures
    q = positions(folder)
    load = DriveLoad(2000.0, 5000.0, 600.0, 3000.0)
    assert RAM.limits.loads == {1: load}
    share = of_setpoints(q[:, 1], load)
    assert 0.998 < share.max() < 1.001
    assert proof.use_of('torque', 'Y') == pytest.approx(share.max(), abs=1e-3)
    assert np.isnan(proof.use_of('torque', 'X')) and 'torque' in proof.text()
    refuse_setpoints(RAM, T, np.repeat(q[:1], 3, axis=0), q)


def test_a_plan_without_the_force_is_not_proven(planned, tmp_path):
    endless = RAM.having(load={})
    (tmp_path / 'ram.ngc').write_text(PROGRAM)
    program = open_program(tmp_path / 'ram.ngc', Transform.of(endless), Settings())
    plan_to_files(program, endless, tmp_path / 'out')
    assert verify_plan(tmp_path / 'out', endless).ok
    proof = verify_plan(tmp_path / 'out', RAM)
    assert [failure.split()[:3] for failure in proof.failures] == [['torque', 'of', 'Y']]
    assert ' N, limit 5000 N ' in proof.failures[0]
    q = positions(tmp_path / 'out')
    with pytest.raises(StreamError, match=r'Y asked for .* times its largest torque'):
        refuse_setpoints(RAM, T, np.repeat(q[:1], 3, axis=0), q)
    assert len(q) < len(positions(planned[0]))


def test_jog_keeps_the_force():
    motion = JogMotion(Slides.of_axes(RAM), T, np.array([0.0, 0.0, 0.0]))
    motion.go(np.array([0.1, 0.5, 0.0]), 1.0)
    rows = []
    while not motion.over:
        rows.append(motion.piece(50).samples.position)
    q = np.concatenate(rows)
    refuse_setpoints(RAM, T, np.zeros((3, 3)), q)
    assert of_setpoints(q[:, 1], RAM.limits.loads[1]).max() <= 1.001


@pytest.mark.parametrize(
    ('axis', 'change', 'says'),
    [
        ('Y', {'mass_kg': None}, 'loads.Y.mass_kg: must be a number'),
        ('Y', {'force_N': -1.0}, 'loads.Y.force_N: must be positive'),
        ('Y', {'force_N': 1500.0}, 'at the largest velocity friction takes 2100'),
        ('Y', {'coulomb_N': -1.0}, 'loads.Y.coulomb_N: must not be negative'),
        ('Y', {'torque_Nm': 1.0}, 'loads.Y: give mass_kg and force_N; coulomb_N, viscous'),
        ('X', {'mass_kg': 10.0}, 'loads.X: give mass_kg and force_N'),
        ('B', {}, 'loads.B: the machine has no such axis'),
    ],
)
def test_a_wrong_load_is_refused_in_one_line(axis, change, says):
    content = copy.deepcopy(CONTENT)
    content['loads'].setdefault(axis, {}).update(change)
    with pytest.raises(MachineError) as refused:
        from_mapping(content)
    assert says in str(refused.value) and '\n' not in str(refused.value)


def test_the_report_draws_the_force(planned):
    plan = read_plan(planned[0])
    series = series_of(plan, RAM)
    assert list(series.torque_use) == [1] and series.largest_torque == {1: 5000.0}
    found = verify_plan(planned[0], RAM).largest('torque', 'Y')
    assert series.torque_use[1][found.sample] == pytest.approx(found.ratio, abs=1e-9)
    drawn = [trace.name for trace in axes_figure(series).data]
    assert 'Y torque' in drawn and 'X torque' not in drawn
