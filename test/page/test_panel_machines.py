"""The page beside machines with outputs, and with compensated drives."""

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import MachineSignals
from page_under_test import PanelUnderTest

from cnc_interp.nodes import qos
from cnc_interp.page.readings import NOTHING
from cnc_interp.processes.node_processes import NODES

#: Bottom of the lowest key and of the part of the page that is in sight.
BOTTOMS = """(() => {
  const keys = [...document.querySelectorAll('.signals .switch')];
  return [Math.max(...keys.map(key => key.getBoundingClientRect().bottom)), innerHeight];
})()"""


@pytest.mark.thorough
def test_an_output_is_switched_by_its_key_and_off_by_the_emergency_stop():
    panel = PanelUnderTest({node: {'machine': 'vmc'} for node in NODES})
    told = []
    panel.node.create_subscription(MachineSignals, 'machine_signals', told.append, qos.LOADED)

    def output(name):
        return told and told[-1].output_values[list(told[-1].outputs).index(name)]

    try:
        tab = panel.open_in_charge()
        tab.wait(lambda: 'spindle speed 0' in (tab.text('signals') or ''))
        lowest, in_sight = tab.run(BOTTOMS)
        assert lowest <= in_sight
        panel.press_key(tab, 'coolant flood', lambda: output('coolant_flood') == 1.0)
        key = 'document.querySelector(`[data-mark="coolant flood"]`).ariaPressed'
        tab.wait(lambda: tab.run(key) == 'true')
        tab.click('EMERGENCY STOP')
        panel.spin_until(lambda: output('coolant_flood') == 0.0)
        tab.wait(lambda: tab.run(key) == 'false')
        assert tab.faults == []
    finally:
        panel.close()


PROGRAM = 'G21 G90 G94\nG0 X0 Y0\n' + 'G2 X0 Y0 I20 J0 F6000\n' * 3 + 'M30\n'


@pytest.mark.thorough
def test_error_with_and_without_compensation():
    machine = {'machine': 'xyzac_tired'}
    parameters = {node: dict(machine) for node in NODES}
    parameters['machine_node']['compensation'] = 'xyzac_tired'
    panel = PanelUnderTest(parameters)
    try:
        tab = panel.open()
        panel.run(text=PROGRAM)
        tab.wait(lambda: tab.text('uncompensated') not in ('', '0.0 µm', NOTHING))
        told, largest = (
            float(tab.text(name).split()[0]) for name in ('uncompensated', 'largest contour')
        )
        assert told > 10.0 and largest < 5.0
    finally:
        panel.close()
