"""The table of the kinds of drives: the node parameters of each, and its constructor."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from cnc_interp.core import FloatArray, InterpError
from cnc_interp.machine.kept_positions import kept_positions
from cnc_interp.machine_model.signals import home_input

if TYPE_CHECKING:
    from cnc_interp.machine.drives import Drives
    from cnc_interp.machine.trajectory_drives import Controller
    from cnc_interp.machine_model.machine import Machine

Values = Mapping[str, Any]
#: Function that opens the topics of a controller; takes node parameters and names of joints.
Link = Callable[[Values, list[str]], 'Controller']


class Declared(NamedTuple):
    """A node parameter with its default and range. Its value is fixed when the node starts."""

    name: str
    default: float | int | bool | str | list[str]
    description: str
    low: float | None = None
    high: float | None = None

    def value_text(self, text: str) -> str:
        """Return a value from the command line in the notation of ROS parameters."""
        if isinstance(self.default, list):
            return str(text.split())
        return f"'{text}'" if isinstance(self.default, str) else text


@dataclass(frozen=True)
class DriveKind:
    what: str  #: Description of the drives for users.
    parameters: tuple[Declared, ...]  #: Parameters that machine_node has only for these drives.
    make: Callable[[Machine, float, Values, Link], Drives]


def _simulated(machine: Machine, period: float, values: Values, _link: Link) -> Drives:
    from cnc_interp.drives.compensation import compensated_model
    from cnc_interp.drives.learning import learnt_for
    from cnc_interp.machine.simulated_drives import CompensatedDrives, SimulatedDrives

    position, touches = _start(machine, values['start_height']), values['probe_touches']
    known = kept_positions(values['position_file'], machine)
    position = np.where(np.isfinite(known), known, position)
    drives = SimulatedDrives(machine, period, position)
    if touches:
        from cnc_interp.machine.simulated_probe import ProbingDrives

        drives = ProbingDrives(machine, period, position, Path(touches))
    model, learnt = values['compensation'], values['learnt']
    motion = learnt_for(Path(learnt), values['machine'], model, period) if learnt else None
    if not model:
        return drives
    return CompensatedDrives(drives, compensated_model(model, machine), period, motion)


def _start(machine: Machine, height: float) -> FloatArray:
    """Return where simulated axes start: 0, the tip ``height`` above the part, or arm's home."""
    if machine.arm is not None:
        return machine.arm.home.copy()
    position = np.zeros(len(machine.axis_names))
    if height > 0.0:
        from cnc_interp.machine_model.transform_port import Transform

        zero = Transform.of(machine).linear(np.zeros((1, 3)), np.zeros((1, 2)))[0]
        low, high = machine.travel[2]
        position[2] = min(max(zero[2] + height, low), high)
    return position


def _hal(machine: Machine, period: float, values: Values, _link: Link) -> Drives:
    from cnc_interp.machine.hal_drives import HalDrives

    known = kept_positions(values['position_file'], machine)
    return HalDrives(machine, period, values['hal_depth'], _limits(machine, values), known)


def _trajectory(machine: Machine, period: float, values: Values, link: Link) -> Drives:
    from cnc_interp.machine.trajectory_drives import TrajectoryDrives

    joints = joints_of(values['controller_joints'], machine)
    controller = link(values, joints)
    delay, silence = values['controller_delay'], values['controller_silence']
    return TrajectoryDrives(machine, period, controller, delay, _limits(machine, values), silence)


def _limits(machine: Machine, values: Values) -> FloatArray:
    """Return the limit of each axis's following error: its own or the common one [m, rad]."""
    usual = values['following_error_limit'], values['following_angle_limit']
    found = np.where(machine.is_linear, *usual)
    for axis, own in machine.following_errors.items():
        found[axis] = own
    return found


LIMITS = (
    Declared('following_error_limit', 1e-3, 'Largest following error of linear axes [m]', 1e-6, 1),
    Declared(
        'following_angle_limit', 0.02, 'Largest following error of rotary axes [rad]', 1e-6, 7
    ),
)
KINDS = {
    'simulated': DriveKind(
        'models of the machine file',
        (
            Declared('probe_touches', '', 'YAML file of what a simulated probe touches'),
            Declared(
                'start_height',
                0.0,
                'Height of the tip over the workpiece zero at the start, other axes at 0; 0: all '
                'axes at 0 [m]',
                0,
                10,
            ),
        ),
        _simulated,
    ),
    'hal': DriveKind(
        "those in LinuxCNC's HAL",
        (Declared('hal_depth', 8, "Setpoints in the FIFO of LinuxCNC's HAL", 2, 1000), *LIMITS),
        _hal,
    ),
    'trajectory': DriveKind(
        'a controller of ros2_control',
        (
            Declared('controller', '/joint_trajectory_controller', 'Name of the controller'),
            Declared(
                'controller_feedback',
                '/joint_state_broadcaster/joint_states',
                'Topic on which ros2_control reports the joints',
            ),
            Declared(
                'controller_joints', [''], 'Joint of each axis; if empty named as in the URDF'
            ),
            Declared(
                'controller_speed',
                '',
                'Topic with the speed at which the robot executes trajectories; if empty, it '
                'always executes them at full speed',
            ),
            Declared(
                'controller_full_speed', 100.0, 'Value of the speed topic at full speed', 1e-3, 1e6
            ),
            Declared(
                'controller_delay',
                0.2,
                'Time from a setpoint to its execution by the controller [s]',
                0.05,
                2,
            ),
            Declared(
                'controller_silence',
                1.0,
                'Silence of the controller that stops the machine [s]',
                0.1,
                60,
            ),
            *LIMITS,
        ),
        _trajectory,
    ),
}
CHOICE = '; '.join(f'{name}: {kind.what}' for name, kind in KINDS.items())  #: All kinds, in words.


def parameters_of_drives() -> tuple[Declared, ...]:
    every = {each.name: each for kind in KINDS.values() for each in kind.parameters}
    return Declared('drives', 'simulated', f'Drives of the axes. {CHOICE}'), *every.values()


def drives_of(machine: Machine, period: float, values: Values, link: Link) -> Drives:
    name = values['drives']
    if name not in KINDS:
        raise InterpError(f'drives: {name!r} is unknown; choose {", ".join(KINDS)}')
    if name != 'simulated':
        if values['compensation'] or values['learnt']:
            text = 'are not compensated so far; leave compensation out'
            raise InterpError(f'drives of {name} {text}')
        inputs = {signal.name for signal in machine.signals.inputs} if name == 'hal' else set()
        if missing := {*map(home_input, machine.homing.switches)} - inputs:
            needed = f'the inputs {" ".join(sorted(missing))} in its signals' if inputs else 'HAL'
            raise InterpError(f'homing of the machine file needs {needed}, or leave homing out')
    return KINDS[name].make(machine, period, values, link)


def joints_of(names: list[str], machine: Machine) -> list[str]:
    given = [name for name in names if name]
    if given and (len(set(given)) != len(given) or len(given) != len(machine.axis_names)):
        axes = ' '.join(machine.axis_names)
        raise InterpError(f'controller_joints: one joint for each of {axes} is needed')
    return given or list(machine.joint_names)
