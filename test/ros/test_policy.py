"""The SROS 2 policy lets every node do what it does, and no more."""

import contextlib
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from nodes_under_test import NodesUnderTest
from rclpy.node import NodeNameNonExistentError

from cnc_interp.processes.node_processes import NODES

pytestmark = pytest.mark.thorough

POLICY = Path(__file__).parents[2] / 'config' / 'sros2' / 'policy.xml'


def allowed(node, element, right):
    for profile in ElementTree.parse(POLICY).iter('profile'):
        if profile.get('node') == node:
            return {
                name.text.rpartition('/')[2]
                for group in profile.findall(element)
                if group.get(right) == 'ALLOW'
                for name in group
            }
    raise AssertionError(f'no profile of {node}')


def own(names_and_types):
    return {name.rpartition('/')[2] for name, _ in names_and_types if '_action/' not in name}


def seen(look, wanted):
    """Ask the graph, which learns of a node a little later than that node is there."""
    found, deadline = None, time.monotonic() + 30.0
    while found != wanted and time.monotonic() < deadline:
        with contextlib.suppress(NodeNameNonExistentError):
            found = look()
        time.sleep(0.1)
    return found


def test_policy_and_nodes_agree():
    running = NodesUnderTest()
    graph, space = running.node, running.namespace
    try:
        for node in NODES:
            for element, right, ask in (
                ('topics', 'publish', graph.get_publisher_names_and_types_by_node),
                ('topics', 'subscribe', graph.get_subscriber_names_and_types_by_node),
                ('services', 'reply', graph.get_service_names_and_types_by_node),
                ('services', 'request', graph.get_client_names_and_types_by_node),
            ):
                wanted = allowed(node, element, right) - {'clock'}  # of a simulated time
                assert seen(lambda: own(ask(node, space)), wanted) == wanted, (node, right)
        assert allowed('program_node', 'actions', 'execute') == {'run_program'}
    finally:
        running.close()
    assert allowed('observer', 'topics', 'publish') == {'rosout', 'parameter_events'}  # any node's
