"""The operator page in a real browser, beside real nodes: what it shows, does and refuses."""

import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import MachineState

from cnc_interp.page.contact import INTERRUPTED, LATE
from cnc_interp.page.hand_motion import STALE

IMPELLER = Path(__file__).parents[3] / 'shared/programs/linuxcnc-impeller-xyzac'
#: Lines of a program that runs to its end, and of one that outlasts every test.
SHORT, LONG = 4, 24
TABS = 3


def zigzag(name, lines, after_first='', feed=2000):
    """A program of lines of 30 mm to and fro."""
    moves = [f'G1 X{30 * (k % 2)} Y{5 * (k % 8)} F{feed}\n' for k in range(1, lines + 1)]
    moves.insert(1, after_first)
    return f'({name} <of lines>)\nG21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A15 C30\n{"".join(moves)}M30\n'


#: Sends a program to the server past the buttons of the page; returns the status.
UPLOAD = """(() => {
  const url = Object.values(mounted_app.elements).map(e => e.props?.url).find(u => u);
  const form = new FormData();
  form.append('file', new Blob(['G1 X10 F600']), 'sent.ngc');
  const request = new XMLHttpRequest();
  request.open('POST', url, false);
  request.send(form);
  return request.status;
})()"""


#: Corners of the triangles that the page draws as executed.
DRAWN_AS_DONE = """(() => {
  let count = -1;
  const scene = Object.keys(mounted_app.elements).map(id => getElement(id)).find(e => e?.objects);
  scene.objects.get('scene').mesh.traverse(part => {
    if (part.isMesh && Array.isArray(part.material)) count = part.geometry.groups[0].count;
  });
  return count;
})()"""


@pytest.fixture
def short_program(tmp_path):
    path = tmp_path / 'short.ngc'
    path.write_text(zigzag('SHORT', SHORT))
    return path


@pytest.fixture
def long_program(tmp_path):
    path = tmp_path / 'long.ngc'
    text = zigzag('LONG', LONG, feed=500)
    path.write_text(text.replace('M30', '(more lines than the page shows)\n' * 60 + 'M30'))
    return path


#: Where the slider of the override stands.
SLIDER = 'document.querySelector(`[data-mark="override slider"]`).ariaValueNow'


def shows(tab, state):
    """Tell whether the read-outs are those of a machine state, to their last digits."""
    text, q = tab.texts(), state.positions
    true = [x * 1e3 for x in q[:3]] + [x * 57.29577951308232 for x in q[3:]]
    axes = [float(text[f'axis {name}']) for name in 'XYZAC']
    digits = (1e-3,) * 3 + (1e-4,) * 2
    return (
        all(abs(a - b) <= digit for a, b, digit in zip(axes, true, digits, strict=True))
        and [float(text[f'tip {x}']) for x in 'xyz']
        == pytest.approx([1e3 * x for x in state.tip], abs=1e-3)
        and text['line'] == str(state.line_number)
    )


def seconds(tab, mark):
    """A time of the read-outs [s]; NaN while a page is being built."""
    minutes, rest = (tab.text(mark) or 'nan:nan').split(':')
    return 60 * float(minutes) + float(rest)


def set_override(panel, tab, percent):
    """
    Move the slider, five percent a step.

    What is pressed while the connection is interrupted (see ``press_key``) does nothing: the page
    says so, and its slider goes back to what counts. The rest is pressed then.
    """

    def seen(share):
        return (
            tab.run(SLIDER) == f'{100 * share:.0f}' and tab.text('override') == f'feed {share:.0%}'
        )

    while panel.override != percent / 100:
        tab.wait(lambda: not tab.shows(INTERRUPTED) and seen(panel.next_state().feed_override))
        steps = round((percent - 100 * panel.override) / 5)
        key = 'ArrowRight' if steps > 0 else 'ArrowLeft'
        tab.press_key('override slider', key, times=abs(steps))
        panel.spin_until(lambda: panel.override == percent / 100 or tab.shows(INTERRUPTED))
    tab.wait(lambda: seen(percent / 100))


def hold(panel, tab, program):
    """Hold, and compare what the page shows with what the machine says."""
    tab.click('feed hold')
    panel.until(MachineState.HELD)
    held = panel.next_state()
    while not np.allclose(held.positions, held.commanded_positions, rtol=0.0, atol=1e-8):
        held = panel.next_state()  # the drives come after the last setpoint
    tab.wait(lambda: tab.text('state') == 'held')
    tab.wait(lambda: shows(tab, held))
    line = program.read_text().splitlines()[held.line_number - 1]
    tab.wait(
        lambda: (
            tab.run('document.querySelector(".lines .now")?.textContent')
            == f'{held.line_number}{line}'
        )
    )
    share = 100 * held.path_position / panel.loaded[-1].path_length
    tab.wait(lambda: abs(float(tab.text('progress').rstrip('%')) - share) < 0.11)
    return held


def stop_and_reset(panel, tab):
    """Stop in an emergency, and clear the fault."""
    tab.click('EMERGENCY STOP')
    panel.until(MachineState.FAULT)
    tab.wait(lambda: tab.text('state') == 'fault')
    panel.reset(tab)


#: A status that is read just after a press may be that from before.
WATCH_THE_PLANNING = """
const mark = document.querySelector('[data-mark="status"]');
new MutationObserver(() => { window.plansAgain ||= mark.textContent !== 'planned'; })
  .observe(mark, {childList: true, characterData: true, subtree: true}); 0
"""


@pytest.mark.thorough
def test_settings_of_the_dialog_are_planned_and_run(panel, long_program):
    tab = panel.open_in_charge()
    tab.click('settings')
    tab.fill('setting contour_tolerance', 'wide')
    tab.click('use settings')
    wrong = "largest deviation of the tool tip: 'wide' is not a number"
    tab.wait(lambda: tab.shows(wrong))
    tab.fill('setting contour_tolerance', '0.1')
    tab.click('use settings')
    panel.load(tab, long_program)
    panel.begin(tab)
    told = {pair.key: pair.value for pair in panel.loaded[-1].settings}
    assert float(told['contour_tolerance']) == pytest.approx(1e-4)
    tab.wait(lambda: tab.text('programmed') == '500')
    assert tab.text('status') == 'planned', 'the page knows the run as its own'
    stop_and_reset(panel, tab)
    tab.click('settings')
    tab.wait(lambda: tab.value('setting contour_tolerance') == '0.1')
    tab.click('defaults settings')
    tab.wait(lambda: tab.value('setting contour_tolerance') == '0.02')
    tab.run(WATCH_THE_PLANNING)
    tab.click('use settings')
    tab.wait(lambda: tab.run('window.plansAgain'))
    tab.wait(lambda: tab.text('status') == 'planned')
    panel.begin(tab)
    told = {pair.key: pair.value for pair in panel.loaded[-1].settings}
    assert float(told['contour_tolerance']) == pytest.approx(2e-5)
    stop_and_reset(panel, tab)


@pytest.mark.thorough
def test_a_program_is_operated_from_the_page(panel, long_program, short_program):
    tab = panel.open_in_charge()
    panel.load(tab, long_program)
    panel.begin(tab)
    held = hold(panel, tab, long_program)

    # A refreshed page keeps everything; the machine does not notice.
    tab.reload()
    tab.wait(lambda: tab.text('program') == long_program.name)
    tab.wait(lambda: tab.text('rights') == 'in charge')
    tab.wait(lambda: shows(tab, held))
    assert panel.next_state().state == MachineState.HELD

    tab.click('single block')
    panel.go_on(tab)
    panel.until(MachineState.HELD)
    assert panel.peers.state.line_number - held.line_number <= 1
    tab.click('single block')
    panel.go_on(tab)
    stop_and_reset(panel, tab)

    panel.load(tab, short_program)
    tab.click('check')
    tab.wait(lambda: tab.text('status') == 'every setpoint proven')
    panel.begin(tab)
    panel.spin_until(lambda: panel.peers.state.completed)
    tab.wait(lambda: tab.text('progress') == '100.0%')


@pytest.mark.thorough
@pytest.mark.skipif(not IMPELLER.is_dir(), reason='needs the public programs in ../shared')
def test_the_impeller_is_operated_from_the_page(panel):
    tab, program = panel.open_in_charge(), next(IMPELLER.glob('*.ngc'))
    panel.load(tab, program)
    panel.begin(tab)
    set_override(panel, tab, 50)
    hold(panel, tab, program)
    panel.go_on(tab)
    stop_and_reset(panel, tab)


LOSE_THE_NEXT_STOP = """
const ws = window.socket.io.engine.transport.ws, send = ws.send;
ws.send = function (frame) {
  if (!window.lost && String(frame).includes('feed_hold')) window.lost = frame;
  else send.call(ws, frame);
}; 0
"""


@pytest.mark.thorough
def test_a_stop_is_never_lost_and_a_start_never_late(panel, long_program):
    tab = panel.open_in_charge()
    panel.load(tab, long_program)
    panel.begin(tab)

    # What the browser sends is lost once.
    tab.run(LOSE_THE_NEXT_STOP)
    tab.click('feed hold')
    panel.until(MachineState.HELD)
    assert tab.run('window.lost')
    tab.wait(lambda: tab.text('contact') == '')
    panel.go_on(tab)

    # The connection breaks in the moment of the press.
    tab.run('socket.io.engine.close(); document.querySelector(`[data-mark="feed hold"]`).click()')
    panel.until(MachineState.HELD)
    tab.wait(lambda: tab.text('contact') == '')
    panel.go_on(tab)

    # It is given up, as after a refusal of the server: the page tries again by itself.
    tab.run('socket.disconnect(); document.querySelector(`[data-mark="feed hold"]`).click()')
    panel.until(MachineState.HELD)
    tab.wait(lambda: tab.text('contact') == '')
    panel.go_on(tab)

    # So it is, and the page is loaded again.
    tab.run('socket.disconnect(); document.querySelector(`[data-mark="feed hold"]`).click()')
    tab.reload()
    panel.until(MachineState.HELD)
    tab.wait(lambda: tab.text('rights') == 'in charge' and tab.text('contact') == '')
    panel.go_on(tab)

    # The server hears nothing for a while: the page says so; a hold comes late, a start never.
    server = panel.page.process.pid
    os.kill(server, signal.SIGSTOP)
    tab.run('document.querySelector(`[data-mark="feed hold"]`).click()')
    tab.wait(lambda: tab.text('contact').startswith('feed_hold: sent until it is answered; no'))
    os.kill(server, signal.SIGCONT)
    panel.until(MachineState.HELD)
    tab.wait(lambda: tab.text('contact') == '')

    os.kill(server, signal.SIGSTOP)
    tab.wait(lambda: tab.run(f'performance.now() - contact.heard > {1000 * (LATE + 1)}'))
    tab.run('document.querySelector(`[data-mark="cycle start"]`).click()')
    panel.states.clear()
    tab.press_key_at_once('override slider', 'ArrowLeft')
    os.kill(server, signal.SIGCONT)
    tab.wait(lambda: tab.shows(INTERRUPTED))
    tab.wait(lambda: tab.run(SLIDER) == '100')
    assert {state.feed_override for state in panel.states} <= {1.0}
    assert panel.next_state().state == MachineState.HELD and panel.override == 1.0
    tab.wait(lambda: not tab.shows(INTERRUPTED))
    panel.go_on(tab)
    stop_and_reset(panel, tab)


@pytest.mark.thorough
def test_only_one_page_with_the_token_commands(panel, short_program):
    first = panel.open_in_charge()
    stranger, second = panel.open('wrong'), panel.open()
    for tab in (stranger, second):
        assert tab.text('rights') == 'view only'
        assert tab.run('document.querySelector(`[data-mark="cycle start"]`).disabled')
    assert stranger.run('document.querySelector(`[data-mark="EMERGENCY STOP"]`).disabled')
    assert not second.run('document.querySelector(`[data-mark="EMERGENCY STOP"]`).disabled')

    stranger.show()
    stranger.click('take over')
    stranger.wait(lambda: 'the token in the address' in stranger.text('refused'))
    second.show()
    second.click('take over')
    second.wait(lambda: second.text('rights') == 'in charge')
    first.show()
    first.wait(lambda: first.text('rights') == 'view only')
    stranger.show()
    assert stranger.text('rights') == 'view only'

    # What a page without the token sends by other means is refused by the server.
    assert (stranger.run(UPLOAD), second.run(UPLOAD)) == (403, 200)
    second.show()
    second.wait(lambda: second.text('program') == 'sent.ngc')
    panel.load(second, short_program)
    panel.begin(second)
    stranger.show()
    stranger.run('contact.stop("emergency_stop")')
    stranger.wait(lambda: stranger.run('!!document.querySelector(".q-notification")'))
    stranger.wait(lambda: stranger.text('contact') == '')

    # Closing the page in charge neither stops the motion nor keeps the keys.
    panel.page.close_tab(second)
    panel.spin_until(lambda: panel.peers.state.completed)
    first.show()
    first.wait(lambda: first.text('progress') == '100.0%')


@pytest.mark.thorough
def test_many_tabs(panel, long_program):
    first = panel.open_in_charge()
    panel.load(first, long_program)
    panel.begin(first)
    set_override(panel, first, 10)  # many pages take long to open on a slow computer
    tabs = [first] + [panel.open() for _ in range(TABS - 1)]
    assert [tab.text('rights') for tab in tabs[1:]] == ['view only'] * (TABS - 1)
    first.show()
    for tab in tabs[1:]:  # nothing is sent to tabs that nobody sees
        tab.wait(lambda tab=tab: seconds(first, 'elapsed') > seconds(tab, 'elapsed') + 2)
    held = hold(panel, first, long_program)
    for tab in tabs[1:]:
        tab.show()
        tab.wait(lambda tab=tab: tab.text('state') == 'held' and shows(tab, held))

    # The one in charge is closed in between: the machine goes on, another page takes over.
    first.show()
    panel.go_on(first)
    *others, last = tabs[1:]
    for tab in (*others[::2], first, *others[1::2]):
        panel.page.close_tab(tab)
        before = panel.next_state()
        panel.spin_until(lambda at=before: panel.peers.state.path_position > at.path_position)
    last.show()
    assert last.text('rights') == 'view only'
    last.click('take over')
    last.wait(lambda: last.text('rights') == 'in charge')
    hold(panel, last, long_program)
    panel.reset(last)


@pytest.mark.thorough
def test_a_program_waits_for_the_end_of_the_one_that_runs(panel, short_program, tmp_path):
    tab, first = panel.open_in_charge(), tmp_path / 'first.ngc'
    first.write_text(zigzag('FIRST', SHORT, after_first='M0\n'))
    panel.load(tab, first)
    panel.begin(tab)
    panel.until(MachineState.HELD)  # at M0, for as long as it takes
    tab.wait(lambda: tab.text('state') == 'held')

    def wait_for_its_end():
        tab.click('queue next')
        tab.choose_file('input[type=file]', short_program)
        tab.wait(lambda: tab.text('waiting') == f'next: {short_program.name}')

    wait_for_its_end()
    tab.click('clear queue')
    tab.wait(lambda: tab.text('waiting') == '')
    wait_for_its_end()
    assert tab.text('program') == first.name
    panel.go_on(tab)
    panel.spin_until(lambda: panel.loaded[-1].name == short_program.name)
    tab.wait(lambda: tab.text('program') == short_program.name and tab.text('waiting') == '')
    panel.spin_until(
        lambda: (
            panel.peers.state.completed
            and panel.peers.state.program_id == panel.loaded[-1].program_id
        )
    )


#: Whether a window shows all of a page, with charts of about one size.
FITS = """
document.documentElement.scrollWidth <= innerWidth &&
[...document.querySelectorAll('.chart')].every((chart, _, all) => {
  const box = chart.getBoundingClientRect(), drawn = chart.querySelector('canvas').clientWidth;
  const all_of = chart.parentElement.getBoundingClientRect(), other = all[1].clientWidth;
  return box.right <= all_of.right && box.bottom <= all_of.bottom && drawn <= box.width + 1 &&
    box.width < 1.5 * other;
})
"""


#: Keys, fields and texts that something else covers, or that are cut off.
COVERED = """
[...document.querySelectorAll('[data-mark]')].filter((part) => {
  if (!part.checkVisibility({ visibilityProperty: true })) return false;
  if (getComputedStyle(part).pointerEvents === 'none' || !part.clientWidth) return false;
  part.scrollIntoView({ block: 'center' });
  const box = part.getBoundingClientRect(), y = box.top + box.height / 2;
  const cut = part.matches('button, .place *') && part.scrollWidth > part.clientWidth + 1;
  return cut || [box.left + 3, box.left + box.width / 2, box.right - 3].some((x) => {
    const hit = document.elementFromPoint(x, y);
    return !hit || (!part.contains(hit) && !hit.contains(part));
  });
}).map((part) => part.dataset.mark)
"""


@pytest.mark.thorough
def test_the_keyboard(panel, long_program, short_program):
    tab = panel.open_in_charge()
    panel.load(tab, long_program)
    # Before the start, the page shows what the program will take, and nothing of an earlier run.
    assert seconds(tab, 'left') > 90 and tab.text('line') == tab.text('progress') == '–'
    # Neither space nor Enter press a key that moves.
    for key in (' ', 'Enter'):
        tab.run('document.querySelector(`[data-mark="cycle start"]`).focus()')
        tab.type_key(key)
    time.sleep(1.0)
    assert panel.next_state().state == MachineState.IDLE
    before = len(panel.loaded)
    tab.type_key('R')
    panel.spin_until(lambda: len(panel.loaded) > before)
    panel.spin_until(panel.is_on_its_way)
    # The text follows the executed line until its user scrolls.
    tab.wait(lambda: tab.run('document.querySelector(".lines .now") !== null'))
    tab.run('document.querySelector(".lines").dispatchEvent(new Event("wheel"))')
    tab.run('document.querySelector(".lines").scrollTop = 1e6')
    tab.wait(
        lambda: 'M30' in tab.run('document.querySelector(".lines li:last-child").textContent')
    )
    tab.click('to the line')
    tab.wait(lambda: tab.run('document.querySelector(".lines .now") !== null'))
    # Feed override, hold, emergency stop.
    for key, percent in (('-', 95), ('-', 90), ('+', 95), ('0', 100)):
        tab.type_key(key)
        panel.spin_until(lambda percent=percent: panel.override == percent / 100)
    tab.type_key('Escape')
    panel.until(MachineState.HELD)
    tab.type_key('F1')
    panel.until(MachineState.FAULT)
    # What was done is drawn as done, and another program shows nothing of it.
    tab.wait(lambda: tab.run(DRAWN_AS_DONE) > 0)
    panel.reset(tab)
    panel.load(tab, short_program)
    tab.wait(lambda: tab.text('line') == tab.text('progress') == '–')
    assert tab.run('document.querySelector(".lines .now")') is None
    assert 0 < seconds(tab, 'left') < 10


@pytest.mark.thorough
def test_axes_are_moved_by_hand_from_the_page(panel):
    tab = panel.open_in_charge()
    tab.wait(lambda: tab.text('state') == 'idle')
    tab.click('jog')
    tab.wait(lambda: tab.run('!!jog.pad()'))

    def rests():
        panel.until(MachineState.IDLE)
        return np.array(panel.next_state().commanded_positions)

    # While a key is held.
    before = rests()
    key = tab.centre('jog X+')
    tab.pointer('move', *key)
    tab.pointer('press', *key)
    panel.until(MachineState.JOGGING)
    panel.spin_until(lambda: panel.peers.state.positions[0] > before[0] + 1e-3)
    tab.pointer('release', *key)
    after = rests()
    assert after[0] > before[0] + 1e-3 and (after[1:] == before[1:]).all()
    # With an arrow key, whose release is lost: the machine stops by itself.
    tab.send('Input.dispatchKeyEvent', type='keyDown', key='ArrowLeft', windowsVirtualKeyCode=37)
    panel.spin_until(lambda: panel.peers.state.positions[0] < after[0] - 1e-3)
    tab.run('clearInterval(jog.timer)')
    rests()
    tab.send('Input.dispatchKeyEvent', type='keyUp', key='ArrowLeft', windowsVirtualKeyCode=37)
    # A beat that was on its way for long does not count.
    tab.wait(lambda: tab.run('contact.beat > 0'))
    time.sleep(STALE)  # from now on no beat from before counts
    here = rests()
    tab.run("emitEvent('jog', {name: 'X', sign: 1, heard: contact.beat - 2.5})")
    time.sleep(1.0)
    assert (rests() == here).all()
    # By steps, along an axis and along the tool.
    tab.run('[...document.querySelectorAll(`[data-mark="jog step"] button`)].at(-2).click()')
    tab.wait(lambda: tab.run('document.querySelector(".jog").dataset.step') == '1')

    def position(i):
        return panel.peers.state.positions[i]

    panel.press_key(tab, 'jog Y-', lambda: position(1) < here[1] - 0.9999e-3)
    there = rests()
    assert there - here == pytest.approx([0.0, -1e-3, 0.0, 0.0, 0.0], abs=1e-9)
    panel.press_key(tab, 'jog tool+', lambda: position(2) > there[2] + 0.9999e-3)
    assert rests() - there == pytest.approx([0.0, 0.0, 1e-3, 0.0, 0.0], abs=1e-9)
    # A page that does not command moves nothing.
    other = panel.open()
    assert other.text('rights') == 'view only'
    other.run("emitEvent('jog', {name: 'X', sign: 1, heard: contact.beat})")
    time.sleep(1.0)
    assert panel.next_state().state == MachineState.IDLE


@pytest.mark.thorough
def test_lines_by_hand_are_given_on_the_page(panel, long_program):
    tab = panel.open_in_charge()
    panel.load(tab, long_program)
    tab.wait(lambda: {'G17', 'G90'} <= set(tab.text('modes').split()))

    before = np.array(panel.next_state().commanded_positions)
    panel.give(tab, 'g91 g1 f2000')
    tab.wait(lambda: {'G91', 'G1', 'F2000'} <= set(tab.text('modes').split()))
    panel.give(tab, 'X2')
    after = np.array(panel.next_state().commanded_positions)
    assert after - before == pytest.approx([0.002, 0, 0, 0, 0], abs=1e-9)
    # A refused line says why and stays to be corrected; nothing moves.
    panel.give(tab, 'X1 Q5', 'MDI:1: Q5')
    assert (np.array(panel.next_state().commanded_positions) == after).all()
    assert tab.value('mdi') == 'X1 Q5'
    # Lines before, by the arrow keys.
    for key, line in (('Up', 'X1 Q5'), ('Up', 'X2'), ('Down', 'X1 Q5'), ('Down', '')):
        tab.type_key(f'Arrow{key}')
        tab.wait(lambda line=line: tab.value('mdi') == line)
    # The loaded program stays, and runs.
    assert tab.text('program') == long_program.name
    panel.begin(tab)
    panel.give(tab, 'X1', 'program is running')
    tab.click('feed hold')
    panel.until(MachineState.HELD)
    panel.reset(tab)
    # A page that does not command gives no line.
    other = panel.open()
    assert other.text('rights') == 'view only'
    assert other.run('document.querySelector("[data-mark=mdi]").disabled')


@pytest.mark.thorough
def test_the_page_fits_every_window(panel):
    tab = panel.open_in_charge()
    tab.wait(lambda: tab.run('document.querySelectorAll(".chart canvas").length') == 4)
    # All that can stand in the view stands there.
    tab.click('jog')
    tab.click('show touch off')
    way = 'the way is told in some lines. ' * 6
    tab.run(f'document.querySelector("[data-mark=start]").textContent = "{way}"')
    for size in ((1366, 768), (1920, 1080), (1366, 768), (390, 844, True), (1366, 768)):
        tab.size(*size)
        time.sleep(1.0)  # what is drawn follows later
        tab.wait(lambda: tab.run(FITS))
        tab.wait(lambda: tab.run(COVERED) == [])
    # Nothing of a phone's dialogs lies below the keys that stop, or beside its screen.
    tab.size(390, 844, True)
    beside = '[...document.querySelectorAll(".q-dialog .file .q-btn")]'
    beside += '.filter(part => part.getBoundingClientRect().right > innerWidth).length'
    for name, end in (('settings', 'cancel settings'), ('programs', 'close programs')):
        tab.click(name)
        tab.centre(end)
        assert tab.run(beside) == 0
        tab.click_with_mouse(end)
        tab.wait(lambda end=end: not tab.run(f'!!document.querySelector(`[data-mark="{end}"]`)'))


@pytest.mark.thorough
def test_what_is_wrong_with_a_program_is_said(panel, tmp_path):
    tab = panel.open_in_charge()
    wrong = tmp_path / 'wrong.ngc'
    wrong.write_text('G21 G90 G94\nG0 X0 Y0 Z0\nG1 X10 F0\nM30\n')
    tab.choose_file('input[type=file]', wrong)
    tab.wait(lambda: tab.text('status').startswith('wrong.ngc:3: '))
    tab.wait(
        lambda: tab.run('document.querySelector(".lines .wrong")?.textContent') == '3G1 X10 F0'
    )
    tab.wait(lambda: 'wrong.ngc:3' in tab.run('document.querySelector(".alarms").textContent'))
    tab.click('cycle start')
    tab.wait(lambda: tab.run('document.querySelector(".q-notification")?.textContent ?? ""'))
    assert panel.next_state().state == MachineState.IDLE
    tab.click('clear messages')
    tab.wait(lambda: tab.run('document.querySelector(".alarms").textContent') == '')

    # What has no effect is told, too.
    passed = tmp_path / 'passed.ngc'
    passed.write_text(zigzag('PASSED', SHORT, after_first='M8\n'))
    panel.load(tab, passed)
    tab.wait(lambda: 'M8: no effect' in tab.run('document.querySelector(".alarms").textContent'))


@pytest.mark.thorough
def test_the_page_never_comes_before_the_nodes(panel):
    def niceness(number):
        tasks = Path(f'/proc/{number}/task').glob('*/stat')
        return [int(task.read_text().rpartition(')')[2].split()[16]) for task in tasks]

    page = niceness(panel.page.process.pid)
    assert len(page) > 5 and min(page) >= os.getpriority(os.PRIO_PROCESS, 0)
    for node in panel.children.nodes.values():
        assert max(niceness(node.process.pid)) <= min(page)


@pytest.mark.thorough
def test_a_killed_node_is_named_and_its_program_goes_on_from_the_page(panel, long_program):
    tab = panel.open_in_charge()
    panel.load(tab, long_program)
    panel.begin(tab)
    panel.watching = False
    os.kill(panel.children.nodes['feedrate_node'].process.pid, signal.SIGKILL)
    tab.wait(lambda: tab.text('state') == 'no answer')
    tab.wait(lambda: tab.text('why') == 'feedrate_node does not answer')
    panel.spin_until(lambda: panel.peers.state.plan_over)
    stopped = panel.next_state()
    assert stopped.state == MachineState.STARVED
    tab.wait(lambda: shows(tab, stopped))
    tab.wait(lambda: 'feedrate_node' in tab.run('document.querySelector(".alarms").textContent'))

    assert list(panel.children.revive()) == ['feedrate_node']
    panel.watching = True
    panel.spin_until(lambda: any('was restarted' in text for _, text in panel.diagnostics))
    panel.go_on(tab)
    hold(panel, tab, long_program)
    panel.reset(tab)
