"""The probing cycles on the page: chosen, started, and the offset is where the bore is."""

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from page_under_test import PanelUnderTest

from cnc_interp.processes.node_processes import NODES


@pytest.mark.thorough
def test_a_bore_is_found_from_the_dialog(tmp_path):
    part = tmp_path / 'part.yaml'
    part.write_text('surfaces: [{bore: [12.3, -4.5, 0], radius_mm: 8}]')
    own = {'machine_node': {'probe_touches': str(part)}}
    panel = PanelUnderTest({node: {'machine': 'vmc', **own.get(node, {})} for node in NODES})
    try:
        tab = panel.open_in_charge()
        panel.give(tab, 'G0 X12 Y-5 Z-5')
        tab.click('probe')
        tab.wait(lambda: tab.text('probe bore'))
        tab.click('probe bore')
        tab.wait(lambda: tab.run('!!document.querySelector(\'[data-mark="probe diameter"]\')'))
        tab.fill('probe diameter', '16')
        tab.click('start probe')
        # It says what it found, old and new, and sets nothing before its user agrees.
        tab.wait(lambda: 'G54 X ' in (tab.text('found') or ''))
        assert '→ ' in tab.text('found') and not panel.setup.work_offsets
        tab.click_with_mouse('leave found')
        assert tab.text('work X') != '0.000' and not panel.setup.work_offsets
        tab.click_with_mouse('probe')
        tab.click_with_mouse('probe bore')
        tab.wait(lambda: tab.value('probe diameter') == '20')
        tab.fill('probe diameter', '16')
        tab.click_with_mouse('start probe')
        tab.wait(lambda: 'G54 X ' in (tab.text('found') or ''))
        tab.click_with_mouse('set found')
        tab.wait(lambda: tab.text('work X') == tab.text('work Y') == '0.000')
        tip = [float(tab.text(f'tip {letter}')) for letter in 'xy']
        assert tip == pytest.approx([12.3, -4.5], abs=3e-3)
        assert tab.faults == []
    finally:
        panel.close()
