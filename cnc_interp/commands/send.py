"""`cnc-interp send`: let a controller of ros2_control execute a finished plan."""

import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

from cnc_interp.commands.check import prove
from cnc_interp.commands.parser import FAILED, FINE, command, option
from cnc_interp.core import DEG, MM


def add_send_command(commands: Any) -> None:
    command(
        commands,
        send_command,
        'send out/part',
        option('directory', 'folder with plan files', Path, 'DIR'),
        option('--machine', 'another machine than the plan names', metavar='M'),
        option(
            '--controller',
            'the controller; it offers the action follow_joint_trajectory '
            '(/joint_trajectory_controller)',
            metavar='NAME',
            default='/joint_trajectory_controller',
        ),
        option(
            '--feedback',
            'topic on which the joints are reported (/joint_states)',
            metavar='TOPIC',
            default='/joint_states',
        ),
        option(
            '--joints',
            'the joint of each axis, in the order of the machine file (as in its URDF)',
            metavar='NAME',
            nargs='+',
            default=[],
        ),
        option('--domain', 'ROS domain (ROS_DOMAIN_ID)', int, 'N'),
    )


def send_command(options: Namespace) -> int:
    """Prove a plan, and let a trajectory controller of ros2_control execute it."""
    from cnc_interp.client.served_node import ServedNode
    from cnc_interp.client.trajectory_goal import FollowedPlan, trajectory_of
    from cnc_interp.core.progress_bar import ProgressBar
    from cnc_interp.machine.drive_kinds import joints_of
    from cnc_interp.machine_model.machine import Machine
    from cnc_interp.proof.plan_files import read_plan

    proof = prove(Namespace(program=None, **vars(options)), options.directory, options.machine)
    if not proof.ok:
        print(proof.text())
        return FAILED
    plan = read_plan(options.directory)
    trajectory = trajectory_of(plan)
    machine = Machine.load(options.machine or str(plan.summary['machine']))
    joints = joints_of(options.joints, machine)
    progress = ProgressBar(sys.stderr)
    told, length = progress.of('executing'), 1e-9 * float(trajectory.times[-1])
    with ServedNode('send', '/', options.domain) as node:
        robot = FollowedPlan(node, options.controller, joints, options.feedback)
        robot.refuse_elsewhere(machine, trajectory.rows.position[0])
        try:
            robot.execute(trajectory, lambda done: told(done / length))
        finally:
            progress.end(complete=False)
    errors = (
        f'{joint} {error / MM:.4f} mm' if linear else f'{joint} {error / DEG:.4f} deg'
        for joint, error, linear in zip(joints, robot.errors, machine.is_linear, strict=True)
    )
    print(f'executed       {length:.3f} s, {len(trajectory.rows)} points')
    print(f'following      {"  ".join(errors)}')
    return FINE
