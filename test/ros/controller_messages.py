"""The messages of ros2_control that ``cnc-interp send`` needs; a workspace of ROS 2 has them."""

import os
import re
import subprocess
import sys
import sysconfig
from pathlib import Path

ROOT = Path(__file__).parents[2]
TOLERANCE = 'float64 position\nfloat64 velocity\nfloat64 acceleration\n'
POINTS = 'desired', 'actual', 'error'
PROGRESS = '\n'.join(
    [
        'std_msgs/Header header',
        'string[] joint_names',
        *(
            f'trajectory_msgs/JointTrajectoryPoint {name}'
            for name in ('desired', 'actual', 'error')
        ),
        'string[] multi_dof_joint_names',
        *(f'trajectory_msgs/MultiDOFJointTrajectoryPoint multi_dof_{name}' for name in POINTS),
    ]
)
FILES = {
    'msg/JointTolerance.msg': f'string name\n{TOLERANCE}',
    'msg/JointComponentTolerance.msg': f'string joint_name\nuint16 component\n{TOLERANCE}',
    'action/FollowJointTrajectory.action': f"""
trajectory_msgs/JointTrajectory trajectory
trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
JointTolerance[] path_tolerance
JointComponentTolerance[] component_path_tolerance
JointTolerance[] goal_tolerance
JointComponentTolerance[] component_goal_tolerance
builtin_interfaces/Duration goal_time_tolerance
---
int32 error_code
int32 SUCCESSFUL = 0
int32 INVALID_GOAL = -1
int32 INVALID_JOINTS = -2
int32 OLD_HEADER_TIMESTAMP = -3
int32 PATH_TOLERANCE_VIOLATED = -4
int32 GOAL_TOLERANCE_VIOLATED = -5
string error_string
---
{PROGRESS}
""",
}


def built(folder):
    """Build them as our own messages are built; return the environment of processes with them."""
    source, prefix, root = folder / 'source', folder / 'installed', Path(sys.prefix)
    for name, text in FILES.items():
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        (source / name).write_text(text)
    used = 'builtin_interfaces std_msgs trajectory_msgs'
    cmake = (ROOT / 'msg_defs' / 'CMakeLists.txt').read_text()
    cmake = cmake.replace('project(cnc_interp_msgs)', 'project(control_msgs)')
    named = re.compile(r'(?<=interfaces\(\$\{PROJECT_NAME\}\n).*?(?=DEPENDENCIES)', re.DOTALL)
    cmake = named.sub('\n'.join(FILES) + '\n', cmake)
    cmake = cmake.replace('DEPENDENCIES diagnostic_msgs std_msgs', f'DEPENDENCIES {used}')
    cmake = cmake.replace('find_package(diagnostic_msgs', 'find_package(trajectory_msgs')
    (source / 'CMakeLists.txt').write_text(cmake)
    package = (ROOT / 'msg_defs' / 'package.xml').read_text()
    (source / 'package.xml').write_text(package.replace('cnc_interp_msgs', 'control_msgs'))
    environment = os.environ | {
        'PATH': f'{root / "bin"}:{os.environ["PATH"]}',
        'AMENT_PREFIX_PATH': str(root),
        'PYTHONPATH': str(ROOT / 'tools' / 'message_build'),
    }
    for words in (
        [
            *('cmake', '-S', source, '-B', folder / 'build', '-G', 'Ninja', '-DONLY_PYTHON=ON'),
            *('-DBUILD_TESTING=OFF', f'-DCMAKE_INSTALL_PREFIX={prefix}'),
            *(f'-DCMAKE_PREFIX_PATH={root}', f'-DPython3_EXECUTABLE={sys.executable}'),
            '-DPython3_FIND_VIRTUALENV=ONLY',
        ],
        ['ninja', '-C', folder / 'build', 'install'],
    ):
        done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, (done.stdout + done.stderr)[-3000:]
    packages = Path(sysconfig.get_path('purelib')).relative_to(root)
    return {
        'PYTHONPATH': str(prefix / packages),
        'LD_LIBRARY_PATH': f'{prefix / "lib"}:{os.environ.get("LD_LIBRARY_PATH", "")}',
        'AMENT_PREFIX_PATH': f'{prefix}:{root}',
    }
