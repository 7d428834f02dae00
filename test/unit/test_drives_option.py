"""The option --drives: kinds of drives with their parameters."""

import argparse

import pytest

from cnc_interp.commands.parser import drives
from cnc_interp.machine.drive_kinds import KINDS


def test_drives_with_their_parameters():
    assert drives('simulated') == {'drives': 'simulated'}
    assert drives('hal,hal_depth=50') == {'drives': 'hal', 'hal_depth': '50'}
    given = drives('trajectory,controller=/arm,controller_joints=a b')
    assert given['controller'] == "'/arm'" and given['controller_joints'] == "['a', 'b']"


@pytest.mark.parametrize(
    'text',
    ['', 'servo', 'simulated,hal_depth=3', 'hal,depth=3', 'hal,hal_depth', "hal,hal_depth='"],
)
def test_what_is_no_drive_is_refused(text):
    with pytest.raises(argparse.ArgumentTypeError):
        drives(text)


def test_every_parameter_is_one_of_the_machine_node():
    pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')
    from cnc_interp.nodes.parameters import MACHINE_NODE

    known = [each.name for each in MACHINE_NODE]
    assert len(set(known)) == len(known)
    assert {each.name for kind in KINDS.values() for each in kind.parameters} < set(known)
