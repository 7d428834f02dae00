"""Over ROS: a compensated run is recorded, learnt from, and run again with less error."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp.client.run_request import RunRequest
from cnc_interp.client.session import run_session
from cnc_interp.commands.cli import main
from cnc_interp.core import InterpError
from cnc_interp.drives.learning import LearntMotion
from cnc_interp.machine_model.machine import find_machine_file
from cnc_interp.settings.options import Settings

PYRAMID = Path(__file__).parents[2] / 'examples' / 'pyramid.ngc'
TIRED = 'xyzac_tired'


def run(settings, bag):
    request = RunRequest(PYRAMID, machine=TIRED, settings=settings, record=bag, quiet=True)
    (result,) = run_session(request)
    assert result.ok and not result.excesses, result.message
    return result.contour_error


@pytest.mark.thorough
def test_a_run_teaches_the_next_one(tmp_path, capfd):
    model = tmp_path / 'model.yaml'
    rows = find_machine_file(TIRED).read_text().splitlines(keepends=True)
    for axis, value, other in (
        ('X', 'delay_ms: 1.5', 'delay_ms: 2.0'),
        ('Y', 'velocity_lag_ms: 5.0', 'velocity_lag_ms: 6.0'),
    ):
        k = next(k for k, row in enumerate(rows) if f'{axis}: {{position_gain' in row)
        assert value in rows[k]
        rows[k] = rows[k].replace(value, other)
    text = ''.join(rows)
    model.write_text(text)
    settings = Settings(compensation=str(model))
    bags, files = [[tmp_path / f'{what}{k}' for k in range(2)] for what in ('bag', 'learnt')]
    plain = run(settings, bags[0])
    assert main(['learn', str(bags[0]), '--out', str(files[0])]) == 0
    assert 'runs learnt    1' in capfd.readouterr().out
    again = run(replace(settings, learnt=files[0]), bags[1])
    assert main(['learn', str(bags[1]), '--out', str(files[1])]) == 0
    assert 'runs learnt    2' in capfd.readouterr().out
    first, second = LearntMotion.load(files[1]).error
    assert second[0] < 0.5 * first[0] and second[1] < 0.3 * first[1]
    assert again < 0.5 * plain
    assert np.array_equal(
        LearntMotion.load(files[0]).setpoint, LearntMotion.load(files[1]).setpoint
    )
    # What was learnt with another model is refused before anything moves.
    with pytest.raises(InterpError, match='machine_node cannot be configured'):
        run(Settings(compensation=TIRED, learnt=files[0]), None)
    with pytest.raises(InterpError, match='machine_node cannot be configured'):
        run(Settings(learnt=files[0]), None)


@pytest.mark.thorough
def test_a_run_without_compensation_teaches_nothing(tmp_path, capfd):
    run(Settings(), tmp_path / 'bag')
    assert main(['learn', str(tmp_path / 'bag'), '--out', str(tmp_path / 'learnt')]) == 2
    assert 'record a run with --compensate MODEL' in capfd.readouterr().err
