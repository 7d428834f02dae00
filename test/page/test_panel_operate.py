"""An operator's tasks on the page: load, touch off, jog, MDI, start at a line, hold, finish."""

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')
pytest.importorskip(
    'nicegui', reason='needs requirements/panel.txt; run the tests with ./cnc test'
)
pytest.importorskip('websockets', reason='needs requirements/panel.txt')

from browser import found
from cnc_interp_msgs.msg import MachineState, SetupTable
from page_under_test import REFUSED, PanelUnderTest

from cnc_interp.nodes import qos
from cnc_interp.program import JobSetup

pytestmark = pytest.mark.skipif(
    found() is None, reason='needs a browser: apt-get install chromium'
)

#: Line 7 is executed three times; line 9 ends the program at X0 Y40 Z10.
PART = """(part)
G21 G90 G94 G54
TRAORI
G0 X0 Y0 Z10 A10 C0
G1 Z0 F1500
o100 repeat [3]
G91 G1 X10 F200
o100 endrepeat
G90 G1 X0 Y40 Z10 F1500
M30
"""
LINE, PASSES = 7, 3


@pytest.fixture(scope='module')
def running():
    panel = PanelUnderTest()
    panel.told = []
    panel.node.create_subscription(SetupTable, 'setup_table', panel.told.append, qos.LOADED)
    panel.spin_until(lambda: panel.told)
    yield panel
    panel.close()


@pytest.fixture
def panel(running):
    yield running
    running.tidy()


@pytest.fixture
def part(request, tmp_path):
    """A program with a name of its own, by which the page tells that it is loaded."""
    path = tmp_path / f'{request.node.name}.ngc'
    path.write_text(PART)
    return path


def choose(panel, tab, line, which, told):
    """Press a line of the text, name its pass, and choose it for the next start."""
    row = f'[...document.querySelectorAll(".lines li")][{line - 1}]'
    tab.wait(lambda: tab.run(f'!!{row} && ({row}.click(), true)'))
    field = 'document.querySelector("[data-mark=\'start line\']").value'
    tab.wait(lambda: tab.run(field) == str(line))
    if which:
        tab.fill('start pass', str(which))
    panel.press_key(tab, 'start here', lambda: told in tab.text('start'))


def test_the_task_list(panel, part):
    tab = panel.open_in_charge()
    panel.load(tab, part)

    def tip():
        return np.array([float(tab.text(f'tip {x}')) for x in 'xyz'])

    # Touch off: here is X 0, Y 0, Z 10 of G54.
    zero = tip() - (0.0, 0.0, 10.0)
    tab.click('offsets')
    for name, value in (('X', '0'), ('Y', '0'), ('Z', '10')):
        tab.fill(f'here {name}', value)
    tab.click('touch off')
    panel.spin_until(lambda: 'G54' in JobSetup.of_text(panel.told[-1].text).work_offsets)
    tab.wait(lambda: (tab.text('work X'), tab.text('work Z')) == ('0.000', '10.000'))
    tab.click('close setup')
    tab.wait(lambda: tab.text('status') == 'planned')

    # Jog by a step, then move by a line.
    before = np.array(panel.next_state().commanded_positions)
    tab.click('jog')
    tab.wait(lambda: tab.run('!!jog.pad()'))
    tab.run('[...document.querySelectorAll(`[data-mark="jog step"] button`)].at(-1).click()')
    tab.wait(lambda: tab.run('document.querySelector(".jog").dataset.step') == '10')
    panel.press_key(tab, 'jog Z+', lambda: panel.peers.state.positions[2] > before[2] + 9.99e-3)
    tab.wait(lambda: tab.text('state') == 'idle')
    tab.click('jog')
    tab.fill('mdi', 'G0 X5 Y-5')
    tab.type_key('Enter', 13)
    tab.wait(lambda: ': done' in tab.text('mdi answer') or tab.run(REFUSED))
    if tab.run(REFUSED):  # a busy computer interrupts the connection: then nothing was given
        tab.wait(lambda: not tab.run(REFUSED))
        tab.type_key('Enter', 13)
        tab.wait(lambda: ': done' in tab.text('mdi answer'))
    tab.wait(lambda: (tab.text('work X'), tab.text('work Y')) == ('5.000', '-5.000'))

    # Start at a line: the pass is asked for, the way is shown, and nothing moves before it is.
    stands = np.array(panel.next_state().commanded_positions)
    choose(panel, tab, LINE, 0, f'starts at line {LINE};')
    asked = f'executed {PASSES} times; choose pass 1 to {PASSES}'
    panel.press_key(tab, 'cycle start', lambda: asked in tab.text('start'))
    choose(panel, tab, LINE, 2, f'starts at line {LINE}, pass 2;')
    panel.press_key(tab, 'cycle start', lambda: 'plunge' in tab.text('start'))
    run = panel.loaded[-1]
    assert (run.start_line, run.start_pass) == (LINE, 2) and 0.0 < run.start_at < run.path_length
    assert f'start at line {LINE} (pass 2 of {PASSES})' in tab.text('start')
    assert tab.run('document.querySelector(".lines .start").textContent').startswith(f'{LINE}G91')
    waits = panel.next_state()
    assert waits.reason == MachineState.REASON_APPROACH
    assert np.abs(np.array(waits.commanded_positions) - stands).max() < 1e-9
    legs = {'1 retract', '2 position', '3 plunge'}
    shown = '[...document.querySelectorAll(".scene div")].map(label => label.textContent)'
    tab.wait(lambda: legs <= set(tab.run(shown)))
    panel.states.clear()
    panel.press_key(tab, 'cycle start', lambda: any(state.sequence for state in panel.states))
    on_path = [state.path_position for state in panel.states if state.sequence]
    assert min(on_path) >= run.start_at - 1e-9

    # Hold: the modal state is that of the line which is executed.
    tab.wait(lambda: not legs & set(tab.run(shown)) and tab.text('start') == '')
    tab.click('feed hold')
    panel.until(MachineState.HELD)
    tab.wait(lambda: {'executed:', 'G91', 'TRAORI', 'F200'} <= set(tab.text('modes').split()))

    # Jog away, return: cycle start leads back to the place of the hold, and goes on from there.
    panel.spin_until(lambda: panel.next_state().resting)
    held = panel.next_state()
    rests = np.array(held.commanded_positions)
    tab.click('jog')
    panel.press_key(tab, 'jog Z+', lambda: panel.peers.state.positions[2] > rests[2] + 9.99e-3)
    tab.wait(lambda: tab.text('state') == 'held')
    away = panel.next_state()
    assert np.abs(np.array(away.resume_positions) - rests).max() < 1e-9
    assert away.path_position == held.path_position
    tab.click('jog')
    tab.wait(lambda: legs <= set(tab.run(shown)))
    panel.states.clear()
    panel.go_on(tab)
    on_path = [state.path_position for state in panel.states if state.state == state.RUNNING]
    assert min(on_path) >= held.path_position - 1e-9 and not panel.peers.state.resume_positions
    panel.spin_until(lambda: panel.peers.state.completed)
    tab.wait(lambda: tab.text('progress') == '100.0%')
    tab.wait(lambda: np.abs(tip() - zero - (0.0, 40.0, 10.0)).max() < 2e-3)
    assert tab.faults == []


def test_the_choice_of_a_line_is_forgotten_with_its_program(panel, part):
    tab = panel.open_in_charge()
    panel.load(tab, part)
    choose(panel, tab, 9, 0, 'starts at line 9;')
    panel.press_key(tab, 'from the top', lambda: tab.text('start') == '')
    choose(panel, tab, 9, 0, 'starts at line 9;')
    tab.fill('start line', '99')
    refused = f'document.body.textContent.includes("{part.name} has 10 lines")'
    panel.press_key(tab, 'start here', lambda: tab.run(refused))
    other = part.with_name('other.ngc')
    other.write_text(PART)
    panel.load(tab, other)
    tab.wait(lambda: tab.text('start') == '')
    assert tab.run('document.querySelector("[data-mark=\'start line\']").value') == ''
    assert tab.run('document.querySelector(".lines .start")') is None
    # After a run that began at a line, the next one begins at the top.
    choose(panel, tab, 9, 0, 'starts at line 9;')
    panel.press_key(tab, 'cycle start', lambda: 'plunge' in tab.text('start'))
    panel.reset(tab)
    tab.wait(lambda: tab.text('start') == '')
    panel.begin(tab)
    assert panel.loaded[-1].start_line == 0
    assert tab.faults == []
