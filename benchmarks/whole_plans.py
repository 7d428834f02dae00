"""Whole programs, planned and kept: what tests and benchmarks look at."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cnc_interp.feedrate.feed_planner import PlannedPiece
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform
from cnc_interp.program import Program
from cnc_interp.program.blocks import Blocks
from cnc_interp.run.chain import Chain, at_fault, no_motion
from cnc_interp.run.path_chain import PathChain, batches
from cnc_interp.run.plan_figures import PlanFigures
from cnc_interp.run.plan_writer import PlanWriter
from cnc_interp.run.setpoints import Setpoints
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.segments import PathSegments


def path_of(blocks: Blocks, transform: Transform, settings: Settings) -> AxisPath:
    """Smooth a whole program and return its path in machine axes."""
    chain = PathChain(transform, settings)
    parts = [*(chain.push(batch) for batch in batches(blocks)), chain.finish()]
    return AxisPath.join([part.path for part in parts if part.path is not None])


class Kept:
    """A sink that keeps everything."""

    def __init__(self) -> None:
        self.parts: list[PathSegments] = []
        self.pieces: list[PlannedPiece] = []
        self.samples: list[Setpoints] = []
        self.segments, self.piece = self.parts.append, self.pieces.append
        self.setpoints = self.samples.append


@dataclass(frozen=True)
class Plan:
    """A planned program: everything from blocks to setpoints, and the time that planning took."""

    program: Program
    machine: Machine
    settings: Settings
    segments: PathSegments
    pieces: list[PlannedPiece]
    setpoints: Setpoints
    planning_time: dict[str, float]


def plan_program(program: Program, machine: Machine, settings: Settings | None = None) -> Plan:
    """Plan a whole program and keep everything; ``plan_to_files`` keeps nothing."""
    settings, kept = settings or Settings(), Kept()
    chain = Chain(machine, settings, kept)
    with at_fault(program.source):
        for batch in batches(program.blocks):
            chain.push(batch)
        chain.finish()
    if not chain.moved:
        raise no_motion(program.source)
    segments, setpoints = PathSegments.concatenate(kept.parts), Setpoints.concatenate(kept.samples)
    return Plan(program, machine, settings, segments, kept.pieces, setpoints, chain.seconds)


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
