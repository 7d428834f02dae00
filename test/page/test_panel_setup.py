"""Offsets and tools on the operator page: edited, touched off, and used by the next program."""

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import MachineState
from cnc_interp_msgs.srv import MoveAxes
from page_under_test import PanelUnderTest

pytestmark = pytest.mark.thorough


@pytest.fixture(scope='module')
def running(tmp_path_factory):
    file = tmp_path_factory.mktemp('setup') / 'setup.yaml'
    panel = PanelUnderTest({'program_node': {'setup': f"'{file}'"}})
    panel.mover = panel.node.create_client(MoveAxes, 'move_axes')
    panel.spin_until(panel.mover.service_is_ready)
    yield panel
    panel.close()


def see(panel, tab, mark, done):
    """Press a key of the dialog, and see what it does to the table."""
    tab.click(mark)
    panel.spin_until(lambda: done(panel.setup))
    tab.wait(lambda: panel.told[-1].change in (tab.text('setup change') or ''))


def move(panel, **axes):
    request = MoveAxes.Request(axes=list(axes), values=list(axes.values()))
    answer = panel.mover.call_async(request)
    panel.spin_until(answer.done)
    wanted = np.array(answer.result().positions)
    panel.spin_until(
        lambda: (
            panel.peers.at_rest
            and np.abs(wanted - panel.peers.state.commanded_positions).max() < 1e-9
        )
    )


def test_edit_touch_off_and_run(panel, tmp_path):
    tab = panel.open_in_charge()
    tab.click('offsets')
    tab.fill('new tool number', '3')
    tab.fill('new tool length', '75.5')
    tab.fill('new tool remark', 'ball')
    see(panel, tab, 'set new tool', lambda s: 3 in s.tools)
    assert panel.setup.tools[3].remark == 'ball'
    assert panel.setup.tools[3].length == pytest.approx(0.0755)
    see(panel, tab, 'load tool 3', lambda s: s.tool == 3)
    see(panel, tab, 'use G55', lambda s: s.active == 'G55')
    tab.wait(lambda: tab.text('setup') == 'G55, tool 3')
    tab.fill('G54 X', 'ten')
    tab.click('set G54')
    tab.wait(lambda: tab.shows('write a number'))
    tab.click('close setup')
    move(panel, X=0.1, Y=-0.05, Z=0.3)
    tab.click('show touch off')
    tab.fill('here X', '2')
    tab.fill('here Y', '0')
    tab.fill('here Z', '10')
    tab.click('touch off')
    panel.spin_until(lambda: 'G55' in panel.setup.work_offsets)
    wanted = {'X': 0.098, 'Y': -0.05, 'Z': 0.3 - 0.0755 - 0.01}
    assert panel.setup.work_offsets == {'G55': pytest.approx(wanted)}
    assert panel.told[-1].changed_by.startswith('page of ')
    tab.wait(lambda: (tab.text('work X'), tab.text('work Z')) == ('2.000', '10.000'))
    tab.wait(lambda: tab.text('axis X') == '100.000')
    program = tmp_path / 'lands.ngc'
    program.write_text('G21 G90\nG43 H3\nG0 X0 Y0 Z30\nG1 X12 Y0 Z10 F3000\n')
    panel.load(tab, program)
    panel.press_key(tab, 'cycle start', lambda: bool(panel.loaded))
    panel.spin_until(lambda: panel.peers.state.completed)
    np.testing.assert_allclose(
        panel.next_state().commanded_positions[:3], [0.11, -0.05, 0.3], atol=1e-9
    )
    tab.wait(lambda: tab.text('progress') == '100.0%')


def test_what_a_program_uses_is_refused_with_one_line(panel, tmp_path):
    tab = panel.open_in_charge()
    program = tmp_path / 'waits.ngc'
    program.write_text('G21 G90\nG54 G0 X0 Y0 Z0\nG1 X20 F3000\nM0\nG1 X30\nM30\n')
    panel.load(tab, program)
    panel.begin(tab)
    panel.spin_until(lambda: panel.peers.state.may_resume and panel.peers.at_rest)
    tab.click('offsets')
    tab.fill('G54 X', '5')
    tab.click('set G54')
    told = 'G54 is used by waits.ngc, which is running'
    tab.wait(lambda: tab.shows(told))
    assert 'G54' not in panel.setup.work_offsets
    tab.click('close setup')
    panel.reset(tab)
    panel.until(MachineState.IDLE)


def test_tools_come_from_a_file_and_are_touched_off(panel, tmp_path):
    tab = panel.open_in_charge(width=1500, height=1000)
    tab.wait(lambda: tab.text('state') == 'idle')
    table = tmp_path / 'tool.tbl'
    table.write_text('T8 P3 Z+61.25 D8.0 ;mill\nT9 P9 Z+40 D6\n')
    tab.click_with_mouse('offsets')
    tab.centre('import tools')
    tab.choose_file('.tool-file input', table)
    panel.spin_until(lambda: {8, 9} <= set(panel.setup.tools))
    tool = panel.setup.tools[8]
    assert (tool.length, tool.radius) == pytest.approx((0.06125, 0.004))
    assert (tool.pocket, tool.remark) == (3, 'mill')
    tab.wait(lambda: tab.value('tool 9 length') == '40.000')
    # The tip touches Z 2 of the program: its length is what is left.
    tab.fill('touch Z', '2')
    tab.click_with_mouse('touch tool 9')
    panel.spin_until(lambda: panel.setup.tools[9].length != pytest.approx(0.04))
    stands = panel.next_state().commanded_positions[2]
    zero = dict(zip(panel.told[-1].axes, panel.told[-1].zero, strict=True))['Z']
    zero = panel.setup.work_offsets.get(panel.setup.offset, {}).get('Z', zero)
    assert panel.setup.tools[9].length == pytest.approx(stands - zero - 0.002, abs=1e-9)
    tab.wait(lambda: 'tool 9: length 40' in (tab.text('setup change') or ''))
    tab.click_with_mouse('close setup')
