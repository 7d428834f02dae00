"""The tool pose under geometric errors, by a chain of frames with finite rotations."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cnc_interp.core import FloatArray
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.plan_files import PlanFiles, Stored, spans

DEGREE = 5  #: Degree of the splines through the tables.


@dataclass(frozen=True)
class OwnErrors:
    machine: Machine

    def nominal(self, commanded: FloatArray) -> FloatArray:
        """Return axis positions, (n, n_axes), that give an ideal machine the tips of this one."""
        errors, found = self.machine.errors, np.array(commanded)
        if errors is None:
            return found
        tool = self._tool(commanded, errors.tool_length)
        pose = np.broadcast_to(np.eye(4), (len(found), 4, 4))
        carried = np.ones(3)  # by each axis: those after it, towards the tool
        for a in errors.chain:
            carried[a] = 0.0
            place = carried * errors.measured_at[a]
            pose = pose @ shift(np.eye(3)[a] * commanded[:, a, None])
            pose = pose @ shift(place)
            table = errors.tables[a]
            pose = pose @ error_frame(table.at, table.values, commanded[:, a])
            pose = pose @ shift(-place)
        tip = (pose @ np.append(tool, np.ones((len(tool), 1)), axis=1)[:, :, None])[:, :3, 0]
        found[:, :3] = tip - tool
        return found

    def _tool(self, q: FloatArray, length: float) -> FloatArray:
        """Return the tool tip in the frame that X Y Z move, (n, 3) [m]."""
        machine = self.machine
        tip, head = machine.tool_offset
        arm = np.tile(tip + [0.0, 0.0, length], (len(q), 1))
        rest = (tip + head) * any(machine.rotary_on_head)
        for k, more in ((1, head), (0, np.zeros(3))):
            if machine.rotary_on_head[k]:
                arm = turned(machine.rotary_direction[k] * q[:, 3 + k, None], arm)
            arm = arm + more
        count = len(machine.extra_direction)
        return rest - arm + q[:, q.shape[1] - count :] @ machine.extra_direction


def turned(rotation: FloatArray, points: FloatArray) -> FloatArray:
    """Rotate points (n, 3) by rotation vectors (n, 3) [rad]."""
    return np.asarray((turns(rotation) @ points[:, :, None])[:, :, 0])


def turns(rotation: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation  # loaded with errors only

    return np.asarray(Rotation.from_rotvec(rotation).as_matrix())


def shift(way: Any) -> FloatArray:
    found = np.broadcast_to(np.eye(4), (*np.shape(way)[:-1], 4, 4)).copy()
    found[..., :3, 3] = way
    return found


def error_frame(nodes: FloatArray, errors: FloatArray, at: FloatArray) -> FloatArray:
    from scipy.interpolate import make_interp_spline  # loaded with errors only

    values = make_interp_spline(nodes, errors, DEGREE)(np.clip(at, nodes[0], nodes[-1]))
    found = shift(values[:, :3])
    found[:, :3, :3] = turns(values[:, 3:])
    return found


def in_nominal_axes(plan: PlanFiles, machine: Machine) -> PlanFiles:
    """Return a plan with axis positions that give an ideal machine the tips of this one."""
    if machine.errors is None:
        return plan
    own, path = OwnErrors(machine), plan.path
    if path:
        path = {**path, 'q': _stored(path['q'], own)}
    position = _stored(plan.position, own)
    return replace(plan, setpoints={**plan.setpoints, 'position': position}, path=path)


def _stored(commanded: NDArray[np.float64] | Stored, own: OwnErrors) -> Stored:
    found = Stored.empty(len(commanded), np.float64, commanded.shape[1:])
    for a, b in spans(len(commanded)):
        found[a:b] = own.nominal(commanded[a:b])
    return found
