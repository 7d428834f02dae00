"""Start the four nodes of the interpolator; the lifecycle nodes come up configured and active."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.event_handlers import OnProcessStart
from launch.events import matches_action
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from lifecycle_msgs.msg import Transition

ARGUMENTS = (
    ('namespace', '', 'Namespace of all nodes, topics, services and actions.'),
    ('machine', 'xyzac', 'Name of a bundled machine, or path of a machine file.'),
    ('use_sim_time', 'false', 'Take the time from topic /clock instead of the system clock.'),
    ('log_level', 'info', 'Least severe messages that are logged: debug, info, warn or error.'),
)

PLAIN_NODES = ('lookahead_node', 'program_node')
LIFECYCLE_NODES = ('feedrate_node', 'machine_node')  # what moves axes

COMMON = {
    'package': 'cnc_interp',
    'namespace': LaunchConfiguration('namespace'),
    'output': 'screen',
    'parameters': [
        {
            'machine': LaunchConfiguration('machine'),
            'use_sim_time': LaunchConfiguration('use_sim_time'),
        }
    ],
    'ros_arguments': ['--log-level', LaunchConfiguration('log_level')],
}


def request(node: LifecycleNode, transition: int) -> EmitEvent:
    """Ask a lifecycle node for a transition."""
    return EmitEvent(
        event=ChangeState(lifecycle_node_matcher=matches_action(node), transition_id=transition)
    )


def bring_up(node: LifecycleNode) -> list[RegisterEventHandler]:
    """Configure a lifecycle node once it has started and activate it once it is configured."""
    started = OnProcessStart(
        target_action=node, on_start=[request(node, Transition.TRANSITION_CONFIGURE)]
    )
    configured = OnStateTransition(
        target_lifecycle_node=node,
        start_state='configuring',
        goal_state='inactive',
        entities=[request(node, Transition.TRANSITION_ACTIVATE)],
    )
    return [RegisterEventHandler(started), RegisterEventHandler(configured)]


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments and the nodes."""
    lifecycle = [LifecycleNode(name=n, executable=n, **COMMON) for n in LIFECYCLE_NODES]
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(n, default_value=v, description=t) for n, v, t in ARGUMENTS),
            *(handler for node in lifecycle for handler in bring_up(node)),
            *lifecycle,
            *(Node(name=n, executable=n, **COMMON) for n in PLAIN_NODES),
        ]
    )
