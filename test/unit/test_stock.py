"""The stock that is cut: volumes, what meets what is left, and what `check` must catch."""

import csv
import json
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import griddata

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.iso_scallop import IsoScallopOptions, iso_scallop_paths
from cnc_interp.cam.nbuffer import cut_needles
from cnc_interp.cam.needles import Needles
from cnc_interp.cam.shapes import Bumps
from cnc_interp.cam.spline_pass import SplinePass
from cnc_interp.cam.tool_path import LinkOptions, ToolPath, link
from cnc_interp.collision.cutting import Mills, cut_by
from cnc_interp.collision.hits import CollisionError
from cnc_interp.collision.mesh_file import triangles_of
from cnc_interp.collision.mill_sweep import Z1, slabs_of
from cnc_interp.collision.motions import MOTION
from cnc_interp.collision.scene_file import read_scene
from cnc_interp.collision.stock import field_of, lines, volume
from cnc_interp.commands.cli import main
from cnc_interp.core import MM, UM
from cnc_interp.kinematics.axis_path import evaluate
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.page.preview import Preview
from cnc_interp.program import read_text
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.report.stock import removal_rates, stock_section
from cnc_interp.run.path_chain import segments_of
from cnc_interp.run.run_planner import RunPlanner
from cnc_interp.settings.options import Settings

TRANSFORM = Transform.of(Machine.load('xyzac'))

BLOCK = (
    'stock: {link: workpiece, box_mm: {low: [-20, -20, -10], high: [20, 20, 0]}, grid_mm: %s}\n'
)
FLAT, BALL, BULL = (
    f'tools: {{1: {{diameter_mm: 6, flute_mm: 20{corner}}}}}\n'
    for corner in ('', ', corner_mm: 3', ', corner_mm: 1')
)
OPTIONS = IsoScallopOptions(stepover=1.8 * MM)
R, DEEP, LONG = 3.0, 3.0, 20.0
COS, SIN = np.cos(0.3), np.sin(0.3)
ACROSS = [(-10.0 * COS, -10.0 * SIN, -DEEP), (10.0 * COS, 10.0 * SIN, -DEEP)]


def bodies(folder, tool, grid=0.1, stock=BLOCK):
    (folder / 'scene.yaml').write_text(tool + (stock % grid if '%s' in stock else stock))
    scene = read_scene(folder / 'scene.yaml')
    stock = next(body for body in scene.bodies if body.name == 'stock')
    return stock, next(body for body in scene.bodies if body.name == 'cutter')


def lines_of(points, axis=(0.0, 0.0, 1.0)):
    """Pieces of motion from point to point, the tool axis as it is."""
    points, rows = np.asarray(points) * MM, []
    for one, other in pairwise(points):
        row = np.zeros(MOTION)
        row[:3], row[3:6], row[6:9] = (one + other) / 2, axis, (other - one) / 2
        rows.append(row)
    return np.array(rows)


def cut(field, rows, cutter, step):
    slabs = slabs_of(cutter)
    return cut_by(field, rows, Mills(slabs, np.array([0, len(slabs)])), step)


def removed(stock, cutter, motions, grid=0.1, axis=2):
    """The volume that motions take out of a block, in mm3."""
    field = field_of(stock, axis, grid * MM, shifted=True)
    return (volume(field) - volume(cut(field, motions, cutter, 0.1 * grid * MM))) / MM**3


def disc_part(depth, width=R):
    """Area of a disc up to a depth from its rim."""
    return quad(lambda z: 2.0 * np.sqrt(max(z * (2.0 * width - z), 0.0)), 0.0, depth)[0]


def bull_width(z, corner):
    """Radius of the mill at a height."""
    return R - corner + np.sqrt(max(corner**2 - (corner - z) ** 2, 0.0)) if z < corner else R


@pytest.mark.parametrize('axis', [0, 1, 2])
@pytest.mark.parametrize(('tool', 'corner'), [(FLAT, 0.0), (BALL, 3.0), (BULL, 1.0)])
def test_slots_have_their_volume(tmp_path, tool, corner, axis):
    layer = lambda z: LONG * 2.0 * bull_width(z, corner) + np.pi * bull_width(z, corner) ** 2  # noqa: E731
    exact = quad(layer, 0.0, DEEP, points=[corner])[0]
    found = removed(*bodies(tmp_path, tool), lines_of(ACROSS), axis=axis)
    assert found == pytest.approx(exact, rel=1e-3)


def test_a_bore_has_its_volume(tmp_path):
    # The mill circles below the surface, so that a disc of it is left: an undercut, for one axis.
    angle = np.linspace(0.0, 2.0 * np.pi, 721)
    circle = np.column_stack([5.0 * np.cos(angle), 5.0 * np.sin(angle), np.full(721, -8.0)])
    exact = np.pi * (8.0**2 - 2.0**2) * 8.0
    found = removed(*bodies(tmp_path, FLAT), lines_of(circle))
    assert found == pytest.approx(exact, rel=1e-3)


def test_a_tilted_mill_leaves_its_tilted_slot(tmp_path):
    # It moves across its tilt; the slot is the shadow of the mill along the motion.
    tilt = np.radians(25.0)
    axis = np.array([0.0, -np.sin(tilt), np.cos(tilt)])
    points = [(-60.0, 0.0, -5.0), (60.0, 0.0, -5.0)]

    def width(z):
        # Seen along X, the mill is a rectangle whose lower side goes through the tip.
        side = min(R, (z + 5.0) / np.sin(tilt))
        return max(side + R, 0.0) / np.cos(tilt)

    low, corner = (-5.0 + side * R * np.sin(tilt) for side in (-1.0, 1.0))
    exact = 40.0 * quad(width, low, 0.0, points=[corner])[0]
    found = removed(*bodies(tmp_path, FLAT), lines_of(points, axis))
    assert found == pytest.approx(exact, rel=1e-3)


@pytest.mark.parametrize('tool', [FLAT, BALL, BULL])
def test_sweeps_are_what_dense_poses_leave(tmp_path, tool):
    """Random oblique motions, every line: a sweep contains all poses and little more."""
    rng = np.random.default_rng(5)
    stock, cutter = bodies(tmp_path, tool, 0.8)
    for k in range(12):
        axis = rng.normal(size=3) * [0.5, 0.5, 0.0] + [0.0, 0.0, 1.0]
        axis /= np.linalg.norm(axis)
        ends = rng.uniform([-15, -15, -8], [15, 15, -1], (2, 3))
        ends[1, 2] = ends[0, 2] if k % 3 == 0 else ends[1, 2]
        swept = removed(stock, cutter, lines_of(ends, axis), 0.8, axis=k % 3)
        dense = np.linspace(ends[0], ends[1], 2001)
        still = np.repeat(dense, 2, axis=0)
        poses = lines_of(still, axis)[::2]  # every pose for itself, without motion
        stamped = removed(stock, cutter, poses, 0.8, axis=k % 3)
        assert stamped <= swept + 1e-9
        assert swept == pytest.approx(stamped, rel=2e-3)


@pytest.mark.thorough
def test_dexels_and_needles_agree_on_a_surface_of_cam(tmp_path):
    surface = Bumps((0.02, 0.018), [(0, 0, 0.002, 0.01)])
    mill = Cutter(5 * MM, 1.5 * MM)
    passes = iso_scallop_paths(surface, mill, np.array([0.0, 1.0, 0.0]), OPTIONS).passes
    curves = [c for c in (SplinePass.of(p, 0.5 * MM) for p in passes) if c]
    path = ToolPath.of(link(curves, surface, mill, LinkOptions()), UM)
    needles = Needles.on(surface, 0.15 * MM)
    height = cut_needles(needles, mill, path.tip, path.axis).height
    tool = 'tools: {1: {diameter_mm: 13, corner_mm: 1.5, flute_mm: 20}}\n'
    block = 'stock: {link: workpiece, box_mm: {low: [-8, -7, -2], high: [8, 7, 2.5]}}\n'
    stock, cutter = bodies(tmp_path, tool, stock=block)
    # The rim of a slab must not turn far in a piece of motion: sixteen pieces from pose to pose.
    fine = np.arange(16 * (len(path.tip) - 1) + 1) / 16
    tip, axis = (
        np.column_stack([np.interp(fine, np.arange(len(values)), c) for c in values.T])
        for values in (path.tip, path.axis)
    )
    rows = np.zeros((len(tip) - 1, MOTION))
    for column, values in ((0, tip), (3, axis)):
        rows[:, column : column + 3] = 0.5 * (values[1:] + values[:-1])
        rows[:, column + 6 : column + 9] = 0.5 * np.diff(values, axis=0)
    field = field_of(stock, 2, 0.2 * MM, shifted=True)
    field = cut(field, rows, cutter, 2 * UM)
    assert (field.used == 1).all()
    at = lines(field).reshape(-1, 2)
    z, slope_x, slope_y = surface.height(*at.T)[:3]
    above = (field.ends[..., 0, 1].ravel() - z) / np.sqrt(1.0 + slope_x**2 + slope_y**2)
    place = needles.base[..., :2].reshape(-1, 2)
    off = above - griddata(place, height.ravel(), at)
    # Eight frusta leave so much of the corner radius; the scallops are 10 um high.
    assert np.abs(off).max() < 8 * UM
    assert abs(off.mean()) < 3 * UM


def test_the_grid_changes_little(tmp_path):
    found = [
        removed(*bodies(tmp_path, BALL, grid), lines_of(ACROSS), grid) for grid in (0.4, 0.2, 0.1)
    ]
    assert np.ptp(found) < 2e-3 * found[0]


def test_a_reduced_mill_is_within_the_mill(tmp_path):
    for tool in (FLAT, BALL, BULL):
        _, cutter = bodies(tmp_path, tool)
        less = slabs_of(cutter, -0.3 * MM)
        for z in np.linspace(0.31, 19.6, 50) * MM:
            rows = less[(less[:, 1] <= z) & (z <= less[:, 3]) & (less[:, 0] == 0.0)]
            share = (z - rows[:, 1]) / (rows[:, 3] - rows[:, 1])
            radii = rows[:, 2] + share * (rows[:, 4] - rows[:, 2])
            corner = cutter.pieces[0].round / MM
            assert (radii / MM <= bull_width(z / MM, corner) - 0.29).all()
        assert less[:, Z1].max() == pytest.approx(19.7 * MM) or corner == 3.0


# Programs ------------------------------------------------------------------------------------

POCKET = """
G21 G90
G0 X0 Y0 Z20 A0 C0
G0 X-10
G1 Z-3 F1200
X10
G0 Z20
X-10
G1 Z-2.9
%s X10
G0 Z20
M30
"""
NECK = """
tools:
  1: {diameter_mm: 6, corner_mm: 1, flute_mm: 8, shank_mm: [[8, 2], [20, 2]],
      holder_mm: [[20, 5], [40, 15]]}
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / 'part.ngc').write_text(POCKET % 'G0')
    (tmp_path / 'scene.yaml').write_text(NECK + BLOCK % 0.4)
    return tmp_path


def plan(folder, *more, out='plan'):
    words = ['plan', str(folder / 'part.ngc'), '--out', str(folder / out), '--machine', 'xyzac']
    return main([*words, '--scene', str(folder / 'scene.yaml'), *more])


def check(folder, out='plan'):
    return main(['check', str(folder / out)])


def told(folder, out='plan'):
    return json.loads((folder / out / 'summary.json').read_text())['collision']['stock']


def test_a_rapid_through_a_slot_is_free_once_it_is_cut(folder, capsys):
    assert plan(folder) == 0
    assert check(folder) == 0
    layers = quad(lambda z: 20 * 2 * bull_width(z, 1.0) + np.pi * bull_width(z, 1.0) ** 2, 0, 3)
    assert told(folder)['removed'] / MM**3 == pytest.approx(layers[0], rel=0.01)
    capsys.readouterr()
    (folder / 'part.ngc').write_text((POCKET % 'G0').replace('Z-2.9', 'Z-3.3'))
    assert plan(folder) == 2, 'the same rapid deeper than the slot'
    assert 'line 10, cutter and stock' in capsys.readouterr().err
    assert plan(folder, '--collision', 'warn') == 1
    assert check(folder) == 1
    assert 'hits of the stock that is left' in capsys.readouterr().out


def test_a_thin_neck_may_follow_its_mill_and_a_thick_holder_may_not(folder, capsys):
    deep = (POCKET % 'G1').replace('Z-3 ', 'Z-9.5 ')
    drill = deep.replace('\nX10\n', '\n')
    (folder / 'part.ngc').write_text(drill)
    assert plan(folder) == 0, 'the neck is thinner than its hole'
    assert check(folder) == 0
    (folder / 'part.ngc').write_text(deep)
    capsys.readouterr()
    assert plan(folder) == 2, 'along a slot deeper than the flutes, it is not'
    assert 'line 6, shank and stock' in capsys.readouterr().err
    (folder / 'part.ngc').write_text(drill)
    (folder / 'scene.yaml').write_text(
        NECK.replace('[20, 2]]', '[9, 2]]').replace('[[20, 5]', '[[9, 5]') + BLOCK % 0.4
    )
    assert plan(folder) == 2
    assert 'line 5, holder and stock' in capsys.readouterr().err


@pytest.mark.parametrize('aside', [0.0, 0.1, 0.2, 0.3])
def test_a_wall_thinner_than_a_cell_is_not_missed_by_the_shank(folder, capsys, aside):
    """Between the lines of the nominal field there may be none of its material."""
    tool = '  1: {diameter_mm: 6, flute_mm: 2, shank_mm: [[2, 2], [20, 2]]}\n'
    (folder / 'scene.yaml').write_text(f'tools:\n{tool}' + BLOCK % 0.4)
    for wall, code in ((0.1, 2), (-1.0, 0)):
        side, lines_of_program = R + wall / 2, ['G21 G90', 'G0 X-26 Y0 Z5 A0 C0']
        for y in (aside + side, aside - side, aside):
            for z in (-1, -2, -3) if y != aside else (-3,):
                lines_of_program += [f'G0 X-26 Y{y:.3f}', f'G1 Z{z} F1200', 'X26', 'G0 Z5']
        (folder / 'part.ngc').write_text('\n'.join([*lines_of_program, 'M30', '']))
        assert plan(folder) == code
        line = len(lines_of_program) - 1
        assert (f'line {line}, shank and stock' in capsys.readouterr().err) == (code == 2)


def test_planted_faults_of_the_cutter_are_found(folder, capsys):
    assert plan(folder) == 0
    file = folder / 'plan' / 'remaining.npz'
    with np.load(file) as archive:
        sound = dict(archive)

    def verdict(**changed):
        np.savez(file, **{**sound, **changed})
        code = check(folder)
        return code, capsys.readouterr().out

    cut = sound['interval'].copy()
    rows = cut[:, 1] < -1e-6
    assert rows.any()
    cut[rows, 1] += 0.3 * MM  # too little removed, and the sums no longer agree
    code, text = verdict(interval=cut)
    assert code == 1 and 'remaining.npz is wrong at' in text and 'its lines say' in text
    cut[rows, 1] -= 0.6 * MM
    assert 'remaining.npz is wrong at' in verdict(interval=cut)[1]
    assert verdict()[0] == 0


@pytest.mark.thorough
def test_what_is_left_is_the_next_stock(folder):
    assert plan(folder, '--save-stock') == 0
    surface = triangles_of(folder / 'plan' / 'stock.stl', MM, 0.0)  # watertight, or it raises
    size = np.einsum('ij,ij->', surface[:, 0], np.cross(surface[:, 1], surface[:, 2])) / 6.0
    left = told(folder)['volume'] - told(folder)['removed']
    assert size == pytest.approx(left, rel=2e-3)
    (folder / 'scene.yaml').write_text(
        NECK + 'stock: {link: workpiece, mesh: plan/stock.stl, grid_mm: 0.4}\n'
    )
    # The slot is there already: all of it may be passed in rapids, and next to nothing is cut.
    (folder / 'part.ngc').write_text(
        (POCKET % 'G0').replace('\nG1 Z-3 F1200\nX10', '\nG1 F1200\n')
    )
    assert plan(folder, out='next') == 0
    assert check(folder, 'next') == 0
    assert told(folder, 'next')['volume'] == pytest.approx(left, rel=2e-3)
    assert told(folder, 'next')['removed'] < 1e-2 * told(folder)['removed']


def test_a_run_that_starts_inside_has_the_stock_of_its_line(folder, capsys):
    assert plan(folder, '--from-line', '10') == 0, 'the slot was cut before'
    assert check(folder) == 0
    whole = told(folder)['removed']
    assert whole / MM**3 > 300.0
    (folder / 'part.ngc').write_text((POCKET % 'G0').replace('\nX10\n', '\n'))
    capsys.readouterr()
    assert plan(folder, '--from-line', '9') == 2
    assert 'cutter and stock' in capsys.readouterr().err


@pytest.mark.parametrize(('cut', 'free'), [(True, True), (False, False)])
def test_a_run_that_goes_on_inside_has_the_stock_of_its_place(folder, cut, free):
    """Its path before the place is not executed, but it has been cut along."""
    program = POCKET % 'G0' if cut else (POCKET % 'G0').replace('\nX10\n', '\n')
    settings = Settings(scene=folder / 'scene.yaml', flank_height=0.03)
    blocks = read_text(program, 'part.ngc', TRANSFORM, settings).blocks
    whole = segments_of(blocks, TRANSFORM, settings)
    path = AxisPathBuilder(TRANSFORM, 0.03, 1e-3).push(whole)
    place = next(  # above the slot, between both rapids of line 7 or 8
        s
        for s, tip, line in zip(
            path.s, path.tip, blocks.line_number[[*path.cell_block, -1]], strict=True
        )
        if line > 6 + cut and tip[2] > 0.019
    )
    there = evaluate(path, np.array([place]))[0][0]
    planner = RunPlanner(TRANSFORM, settings, 0.01, there, float(place))
    singles = [whole[np.array([k])] for k in range(len(whole))]
    if not free:
        with pytest.raises(CollisionError, match='cutter and stock'):
            for segment in singles:
                planner.push(segment, {})
        return
    for segment in singles:
        planner.push(segment, {})
    stock = planner.clearance.stock
    layers = quad(lambda z: 20 * 2 * bull_width(z, 1.0) + np.pi * bull_width(z, 1.0) ** 2, 0, 3)
    assert stock.figures()['removed'] / MM**3 == pytest.approx(layers[0], rel=0.01)
    assert 'of 1.6e+04 mm3 removed' in planner.clearance.stock_text()


def test_excess_and_gouge_are_those_of_the_part(folder):
    (folder / 'scene.yaml').write_text(NECK + BLOCK % 0.4)
    assert plan(folder, '--save-stock') == 0
    (folder / 'part.stl').write_bytes((folder / 'plan' / 'stock.stl').read_bytes())
    part = 'part: {mesh: part.stl%s}\n'
    (folder / 'scene.yaml').write_text(NECK + BLOCK % 0.4 + part % '')
    assert plan(folder) == 0
    same = told(folder)
    # Marching tetrahedra bevel sharp edges by less than half a cell.
    assert same['excess'] < 0.2 * MM and same['gouge'] < 0.2 * MM
    (folder / 'scene.yaml').write_text(NECK + BLOCK % 0.4 + part % ', at_mm: [0, 0, 0.5]')
    assert plan(folder) == 0
    high = told(folder)
    assert high['gouge'] == pytest.approx(0.5 * MM, abs=0.1 * MM)
    assert high['excess'] == pytest.approx(0.5 * MM, abs=0.2 * MM)
    # Material above the raised top is missing, and below the raised bottom it is in excess.
    rest = read_plan(folder / 'plan').rest
    height, excess = rest['place'][:, 2], rest['excess']
    for at, off in ((height.max(), -0.5), (height.min(), 0.5)):
        there = np.abs(height - at) < 0.01 * MM
        assert there.sum() > 100 and np.median(excess[there]) == pytest.approx(off * MM, abs=UM)
    assert 'excess (mm)' in stock_section(read_plan(folder / 'plan'))
    # Below a floor that is 0.5 mm too high, the walls of the part are 0.5 mm deep in material,
    # though the material along their normals ends at the far side of the block.
    (folder / 'scene.yaml').write_text(NECK + BLOCK % 0.4 + part % ', at_mm: [0, 0, -0.5]')
    assert plan(folder) == 0
    low = told(folder)
    assert low['excess'] == pytest.approx(0.5 * MM, abs=0.2 * MM)
    assert low['gouge'] == pytest.approx(0.5 * MM, abs=0.2 * MM)


def test_removal_rates_sum_up_to_the_volume(folder):
    assert plan(folder) == 0
    found = read_plan(folder / 'plan')
    time, rate = removal_rates(found)
    step = time[1] - time[0]
    assert (rate * step).sum() == pytest.approx(told(folder)['removed'], rel=1e-6)
    # 20 mm/s with a section of 6 by 3 mm, less both corners.
    section = quad(lambda z: 2 * bull_width(z, 1.0), 0, 3)[0]
    assert rate.max() == pytest.approx(20 * section * MM**3, rel=0.1)


@pytest.mark.thorough
def test_a_batch_and_a_sweep_say_in_one_line_what_was_cut(folder):
    words = ['--machine', 'xyzac', '--scene', str(folder / 'scene.yaml')]
    part, both = str(folder / 'part.ngc'), ('keep their clearances', 'of 1.6e+04 mm3 removed')
    assert main(['batch', part, '--out', str(folder / 'all'), '--workers', '1', *words]) == 0
    row = next(csv.DictReader((folder / 'all' / 'table.csv').open()))
    assert all(text in row['notices'] for text in both)
    many = ['sweep', '--out', str(folder / 'swept'), '--workers', '1', '--vary', 'ratio', '1.5']
    assert main([*many, '--', 'plan', part, *words]) == 0
    rows = list(csv.DictReader((folder / 'swept' / 'sweep.csv').open()))
    assert rows and all(text in row['collision'] for row in rows for text in both)


def test_without_a_stock_nothing_of_it_is_loaded(tmp_path):
    (tmp_path / 'scene.yaml').write_text(NECK)
    script = (
        'import sys\n'
        'from pathlib import Path\n'
        'from cnc_interp.machine_model.machine import Machine\n'
        'from cnc_interp.run.clearance_stage import clearance_of\n'
        'from cnc_interp.settings.options import Settings\n'
        f'scene = Path({str(tmp_path / "scene.yaml")!r})\n'
        'clearance_of(Machine.load("xyzac"), Settings(scene=scene))\n'
        "names = ('follow', 'stock', 'mill_sweep', 'rest')\n"
        "print([n for n in names if f'cnc_interp.collision.{n}' in sys.modules])"
    )
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True)
    assert done.stdout == '[]\n', done.stderr


def test_the_page_gets_the_stock_while_it_is_cut(folder):
    assert plan(folder, '--stock-stages', '5') == 0
    preview = Preview.read(folder / 'plan')
    sizes = []
    for k, content in enumerate(preview.stages):
        (folder / f'{k}.stl').write_bytes(content)
        surface = triangles_of(folder / f'{k}.stl', 1.0, 0.0)  # watertight, or it raises
        volume = np.einsum('ij,ij->', surface[:, 0], np.cross(surface[:, 1], surface[:, 2])) / 6.0
        sizes.append(volume)
        place = max(float(preview.stage_from[k]), 0.0)
        assert preview.stage_at(place) == k
    whole, removed = told(folder)['volume'], told(folder)['removed']
    assert sizes[0] == pytest.approx(whole, rel=5e-3), 'before anything is cut'
    left = [(sizes[0] - size) / removed for size in sizes]
    assert left[-1] == pytest.approx(1.0, abs=0.02) and len(left) >= 6
    assert (np.diff(left) > 0.0).all() and np.diff(left).max() < 0.4
    assert preview.stage_at(-1.0) == 0 and preview.stage_at(preview.length) == len(left) - 1
