"""Parameters of the nodes in SI units, each with a description and a range."""

from collections.abc import Mapping, Set
from functools import partial
from typing import Any

from rcl_interfaces import msg

from cnc_interp.core import InterpError
from cnc_interp.machine.drive_kinds import Declared, parameters_of_drives
from cnc_interp.nodes.qos import DEPTH
from cnc_interp.settings.option_kinds import Choice, Stage, choices
from cnc_interp.settings.options import DEFAULT_MACHINE, Settings


def of_settings(*stages: Stage) -> tuple[Declared, ...]:
    """Return the settings of ``stages`` as parameters; 0 or '' if an optional one is not set."""
    return tuple(declared(choice) for choice in choices(Settings, *stages))


def declared(choice: Choice) -> Declared:
    default = choice.plain(choice.default)
    told = choice.sentence[0].upper() + choice.sentence[1:]
    if choice.values:
        told += f': {", ".join(choice.values)}'
    if choice.kind is not float:
        bounded = choice.kind is int
        low, high = (choice.low, choice.high) if bounded else (None, None)
        return Declared(choice.name, default, told, low, high)
    none = f'; 0: {choice.nothing or "none"}' if choice.optional else ''
    low = 0.0 if choice.optional else choice.low
    return Declared(choice.name, default, f'{told}{none} [{choice.unit.si}]', low, choice.high)


MACHINE = Declared('machine', DEFAULT_MACHINE, 'Machine: a bundled one, or path of a YAML file')
AUTOSTART = Declared('autostart', True, 'Configure and activate without waiting for a command')
RESEND = Declared('resend_after', 0.25, 'Time until a lost message is resent [s]', 0.02, 10.0)
PEER_TIMEOUT = Declared(
    'peer_timeout', 3.0, 'Silence after which another node counts as lost [s]', 0.5, 60.0
)
#: The scene, and the tool table with the shapes of its tools.
SCENE = tuple(each for each in of_settings(*Stage) if each.name in ('scene', 'setup'))

LOOKAHEAD = (
    MACHINE,
    *of_settings(Stage.SMOOTHING),
    Declared(
        'block_window', 512, 'Blocks accepted before the look-ahead needs them', 4, DEPTH - 1
    ),
    RESEND,
    PEER_TIMEOUT,
)
FEEDRATE = (
    MACHINE,
    AUTOSTART,
    *of_settings(Stage.MOTION, Stage.PLANNING, Stage.APPROACH),
    *(each for each in SCENE if each.name == 'setup'),
    Declared(
        'segment_window', 256, 'Segments accepted before the planner needs them', 4, DEPTH - 1
    ),
    Declared('plan_ahead', 10.0, 'Motion planned beyond what the machine buffers [s]', 0.1, 600.0),
    Declared('chunk_time', 0.005, 'Motion sent per message, at least one setpoint [s]', 0.0, 0.1),
    RESEND,
    PEER_TIMEOUT,
)
MACHINE_NODE = (
    MACHINE,
    AUTOSTART,
    *of_settings(Stage.MOTION),
    *SCENE,
    Declared('buffer_time', 1.0, 'Motion that the machine buffers [s]', 0.01, 2.0),
    Declared('joint_state_rate', 50.0, 'Rate of joint_states [Hz]', 1.0, 200.0),
    Declared('machine_state_rate', 20.0, 'Rate of machine_state [Hz]', 1.0, 100.0),
    Declared(
        'position_file', '', 'File that keeps the positions of the axes while the power is off'
    ),
    *parameters_of_drives(),
    Declared('realtime_priority', 10, 'SCHED_FIFO priority of the clock; 0: ordinary', 0, 99),
    Declared('lock_memory', True, 'Keep the memory of this node from being paged out'),
)
PROGRAM = (
    MACHINE,
    *of_settings(*(stage for stage in Stage if stage is not Stage.START)),
    Declared('program_folders', [''], 'Folders and files of programs that a goal may name'),
    Declared('run_history', '', 'CSV file with a row for each run; empty: runs.csv of the user'),
    PEER_TIMEOUT,
    RESEND,
)

MARKERS = (
    MACHINE,
    *SCENE,
    Declared('rate', 4.0, 'Rate of markers while something changes [Hz]', 0.1, 30.0),
    Declared('spacing', 5e-5, 'Least distance between points of a line [m]', 0.0, 0.1),
)

BATCH = (
    MACHINE,
    *of_settings(*(stage for stage in Stage if stage is not Stage.START)),
    Declared('program_folders', [''], 'Folders and files of programs that a goal may name'),
    Declared('batch_folder', '', 'Folder for tables and pages'),
    Declared('workers', 1, 'Programs that are planned at the same time', 1, 1024),
    Declared('longest_planning', 3600.0, 'Longest planning time of a program [s]', 1.0, 1e6),
)

#: Node -> its parameters, for the nodes that a run needs.
NODES = {
    'program_node': PROGRAM,
    'lookahead_node': LOOKAHEAD,
    'feedrate_node': FEEDRATE,
    'machine_node': MACHINE_NODE,
}


def declare(node: Any, parameters: tuple[Declared, ...]) -> dict[str, Any]:
    values = {}
    for parameter in parameters:
        try:
            told = descriptor_of(parameter)
            found = node.declare_parameter(parameter.name, parameter.default, told)
        except Exception as problem:
            raise InterpError(f'parameter {parameter.name}: {problem}') from None
        values[parameter.name] = found.value
    names = {parameter.name for parameter in parameters}
    node.add_on_set_parameters_callback(partial(check_change, names))
    return values


def settings_of(values: Mapping[str, Any]) -> Settings:
    """Return the settings in the parameters of a node; SettingsError if a value is invalid."""
    known = [choice for choice in choices(Settings) if choice.name in values]
    return Settings(**{choice.name: choice.from_plain(values[choice.name]) for choice in known})


def descriptor_of(parameter: Declared) -> msg.ParameterDescriptor:
    descriptor = msg.ParameterDescriptor(description=parameter.description)
    if parameter.low is None or parameter.high is None:
        return descriptor
    if isinstance(parameter.default, int):
        descriptor.integer_range = [
            msg.IntegerRange(from_value=int(parameter.low), to_value=int(parameter.high), step=1)
        ]
    else:
        descriptor.floating_point_range = [
            msg.FloatingPointRange(from_value=float(parameter.low), to_value=float(parameter.high))
        ]
    return descriptor


def check_change(declared: Set[str], changes: list[Any]) -> msg.SetParametersResult:
    """Reject changes of parameters, because buffers, windows and plans depend on them."""
    for change in changes:
        if change.name in declared:
            return msg.SetParametersResult(
                successful=False,
                reason=f'{change.name} is read at start; start the node again with another value',
            )
    return msg.SetParametersResult(successful=True)
