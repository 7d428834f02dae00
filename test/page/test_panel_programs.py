"""Programs of the folder, the editor, the queue, and macros of the machine file, on the page."""

import csv
import urllib.request

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

import yaml
from cnc_interp_msgs.msg import MachineState
from page_under_test import PanelUnderTest

from cnc_interp.core.small_files import config_directory
from cnc_interp.processes.node_processes import NODES
from cnc_interp.run.run_history import RunHistory

LONG = 'G21 G90 G94\nTRAORI\nG0 X0 Y0 Z0 A0 C0\n' + 'G1 X30 F600\nG1 X0\n' * 200 + 'M30\n'
WRONG = 'document.querySelectorAll(".edited .wrong")'


def panel_with_programs(folder):
    programs = folder / 'programs'
    programs.mkdir(parents=True, exist_ok=True)
    (programs / 'good.ngc').write_text('G21 G90\nG0 X0 Y0 Z10\nG1 X5 F1000\nM30\n')
    (programs / 'long.ngc').write_text(LONG)
    machine = yaml.safe_load((config_directory() / 'machines' / 'xyzac.yaml').read_text())
    machine['macros'] = {'flood': 'M8', 'aside': ['G90', 'G1 G53 X12 F3000']}
    (folder / 'own.yaml').write_text(yaml.safe_dump(machine))
    own = {node: {'machine': f"'{folder / 'own.yaml'}'"} for node in NODES}
    return PanelUnderTest(own, '--programs', str(programs))


@pytest.fixture(scope='module')
def running(tmp_path_factory):
    folder = tmp_path_factory.mktemp('shop')
    panel = panel_with_programs(folder)
    panel.programs = folder / 'programs'
    yield panel
    panel.close()


def rewrite(tab, text, field='edited text'):
    """Replace what a field holds, as a user pastes it."""
    tab.click_with_mouse(field)
    tab.send(
        'Input.dispatchKeyEvent', type='keyDown', key='a', modifiers=2, commands=['selectAll']
    )
    tab.send('Input.insertText', text=text)


@pytest.mark.thorough
def test_the_page_shows_times_by_tool_and_each_run_with_its_operator(panel):
    tab = panel.open_in_charge()
    tab.wait(lambda: tab.text('state') == 'idle')
    (panel.programs / 'tools.ngc').write_text(
        'G21 G90 G94\nT3 M6\nS1000 M3\nG0 X0 Y0 Z10\nG1 X5 F1000\nM5\nM30\n'
    )
    tab.click_with_mouse('programs')
    tab.click_with_mouse('load tools.ngc')
    tab.wait(lambda: tab.text('program') == 'tools.ngc' and tab.text('status') == 'planned')
    tab.click_with_mouse('times')
    tab.wait(lambda: 'spindle' in (tab.text('times by tool') or ''))
    (line,) = tab.text('times by tool').splitlines()[1:]
    row = line.split()
    total, cutting = map(float, row[2:4])
    assert row[:2] == ['2', '3'] and total == cutting > 0.3  # 5 mm, F1000
    rewrite(tab, 'Grace', 'who')
    tab.click_with_mouse('set operator')
    tab.click_with_mouse('close times')
    panel.press_key(tab, 'cycle start', lambda: panel.loaded and tab.text('state') != 'idle')

    def rows():
        with urllib.request.urlopen(f'{panel.page.address}runs.csv') as answer:
            found = csv.DictReader(answer.read().decode().splitlines())
        return [each for each in found if each['program'] == 'tools.ngc']

    def ended():
        if tab.text('why').startswith('put tool'):
            tab.click('cycle start')
        return (RunHistory('').file.exists() and rows()) or False

    panel.spin_until(ended)
    (told,) = rows()
    assert told['operator'] == 'Grace' and told['outcome'] == 'succeeded'
    assert float(told['predicted_s']) == pytest.approx(total, abs=0.01)
    tab.click_with_mouse('times')
    tab.wait(lambda: 'Grace' in (tab.text('runs') or ''))
    assert told['actual_s'] in tab.text('runs')
    tab.click_with_mouse('close times')


@pytest.mark.thorough
def test_a_program_is_opened_edited_and_saved_under_another_name(panel):
    tab = panel.open_in_charge()
    tab.wait(lambda: tab.text('state') == 'idle')
    tab.click_with_mouse('programs')
    tab.click_with_mouse('load good.ngc')
    tab.wait(lambda: tab.text('program') == 'good.ngc' and tab.text('status') == 'planned')
    tab.click_with_mouse('edit')
    text = 'document.querySelector(`[data-mark="edited text"]`)?.value'
    tab.wait(lambda: 'X5 F1000' in (tab.run(text) or ''))
    rewrite(tab, 'G21 G90\nG0 X0 Y0 Z10\nG1 X5 FF\nG1 X6 F600\nHELLO 5\nG1 X7\nM30\n')
    tab.click_with_mouse('check edited')
    marked = f'[...{WRONG}].map(row => row.textContent).join()'
    tab.wait(lambda: tab.run(marked) == '3,5')
    assert tab.text('edited status') == tab.text('status') and 'good.ngc:3' in tab.text('status')
    # Nothing is written before it is saved.
    assert 'FF' not in (panel.programs / 'good.ngc').read_text()
    rewrite(tab, 'G21 G90\nG0 X0 Y0 Z10\nG1 X7 F600\nM30\n')
    rewrite(tab, 'long.ngc', 'edited name')
    tab.click_with_mouse('save edited')
    tab.wait(lambda: tab.text('save edited') == 'overwrite')  # another program has that name
    assert (panel.programs / 'long.ngc').read_text() == LONG
    rewrite(tab, 'other.ngc', 'edited name')
    tab.click_with_mouse('save edited')
    tab.wait(lambda: tab.text('program') == 'other.ngc' and tab.text('status') == 'planned')
    assert 'X7 F600' in (panel.programs / 'other.ngc').read_text()
    assert tab.run(f'{WRONG}.length') == 0
    tab.click_with_mouse('close editor')
    tab.click_with_mouse('programs')
    tab.centre('load opened last other.ngc')
    tab.click_with_mouse('close programs')


@pytest.mark.thorough
def test_a_program_of_the_folder_waits_in_the_queue(panel):
    tab = panel.open_in_charge()
    tab.wait(lambda: tab.text('state') == 'idle')
    tab.click_with_mouse('programs')
    tab.click_with_mouse('load long.ngc')
    tab.wait(lambda: tab.text('program') == 'long.ngc' and tab.text('status') == 'planned')
    panel.begin(tab)
    tab.click_with_mouse('programs')
    tab.click_with_mouse('queue good.ngc')
    tab.wait(lambda: tab.text('waiting') == 'next: good.ngc')
    tab.click_with_mouse('clear queue')
    tab.wait(lambda: tab.text('waiting') == '')


@pytest.mark.thorough
def test_a_macro_that_moves_asks_first(panel):
    tab = panel.open_in_charge()
    tab.wait(lambda: tab.text('state') == 'idle')
    panel.until(MachineState.IDLE)
    before = np.array(panel.next_state().commanded_positions)
    tab.click_with_mouse('macro flood')
    tab.wait(lambda: tab.text('mdi answer') == 'M8: done')
    tab.click_with_mouse('macro aside')
    tab.centre('go macro')
    assert (np.array(panel.next_state().commanded_positions) == before).all()
    tab.click_with_mouse('cancel macro')
    tab.click_with_mouse('macro aside')
    tab.click_with_mouse('go macro')
    tab.wait(lambda: tab.text('mdi answer') == 'G1 G53 X12 F3000: done')
    assert panel.next_state().commanded_positions[0] == pytest.approx(12e-3, abs=1e-9)
    tab.click_with_mouse('programs')  # every program of the folder is there
    tab.centre('load good.ngc')
    tab.click_with_mouse('close programs')
