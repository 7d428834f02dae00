"""The four nodes of cnc_interp with their parameter file; `run_program` then takes programs."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments and start the nodes; those that move axes start themselves."""
    package = 'cnc_interp'
    parameters = [
        LaunchConfiguration('parameters'),
        {'machine': LaunchConfiguration('machine')},
    ]
    namespace = LaunchConfiguration('namespace')
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                'machine', default_value='xyzac', description='Bundled machine, or a YAML file'
            ),
            DeclareLaunchArgument(
                'parameters',
                default_value=PathJoinSubstitution(
                    [FindPackageShare(package), 'config', 'nodes.yaml']
                ),
                description='Parameter file of the nodes',
            ),
            DeclareLaunchArgument(
                'namespace', default_value='', description='Namespace of the machine'
            ),
            *(
                action(
                    package=package,
                    executable=name,
                    name=name,
                    namespace=namespace,
                    parameters=parameters,
                    output='screen',
                )
                for name, action in (
                    ('program_node', Node),
                    ('lookahead_node', Node),
                    ('feedrate_node', LifecycleNode),
                    ('machine_node', LifecycleNode),
                )
            ),
        ]
    )
