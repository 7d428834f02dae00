"""Outputs and inputs on the page: in sight, switched by hand, switched off by a stop."""

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')
pytest.importorskip(
    'nicegui', reason='needs requirements/panel.txt; run the tests with ./cnc test'
)
pytest.importorskip('websockets', reason='needs requirements/panel.txt')

from browser import found
from cnc_interp_msgs.msg import MachineSignals
from page_under_test import PanelUnderTest

from cnc_interp.nodes import qos
from cnc_interp.processes.node_processes import NODES

pytestmark = pytest.mark.skipif(
    found() is None, reason='needs a browser: apt-get install chromium'
)

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
