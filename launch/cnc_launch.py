"""Start the interpolator's four nodes; the three that move axes come up configured and active."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node

ARGUMENTS = (
    ('namespace', '', 'Namespace of all nodes, topics, services and actions.'),
    ('machine', 'xyzac', 'Name of a bundled machine, or path of a machine file.'),
    ('use_sim_time', 'false', 'Take the time from topic /clock instead of the system clock.'),
    ('log_level', 'info', 'Least severe messages that are logged: debug, info, warn or error.'),
)


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments and the nodes; program_node brings the lifecycle nodes up."""
    common = {
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
    streaming = [
        LifecycleNode(name=f'{role}_node', executable=f'{role}_node', **common)
        for role in ('lookahead', 'feedrate', 'machine')
    ]
    program = Node(name='program_node', executable='program_node', **common)
    arguments = [
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, value, text in ARGUMENTS
    ]
    return LaunchDescription([*arguments, *streaming, program])
