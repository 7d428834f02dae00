"""Layouts of RViz, Foxglove and PlotJuggler name only what the nodes really send."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import MachineState

from cnc_interp.description.urdf import describe_machine
from cnc_interp.machine_model.machine import Machine

CONFIG = Path(__file__).parents[2] / 'config'
VIEWS = CONFIG / 'views'
#: What markers_node and robot_state_publisher send; test_markers.py listens to the first.
SHOWN = {'/markers', '/robot_description'}


def sent():
    """Topics of the four nodes, from the policy that test_policy.py compares with them."""
    policy = ElementTree.parse(CONFIG / 'sros2' / 'policy.xml')
    groups = policy.findall(".//topics[@publish='ALLOW']")
    return {f'/{topic.text.lstrip("/")}' for group in groups for topic in group} | SHOWN


def check_series(name):
    """A series is a field of machine_state; with an index only where there are several."""
    found = re.fullmatch(r'/machine_state[./](\w+)(\[(\d)\])?', name)
    assert found and '/machine_state' in sent(), name
    kind = MachineState.get_fields_and_field_types()[found[1]]
    assert ('sequence' in kind) == (found[2] is not None), name
    if found[3]:
        assert int(found[3]) < len(Machine.load('xyzac').axis_names)


def test_foxglove():
    layout = json.loads((VIEWS / 'foxglove.json').read_text())
    panels = layout['configById']
    series = [path['value'] for p in panels.values() for path in p.get('paths', [])]
    assert len(series) > 10
    for name in series:
        check_series(name)
    scene = panels['3D!machine']
    named = {scene['layers']['urdf']['topic'], *scene['topics']}
    named |= {
        p[key] for p in panels.values() for key in ('topicPath', 'topicToRender') if key in p
    }
    assert {'/machine_state', '/diagnostics'} | SHOWN <= named <= sent()

    def leaves(tree):
        return {tree} if isinstance(tree, str) else leaves(tree['first']) | leaves(tree['second'])

    assert leaves(layout['layout']) == set(panels)


def test_plotjuggler():
    root = ElementTree.parse(VIEWS / 'plotjuggler.xml').getroot()
    curves = [curve.get('name') for curve in root.iter('curve')]
    assert len(curves) > 10
    for name in curves:
        check_series(name)
    for splitter in root.iter('DockSplitter'):
        assert int(splitter.get('count')) == len(splitter)


def test_rviz():
    config = yaml.safe_load((VIEWS / 'cnc.rviz').read_text())['Visualization Manager']
    displays = {display['Class'].split('/')[1]: display for display in config['Displays']}
    links = describe_machine(Machine.load('xyzac')).links
    assert config['Global Options']['Fixed Frame'] in links
    for display in config['Displays']:
        assert display.get('Reference Frame', 'base_link') in links
    drawn = displays['RobotModel']['Description Topic'], displays['MarkerArray']['Topic']
    assert {f'/{topic["Value"]}' for topic in drawn} == SHOWN
