"""The proof of what a machine executed beside the program: the approach, by hand and back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.axis_limits import limits_of_differences, torques_of
from cnc_interp.proof.path_grid import ROUNDING
from cnc_interp.proof.program_shapes import SLACK
from cnc_interp.proof.verdict import DIFFERENCES, TORQUE, Proof


def with_beside(
    proof: Proof, machine: Machine, period: float, stretches: Sequence[FloatArray]
) -> Proof:
    """
    Add to a proof the limits and the travel of the motion beside the program.

    ``stretches`` (K, n_axes): positions, each from rest to rest [m, rad].
    """
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
