"""The proof of the error that simulated drives leave at the tool, where a plan limits it."""

from __future__ import annotations

from dataclasses import replace

from cnc_interp.core.units import MM
from cnc_interp.drives.compensation import compensated_model
from cnc_interp.drives.tool_error import ToolMotion
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.path_grid import ROUNDING
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.proof.stored_columns import spans
from cnc_interp.proof.verdict import Proof


def with_tool_error(proof: Proof, plan: PlanFiles, machine: Machine) -> Proof:
    """Add to a proof the error at the tool by the drives of the machine, if it was limited."""
    told = plan.summary.get('settings')
    if not isinstance(told, dict) or told.get('tool_error') is None:
        return proof
    name, limit, height = told.get('compensation'), told['tool_error'], plan.flank_height
    model = compensated_model(name, machine) if name else None
    motion = ToolMotion(machine, plan.period, plan.position[0], model)
    velocity, tip, axis = plan.setpoints['velocity'], 0.0, 0.0
    for error in (
        *(motion.push(plan.position[a:b], velocity[a:b]) for a, b in spans(len(plan.position))),
        motion.settle(),
    ):
        tip, axis = max(tip, error.tip.max()), max(axis, error.axis.max() * height)
    line = (
        f'error at the tool by the drives of {machine.name}'
        f'{f", compensated by {name}" if name else ""}: tip {tip / MM:.4f} mm, axis '
        f'{axis / MM:.4f} mm at {height / MM:g} mm, limit {limit / MM:g} mm'
    )
    fault = () if max(tip, axis) <= ROUNDING * limit else (f'{line}: exceeded',)
    return replace(proof, failures=(*proof.failures, *fault), beside=line)
