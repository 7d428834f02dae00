"""Start the four nodes of the interpolator; they configure and activate themselves.

``show:=true`` adds what RViz and Foxglove draw: the machine's frames and the markers of the paths.
"""

import os
import sys

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable
from launch.conditions import IfCondition
from launch.substitutions import (
    Command,
    LaunchConfiguration,
    PathJoinSubstitution,
    PythonExpression,
)
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from cnc_interp.machine.drive_kinds import CHOICE
from cnc_interp.processes.this_host import variables_of_this_host

NODES = ('lookahead_node', 'feedrate_node', 'machine_node', 'program_node')

SHARE = FindPackageShare('cnc_interp')
PARAMETERS_FILE = PathJoinSubstitution([SHARE, 'config', 'nodes.yaml'])
RVIZ_FILE = PathJoinSubstitution([SHARE, 'config', 'views', 'cnc.rviz'])

ARGUMENTS = (
    ('machine', 'xyzac', 'Name of a bundled machine, or path of a machine file.'),
    ('namespace', '', 'Namespace of all nodes, topics, services and actions.'),
    ('parameters_file', PARAMETERS_FILE, 'Parameters of the nodes, a YAML file.'),
    ('program_folder', '', 'Programs below this folder may be run by their path.'),
    ('drives', 'simulated', f'Drives of the axes. {CHOICE}.'),
    ('scene', '', 'Scene: a YAML file of bodies that must keep apart.'),
    ('setup', '', 'File in which offsets and tools of the machine are kept.'),
    ('use_sim_time', 'false', 'Take the time from topic /clock instead of the system clock.'),
    ('show', 'false', 'Also start robot_state_publisher and the markers of the paths.'),
    ('rviz', 'false', 'Also start RViz; needs show:=true.'),
    ('rviz_file', RVIZ_FILE, 'Configuration of RViz.'),
    ('log_level', 'info', 'Least severe messages that are logged: debug, info, warn or error.'),
)


def node(name: str, condition: IfCondition | None = None) -> Node:
    """Describe one node; the values of this launch win over those of the parameters file."""
    values = {
        'machine': ParameterValue(LaunchConfiguration('machine'), value_type=str),
        'use_sim_time': ParameterValue(LaunchConfiguration('use_sim_time'), value_type=bool),
    }
    if name == 'machine_node':
        values['drives'] = ParameterValue(LaunchConfiguration('drives'), value_type=str)
    if name != 'lookahead_node':
        for given in ('scene', 'setup'):
            values[given] = ParameterValue(LaunchConfiguration(given), value_type=str)
    if name == 'program_node':
        folders = ["['", LaunchConfiguration('program_folder'), "']"]
        values['program_folders'] = ParameterValue(folders, value_type=list[str])
    return Node(
        package='cnc_interp',
        executable=name,
        name=name,
        namespace=LaunchConfiguration('namespace'),
        parameters=[LaunchConfiguration('parameters_file'), values],
        ros_arguments=['--log-level', LaunchConfiguration('log_level')],
        output='screen',
        condition=condition,
    )


def views() -> list[Node]:
    """Describe what draws."""
    show = IfCondition(LaunchConfiguration('show'))
    bodies = PythonExpression(["' --frames' if '", LaunchConfiguration('scene'), "' else ''"])
    command = [sys.executable, ' -m cnc_interp urdf ', LaunchConfiguration('machine'), bodies]
    urdf = Command(command)
    frames = Node(
        package='robot_state_publisher',
        executable='robot_state_publisher',
        namespace=LaunchConfiguration('namespace'),
        parameters=[{'robot_description': ParameterValue(urdf, value_type=str)}],
        output='screen',
        condition=show,
    )
    rviz = Node(
        package='rviz2',
        executable='rviz2',
        namespace=LaunchConfiguration('namespace'),
        arguments=['-d', LaunchConfiguration('rviz_file')],
        condition=IfCondition(LaunchConfiguration('rviz')),
    )
    return [frames, node('markers_node', show), rviz]


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments and the nodes."""
    arguments = [
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, value, text in ARGUMENTS
    ]
    local = [SetEnvironmentVariable(*pair) for pair in variables_of_this_host(os.environ).items()]
    return LaunchDescription([*arguments, *local, *(node(name) for name in NODES), *views()])
