"""The page shows the error at the tool, and what it would be without compensation."""

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')
pytest.importorskip(
    'nicegui', reason='needs requirements/panel.txt; run the tests with ./cnc test'
)
pytest.importorskip('websockets', reason='needs requirements/panel.txt')

from browser import found
from page_under_test import PanelUnderTest

from cnc_interp.page.readings import NOTHING
from cnc_interp.processes.node_processes import NODES

pytestmark = pytest.mark.skipif(
    found() is None, reason='needs a browser: apt-get install chromium'
)

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
