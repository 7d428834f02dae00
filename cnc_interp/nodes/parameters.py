"""Parameters of the nodes: one scalar each, SI, with description and range."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)

from cnc_interp.core.errors import InterpError
from cnc_interp.core.units import MM
from cnc_interp.nodes.qos import DEPTH
from cnc_interp.run.chain import ChainOptions
from cnc_interp.smoothing.dense.compression import Compression


@dataclass(frozen=True)
class Declared:
    """A parameter with its default and range; all are fixed once the node has started."""

    name: str
    default: float | int | bool | str
    description: str
    low: float | None = None
    high: float | None = None


MACHINE = Declared('machine', 'xyzac', 'Machine: name of a bundled one, or path of a YAML file')
AUTOSTART = Declared('autostart', True, 'Configure and activate without waiting for a command')
PERIOD = Declared('interpolation_period', 0.001, 'Time between setpoints [s]', 0.0001, 0.01)
RESEND = Declared('resend_after', 0.25, 'Send again what was not acknowledged [s]', 0.02, 10.0)
PEER_TIMEOUT = Declared(
    'peer_timeout', 3.0, 'Silence after which another node counts as lost [s]', 0.5, 60.0
)

#: How paths are smoothed: by the look-ahead, and by the program node's check before.
SMOOTHING = (
    Declared(
        'corner_ratio', 0.0, 'L2/L1 of rounded corners, 1.2 to 4; 0: chosen for each [-]', 0.0, 4.0
    ),
    Declared('parametrization', 'exact', 'Orientation of corners: exact, linear or paper'),
    Declared('top', 'in_step', 'Top curve of corners: in_step or tolerance'),
    Declared('septic', False, 'Continue the third derivative of the tool axis too'),
    Declared('compress', True, 'Make curves of dense blocks; else round every corner'),
    Declared('longest_block', 0.005, 'Longer blocks stay straight lines [m]', 1e-6, 10.0),
    Declared('corner_angle', 0.6109, 'Sharper turns of dense blocks are corners [rad]', 0.01, 3.1),
    Declared('tolerance_share', 0.98, 'Part of the tolerances that curves may use', 0.1, 1.0),
)
LOOKAHEAD = (
    MACHINE,
    *SMOOTHING,
    Declared('block_window', 512, 'Blocks taken ahead of the look-ahead', 4, DEPTH - 1),
    RESEND,
    PEER_TIMEOUT,
)
FEEDRATE = (
    MACHINE,
    AUTOSTART,
    PERIOD,
    Declared('segment_window', 256, 'Segments taken ahead of the planner', 4, DEPTH - 1),
    Declared('plan_ahead', 10.0, 'Motion planned beyond what the machine holds [s]', 0.1, 600.0),
    Declared('chunk_size', 10, 'Setpoints in a message', 1, 100),
    RESEND,
    PEER_TIMEOUT,
)
MACHINE_NODE = (
    MACHINE,
    AUTOSTART,
    PERIOD,
    Declared('buffer_time', 0.25, 'Motion that the machine holds ready [s]', 0.01, 2.0),
    Declared('start_time', 0.1, 'Motion at hand before the machine starts [s]', 0.0, 2.0),
    Declared('joint_state_rate', 50.0, 'Rate of joint_states [Hz]', 1.0, 200.0),
    Declared('machine_state_rate', 20.0, 'Rate of machine_state [Hz]', 1.0, 100.0),
    Declared('position_gain', 100.0, 'Gain kv of the drives [1/s]', 1.0, 1000.0),
    Declared('feed_forward', 1.0, 'Share of velocity feed-forward of the drives [-]', 0.0, 1.0),
    Declared(
        'trajectory_topic', '', 'Where to publish the setpoints to come as JointTrajectory too'
    ),
    Declared('time_constant', 0.002, 'Lag of the velocity loop of the drives [s]', 1e-4, 0.1),
    Declared('realtime_priority', 10, 'SCHED_FIFO priority of the clock; 0: ordinary', 0, 99),
    Declared('lock_memory', False, 'Keep the memory of this node from being paged out'),
)
PROGRAM = (
    MACHINE,
    Declared('contour_tolerance', 2e-5, 'Where the program gives none [m]', 1e-7, 0.1),
    Declared('orientation_tolerance', 2e-5, 'Where the program gives none [m]', 1e-7, 0.1),
    Declared('flank_height', 0.03, 'Height at which orientation is measured [m]', 1e-4, 1.0),
    Declared('setup', '', 'YAML file with work offsets, tools and reference points'),
    Declared('rotary_sense', 'programmed', 'Rotary words: programmed, or the shortest way'),
    Declared('skip_blocks', False, 'Leave out the lines that begin with a slash'),
    *SMOOTHING,
    PEER_TIMEOUT,
    RESEND,
)

MARKERS = (
    MACHINE,
    Declared('rate', 4.0, 'Rate of markers while something changes [Hz]', 0.1, 30.0),
    Declared('spacing', 5e-5, 'Least distance between points of a line [m]', 0.0, 0.1),
)


def declare(node: Any, parameters: tuple[Declared, ...]) -> dict[str, Any]:
    """
    Declare parameters on a node and return their values.

    Raises
    ------
    InterpError
        If a value is of the wrong type or outside its range, or two do not fit together.

    """
    values = {}
    for parameter in parameters:
        try:
            found = node.declare_parameter(
                parameter.name, parameter.default, descriptor_of(parameter)
            )
        except Exception as problem:
            raise InterpError(f'parameter {parameter.name}: {problem}') from None
        values[parameter.name] = found.value
    node.add_on_set_parameters_callback(check_change)
    if values.get('start_time', 0.0) > values.get('buffer_time', math.inf):
        raise InterpError('parameter start_time must not be greater than buffer_time')
    return values


def chain_options(values: dict[str, Any], flank_height: float = 30.0 * MM) -> ChainOptions:
    """
    Return how the look-ahead makes the path.

    Parameters
    ----------
    values : dict
        Parameters of a node that declares SMOOTHING.
    flank_height : float
        Height at which the orientation tolerance is measured [m].

    """
    return ChainOptions(
        flank_height=flank_height,
        ratio=values['corner_ratio'] or None,
        parametrization=values['parametrization'],
        top=values['top'],
        septic=values['septic'],
        compression=Compression(
            values['compress'], values['longest_block'], values['corner_angle'],
            values['tolerance_share'],
        ),
    )  # fmt: skip


def descriptor_of(parameter: Declared) -> ParameterDescriptor:
    """Describe a parameter, with the kind of range that fits its type."""
    descriptor = ParameterDescriptor(description=parameter.description)
    if parameter.low is None or parameter.high is None:
        return descriptor
    if isinstance(parameter.default, int):
        descriptor.integer_range = [
            IntegerRange(from_value=int(parameter.low), to_value=int(parameter.high), step=1)
        ]
    else:
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(parameter.low), to_value=float(parameter.high))
        ]
    return descriptor


def check_change(changes: list[Any]) -> SetParametersResult:
    """Refuse changes while the node runs: buffers, windows and plans are built on the values."""
    known = {
        p.name for table in (LOOKAHEAD, FEEDRATE, MACHINE_NODE, PROGRAM, MARKERS) for p in table
    }
    for change in changes:
        if change.name in known:
            return SetParametersResult(
                successful=False,
                reason=f'{change.name} is read at start; start the node again with another value',
            )
    return SetParametersResult(successful=True)
