"""A run out of a bag: its blocks, what the machine executed, and how the nodes were set."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import G1Block, SetpointChunk

from cnc_interp.client.bag import Bag
from cnc_interp.client.executed_plan import executed
from cnc_interp.core.errors import InterpError
from cnc_interp.kinematics.machine import Machine
from cnc_interp.nodes import parameters
from cnc_interp.program import Program
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.run.chain import Plan, plan_program
from cnc_interp.run.interpolator import Setpoints
from cnc_interp.run.plan_writer import block_columns
from cnc_interp.run.run_id import RunId
from cnc_interp.settings.choices import Settings
from cnc_interp.wire.path_messages import blocks_from
from cnc_interp.wire.run_id_messages import run_id_of


@dataclass(frozen=True)
class RecordedRun:
    """
    The last run in a bag that moved.

    Parameters
    ----------
    program_id : str
        The run.
    name : str
        Name of the program.
    machine : str
        Machine that the nodes were started with; empty where the bag does not know.
    settings : Settings
        The choices of the run.
    blocks : list of G1Block
        The program, gap-free from the start pose.
    chunks : list of SetpointChunk
        What the machine executed, as it told.
    largest_override : float
        Largest feed override of the run, at least 1 [-].

    """

    program_id: str
    name: str
    machine: str
    settings: Settings
    blocks: list[G1Block]
    chunks: list[SetpointChunk]
    largest_override: float

    def program(self) -> Program:
        """Return the program as its reader made it."""
        return Program(blocks_from(self.blocks), (), self.name, 'gcode')

    def setpoints(self) -> Setpoints:
        """Return what was executed, the approach left out."""
        return executed(self.chunks)


def recorded_run(bag: Bag) -> RecordedRun:
    """
    Find the last run in a bag that moved.

    Raises
    ------
    InterpError
        If nothing was executed, or blocks are missing.

    """
    told = bag.read('executed_setpoints')
    if not told:
        raise InterpError(f'{bag.path}: nothing was executed in this bag; record a run')
    last = run_id_of(told[-1])
    blocks = blocks_of(bag, last)
    names = {m.program_id: m.name for m in bag.read('loaded_program')}
    overrides = [m.data for m in bag.read('feed_override') if np.isfinite(m.data)]
    return RecordedRun(
        program_id=last.program_id,
        name=names.get(last.program_id, str(bag.path)),
        machine=str(bag.parameters.get('machine_node.machine', '')),
        settings=settings_of_run(bag.parameters, blocks[0].flank_height, told[-1].period),
        blocks=blocks,
        chunks=[m for m in told if m.program_id == last.program_id],
        largest_override=max([1.0, *overrides]),
    )


def blocks_of(bag: Bag, run_id: RunId) -> list[G1Block]:
    """
    Return the blocks of an attempt at a run in order, each once.

    Raises
    ------
    InterpError
        If one is missing.

    """
    found = {m.sequence: m for m in bag.read('blocks') if run_id_of(m).same_attempt(run_id)}
    missing = next((k for k in range(len(found)) if k not in found), None)
    if missing is not None or not found:
        raise InterpError(
            f'{bag.path}: block {missing or 0} of run {run_id.program_id} is not in the bag; '
            'record from before the start'
        )
    return [found[k] for k in range(len(found))]


def settings_of_run(told: dict[str, Any], flank_height: float, period: float) -> Settings:
    """Return how the nodes were told to smooth and interpolate."""
    prefix = 'lookahead_node.'
    values = {k.removeprefix(prefix): v for k, v in told.items() if k.startswith(prefix)}
    smoothing = parameters.settings_of(values)
    return replace(smoothing, flank_height=flank_height, interpolation_period=period)


def plan_files_of(run: RecordedRun) -> PlanFiles:
    """
    Return the run as a plan to be proven: blocks and executed setpoints alone.

    Feeds are those that the largest override of the run allowed.
    """
    samples = run.setpoints()
    columns = block_columns(run.program().blocks)
    columns['feed'] = columns['feed'] * run.largest_override
    columns['duration'] = columns['duration'] / run.largest_override
    setpoints = {
        'time': samples.time,
        'position': samples.position,
        'velocity': samples.velocity,
        'acceleration': samples.acceleration,
        'block': samples.block,
        's': samples.s,
    }
    summary = {
        'program': run.name,
        'machine': run.machine,
        'interpolation_period': run.settings.interpolation_period,
        'flank_height': run.settings.flank_height,
    }
    return PlanFiles(setpoints, {}, columns, summary)


def plan_of(run: RecordedRun, machine: Machine) -> Plan:
    """Return the run as a plan to be reported: path planned anew, setpoints as executed."""
    plan = plan_program(run.program(), machine, run.settings)
    return replace(plan, setpoints=run.setpoints())
