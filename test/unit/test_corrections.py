"""Corrections of a law between the nodes: few cells are solved again, the rest of it stays."""

import numpy as np
import pytest
from programs import zigzag
from tiers import few_of
from whole_plans import path_of

from cnc_interp.core import MM
from cnc_interp.feedrate import jerk_stage
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.settings.options import Settings

XYZAC = Machine.load('xyzac')


def test_spans_hold_the_margins_and_are_joined():
    changed = np.zeros(1000, dtype=bool)
    changed[[3, 400, 401, 500, 900]] = True
    margin = jerk_stage.MARGIN
    assert jerk_stage._spans_around(changed) == [
        (0, 3 + margin + 1),
        (400 - margin, 500 + margin + 1),
        (900 - margin, 1000),
    ]
    assert jerk_stage._spans_around(np.zeros(1000, dtype=bool)) == []


@pytest.mark.parametrize('seed', few_of(2, [0, 1]))
def test_solving_few_cells_again_gives_the_law_of_solving_all(seed, monkeypatch):
    blocks = zigzag(seed, count=40, step=1 * MM)
    path = path_of(blocks, Transform.of(XYZAC), Settings(compress=False))
    table, solved = XYZAC.limits.table, []
    solve_cells = jerk_stage.StretchProblem._solve_cells

    def noted(self, first, end, *rest):
        solved.append(end - first < len(self.h))
        return solve_cells(self, first, end, *rest)

    monkeypatch.setattr(jerk_stage.StretchProblem, '_solve_cells', noted)
    few = jerk_stage.plan(path, table)
    assert any(solved)
    monkeypatch.setattr(jerk_stage, 'FEW', 0.0)
    solved.clear()
    whole = jerk_stage.plan(path, table)
    assert not any(solved)
    assert few.converged and whole.converged and few.use <= 1.0
    assert few.duration.sum() == pytest.approx(whole.duration.sum(), rel=5e-5)
    # Speed and acceleration are continuous over the ends of the spans.
    end = few.v[:-1] + few.duration * (few.a[:-1] + few.duration * few.jerk / 2)
    np.testing.assert_allclose(end, few.v[1:], atol=1e-12)
    np.testing.assert_allclose(few.a[:-1] + few.duration * few.jerk, few.a[1:], atol=1e-9)
