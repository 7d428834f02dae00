"""A plan becomes a trajectory only if motion is all that it needs."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp.client.trajectory_goal import trajectory_of
from cnc_interp.commands.cli import main
from cnc_interp.core import InterpError
from cnc_interp.machine.trajectory_drives import SPACING
from cnc_interp.proof.plan_files import read_plan

PROGRAM = 'G21 G90 G94 G0 X0 Y0 Z0\nG1 X7 F3000\n{stop}\nX9.3 Y4\nM30\n'


def planned(folder, stop=''):
    (folder / 'part.ngc').write_text(PROGRAM.format(stop=stop))
    assert main(['plan', str(folder / 'part.ngc'), '--out', str(folder / 'part')]) == 0
    return read_plan(folder / 'part')


def test_the_points_are_setpoints_and_the_last_one_rests(tmp_path):
    plan = planned(tmp_path)
    times, rows = trajectory_of(plan)[1:]
    steps = np.diff(times)
    assert (steps[:-1] == round(SPACING * 1e9)).all() and 0 < steps[-1] <= round(SPACING * 1e9)
    chosen = np.rint(1e-9 * times / plan.period).astype(int)
    assert chosen[0] == 0 and chosen[-1] == len(plan.position) - 1
    assert np.array_equal(rows.position, np.array(plan.position)[chosen])
    assert np.array_equal(rows.velocity[:-1], np.array(plan.setpoints['velocity'])[chosen][:-1])
    assert not rows.velocity[-1].any() and not rows.acceleration[-1].any()


@pytest.mark.parametrize('stop', ['M0', 'M1'])
def test_a_plan_that_waits_is_refused_by_line(tmp_path, stop):
    with pytest.raises(InterpError, match=r'after line 2.*cnc-interp run --drives trajectory'):
        trajectory_of(planned(tmp_path, stop))


def test_a_plan_that_switches_is_refused_by_line(tmp_path):
    plan = planned(tmp_path)
    functions = {**plan.functions, 'line_number': np.array([2])}
    with pytest.raises(InterpError, match='line 2 sets an output'):
        trajectory_of(replace(plan, functions=functions))
