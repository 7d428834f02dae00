"""What must not mislead an operator: keys pressed by accident, units, rapids, who may stop."""

import re
import time

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from browser import IN_CONTACT
from cnc_interp_msgs.msg import MachineState

from cnc_interp.page.contact import NO_TOKEN, WRONG_TOKEN
from cnc_interp.page.hand_motion import EARLY, FILLS
from cnc_interp.program.job import Tool

LONG = 'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A0 C0\n' + 'G1 X30 F300\nG1 X0\n' * 200 + 'M30\n'
FOCUS = 'document.activeElement?.closest("[data-mark]")?.dataset.mark ?? ""'
LATE = 0.5  #: Longest delay of a beat [s].


def here(panel):
    """Where the axes rest; on a busy computer, beats of a key come after it was let go."""
    before = None
    while True:
        panel.until(MachineState.IDLE)
        now = np.array(panel.next_state().commanded_positions)
        if np.array_equal(now, before):
            return now
        before = now
        panel.spin_for(LATE)


def hold_key(tab, name, seconds, device='mouse'):
    """Hold a key with a pointer for a time [s]."""
    at = tab.centre(name)
    if device == 'mouse':
        tab.pointer('move', *at)
    tab.pointer('press', *at, device)
    time.sleep(seconds)
    tab.pointer('release', *at, device)


def zero_of_x(panel):
    return panel.setup.work_offsets.get('G54', {}).get('X')


@pytest.mark.thorough
def test_no_key_of_the_keyboard_changes_an_offset_and_a_zero_is_undone(panel):
    tab = panel.open_in_charge()
    tab.wait(lambda: tab.text('work X') not in (None, '–') and tab.text('state') == 'idle')
    before, stood = zero_of_x(panel), here(panel)[0]
    tab.click_with_mouse('zero X')
    panel.spin_until(lambda: zero_of_x(panel) == pytest.approx(stood, abs=1e-7))
    # The old and the new value, with their unit.
    told = f'→ {1e3 * stood:z.3f} mm'
    tab.wait(
        lambda: (
            tab.text('offset change').startswith('G54 X ') and told in tab.text('offset change')
        )
    )
    # The axis moves on by an arrow key; then space and Enter, which used to press 0 once more.
    tab.click_with_mouse('jog')
    tab.wait(lambda: tab.run('!!jog.pad()'))
    for kind in ('keyDown', 'keyUp'):
        tab.send('Input.dispatchKeyEvent', type=kind, key='ArrowRight', windowsVirtualKeyCode=39)
        if kind == 'keyDown':
            panel.spin_until(lambda: panel.peers.state.positions[0] > stood + 1e-3)
    moved, tables = here(panel), len(panel.told)
    for key in (' ', 'Enter'):
        tab.type_key(key)
    # Nor where its key has the focus by the keyboard.
    tab.wait(lambda: tab.type_key('Tab') or tab.run(FOCUS) == 'zero X')
    for key in (' ', 'Enter'):
        tab.type_key(key)
    tab.wait(lambda: tab.run('contact.connected()'))
    time.sleep(1.0)
    assert (here(panel) == moved).all() and len(panel.told) == tables
    tab.click_with_mouse('undo offset')
    panel.spin_until(lambda: zero_of_x(panel) == before)
    tab.wait(lambda: tab.text('offset change').startswith(f'G54 X {1e3 * stood:z.3f} → '))
    tab.click_with_mouse('jog')


def write(tab, name, text):
    """Type into a field key by key, as its user does."""
    tab.click_with_mouse(name)
    for character in text:
        tab.type_key(character)


def test_what_is_typed_keeps_its_length_when_the_unit_changes(panel):
    tab = panel.open_in_charge()
    tab.wait(lambda: tab.text('work Z') not in (None, '–') and tab.text('state') == 'idle')
    tab.click_with_mouse('show touch off')
    write(tab, 'here Z', '12.5')
    write(tab, 'here A', '12.5')
    write(tab, 'here X', '1..')
    unit = 'document.querySelector(`[data-mark="here Z"]`).closest(".q-field").textContent'
    assert 'mm' in tab.run(unit)
    tab.click_with_mouse('inch')
    tab.wait(lambda: tab.value('here X') == '' and 'in' in tab.run(unit))
    assert float(tab.value('here Z')) == pytest.approx(12.5 / 25.4, abs=1e-6)
    assert float(tab.value('here A')) == 12.5
    tab.click_with_mouse('touch off')
    tab.wait(lambda: tab.text('work Z') == f'{12.5 / 25.4:.4f}')
    tab.wait(lambda: ' in' in tab.text('offset change'))
    tab.click_with_mouse('inch')
    tab.wait(lambda: tab.text('work Z') == '12.500' and ' mm' in tab.text('offset change'))
    tab.click_with_mouse('undo offset')
    tab.click_with_mouse('show touch off')


@pytest.mark.parametrize('phone', [False, True])
@pytest.mark.thorough
def test_a_rapid_to_zero_begins_only_after_its_key_was_held(panel, phone):
    device = 'touch' if phone else 'mouse'
    size = (390, 844, True) if phone else (1366, 768)
    tab = panel.open_in_charge(**dict(zip(('width', 'height', 'mobile'), size, strict=False)))
    tab.wait(lambda: tab.text('work X') not in (None, '–') and tab.text('state') == 'idle')
    tab.click_with_mouse('zero X')
    tab.wait(lambda: tab.text('work X') == '0.000')
    panel.give(tab, 'G90 G1 X3 F2000')
    tab.wait(lambda: tab.text('work X') == '3.000' and tab.text('state') == 'idle')
    before = here(panel)
    tab.run('document.querySelector(`[data-mark="pose"]`).scrollIntoView({block: "center"})')
    tab.click_with_mouse('pose')
    tab.centre('go to zero X')
    boxes = tab.run(
        'Object.fromEntries([...document.querySelectorAll(`[data-mark^="go to zero"]`)].map('
        'key => [key.dataset.mark.at(-1), key.getBoundingClientRect().toJSON()]))'
    )
    assert all(min(box['width'], box['height']) >= 44 for box in boxes.values())
    others = [box['right'] for name, box in boxes.items() if name != 'Z']
    assert boxes['Z']['left'] - max(others) > 40
    hold_key(tab, 'go to zero X', 0.0, device)
    tab.wait(lambda: tab.shows(EARLY))
    time.sleep(FILLS + 0.5)
    assert (here(panel) == before).all()
    hold_key(tab, 'go to zero X', 2 * FILLS, device)
    tab.wait(lambda: tab.text('work X') == '0.000' and tab.text('state') == 'idle')
    assert here(panel) - before == pytest.approx([-3e-3, 0, 0, 0, 0], abs=1e-9)
    panel.give(tab, 'G90')


@pytest.mark.thorough
def test_a_page_that_looks_may_hold_and_a_wrong_token_gets_a_reason(panel, tmp_path):
    program = tmp_path / 'looked_at.ngc'
    program.write_text(LONG)
    first = panel.open_in_charge()
    panel.load(first, program)
    viewer = panel.open()
    assert (viewer.text('rights'), viewer.text('refused')) == ('view only', '')
    first.show()
    panel.begin(first)
    viewer.show()
    viewer.wait(lambda: viewer.run(IN_CONTACT))
    viewer.click_with_mouse('feed hold')
    panel.until(MachineState.HELD)
    stranger = panel.open('wrong')
    stranger.show()
    stranger.wait(lambda: stranger.text('refused') == WRONG_TOKEN)
    stranger.click_with_mouse('take over')
    stranger.wait(lambda: stranger.text('refused') == WRONG_TOKEN)
    guest = panel.open('')
    guest.show()
    guest.ask('take over', NO_TOKEN)
    first.show()
    panel.reset(first)


@pytest.mark.thorough
def test_m6_without_a_tool_changer_waits_and_names_the_tool(panel, tmp_path):
    program = tmp_path / 'two_tools.ngc'
    program.write_text('G21 G90\nG0 X1 Y0 Z50\nG1 X5 F2000\nT5 M6\nG43 H5\nG1 X8 Z50\nM30\n')
    tab = panel.open_in_charge(width=1500, height=900)
    panel.load(tab, program)
    stood = here(panel)
    # A length that nobody knows is no length of zero.
    tab.wait(lambda: 'WARNING' in tab.run('document.querySelector(".alarms").textContent'))
    tab.click_with_mouse('cycle start')
    tab.wait(lambda: tab.shows('has no length of this tool'))
    assert (here(panel) == stood).all()
    tab.click_with_mouse('offsets')
    fields = {'number': '5', 'length': '75.5', 'flute': '20', 'pocket': '12', 'remark': 'ball'}
    for name, text in fields.items():
        write(tab, f'new tool {name}', text)
    tab.click_with_mouse('set new tool')
    panel.spin_until(lambda: 5 in panel.setup.tools)
    tab.wait(lambda: 'tool 5: not set -> length 75.5' in (tab.text('setup change') or ''))
    write(tab, 'tool 5 holder', 'slim')
    tab.click_with_mouse('set tool 5')
    tab.wait(lambda: 'holder slim' in (tab.text('setup change') or ''))
    made = Tool(0.0755, remark='ball', pocket=12, holder='slim', flute=0.02)
    panel.spin_until(lambda: panel.setup.tools[5] == made)
    tab.click_with_mouse('close setup')
    tab.wait(lambda: tab.text('status') == 'planned')
    tab.click_with_mouse('cycle start')
    wanted = 'put tool 5 into the spindle: ball, length 75.500 mm, pocket 12'
    tab.wait(lambda: wanted in tab.text('why') and wanted in tab.text('start'))
    assert tab.text('state') == 'held' and panel.setup.tool == 0
    # It rests at the end of the line, and waits for as long as nobody confirms.
    stands = panel.next_state().commanded_positions
    assert tab.text('work X') == '5.000'
    time.sleep(1.5)
    assert panel.next_state().commanded_positions == stands and panel.setup.tool == 0
    tab.click_with_mouse('cycle start')
    panel.spin_until(lambda: panel.peers.state.completed)
    panel.spin_until(lambda: panel.setup.tool == 5)
    assert here(panel)[0] - stands[0] == pytest.approx(3e-3, abs=1e-9)
    # The tool is there now: nothing to confirm.
    tab.wait(lambda: tab.text('status') == 'planned' and tab.text('start') == '')
    runs = len(panel.loaded)
    tab.click_with_mouse('cycle start')
    panel.spin_until(
        lambda: (
            len(panel.loaded) > runs
            and panel.peers.state.program_id == panel.loaded[-1].program_id
            and panel.peers.state.completed
        )
    )
    tab.wait(lambda: tab.text('state') == 'idle')
    tab.click_with_mouse('offsets')
    tab.click_with_mouse('load tool 0')
    tab.wait(lambda: 'tool 5 -> no tool' in (tab.text('setup change') or ''))
    tab.click_with_mouse('remove tool 5')
    tab.wait(lambda: '-> not set' in (tab.text('setup change') or ''))
    tab.click_with_mouse('close setup')


SQUARE = ((20, 0), (20, 20), (0, 20), (0, 0))  #: Corners, each the end of a line [mm].


def rests_at(tab):
    """How far the page says that the tool rests from the end of a line [mm], and of which line."""
    found = re.search(r'rests (?:([\d.]+) mm beside|at) the end of line (\d+)', tab.text('why'))
    return (float(found[1] or 0.0), int(found[2])) if found else (None, None)


@pytest.mark.parametrize('in_motion', [False, True])
@pytest.mark.thorough
def test_single_block_says_where_the_tool_rests(panel, tmp_path, in_motion):
    lines = [f'G1 X{x} Y{y} F1500' for x, y in SQUARE] * 5
    program = tmp_path / 'corner.ngc'
    program.write_text('\n'.join(['G21 G90 G64 P0.05', 'G0 X0 Y0 Z10', *lines, 'M30', '']))
    tab = panel.open_in_charge(width=1500, height=900)
    panel.load(tab, program)
    if in_motion:
        panel.begin(tab)
    tab.click_with_mouse('single block')
    panel.spin_until(lambda: panel.peers.state.single_block)
    rounded, seen = [], [None]
    for _ in range(3):
        if not in_motion:
            tab.click_with_mouse('cycle start')
        tab.wait(lambda: rests_at(tab)[1] not in seen)
        beside, line = rests_at(tab)
        seen.append(line)
        state = panel.next_state()
        assert state.reason == MachineState.REASON_SINGLE_BLOCK and state.resting
        end = SQUARE[(state.line_number - 3) % 4]
        off = np.linalg.norm(1e3 * np.array(state.program_positions[:2]) - end)
        assert line == state.line_number and abs(beside - off) < 0.002
        rounded.append(off > 0.01)
        if in_motion:
            tab.click_with_mouse('cycle start')
            panel.spin_until(lambda: not panel.peers.state.resting)
    # A corner was rounded before the key was pressed, or the line has an exact stop.
    assert any(rounded) == in_motion
    tab.click_with_mouse('single block')
    if panel.next_state().state != MachineState.HELD:
        tab.click_with_mouse('feed hold')
        panel.until(MachineState.HELD)
    panel.reset(tab)
