"""An operator's tasks on the page: load, touch off, jog, MDI, start at a line, hold, finish."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from browser import IN_CONTACT, Tab
from cnc_interp_msgs.msg import MachineState
from std_msgs.msg import Float64
from tiers import examples, few_of

from cnc_interp import page
from cnc_interp.client.hand_move import pose_request
from cnc_interp.machine.jog import LATE
from cnc_interp.machine_model.machine import Machine
from cnc_interp.nodes import qos
from cnc_interp.page.contact import AGAIN, INTERRUPTED, VIEW_ONLY
from cnc_interp.page.hand_motion import LOST, STALE, numbers
from cnc_interp.page.scene import FACES, SIDES

#: Line 7 is executed three times; line 9 ends the program at X0 Y40 Z10.
PART = """(part)
G21 G90 G94 G54 T1 M6
TRAORI
G0 X0 Y0 Z10 A10 C0
G1 Z0 F1500
o100 repeat [3]
G91 G1 X10 F100
o100 endrepeat
G90 G1 X0 Y40 Z10 F1500
M30
"""
LINE, PASSES = 7, 3


@pytest.fixture
def part(request, tmp_path):
    """A program with a name of its own, by which the page tells that it is loaded."""
    path = tmp_path / f'{request.node.name[-40:]}.ngc'  # Longer names lose their beginning.
    path.write_text(PART)
    return path


def choose(panel, tab, line, which, told):
    """Press a line of the text, name its pass, and choose it for the next start."""
    row = f'[...document.querySelectorAll(".lines li")][{line - 1}]'
    tab.wait(lambda: tab.run(f'!!{row} && ({row}.click(), true)'))
    tab.wait(lambda: tab.value('start line') == str(line))
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
    tab.click('show touch off')
    for name, value in (('X', '0'), ('Y', '0'), ('Z', '10')):
        tab.fill(f'here {name}', value)
    tab.click('touch off')
    panel.spin_until(lambda: 'G54' in panel.setup.work_offsets)
    tab.wait(lambda: (tab.text('work X'), tab.text('work Z')) == ('0.000', '10.000'))
    tab.click('show touch off')
    tab.wait(lambda: tab.text('status') == 'planned')

    # Jog by a step, then move by a line.
    before = np.array(panel.next_state().commanded_positions)
    tab.click('jog')
    tab.wait(lambda: tab.run('!!jog.pad()'))
    tab.run('[...document.querySelectorAll(`[data-mark="jog step"] button`)].at(-2).click()')
    tab.wait(lambda: tab.run('document.querySelector(".jog").dataset.step') == '1')
    panel.press_key(tab, 'jog Z+', lambda: panel.peers.state.positions[2] > before[2] + 0.99e-3)
    tab.wait(lambda: tab.text('state') == 'idle')
    tab.click('jog')
    panel.give(tab, 'G0 X5 Y-5')
    tab.wait(lambda: (tab.text('work X'), tab.text('work Y')) == ('5.000', '-5.000'))

    # Start at a line: the pass is asked for, the way is shown, and nothing moves before it is.
    stands = np.array(panel.next_state().commanded_positions)
    choose(panel, tab, LINE, 0, f'starts at line {LINE};')
    asked = f'executed {PASSES} times; choose pass 1 to {PASSES}'
    panel.press_key(tab, 'cycle start', lambda: asked in tab.text('start'))
    choose(panel, tab, LINE, 2, f'starts at line {LINE}, pass 2;')
    panel.press_key(tab, 'cycle start', lambda: 'plunge' in tab.text('start'))
    panel.spin_until(lambda: panel.loaded[-1].start_line == LINE)  # the page may hear it first
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
    panel.set_override.publish(Float64(data=0.2))  # so that a slow browser can hold it
    panel.spin_until(lambda: panel.override == 0.2)
    panel.states.clear()
    panel.press_key(tab, 'cycle start', lambda: any(state.sequence for state in panel.states))
    on_path = [state.path_position for state in panel.states if state.sequence]
    assert min(on_path) >= run.start_at - 1e-9

    # Hold: the modal state is that of the line which is executed.
    tab.wait(lambda: not legs & set(tab.run(shown)) and tab.text('start') == '')
    tab.click('feed hold')
    panel.until(MachineState.HELD)
    tab.wait(lambda: {'executed:', 'G91', 'TRAORI', 'F100'} <= set(tab.text('modes').split()))

    # Jog away, return: cycle start leads back to the place of the hold, and goes on from there.
    panel.spin_until(lambda: panel.next_state().resting)
    panel.set_override.publish(Float64(data=1.0))
    panel.spin_until(lambda: panel.override == 1.0)
    held = panel.next_state()
    rests = np.array(held.commanded_positions)
    tab.click('jog')
    panel.press_key(tab, 'jog Z+', lambda: panel.peers.state.positions[2] > rests[2] + 0.99e-3)
    tab.wait(lambda: tab.text('state') == 'held')
    away = panel.next_state()
    assert np.abs(np.array(away.resume_positions) - rests).max() < 1e-9
    assert away.path_position == held.path_position
    # The tool that the program took is in the table; the page shows the run all the same.
    assert panel.setup.tool == 1
    assert (tab.text('line'), tab.text('status')) == (str(held.line_number), 'planned')
    tab.click('jog')
    tab.wait(lambda: legs <= set(tab.run(shown)))
    panel.states.clear()
    panel.go_on(tab)
    seen = [panel.peers.state, *panel.states]
    assert min(state.path_position for state in seen) >= held.path_position - 1e-9
    assert {state.program_id for state in seen} == {held.program_id}
    assert len(panel.peers.state.resume_positions) == 0
    panel.spin_until(lambda: panel.peers.state.completed)
    tab.wait(lambda: tab.text('progress') == '100.0%')
    tab.wait(lambda: np.abs(tip() - zero - (0.0, 40.0, 10.0)).max() < 2e-3)


DEVICES = ('mouse', 1366, 768), ('pen', 1366, 768), ('touch', 390, 844)


@pytest.fixture
def pad(request, panel):
    """A page with its jog keys shown, on a screen of one size, and the pointer of its user."""
    device, width, height = request.param
    tab = panel.open_in_charge(width=width, height=height, mobile=device == 'touch')
    tab.wait(lambda: tab.text('state') == 'idle')
    tab.click('jog')
    tab.wait(lambda: tab.run('!!jog.pad()'))
    tab.run(COUNT_BEATS)
    return tab, device


def moves(panel, tab, device, done=None):
    """
    Press a key with a real pointer, and see its axis move on, or what is asked, while it is held.

    A busy computer may interrupt the contact. Then the page must say so, and let the key go.
    """
    while True:
        tab.wait(lambda: tab.run(IN_CONTACT) and not tab.shows(INTERRUPTED))
        x, y = tab.centre('jog X+')
        start = panel.next_state().positions[0]
        if device != 'touch':
            tab.pointer('move', x, y, device)
        tab.pointer('press', x, y, device)
        moved = done or (lambda start=start: panel.peers.state.positions[0] > start + 1e-3)
        panel.spin_until(lambda moved=moved: moved() or tab.shows(INTERRUPTED))
        if not tab.shows(INTERRUPTED):
            return x, y
        tab.pointer('release', x, y, device)
        rests(panel, tab)


#: Counts the beats that the page sends so that an axis moves, and keeps what it tells its user.
COUNT_BEATS = """
window.told = []; const tell = Quasar.Notify.create;
Quasar.Notify.create = (what) => { told.push(what.message); return tell(what); };
window.beats = 0; const emit = window.emitEvent;
window.emitEvent = (name, ...words) => {
  window.beats += name === 'jog' && !!words[0].name;
  emit(name, ...words);
}; 0
"""


def rests(panel, tab, served=True):
    """
    See the axes come to rest and stay there.

    The page sends no beat any more, and where it is served, all that it had sent were heard.
    """
    tab.wait(lambda: tab.run('!jog.timer'))
    beats, heard = tab.run('[window.beats, contact.beat]')
    if served:
        tab.wait(lambda: tab.run(f'contact.beat - contact.before / 1000 > {heard}'))
    panel.until(MachineState.IDLE)
    before = np.array(panel.next_state().commanded_positions)
    for _ in range(4):  # a second: at rest states are told rarely
        state = panel.next_state()
        assert state.state == MachineState.IDLE
        assert (np.array(state.commanded_positions) == before).all()
    assert tab.run('window.beats') == beats


@pytest.mark.parametrize('pad', few_of(3, DEVICES), indirect=True)
@pytest.mark.thorough
def test_an_axis_moves_exactly_while_a_real_pointer_holds_its_key(panel, pad):
    tab, device = pad
    x, y = moves(panel, tab, device)
    tab.pointer('release', x, y, device)
    rests(panel, tab)
    # The pointer slides off the key, and comes back: only a new press moves.
    x, y = moves(panel, tab, device)
    tab.pointer('move', x, y - 150, device)
    rests(panel, tab)
    tab.pointer('move', x, y, device)
    rests(panel, tab)
    tab.pointer('release', x, y, device)
    if device == 'touch':  # a call comes in
        x, y = moves(panel, tab, device)
        tab.pointer('cancel', x, y, device)
        rests(panel, tab)


@pytest.mark.thorough
@pytest.mark.parametrize('pad', DEVICES, indirect=True)
def test_a_held_key_ends_with_its_window_and_with_the_contact(panel, pad):
    tab, device = pad
    other = panel.open()
    tab.show()
    x, y = moves(panel, tab, device)
    other.show()
    rests(panel, tab)
    tab.show()
    rests(panel, tab)
    tab.wait(lambda: {LOST, AGAIN} & set(tab.run('told')))
    tab.pointer('release', x, y, device)
    tab.wait(lambda: tab.run(IN_CONTACT))
    x, y = moves(panel, tab, device)
    os.kill(panel.page.process.pid, signal.SIGSTOP)
    rests(panel, tab, served=False)
    time.sleep(STALE)
    os.kill(panel.page.process.pid, signal.SIGCONT)
    tab.wait(lambda: tab.run(IN_CONTACT))
    rests(panel, tab)
    assert AGAIN in tab.run('told')
    tab.pointer('release', x, y, device)
    other.click('take over')
    tab.wait(lambda: tab.text('rights') == 'view only')
    tab.pointer('press', *tab.centre('jog X+'), device)
    tab.wait(lambda: VIEW_ONLY in tab.run('told'))
    tab.pointer('release', x, y, device)
    rests(panel, tab)


BUSY_AT_THE_PRESS = """
window.addEventListener('pointerdown', () => {
  const end = Date.now() + 1500;
  while (Date.now() < end);
}, { capture: true, once: true });
"""


@pytest.mark.thorough
@pytest.mark.parametrize('pad', DEVICES[:1], indirect=True)
def test_what_delays_or_ends_the_motion_of_a_held_key_is_told(panel, pad):
    tab, device = pad
    x, y = moves(panel, tab, device)
    os.kill(panel.page.process.pid, signal.SIGSTOP)
    time.sleep(2 * LATE)
    os.kill(panel.page.process.pid, signal.SIGCONT)
    tab.wait(lambda: 'the axes stopped: no message of the held key' in str(tab.run('told')))
    tab.pointer('release', x, y, device)
    rests(panel, tab)
    # The page is busy from the press on.
    x, y = tab.centre('jog X+')
    tab.run(BUSY_AT_THE_PRESS)
    tab.pointer('press', x, y, device)
    tab.pointer('release', x, y, device)
    told = 'this page is busy: the key moves'
    tab.wait(lambda: told in str(tab.run('told')))
    rests(panel, tab)


#: The keys that open a dialog; one for each dialog that the page has.
DIALOGS = 'keyboard', 'settings', 'offsets', 'history messages', 'programs', 'edit', 'times'
OPEN = '[...document.querySelectorAll(".q-dialog__inner > *")].some(d => d.checkVisibility())'


@pytest.mark.parametrize('size', few_of(2, [(390, 844, True), (1366, 768)]))
def test_the_stops_are_pressed_with_any_dialog_open(panel, size):
    texts = [file.read_text() for file in Path(page.__file__).parent.glob('*.py')]
    # Those of the probing cycles and of macros are on pages of some machines only.
    assert sum(text.count('ui.dialog(') for text in texts) == len(DIALOGS) + 2
    tab = panel.open_in_charge()
    tab.size(*size)
    tab.wait(lambda: tab.text('state') == 'idle')
    for key in DIALOGS[: examples(1, len(DIALOGS))]:
        tab.click(key)
        tab.wait(lambda: tab.run(OPEN))
        tab.click_with_mouse('feed hold')
        tab.wait(lambda: tab.shows('nothing to hold'))
        tab.click_with_mouse('EMERGENCY STOP')
        panel.until(MachineState.FAULT)
        assert tab.run(OPEN)  # the press went to the key alone
        tab.type_key('Escape')
        tab.wait(lambda: not tab.run(OPEN))
        panel.reset(tab)


def lit(tab, key):
    return tab.run(f'document.querySelector(`[data-mark="{key}"]`).ariaPressed') == 'true'


@pytest.mark.thorough
def test_rapid_and_spindle_override_by_key_and_keyboard(panel):
    tab = panel.open_in_charge()
    tab.wait(lambda: lit(tab, 'rapid 100%'))
    panel.press_key(tab, 'rapid 25%', lambda: panel.peers.state.rapid_override == 0.25)
    tab.wait(lambda: lit(tab, 'rapid 25%') and not lit(tab, 'rapid 100%'))
    by_others = panel.node.create_publisher(Float64, 'rapid_override', qos.OVERRIDE)

    def set_by_others():
        by_others.publish(Float64(data=0.4))
        return panel.peers.state.rapid_override == 0.4

    panel.spin_until(set_by_others)
    tab.wait(lambda: tab.text('rapids') == 'rapids 40%' and not lit(tab, 'rapid 25%'))
    panel.press_key(tab, '9', lambda: panel.peers.state.rapid_override == 1.0, Tab.type_key)
    tab.wait(lambda: tab.text('rapids') == 'rapids' and lit(tab, 'rapid 100%'))
    panel.press_key(tab, 'spindle faster', lambda: panel.peers.state.spindle_override == 1.05)
    tab.wait(lambda: tab.text('spindle override') == 'spindle 105%')
    panel.press_key(tab, 'spindle 100%', lambda: panel.peers.state.spindle_override == 1.0)
    assert panel.peers.state.feed_override == 1.0


@pytest.mark.thorough
def test_block_delete_leaves_lines_with_a_slash_out(panel, part):
    part.write_text(PART.replace('G90 G1 X0 Y40', '/G1 Y200\nG90 G1 X0 Y40'))
    tab = panel.open_in_charge()
    panel.load(tab, part)
    long = tab.text('left')
    tab.click('block delete')
    tab.wait(lambda: lit(tab, 'block delete') and tab.text('status') == 'planned')
    tab.wait(lambda: tab.text('left') < long)
    panel.begin(tab)
    chosen = {pair.key: pair.value for pair in panel.loaded[-1].settings}
    assert chosen['skip_blocks'] == 'true' and panel.loaded[-1].path_length < 0.15
    tab.click('EMERGENCY STOP')
    panel.until(MachineState.FAULT)
    panel.reset(tab)
    tab.type_key('b')
    tab.wait(lambda: not lit(tab, 'block delete'))


def show_pose(panel, tab):
    """Show the fields of a pose, filled with where the tool is; returns the machine's state."""
    tab.wait(lambda: tab.text('state') == 'idle')
    before = panel.next_state()
    tab.type_key('p')
    tab.wait(lambda: tab.run('!!document.querySelector(".pose").offsetParent'))
    tab.click('here')
    tab.wait(lambda: tab.value('pose K') != '')
    return before


@pytest.mark.thorough
def test_the_tool_goes_to_a_pose(panel):
    tab = panel.open_in_charge()
    before = show_pose(panel, tab)
    tab.fill('pose Z', f'{1e3 * before.tip[2] + 4:.3f}')
    way = 'document.querySelector(`[data-mark="go there"]`)'
    assert tab.run(f'{way}.matches(".moves")')  # neither space nor Enter presses it
    goal = before.tip[2] + 4e-3
    panel.press_key(tab, 'go there', lambda: abs(panel.peers.state.tip[2] - goal) < 1e-5)
    after = panel.next_state()
    assert after.tip == pytest.approx([*before.tip[:2], goal], abs=1e-5)
    assert after.axis == pytest.approx(before.axis, abs=1e-5)


@pytest.mark.thorough
def test_a_key_acts_on_what_is_shown_where_the_typing_was_lost_on_its_way(panel):
    tab = panel.open_in_charge()
    before = show_pose(panel, tab)
    tab.run('void (window.socket.emit = () => {})')
    tab.fill('pose Z', f'{1e3 * before.tip[2] - 3:.3f}')
    tab.fill('mdi', 'G1 G91 X1 F600')
    tab.run('void delete window.socket.emit')
    goal = before.tip[2] - 3e-3
    panel.press_key(tab, 'go there', lambda: abs(panel.peers.state.tip[2] - goal) < 1e-5)
    panel.until(MachineState.IDLE)
    tab.wait(lambda: tab.text('state') == 'idle')
    x = panel.next_state().tip[0] + 1e-3
    tab.type_key('Enter')
    tab.wait(lambda: 'done' in tab.text('mdi answer'))
    panel.spin_until(lambda: abs(panel.peers.state.tip[0] - x) < 1e-5)


def test_a_page_that_looks_only_changes_nothing(panel):
    tab = panel.open(token='wrong')
    before = panel.setup
    tab.click('offsets')
    tab.fill('G54 X', '5')
    tab.click('set G54')
    tab.wait(lambda: tab.run('!!document.querySelector(".q-notification")'))
    assert panel.setup == before


def test_the_request_of_a_pose_keeps_what_is_not_named():
    request = pose_request(numbers({'X': '', 'Z': '12,5', 'I': None, 'K': ' '}), 0.2)
    assert np.array_equal(request.tip, [np.nan, np.nan, 0.0125], equal_nan=True)
    assert (list(request.axis), request.speed) == ([], 0.2)
    assert list(pose_request({'I': 1.0, 'K': 1.0}, 1.0).axis) == [1.0, 0.0, 1.0]
    for texts in ({'X': ''}, {'X': 'nan'}, {'X': 'high'}):
        with pytest.raises(ValueError, match=r'.'):
            numbers(texts)


@pytest.mark.thorough
def test_the_choice_of_a_line_is_forgotten_with_its_program(panel, part):
    tab = panel.open_in_charge()
    panel.load(tab, part)
    choose(panel, tab, 9, 0, 'starts at line 9;')
    panel.press_key(tab, 'from the top', lambda: tab.text('start') == '')
    choose(panel, tab, 9, 0, 'starts at line 9;')
    tab.fill('start line', '99')
    panel.press_key(tab, 'start here', lambda: tab.shows(f'{part.name} has 10 lines'))
    other = part.with_name('other.ngc')
    other.write_text(PART)
    panel.load(tab, other)
    tab.wait(lambda: tab.text('start') == '')
    assert tab.value('start line') == ''
    assert tab.run('document.querySelector(".lines .start")') is None
    # After a run that began at a line, the next one begins at the top.
    choose(panel, tab, 9, 0, 'starts at line 9;')
    panel.press_key(tab, 'cycle start', lambda: 'plunge' in tab.text('start'))
    panel.reset(tab)
    tab.wait(lambda: tab.text('start') == '' and tab.value('start line') == '')
    panel.begin(tab)
    assert panel.loaded[-1].start_line == 0


@pytest.mark.thorough
def test_all_refused_lines_are_marked_and_go_with_their_program(panel, part):
    tab = panel.open_in_charge()
    panel.load(tab, part)
    bad = part.with_name('bad.ngc')
    bad.write_text('G21 G90 G94\nTRAORI\nGO X0\nG0 X30,5\nG1 X10 F500\nG1 X10 Y@\nM30\n')
    tab.choose_file('input[type=file]', bad)
    tab.wait(lambda: 'and 2 more' in tab.text('status'))
    rows = '[...document.querySelectorAll(".lines .wrong i")].map(row => row.textContent)'
    tab.wait(lambda: tab.run(rows) == ['3', '4', '6'])
    told = '[...document.querySelectorAll(".alarms .error")].map(one => one.textContent)'
    told += '.filter(text => text.includes("bad.ngc"))'  # the machine's own errors stay
    tab.wait(lambda: len(tab.run(told)) == 3)
    for line in (3, 4, 6):
        assert f'bad.ngc:{line}:' in ''.join(tab.run(told))
    assert tab.text('scale') == 'no path: the program was refused'
    tab.click_with_mouse('check')
    tab.wait(
        lambda: tab.run('(document.querySelector(".q-notification")?.textContent ?? "")').count(
            'GO:'
        )
    )
    panel.load(tab, part)
    tab.wait(lambda: tab.run(told) == [] and tab.run(rows) == [])
    assert tab.text('scale').endswith('planned feed')


@pytest.mark.thorough
def test_lines_are_found_by_text_and_picked_in_the_view(panel, part):
    tab = panel.open_in_charge()
    panel.load(tab, part)
    tab.fill('find', 'y40')
    tab.type_key('Enter')
    tab.wait(lambda: tab.value('start line') == '9')
    # The end of the path, where the browser shows it: the last vertex of the tube.
    place = """(() => {
      const view = getElement(Number(document.querySelector('.scene').id.slice(1)));
      const canvas = view.renderer.domElement.getBoundingClientRect();
      let at = null;
      for (const object of view.objects.values()) object.mesh?.traverse?.((part) => {
        if (!part.isMesh || !part.geometry.attributes.color) return;
        const vertices = part.geometry.attributes.position;
        const place = part.position.clone().fromBufferAttribute(vertices, vertices.count - 1);
        place.applyMatrix4(part.matrixWorld).project(view.camera);
        at = [canvas.left + (0.5 + place.x / 2) * canvas.width,
              canvas.top + (0.5 - place.y / 2) * canvas.height];
      });
      return at;
    })()"""
    tab.wait(lambda: tab.run(place))
    tab.run('void listing.choose(1)')
    tab.wait(lambda: tab.value('start line') == '1')

    def picked():
        at = tab.run(place)
        for kind in ('move', 'press', 'release'):
            tab.pointer(kind, *at)
        return tab.value('start line') == '9'

    tab.wait(picked)
    assert tab.run('document.querySelector(".lines .picked i").textContent') == '9'


TUBE = """(() => {
  const view = getElement(Number(document.querySelector('.scene').id.slice(1)));
  let found = null;
  for (const object of view.objects.values()) object.mesh?.traverse?.((part) => {
    if (!part.isMesh || !part.geometry.attributes.color) return;
    const { position, normal, color } = part.geometry.attributes;
    found = [position, normal, color, part.geometry.index].map((one) => [...one.array]);
  });
  return found;
})()"""


@pytest.mark.thorough
def test_the_path_is_drawn_as_a_tube_around_its_points(panel, part):
    tab = panel.open_in_charge()
    panel.load(tab, part)
    tab.wait(lambda: tab.run(TUBE))
    vertices, normals, colours, corners = map(np.array, tab.run(TUBE))
    vertices, normals = (each.reshape(-1, SIDES, 3) for each in (vertices, normals))
    middle = vertices.mean(axis=1)
    out = vertices - middle[:, None]
    radius = np.linalg.norm(out, axis=2)
    assert len(middle) > 5 and radius == pytest.approx(radius[0, 0], rel=1e-3)
    assert np.abs(normals - out / radius[..., None]).max() < 1e-3
    assert (colours.reshape(-1, SIDES, 4)[..., 3] == 255).all()
    faces = vertices.reshape(-1, 3)[corners.reshape(-1, 3)]
    assert len(faces) == FACES * (len(middle) - 1)
    across = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    outward = normals.reshape(-1, 3)[corners.reshape(-1, 3)].sum(axis=1)
    # In a rounded corner that is smaller than the tube, its inner side folds.
    straight = np.linalg.norm(np.diff(middle, axis=0), axis=1) > 4.0 * radius[0, 0]
    assert straight.any()
    outside = np.einsum('ij,ij->i', across, outward).reshape(-1, FACES) > 0.0
    assert outside[straight].all()


#: Where the triad of the view stands, in the workpiece [m]: the group that holds the label X.
TRIAD = """(() => {
  const view = getElement(Number(document.querySelector('.scene').id.slice(1)));
  const objects = [...view.objects.values()];
  const label = objects.find(one => one.mesh?.element?.textContent === 'X')?.mesh;
  return label && label.parent.position.toArray();
})()"""


@pytest.mark.thorough
def test_a_coordinate_is_set_to_zero_and_gone_to(panel, part):
    tab = panel.open_in_charge()
    panel.load(tab, part)
    stands = np.array(panel.next_state().commanded_positions[:3])
    tab.click_with_mouse('zero Z')
    tab.wait(lambda: tab.text('work Z') == '0.000')
    # The triad stands there, seen from the zero of the workpiece.
    height = stands[2] - panel.told[-1].zero[2]
    tab.wait(lambda: abs((tab.run(TRIAD) or [0, 0, np.inf])[2] - height) < 1e-5)
    before = np.array(panel.next_state().commanded_positions)
    panel.give(tab, 'G0 G91 Z-4')
    tab.wait(lambda: tab.text('work Z') == '-4.000' and tab.text('state') == 'idle')
    panel.spin_until(lambda: abs(panel.peers.state.positions[2] - before[2] + 4e-3) < 1e-5)
    tab.click_with_mouse('pose')
    at = tab.centre('go to zero Z')
    tab.pointer('move', *at)
    tab.pointer('press', *at)
    panel.spin_until(lambda: abs(panel.peers.state.positions[2] - before[2]) < 1e-5)
    tab.pointer('release', *at)
    tab.wait(lambda: tab.text('work Z') == '0.000')


@pytest.mark.thorough
def test_a_key_at_the_end_of_travel_says_so(panel):
    tab = panel.open_in_charge()
    tab.wait(lambda: tab.text('state') == 'idle')
    end = Machine.load('xyzac').travel[0, 1]
    panel.give(tab, f'G53 G0 X{1e3 * end - 0.5:.3f}')
    tab.click('jog')
    tab.wait(lambda: tab.run('!!jog.pad()'))
    told = f'X is at the end of its travel: {1e3 * end:.3f} mm'
    tab.pointer('release', *moves(panel, tab, 'mouse', lambda: tab.shows(told)))
    assert panel.next_state().commanded_positions[0] == pytest.approx(end, abs=1e-6)
    tab.fill('mdi', 'G53 G0 X0')  # the next test finds room in both directions
    tab.type_key('Enter')
    panel.spin_until(lambda: abs(panel.peers.state.positions[0]) < 1e-6)


@pytest.mark.thorough
def test_lengths_in_inches_and_a_light_page_are_remembered(panel):
    tab = panel.open_in_charge()
    tab.wait(lambda: tab.text('state') == 'idle')
    millimetres = [float(tab.text(name)) for name in ('axis Y', 'work Z', 'work A')]
    tab.click_with_mouse('inch')
    tab.click_with_mouse('light')
    ratios = np.array([25.4, 25.4, 1.0])
    for _ in range(2):
        tab.wait(lambda: tab.run('document.documentElement.className') == 'light')
        tab.wait(
            lambda: (
                np.abs(
                    [float(tab.text(name)) for name in ('axis Y', 'work Z', 'work A')]
                    - millimetres / ratios
                ).max()
                < 1e-4
            )
        )
        tab.reload()
        tab.wait(lambda: tab.text('rights') == 'in charge')
    tab.click('show touch off')
    tab.fill('here X', '1')
    tab.click('touch off')
    tab.wait(lambda: tab.text('work X') == '1.0000')
    tab.click('show touch off')
    # A step of the pad, the table of offsets, a pose, and the charts.
    x = panel.next_state().commanded_positions[0]
    tab.click('jog')
    tab.wait(lambda: tab.run('!!jog.pad()'))
    tab.run('[...document.querySelectorAll(`[data-mark="jog step"] button`)].at(-1).click()')
    tab.wait(lambda: tab.run('document.querySelector(".jog").dataset.step') == '0.1')
    panel.press_key(tab, 'jog X+', lambda: tab.text('work X') == '1.1000')
    tab.wait(lambda: tab.text('state') == 'idle')
    moved = panel.next_state()
    assert moved.commanded_positions[0] == pytest.approx(x + 0.1 * 25.4e-3, abs=1e-9)
    tab.click('jog')
    tab.click('offsets')
    zero = (moved.commanded_positions[0] - 1.1 * 25.4e-3) / 25.4e-3
    tab.wait(lambda: tab.value('G54 X') == f'{zero:z.4f}')
    tab.click('close setup')
    tab.click('pose')
    tab.fill('pose X', f'{moved.tip[0] / 25.4e-3 - 0.05:.4f}')
    goal = moved.tip[0] - 0.05 * 25.4e-3
    panel.press_key(tab, 'go there', lambda: abs(panel.peers.state.tip[0] - goal) < 2e-6)
    chart = 'getElement(Number(document.querySelector(".chart").id.slice(1))).chart'
    assert tab.run(f'{chart}.getOption().title[0].text') == 'feed, in/min'
    panel.until(MachineState.IDLE)
    for key in ('inch', 'light'):
        tab.click_with_mouse(key)
    tab.wait(lambda: tab.text('work X') == f'{25.4 * 1.05:.3f}')
