"""Whole programs, planned and written to plan files, for tests and benchmarks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cnc_interp.library import Kept, Plan, plan_program
from cnc_interp.library import smooth_path as path_of
from cnc_interp.run.plan_figures import PlanFigures
from cnc_interp.run.plan_writer import PlanWriter

__all__ = ['Kept', 'Plan', 'path_of', 'plan_program', 'summary_of', 'write_plan']


def summary_of(plan: Plan) -> dict[str, Any]:
    """Return the plan's summary as written to ``summary.json``; SI units."""
    figures = PlanFigures(plan.machine, plan.settings)
    pass_on(plan, figures)
    return figures.summary(plan.program.source, plan.planning_time)


def write_plan(plan: Plan, directory: Path) -> None:
    """Write the plan files (README, "Plan files"); everything in SI."""
    with PlanWriter(directory, plan.machine, plan.settings) as writer:
        pass_on(plan, writer)
        writer.finish(plan.program.source, plan.planning_time)


def pass_on(plan: Plan, taker: PlanWriter | PlanFigures) -> None:
    """Hand over a whole plan."""
    taker.blocks(plan.program.blocks)
    taker.segments(plan.segments)
    for piece in plan.pieces:
        taker.piece(piece)
    taker.setpoints(plan.setpoints)
