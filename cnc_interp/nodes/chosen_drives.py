"""The drives of the machine node, by its parameter ``drives``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.core.errors import InterpError
from cnc_interp.drives.compensation import compensated_model
from cnc_interp.drives.learning import LearntMotion, learnt_for
from cnc_interp.machine.compensated_drives import CompensatedDrives
from cnc_interp.machine.drives import CycleDrives, Drives
from cnc_interp.machine.simulated_drives import SimulatedDrives
from cnc_interp.machine.trajectory_drives import TrajectoryDrives, TrajectoryOptions
from cnc_interp.machine_model.machine import Machine


def chosen_drives(node: Any, values: dict[str, Any], machine: Machine, period: float) -> Drives:
    """Make the drives that the parameters name."""
    kind, model, learnt = (values[name] for name in ('drives', 'compensation', 'learnt'))
    if kind == 'simulated':
        drives = SimulatedDrives(machine, period, np.zeros(len(machine.axis_names)))
        motion = learnt_for(Path(learnt), values['machine'], model, period) if learnt else None
        return compensated(drives, machine, model, period, motion) if model else drives
    if kind not in ('hal', 'trajectory'):
        raise InterpError(f'drives: {kind!r} is unknown; choose simulated, hal or trajectory')
    if model or learnt:
        raise InterpError(f'drives of {kind} are not compensated so far; leave compensation out')
    refuse_switches(machine)
    errors = values['following_error_limit'], values['following_angle_limit']
    if kind == 'hal':
        from cnc_interp.machine.hal_drives import HalDrives, HalOptions

        return HalDrives(machine, period, HalOptions(values['hal_depth'], *errors))
    from cnc_interp.nodes.controller_link import ControllerLink

    link = ControllerLink(
        node.get_namespace(), values['controller'], values['controller_feedback'],
        joints_of(values['controller_joints'], machine),
    )  # fmt: skip
    return TrajectoryDrives(
        machine,
        period,
        TrajectoryOptions(values['controller_delay'], *errors, values['controller_silence']),
        link,
    )


def joints_of(names: list[str], machine: Machine) -> list[str]:
    """Return the joint of each axis; without names, the axes' own names."""
    given = [name for name in names if name]
    if given and (len(set(given)) != len(given) or len(given) != len(machine.axis_names)):
        axes = ' '.join(machine.axis_names)
        raise InterpError(f'controller_joints: one joint for each of {axes} is needed')
    return given or list(machine.axis_names)


def compensated(
    drives: CycleDrives,
    machine: Machine,
    model: str,
    period: float,
    learnt: LearntMotion | None = None,
) -> CompensatedDrives:
    """Put drives behind the inverse of a model."""
    return CompensatedDrives(drives, compensated_model(model, machine), period, learnt)


def refuse_switches(machine: Machine) -> None:
    """Refuse real drives on a machine whose reference switches are only simulated."""
    if machine.homing.switches:
        raise InterpError(
            'the machine file has reference switches (homing), which only simulated drives have; '
            'real drives must know their positions: remove homing from the machine file'
        )
