"""The operator page with a scene: its bodies, and a program that would hit one of them."""

import os

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import MachineState
from page_under_test import PanelUnderTest

pytestmark = pytest.mark.thorough

SCENE = """
include: xyzac
bodies:
  - {name: clamp, link: workpiece, box_mm: {low: [50, -20, -20], high: [70, 20, 30]}}
stock: {link: workpiece, box_mm: {low: [-30, -20, -12], high: [30, 20, -1]}, grid_mm: 0.4}
holders: {slim: [[0, 6], [40, 12]]}
"""
SLOTS = """G21 G90 G94
G0 X-35 Y-8 Z30 A0 C0
G1 Z-4 F1500
X20
G0 Z10
X-35 Y8
G1 Z-6
X20
G0 Z30
M30
"""
PROGRAM = 'G21 G90 G94\nG0 X0 Y0 Z60 A0 C0\nG1 X{} F3000\nZ10\nX{} Y30\nM30\n'
#: Colours and places of what is drawn of STL files, by colour: red ones hit each other.
DRAWN = """(() => {
  const view = Object.keys(mounted_app.elements).map(id => getElement(id)).find(e => e?.objects);
  const found = [];
  view.objects.forEach(object => {
    const mesh = object.mesh?.children?.[0];
    if (!mesh?.geometry?.attributes?.normal || !mesh.material?.color) return;
    mesh.geometry.computeBoundingBox();
    const { min, max } = mesh.geometry.boundingBox;
    const place = mesh.getWorldPosition(mesh.position.clone());
    const span = [max.x - min.x, max.y - min.y, max.z - min.z];
    const colour = mesh.material.color.getHexString();
    found.push([colour, object.mesh.visible, span, [place.x, place.y, place.z]]);
  });
  return found;
})()"""
RED = 'eb2e33'
CLAMP, CUTTER = (0.02, 0.04, 0.05), (0.006, 0.006, 0.014)


def drawn(tab, size):
    """Colour, visibility and place of the drawn body of a size [m]."""
    for colour, visible, span, place in tab.run(DRAWN):
        if max(abs(a - b) for a, b in zip(span, size)) < 5e-5:
            return colour, visible, place
    return None


@pytest.fixture(scope='module')
def panel(tmp_path_factory):
    file = tmp_path_factory.mktemp('scene') / 'scene.yaml'
    file.write_text(SCENE)
    scene = {'scene': f"'{file}'"}
    names = 'program_node', 'feedrate_node', 'machine_node'
    parameters = {name: dict(scene) for name in names}
    parameters['machine_node']['start_height'] = 0.1
    running = PanelUnderTest(parameters)
    yield running
    running.page.close()
    running.close()


def test_a_program_that_would_hit_is_refused_and_both_bodies_are_red(panel, tmp_path):
    tab = panel.open_in_charge()
    panel.until(MachineState.IDLE)
    tab.wait(lambda: drawn(tab, CLAMP))
    assert drawn(tab, CLAMP)[:2] != (RED, True)
    key = 'document.querySelector(`[data-mark="show hit"]`)'
    assert tab.run(f'getComputedStyle({key}).display') == 'none'
    bad, good = tmp_path / 'bad.ngc', tmp_path / 'good.ngc'
    bad.write_text(PROGRAM.format(60, 40))
    good.write_text(PROGRAM.format(20, 10))
    tab.choose_file('input[type=file]', bad)
    tab.wait(lambda: 'hit: line 4, cutter and clamp' in tab.text('hit'))
    assert 'bad.ngc:4: hit: line 4' in tab.text('status')
    tab.wait(lambda: drawn(tab, CLAMP)[:2] == (RED, True))
    tab.wait(lambda: drawn(tab, CUTTER)[:2] == (RED, True))
    before = drawn(tab, CUTTER)[2]
    tab.click('show hit')
    tab.wait(lambda: drawn(tab, CUTTER)[2] != before)
    _, _, (x, _, z) = drawn(tab, CUTTER)
    # In the view of the part, its place is that in the program: over the clamp, at line 4.
    assert x == pytest.approx(0.060, abs=1e-4) and 0.029 < z < 0.0305
    assert 'not where the machine is' in tab.text('hit')
    count = len(panel.loaded)
    tab.click('cycle start')
    panel.spin_for(1.0)
    assert len(panel.loaded) == count, 'a refused program does not start'
    panel.load(tab, good)
    tab.wait(lambda: drawn(tab, CLAMP)[0] != RED)
    assert tab.text('hit') == ''
    assert drawn(tab, CUTTER)[2] == pytest.approx(before, abs=1e-6), 'where the machine is'
    panel.begin(tab)
    panel.until(MachineState.IDLE)


def test_a_holder_that_the_scene_does_not_know_is_refused_in_one_sentence(panel):
    tab = panel.open_in_charge(width=1500, height=900)
    panel.until(MachineState.IDLE)
    tab.click_with_mouse('offsets')
    fields = {'number': '7', 'length': '60', 'radius': '3', 'holder': 'slimm'}
    for name, text in fields.items():
        tab.fill(f'new tool {name}', text)
    tab.click_with_mouse('set new tool')
    said = "unknown holder 'slimm'; known: slim"
    tab.wait(lambda: tab.shows(said))
    assert 7 not in panel.setup.tools
    tab.fill('new tool holder', 'slim')
    tab.click_with_mouse('set new tool')
    panel.spin_until(lambda: 7 in panel.setup.tools)
    assert panel.setup.tools[7].holder == 'slim'


#: Volume of what is drawn of the stock [mm3]; no other body has its colour.
STOCK = """(() => {
  const view = Object.keys(mounted_app.elements).map(id => getElement(id)).find(e => e?.objects);
  let volume = 0;
  view.objects.forEach(object => {
    const mesh = object.mesh?.children?.[0];
    if (mesh?.material?.color?.getHexString() !== 'b2bdc7' || !object.mesh.visible) return;
    const p = mesh.geometry.attributes.position.array;
    for (let k = 0; k < p.length; k += 9) {
      volume += p[k] * (p[k + 4] * p[k + 8] - p[k + 5] * p[k + 7]);
      volume += p[k + 1] * (p[k + 5] * p[k + 6] - p[k + 3] * p[k + 8]);
      volume += p[k + 2] * (p[k + 3] * p[k + 7] - p[k + 4] * p[k + 6]);
    }
  });
  return Math.round(volume / 6e-9);
})()"""


def test_the_stock_is_drawn_as_it_is_cut(panel, tmp_path):
    tab = panel.open_in_charge()
    panel.until(MachineState.IDLE)
    slots = tmp_path / 'slots.ngc'
    slots.write_text(SLOTS)
    panel.load(tab, slots)
    tab.wait(lambda: tab.run(STOCK))
    uncut = tab.run(STOCK)
    assert uncut == pytest.approx(60 * 40 * 11, rel=0.01)
    panel.begin(tab)
    tab.wait(lambda: 0 < tab.run(STOCK) < uncut)
    panel.until(MachineState.IDLE)
    # Two slots of 50 mm and their ends: half a circle of 6 mm, one of them 2 mm deeper.
    cut = 50 * (9 * np.pi + 2 * 6) + 2 * 18 * np.pi + 9 * np.pi
    tab.wait(lambda: uncut - tab.run(STOCK) == pytest.approx(cut, rel=0.1))
    if folder := os.environ.get('PICTURES'):
        tab.screenshot(f'{folder}/stock.png')
