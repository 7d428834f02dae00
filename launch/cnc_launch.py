"""Start the four nodes of the interpolator; they configure and activate themselves."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

NODES = ('lookahead_node', 'feedrate_node', 'machine_node', 'program_node')

PARAMETERS_FILE = PathJoinSubstitution([FindPackageShare('cnc_interp'), 'config', 'nodes.yaml'])

ARGUMENTS = (
    ('machine', 'xyzac', 'Name of a bundled machine, or path of a machine file.'),
    ('namespace', '', 'Namespace of all nodes, topics, services and actions.'),
    ('parameters_file', PARAMETERS_FILE, 'Parameters of the nodes, a YAML file.'),
    ('use_sim_time', 'false', 'Take the time from topic /clock instead of the system clock.'),
    ('log_level', 'info', 'Least severe messages that are logged: debug, info, warn or error.'),
)


def node(name: str) -> Node:
    """Describe one node; the values of this launch win over those of the parameters file."""
    values = {
        'machine': ParameterValue(LaunchConfiguration('machine'), value_type=str),
        'use_sim_time': ParameterValue(LaunchConfiguration('use_sim_time'), value_type=bool),
    }
    return Node(
        package='cnc_interp',
        executable=name,
        name=name,
        namespace=LaunchConfiguration('namespace'),
        parameters=[LaunchConfiguration('parameters_file'), values],
        ros_arguments=['--log-level', LaunchConfiguration('log_level')],
        output='screen',
    )


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments and the nodes."""
    arguments = [
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, value, text in ARGUMENTS
    ]
    return LaunchDescription([*arguments, *(node(name) for name in NODES)])
