"""The page beside an arm: its joints, where its tool is, and the keys that move it."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import MachineState
from page_under_test import PanelUnderTest

from cnc_interp.machine_model.machine import Machine
from cnc_interp.processes.node_processes import NODES
from cnc_interp.proof.own_chain import OwnChain

PYRAMID = Path(__file__).parents[2] / 'examples/pyramid.apt'


@pytest.mark.thorough
@pytest.mark.parametrize('name', ['ur10e', 'ur10e_cell'])
def test_an_arm_is_shown_jogged_and_runs_a_program(name):
    panel, machine = (
        PanelUnderTest({node: {'machine': name} for node in NODES}),
        Machine.load(name),
    )
    try:
        tab = panel.open_in_charge()
        panel.load(tab, PYRAMID)
        assert tab.text('work J1') is None
        assert tab.text('axis J1') == '165.0000'
        tab.click('jog')
        tab.run('[...document.querySelectorAll(`[data-mark="jog step"] button`)].at(-2).click()')
        tab.wait(lambda: tab.run('document.querySelector(".jog").dataset.step') == '1')
        panel.press_key(tab, 'jog J1-', lambda: tab.text('axis J1') == '164.0000')
        panel.spin_until(lambda: panel.next_state().state == MachineState.IDLE)
        for further in machine.extra_names:
            at = {'E1': '1.0000', 'U': '1.000'}[further]
            panel.press_key(tab, f'jog {further}+', lambda: tab.text(f'axis {further}') == at)
            tab.wait(lambda: tab.text(f'work {further}') == at)
            panel.spin_until(lambda: panel.next_state().state == MachineState.IDLE)
        before = np.array(panel.peers.state.commanded_positions)
        (tip,), (axis,) = OwnChain.of(machine).forward(before[None])
        wanted = [f'{1e3 * x:z.3f}' for x in tip + 1e-3 * axis]
        panel.press_key(tab, 'jog tool+', lambda: [tab.text(f'work {x}') for x in 'XYZ'] == wanted)
        panel.press_key(tab, 'zero X', lambda: tab.text('work X') == '0.000')
        panel.give(tab, 'G91 G1 X5 F1000')
        tab.wait(lambda: tab.text('work X') == '5.000')
        panel.begin(tab)
        panel.spin_until(lambda: panel.peers.state.completed)
        assert tab.faults == []
    finally:
        panel.close()
