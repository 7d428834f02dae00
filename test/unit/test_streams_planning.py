"""A run that goes on from where the machine rests: at any place of its path."""

import numpy as np
import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp.kinematics.axis_path import AxisPath, evaluate
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.kinematics.transform import Transform
from cnc_interp.program import read_text
from cnc_interp.run.path_chain import segments_of
from cnc_interp.run.run_planner import RunPlanner
from cnc_interp.settings.choices import Settings

MACHINE = Machine.load('xyzac')
TRANSFORM = Transform.of(MACHINE)
PROGRAM = 'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A15 C30\n' + ''.join(
    f'G1 X{10 * k} Y{8 * (k % 2)} A{14 + k % 3} F3000\n' for k in range(1, 9)
)


def segments():
    blocks = read_text(PROGRAM, 'steps.ngc', TRANSFORM, Settings()).blocks
    return segments_of(blocks, TRANSFORM, Settings())


def halves():
    """All segments in two parts."""
    whole = segments()
    return whole[: len(whole) // 2], whole[len(whole) // 2 :]


@pytest.mark.parametrize('before', [5e-14, 0.0, -5e-14, 2e-3])
def test_a_run_goes_on_from_the_border_of_what_came_in_one_piece(before):
    first, second = halves()
    builder = AxisPathBuilder(TRANSFORM, 0.03, 1e-3)
    parts = [builder.push(first), builder.push(second)]
    path, place = AxisPath.join(parts), float(parts[0].s[-1]) - before
    stands = evaluate(path, np.array([place]))[0][0]
    planner = RunPlanner(TRANSFORM, 0.03, 1e-3, 0.01, stands, place)
    planner.push(first, {})
    planner.push(second, {})
    planner.finish()
    chunks = []
    while planner.stream.can_plan or planner.stream.can_sample:
        chunks += planner.work(planner.stream.current, True, place)
    q = np.concatenate([chunk.samples.position for chunk in chunks])
    s = np.concatenate([chunk.samples.s for chunk in chunks])
    assert abs(s[0] - place) < 1e-12 and abs(s[-1] - path.s[-1]) < 1e-12
    assert np.abs(q - evaluate(path, s)[0]).max() < 1e-9
    held = np.concatenate([q[:1].repeat(3, 0), q, q[-1:].repeat(3, 0)])
    jerk = np.abs(np.diff(held, 3, axis=0)).max(axis=0) / 1e-9
    assert (jerk <= 1.001 * MACHINE.max_jerk).all()
