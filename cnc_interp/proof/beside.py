"""Proofs added to that of a program: motion beside it, and the error at the tool."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cnc_interp.core import MM, FloatArray
from cnc_interp.drives.compensation import compensated_model
from cnc_interp.drives.tool_error import ToolMotion
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.axis_limits import limits_of_differences, torques_of
from cnc_interp.proof.path_grid import ROUNDING
from cnc_interp.proof.plan_files import PlanFiles, spans
from cnc_interp.proof.program_shapes import SLACK
from cnc_interp.proof.verdict import DIFFERENCES, TORQUE, Proof


def with_beside(
    proof: Proof, machine: Machine, period: float, stretches: Sequence[FloatArray]
) -> Proof:
    """Add to a proof limits and travel of the motion beside the program: stretches (K, n_axes)."""
    if not stretches:
        return proof
    largest, faults = 0.0, []
    for k, q in enumerate(stretches, start=1):
        held = np.pad(q, ((3, 3), (0, 0)), mode='edge')
        uses = {}
        for order, (kind, _) in enumerate(DIFFERENCES, start=1):
            difference = np.abs(np.diff(held, order, axis=0)) / period**order
            use = (difference / limits_of_differences(machine, order, held)).max(axis=0)
            uses.update({(kind, j): float(share) for j, share in enumerate(use)})
        for j, load in machine.loads.items():
            torque = torques_of(machine, j, held[:, j], period)
            uses[TORQUE, j] = float(torque.max()) / load.torque
        largest = max(largest, *uses.values())
        faults += [
            f'{kind} of {machine.axis_names[j]} uses {share:.2%} of its limit beside the program '
            f'(motion {k})'
            for (kind, j), share in uses.items()
            if not share <= ROUNDING
        ]
        beyond = np.maximum(machine.travel[:, 0] - q, q - machine.travel[:, 1]).max(axis=0)
        faults += [
            f'{name} exceeds its travel beside the program (motion {k})'
            for name, outside in zip(machine.axis_names, beyond, strict=True)
            if not outside <= SLACK
        ]
    count = sum(map(len, stretches))
    line = (
        f'beside program {count} samples (approach, by hand and back), largest use {largest:.2%}'
    )
    told = '\n'.join(text for text in (line, proof.beside) if text)
    return replace(proof, failures=(*proof.failures, *faults), beside=told)


def with_tool_error(proof: Proof, plan: PlanFiles, machine: Machine) -> Proof:
    told = plan.settings
    if told.get('tool_error') is None:
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
