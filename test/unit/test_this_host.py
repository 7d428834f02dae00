"""Which variables keep the nodes on this computer, and that the launch file sets them."""

import os
import runpy
import sys
from pathlib import Path
from types import ModuleType

import pytest

from cnc_interp.processes.this_host import (
    PEERS,
    PROFILE,
    RANGE,
    TRANSPORTS,
    variables_of_this_host,
)

LAUNCH = Path(__file__).parents[2] / 'launch' / 'cnc_launch.py'
ALONE = {RANGE: 'SYSTEM_DEFAULT', TRANSPORTS[0]: str(PROFILE)}


@pytest.mark.parametrize(
    ('given', 'wanted'),
    [
        ({}, ALONE),
        ({RANGE: 'LOCALHOST'}, ALONE),
        ({RANGE: 'SUBNET'}, {}),
        ({PEERS: '10.0.0.7'}, {}),
        ({PEERS: ''}, ALONE),
        ({TRANSPORTS[0]: 'own.xml'}, {RANGE: 'LOCALHOST'}),
        ({TRANSPORTS[1]: 'UDPv4'}, {RANGE: 'LOCALHOST'}),
        ({'RMW_IMPLEMENTATION': 'rmw_cyclonedds_cpp'}, {RANGE: 'LOCALHOST'}),
        (ALONE, {}),
    ],
)
def test_what_the_user_has_set_is_respected(given, wanted):
    assert variables_of_this_host(given) == wanted


class Recorded:
    """Stands in for a class of ``launch``: keeps what it is made with."""

    def __init__(self, *words, **options):
        self.words, self.options = words, options


@pytest.mark.parametrize(('given', 'wanted'), [({}, ALONE), ({PEERS: '10.0.0.7'}, {})])
def test_the_launch_file_sets_the_same_variables_before_the_nodes(given, wanted, monkeypatch):
    names = {
        'launch': ('LaunchDescription',),
        'launch.actions': ('DeclareLaunchArgument', 'SetEnvironmentVariable'),
        'launch.conditions': ('IfCondition',),
        'launch.substitutions': (
            'Command',
            'LaunchConfiguration',
            'PathJoinSubstitution',
            'PythonExpression',
        ),
        'launch_ros': (),
        'launch_ros.actions': ('Node',),
        'launch_ros.parameter_descriptions': ('ParameterValue',),
        'launch_ros.substitutions': ('FindPackageShare',),
    }
    for module, classes in names.items():
        stand_in = ModuleType(module)
        for name in classes:
            setattr(stand_in, name, type(name, (Recorded,), {}))
        monkeypatch.setitem(sys.modules, module, stand_in)
    for name in (RANGE, PEERS, *TRANSPORTS):
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setitem(os.environ, name, value)
    (actions,) = runpy.run_path(str(LAUNCH))['generate_launch_description']().words
    kinds = [type(action).__name__ for action in actions]
    variables = [a.words for a in actions if type(a).__name__ == 'SetEnvironmentVariable']
    assert dict(variables) == wanted
    if wanted:
        assert max(i for i, kind in enumerate(kinds) if kind == 'SetEnvironmentVariable') < (
            kinds.index('Node')
        )
