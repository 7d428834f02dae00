"""Motion by hand in a record: it belongs to no plan, whatever plan came and was void meanwhile."""

from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp.client import executed_run
from cnc_interp.client.executed_run import Follower
from cnc_interp.run.run_state import RunId

PLANS = RunId('run'), RunId('run', plan=1), RunId('run', plan=2)


def rows(position, velocity, block):
    """Rows of one axis: position, velocity, acceleration, s, block, line."""
    n = len(position)
    return np.column_stack([position, velocity, np.zeros((n, 2)), np.full(n, block), np.zeros(n)])


@pytest.fixture
def follow(monkeypatch):
    """Follow parts of a record: the plan that each names, and its rows."""
    monkeypatch.setattr(executed_run, 'rows_of', lambda message, _='': message.rows)
    monkeypatch.setattr(executed_run, 'run_id_of', lambda message: message.run_id)
    plan = rows([0.0, 1.0, 2.0], [0.0, 1.0, 0.0], 5)
    sent = {number: rows([2.0, 2.5], [0.0, 0.0], 7) for number in PLANS[1:]} | {PLANS[0]: plan}

    def at(run_id, number):
        found = sent[run_id]
        if number >= len(found):
            return None
        return SimpleNamespace(rows=found, first_sample=0, wait=0, end_of_program=False)

    def faults(*parts):
        follower = Follower(SimpleNamespace(joins={}, at=at, tail=lambda *_: None))
        for run_id, found in ((PLANS[0], plan), *parts):
            follower.take(SimpleNamespace(rows=found, run_id=run_id, axis_count=1))
        return follower.faults

    return faults


def test_hand_motion_goes_on_while_void_plans_come(follow):
    away = rows([2.0, 3.0, 4.0], [0.0, 1.0, 1.0], 0)
    rests = rows([5.0, 5.0], [1.0, 0.0], 0)
    assert follow((PLANS[1], away), (PLANS[2], rests)) == []


def test_what_is_no_motion_by_hand_is_found(follow):
    """In the middle of a line, or with a jump into another plan while the axes move."""
    moving = rows([2.0, 3.0], [0.0, 1.0], 0)
    (fault,) = follow((PLANS[1], rows([2.2, 2.6], [0.0, 0.0], 7)))
    assert 'differs from the setpoint sent' in fault
    (fault,) = follow((PLANS[1], moving), (PLANS[2], rows([2.0, 2.5], [0.0, 0.0], 7)))
    assert 'the machine left it in motion' in fault
