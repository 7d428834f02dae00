"""The SROS 2 policy as a file: complete in itself, and each topic of the nodes has its sender."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp.nodes.seals import OWNERS

POLICY = Path(__file__).parents[2] / 'config' / 'sros2' / 'policy.xml'
#: Elements of a policy of version 0.2.0, with the attributes that they may have.
RULES = {'topics': {'publish', 'subscribe'}, 'services': {'reply', 'request'}}
RULES['actions'] = {'call', 'execute'}
#: What every node of rclpy does.
PARAMETERS = {
    '~/describe_parameters',
    '~/get_parameter_types',
    '~/get_parameters',
    '~/list_parameters',
    '~/set_parameters',
    '~/set_parameters_atomically',
    '~/get_type_description',
}


def profiles():
    return {p.get('node'): p for p in ElementTree.parse(POLICY).iter('profile')}


def allowed(profile, element, right):
    groups = [group for group in profile.findall(element) if group.get(right) == 'ALLOW']
    return {name.text for group in groups for name in group}


def test_the_policy_needs_no_other_file_and_has_rules_alone():
    """It included a file that was not shipped, so no permissions could be made."""
    root = ElementTree.parse(POLICY).getroot()
    assert root.tag == 'policy' and root.get('version') == '0.2.0'
    for name, profile in profiles().items():
        assert profile.attrib == {'ns': '/', 'node': name}
        for group in profile:
            assert len(group) and set(group.attrib) <= RULES[group.tag], group.attrib
            assert set(group.attrib.values()) == {'ALLOW'}
            assert {entry.tag for entry in group} == {group.tag[:-1]}
    enclaves = {e.get('path') for e in root.iter('enclave')}
    assert enclaves == {f'/cnc/{name}' for name in profiles()}


@pytest.mark.parametrize('name', profiles())
def test_every_node_may_log_and_answer_for_its_parameters(name):
    profile = profiles()[name]
    assert {'/rosout', '/parameter_events'} <= allowed(profile, 'topics', 'publish')
    assert allowed(profile, 'services', 'reply') >= PARAMETERS


@pytest.mark.parametrize('topic', [topic for topic, owners in OWNERS.items() if owners])
def test_a_sealed_topic_is_published_by_its_nodes_alone(topic):
    senders = {n for n, p in profiles().items() if topic in allowed(p, 'topics', 'publish')}
    assert senders == set(OWNERS[topic])
    assert any(topic in allowed(p, 'topics', 'subscribe') for p in profiles().values())
