"""Parameters of nodes: what no node reads again is refused while it runs, and what cannot work."""

import subprocess
import sys
from types import SimpleNamespace

import pytest

from cnc_interp.nodes import joy_jog_node, parameters


class StandIn:
    """What ``declare`` asks of a node."""

    def declare_parameter(self, _name, default, _told):
        return SimpleNamespace(value=default)

    def add_on_set_parameters_callback(self, callback):
        self.changed = callback


@pytest.mark.parametrize(
    'table',
    [*parameters.NODES.values(), parameters.BATCH, joy_jog_node.declared(('X', 'C'))],
    ids=[*parameters.NODES, 'batch_node', 'joy_jog_node'],
)
def test_what_a_node_reads_at_start_only_is_refused_later(table):
    """``workers``, ``batch_folder``, ``enable_button`` were accepted, and nothing happened."""
    node = StandIn()
    parameters.declare(node, table)
    for parameter in table:
        told = node.changed([SimpleNamespace(name=parameter.name)])
        assert not told.successful and told.reason.startswith(f'{parameter.name} is read at start')
    assert node.changed([SimpleNamespace(name='use_sim_time')]).successful


def test_a_buffer_that_holds_no_setpoint_is_refused_in_one_line():
    command = [sys.executable, '-m', 'cnc_interp.nodes', 'machine_node', '--ros-args']
    command += ['-p', 'interpolation_period:=0.1', '-p', 'buffer_time:=0.01']
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    last = done.stderr.strip().splitlines()[-1]
    assert done.returncode == 2, done.stderr
    assert 'buffer_time: 0.01 s is less than the period, 0.1 s; give at least one period' in last
    assert 'Traceback' not in done.stderr
