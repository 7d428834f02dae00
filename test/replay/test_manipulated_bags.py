"""Manipulated bags: a recorded run in which one thing is changed is refused or not proven."""

import copy
from array import array
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp.client.bag import Bag
from cnc_interp.client.recorded_run import recorded_run, write_run
from cnc_interp.core import InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.proof.verify import verify

HELD = Path(__file__).parent / 'held'
TOOL = 'tools:\n  1: {diameter_mm: 6, flute_mm: 12, holder_mm: [[20, 5], [40, 15]]}\n'


@pytest.fixture(scope='module')
def recorded():
    with Bag(HELD) as bag:
        run = recorded_run(bag)
    return replace(run, chunks=list(run.chunks))


@pytest.fixture(autouse=True)
def _sent_as_recorded(recorded):
    """Copies of a run share what was sent."""
    settings = recorded.sent.settings
    yield
    recorded.sent.settings = settings


def chunks(change):
    """Change the values of one field of all chunks: name, and what becomes of them."""
    name, new = change

    def changed(run):
        for chunk in run.chunks:
            values = getattr(chunk, name)
            setattr(chunk, name, array(values.typecode, new(np.array(values)).tolist()))
        return run

    return changed


def some(field, change):
    """Change the middle message of a stream."""

    def changed(run):
        messages = getattr(run, field)
        change(messages[len(messages) // 2])
        return run

    return changed


def shifted(values, by=1e-6):
    """Move the first value of the middle row."""
    values = values.copy()
    values[len(values) // 10 * 5] += by
    return values


def without(field, k):
    def changed(run):
        messages = getattr(run, field)
        del messages[k if k >= 0 else len(messages) + k]
        return run

    return changed


def overridden(share):
    def changed(run):
        run.sent.settings = {
            run_id: replace(settings, override=share)
            for run_id, settings in run.sent.settings.items()
        }
        return run

    return changed


TABLE = {
    'one chunk is missing': without('chunks', 3),
    'the last chunk is missing': without('chunks', -1),
    'a block is missing': without('blocks', 2),
    'the last block is missing': without('blocks', -1),
    'an override of 1000': overridden(1000.0),
    'an override of -1': overridden(-1.0),
    'an override that is no number': overridden(float('nan')),
    'an override of 50 %': overridden(0.5),
    'a setpoint off by 1 um': chunks(('positions', shifted)),
    'positions times 1.0001': chunks(('positions', lambda q: q * 1.0001)),
    'velocities times 2': chunks(('velocities', lambda v: v * 2)),
    'accelerations off by 1': chunks(('accelerations', lambda a: a + 1)),
    'path positions times 1.01': chunks(('path_positions', lambda s: s * 1.01)),
    'all of the last block': chunks(('sequences', lambda b: np.where(b > 0, b.max(), b))),
    'a NaN among the positions': chunks(('positions', lambda q: shifted(q, np.nan))),
    'setpoints without row numbers': chunks(('sequences', lambda b: b[:0])),
    'one row number less': some('chunks', lambda c: c.sequences.pop()),
    'a path position less': some('chunks', lambda c: c.path_positions.pop()),
    'another number of axes': some('chunks', lambda c: setattr(c, 'axis_count', 6)),
    'a slower clock': some('chunks', lambda c: setattr(c, 'period', 2 * c.period)),
    'a vertex moved by 0.1 mm': some('blocks', lambda b: setattr(b, 'tip', b.tip + 1e-4)),
    'half the feed': lambda run: (
        [setattr(b, 'feedrate', b.feedrate / 2) for b in run.blocks] and run
    ),
    'a feed that is no number': some('blocks', lambda b: setattr(b, 'feedrate', float('nan'))),
    'a negative tolerance': some('blocks', lambda b: setattr(b, 'contour_tolerance', -1.0)),
    'tolerances of 0.1 um': lambda run: (
        [setattr(b, 'contour_tolerance', 1e-7) for b in run.blocks] and run
    ),
    'a flank height of 0': lambda run: (
        [setattr(b, 'flank_height', 0.0) for b in run.blocks] and run
    ),
}


def proven(run, folder):
    """Tell whether a run is proven; a refusal says why in one line."""
    machine = Machine.load(run.machine)
    try:
        write_run(run, machine, folder)
        return verify(read_plan(folder), machine).ok
    except InterpError as refusal:
        assert '\n' not in str(refusal)
        return False


def test_the_run_as_recorded_is_proven(recorded, tmp_path):
    assert proven(copy.deepcopy(recorded), tmp_path)


def test_a_run_beside_bodies_is_proven_unless_it_hits_one(recorded, tmp_path):
    run, file = copy.deepcopy(recorded), tmp_path / 'scene.yaml'
    entry = next(pair for pair in run.blocks[0].settings if pair.key == 'scene')
    entry.value = str(file)
    x, y, z = (run.blocks[len(run.blocks) // 2].tip * 1e3).tolist()
    found = []
    for beside in (500.0, 0.0):
        low, high = ([x + d + beside, y + d, z + d] for d in (-5.0, 5.0))
        body = f'{{name: clamp, link: workpiece, box_mm: {{low: {low}, high: {high}}}}}'
        file.write_text(f'bodies:\n  - {body}\n{TOOL}')
        found.append(proven(run, tmp_path / f'{beside:g}'))
    assert found == [True, False]


@pytest.mark.parametrize('name', TABLE)
def test_manipulated_runs(name, recorded, tmp_path):
    assert not proven(TABLE[name](copy.deepcopy(recorded)), tmp_path)
