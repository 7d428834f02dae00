"""Plans with a scene: what is refused, what is listed, and what `check` must catch."""

import json
import struct
import subprocess
import sys

import numpy as np
import pytest
from collision_cases import distance

from cnc_interp.batch.task import Jobs
from cnc_interp.collision.drawing import drawn_bodies, rim_points
from cnc_interp.collision.mesh_file import SceneError, triangles_of
from cnc_interp.collision.scene import Placed
from cnc_interp.collision.scene_file import read_scene, require_tool, scenes_directory
from cnc_interp.commands.cli import main
from cnc_interp.machine_model.machine import Machine, arms_directory, machines_directory
from cnc_interp.program.job import Tool
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.report.clearances import clearance_section, distances
from cnc_interp.report.series import series_of
from cnc_interp.settings.options import Settings

XYZAC = 'config/scenes/xyzac.yaml'
#: A line along X, an approach of a wall by the holder, and a rapid back.
PROGRAM = """
G21 G90
G0 X0 Y0 Z20 A0 C0
G1 X20 F3000
X40 Z0
X20 A10
G0 X0
M30
"""
TOOL = (
    'tools:\n  1: {diameter_mm: 6, corner_mm: 1, flute_mm: 12, holder_mm: [[20, 5], [40, 15]]}\n'
)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / 'part.ngc').write_text(PROGRAM)
    return tmp_path


def scene(folder, text):
    (folder / 'scene.yaml').write_text(text)
    return folder / 'scene.yaml'


def plan(folder, *more):
    words = ['plan', str(folder / 'part.ngc'), '--out', str(folder / 'plan'), '--machine', 'xyzac']
    return main([*words, '--scene', str(folder / 'scene.yaml'), *more])


def box(name, low, high, link='workpiece'):
    return f'  - {{name: {name}, link: {link}, box_mm: {{low: {low}, high: {high}}}}}\n'


CLEAR = 'bodies:\n' + box('wall', [50, -20, -20], [70, 20, 15]) + TOOL
HIT = 'bodies:\n' + box('wall', [50, -20, -20], [70, 20, 35]) + TOOL


def least_apart(folder):
    """The least distance of tool and wall over all setpoints, by another program."""
    bodies = read_scene(folder / 'scene.yaml').bodies
    machine, made = Machine.load('xyzac'), read_plan(folder / 'plan').in_memory()
    return min(
        distance(machine, (one, other), (body.link, bodies[0].link), q)
        for q in made.position[::5]
        for body in bodies[1:]
        for one in body.pieces
        for other in bodies[0].pieces
    )


def test_a_clear_program_is_planned_and_proven(folder, capsys):
    scene(folder, CLEAR)
    assert plan(folder) == 0
    told = capsys.readouterr().out
    assert '4 bodies, 3 pairs keep their clearances' in told
    # The cutter, 3 mm in radius, comes to X 40, and the wall begins at X 50.
    summary = json.loads((folder / 'plan' / 'summary.json').read_text())['collision']
    assert f'nearest {summary["nearest"]["distance"] * 1e3:.3g} mm, ' in told
    assert summary['nearest']['distance'] == pytest.approx(least_apart(folder), abs=5e-5)
    assert summary['nearest']['distance'] == pytest.approx(7e-3, abs=5e-5)
    assert set(summary['nearest']['bodies']) == {'cutter', 'wall'}
    assert summary['nearest']['line'] in (5, 6), 'the corner of both lines'
    assert main(['check', str(folder / 'plan')]) == 0
    assert 'scene' in capsys.readouterr().out


def test_a_hit_names_line_bodies_and_how_much_is_missing(folder, capsys):
    scene(folder, HIT)
    assert plan(folder) == 2
    told = capsys.readouterr().err
    assert 'part.ngc:5: hit: line 5, holder and wall' in told
    assert not (folder / 'plan' / 'setpoints.npz').exists()
    # The holder has a radius of 12.5 mm where the wall ends, 10 mm away.
    short = float(told.split('wall, ')[1].split(' mm short')[0])
    assert 0.5 < short < 2.6


def test_a_warning_lists_every_hit_and_the_plan_is_not_proven(folder, capsys):
    scene(folder, HIT)
    assert plan(folder, '--collision', 'warn') == 1
    told = capsys.readouterr().out
    assert told.count('\nhit: line') == len(
        json.loads((folder / 'plan' / 'summary.json').read_text())['collision']['hits']
    )
    assert main(['check', str(folder / 'plan')]) == 1
    told = capsys.readouterr().out
    assert 'hit: line 5, holder and wall' in told
    assert 'nothing proves' not in told and 'does not hold' not in told


def test_the_cutter_may_touch_the_stock_in_feeds_and_not_in_rapids(folder, capsys):
    stock = 'stock: {link: workpiece, box_mm: {low: [10, -5, -20], high: [45, 5, %s]}}\n'
    scene(folder, TOOL + stock % 10)
    assert plan(folder) == 0, 'feeds cut it, and the rapid keeps above it'
    (folder / 'part.ngc').write_text(PROGRAM.replace('G1 X20 F3000\nX40', 'G0 X20\nG1 F3000 X40'))
    assert plan(folder) == 0
    (folder / 'part.ngc').write_text(PROGRAM.replace('X40 Z0', 'X40 Z0\nG0 X30\nG1'))
    assert plan(folder) == 2
    assert 'line 6, cutter and stock' in capsys.readouterr().err
    assert 'line 5,' not in capsys.readouterr().err


@pytest.mark.parametrize(
    ('move', 'is_rapid'),
    [
        ('G0 X90', True),
        ('G53 G0 X490', True),  # the workpiece zero is at X 400
        ('G28 X90', True),  # by X 90 to the reference point
        ('G2 X90 Y0 I45 J0', False),
        ('G38.2 X90 F600', False),
        ('G91 G0 X90', True),
    ],
)
def test_every_kind_of_motion_is_checked(folder, capsys, move, is_rapid):
    place = '{link: workpiece, box_mm: {low: [50, -60, -20], high: [70, 60, 15]}}\n'
    scene(folder, 'bodies:\n  - ' + place.replace('{link', '{name: wall, link') + TOOL)
    start = 'G21 G90\nG0 X0 Y0 Z5\nG1 F3000 Y1\nY0\n'
    (folder / 'part.ngc').write_text(f'{start}{move}\nM30\n')
    assert plan(folder, '--machine', 'vmc') == 2
    assert 'part.ngc:5: hit: line 5, cutter and wall' in capsys.readouterr().err
    # A probe may touch the stock, as a mill may in feeds.
    scene(folder, TOOL + 'stock: ' + place)
    assert plan(folder, '--machine', 'vmc') == (2 if is_rapid else 0)
    assert ('cutter and stock' in capsys.readouterr().err) is is_rapid


def test_rows_of_collision_npz_are_proven_one_by_one(folder, capsys):
    scene(folder, CLEAR)
    assert plan(folder) == 0
    file = folder / 'plan' / 'collision.npz'
    with np.load(file) as archive:
        sound = dict(archive)

    def verdict(**changed):
        np.savez(file, **{**sound, **changed})
        code = main(['check', str(folder / 'plan')])
        return code, capsys.readouterr().out

    assert verdict()[0] == 0
    worst = int(np.argmax(sound['end'] - sound['begin']))
    for k in sorted({0, worst, len(sound['begin']) - 1}):
        rows = np.arange(len(sound['begin'])) != k
        code, told = verdict(**{name: column[rows] for name, column in sound.items()})
        assert code == 1 and 'nothing proves' in told, k
    shorter = sound['end'].copy()
    shorter[worst] = np.nextafter(shorter[worst], 0.0)
    assert verdict(end=shorter)[0] == 1
    code, told = verdict(normal=-sound['normal'])
    assert code == 1 and 'does not hold' in told
    assert verdict(pair=sound['pair'] + 1)[0] == 1
    code, told = verdict(hit=np.arange(len(sound['hit'])) == worst)
    assert code == 1 and 'is not proven' in told
    file.unlink()
    assert main(['check', str(folder / 'plan')]) == 1
    assert 'collision.npz is missing' in capsys.readouterr().out


def test_another_scene_than_the_planned_one_is_not_proven(folder):
    scene(folder, CLEAR)
    assert plan(folder) == 0
    scene(folder, HIT)
    assert main(['check', str(folder / 'plan')]) == 1


def test_tools_are_those_that_the_program_calls(folder, capsys):
    tools = TOOL + '  2: {diameter_mm: 6, flute_mm: 40}\n'
    scene(folder, HIT.replace(TOOL, tools) + 'tool: 2\n')
    (folder / 'part.ngc').write_text(PROGRAM.replace('A0 C0', '').replace(' A10', ''))
    machine = '--machine', 'vmc'
    program = PROGRAM.replace(' A0 C0', '').replace(' A10', '')
    (folder / 'part.ngc').write_text(program)
    assert plan(folder, *machine) == 0, 'tool 2 is thin all the way up'
    (folder / 'part.ngc').write_text(program.replace('G21', 'G21 T1 M6'))
    assert plan(folder, *machine) == 2
    assert 'line 5, holder and wall' in capsys.readouterr().err
    (folder / 'part.ngc').write_text(program.replace('G21', 'G21 T7 M6'))
    assert plan(folder, *machine) == 2
    assert 'tool 7 has no body in the scene' in capsys.readouterr().err


TABLE = """
tools:
  1: {length: 40.0, radius: 3.0}
  2: {length: 40.0, radius: 3.0, corner_radius: 3.0, holder: slim}
  3: {length: 90.0, radius: 3.0, length_wear: -1.0, flute: 12.0}
"""
HOLDERS = 'holders: {default: [[0, 15], [30, 15]], slim: [[0, 5], [30, 5]]}\n'


def test_tools_of_the_tool_table_get_bodies(folder, capsys):
    """Their tips lie so far below the tip of the machine file as G43 counts."""
    file = scene(folder, 'bodies:\n' + box('wall', [50, -20, -60], [70, 20, 35]) + HOLDERS)
    (folder / 'setup.yaml').write_text(TABLE)
    read = read_scene(file, TABLE)
    assert read.tools == (1, 2, 3)
    low = {
        (b.tool, b.name): b.triangles[..., 2].min() * 1e3
        for b in drawn_bodies(read, Machine.load('vmc'))
        if b.tool
    }
    assert low == {
        (1, 'cutter'): pytest.approx(-40),
        (1, 'holder'): pytest.approx(0),
        (2, 'cutter'): pytest.approx(-40),
        (2, 'holder'): pytest.approx(0),
        (3, 'cutter'): pytest.approx(-89),
        (3, 'shank'): pytest.approx(-89 + 12),
        (3, 'holder'): pytest.approx(0),
    }
    # The tip comes to X 40 Z 0: the usual holder, 15 mm in radius, reaches 5 mm into the wall.
    program = PROGRAM.replace(' A0 C0', '').replace(' A10', '')
    more = '--machine', 'vmc', '--setup', str(folder / 'setup.yaml')
    for tool, tip, code in ((1, -5, 2), (2, -5, 0), (3, -5, 0)):
        text = program.replace('G21', f'G21 T{tool} M6 G43 H{tool}').replace('Z0', f'Z{tip}')
        (folder / 'part.ngc').write_text(text)
        assert plan(folder, *more) == code, tool
        told = capsys.readouterr()
        if code:
            assert 'line 5, holder and wall' in told.err
        else:
            assert main(['check', str(folder / 'plan')]) == 0
    (folder / 'setup.yaml').write_text(TABLE.replace('slim', 'fat'))
    assert plan(folder, *more) == 2
    assert (
        "tool 2 of the tool table has the unknown holder 'fat'; known: default, slim"
        in capsys.readouterr().err
    )


def test_a_tool_that_the_operator_puts_in_is_checked_from_its_line_on(folder, capsys):
    """The machine has no tool changer: M6 only waits there."""
    tools = 'tools:\n  1: {diameter_mm: 6, flute_mm: 12}\n  2: {diameter_mm: 60, flute_mm: 12}\n'
    scene(folder, 'bodies:\n' + box('wall', [50, -20, -60], [70, 20, 35]) + tools + 'tool: 1\n')
    text = PROGRAM.replace('G0 X0', 'T{0} M6 G0 X0').replace('X40', 'X30')
    more = '--machine', 'xyzac'
    (folder / 'part.ngc').write_text(text.format(1))
    assert plan(folder, *more) == 0, capsys.readouterr().err
    (folder / 'part.ngc').write_text(text.format(2))
    assert plan(folder, *more) == 2
    assert 'line 5, cutter and wall' in capsys.readouterr().err
    (folder / 'part.ngc').write_text(text.format(2).replace('X30', 'X15').replace('X20', 'X10'))
    assert plan(folder, *more) == 0
    assert main(['check', str(folder / 'plan')]) == 0, capsys.readouterr().out


def test_a_tool_of_the_table_must_fit_the_scene(folder):
    own = 'tools:\n  4: {diameter_mm: 6, flute_mm: 12}\n'
    file = scene(folder, 'bodies:\n' + box('wall', [50, -20, -60], [70, 20, 35]) + own + HOLDERS)
    read = read_scene(file)
    require_tool(read, 2, Tool(0.04, 0.003, holder='slim'))
    require_tool(read, 2, Tool(holder='slim'))
    require_tool(read, 4, Tool(4.0, 0.003))  # the scene describes it itself
    with pytest.raises(SceneError, match=r"tool 2 .* unknown holder 'fat'; known: default, slim"):
        require_tool(read, 2, Tool(holder='fat'))
    with pytest.raises(SceneError, match=r'tools\.2\.'):  # the ball is higher than the tool
        require_tool(read, 2, Tool(0.002, 0.003, corner_radius=0.003))
    bare = read_scene(scene(folder, 'bodies:\n' + box('wall', [50, -20, -60], [70, 20, 35])))
    with pytest.raises(SceneError, match="holder 'slim'; the scene describes no holder"):
        require_tool(bare, 2, Tool(holder='slim'))


def stl(folder, triangles, name='mesh.stl'):
    rows = [struct.pack('<12fH', *np.zeros(3), *np.ravel(t), 0) for t in triangles]
    content = b'\0' * 80 + struct.pack('<I', len(rows)) + b''.join(rows)
    (folder / name).write_bytes(content)


def mesh_box(low, high):
    low, high = np.array(low, float), np.array(high, float)
    corners = [[(low, high)[(k >> a) & 1][a] for a in range(3)] for k in range(8)]
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    return [[corners[k] for k in t] for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]


def test_a_mesh_of_a_file_is_hit_where_the_box_is(folder, capsys):
    mesh = 'bodies:\n  - {name: wall, link: workpiece, mesh: mesh.stl}\n' + TOOL
    scene(folder, mesh)
    stl(folder, mesh_box([50, -20, -20], [70, 20, 15]))
    assert plan(folder) == 0
    assert main(['check', str(folder / 'plan')]) == 0
    stl(folder, mesh_box([50, -20, -20], [70, 20, 35]))
    assert plan(folder) == 2
    assert 'line 5, holder and wall' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('text', 'told'),
    [
        ('bodies:\n' + box('wall', [50, -20, -20], [70, 20, 15], 'b_table'), "no link 'b_table'"),
        ('bodies:\n  - {name: wall, link: workpiece, sphere_mm: {radius: 0.0}}', 'unit right'),
        ('bodies:\n' + box('wall', [5e6, 0, 0], [6e6, 1, 1]), 'is the unit right'),
        ('bodies:\n' + box('wall', [0, 0, 0], [1, 0, 1]), 'low must be less than high'),
        ('bodies:\n  - {name: wall, link: workpiece}', 'must have one shape'),
        ('bodies:\n  - {name: w, link: workpiece, mesh: none.stl}', 'no such file'),
        (
            'bodies:\n  - {name: w, link: workpiece, mesh: open.stl}',
            'not watertight (3 open edges',
        ),
        ('bodies:\n  - {name: w, link: workpiece, mesh: far.stl, unit: m}', 'is the unit right'),
        ('bodies:\n  - {name: w, link: workpiece, mesh: far.stl, unit: feet}', "unit 'feet'"),
        ('bodies:\n  - {name: w, link: workpiece, mesh: 3}', 'must name an STL or STEP file'),
        ('holders: 3', 'map names of holders to rows'),
        ('bodies: []', 'the scene has no body'),
        ('bodys: []', "unknown key 'bodys'"),
        ('clearance_mm: {default: -1}', 'is not between'),
        ('tools:\n  1: {diameter_mm: 6}', 'has no flute_mm'),
        (CLEAR + 'ignore: [[wall, nobody]]', "no body has the name 'nobody'"),
        (CLEAR + 'include: nothing', 'no bundled scene of that name; bundled: bc_trunnion, '),
        ('bodies:\n' + box('wall', [-9, -9, 0], [9, 9, 9]) * 2, 'is used twice'),
        (
            'bodies:\n' + box('wall', [-9, -9, 0], [9, 9, 40]) + TOOL,
            'cutter and wall are too close before anything moves',
        ),
        (
            'bodies:\n  - {name: jar, link: workpiece, mesh: big.stl}\n' + TOOL,
            'cutter lies inside jar',
        ),
        ('- 1', 'must be a mapping'),
        ('x: *y', 'cannot be read as YAML'),
    ],
)
def test_a_bad_scene_is_one_line(folder, capsys, text, told):
    stl(folder, mesh_box([0, 0, 0], [10, 10, 10])[:-1], 'open.stl')
    stl(folder, mesh_box([0, 0, 0], [100, 100, 100]), 'far.stl')
    stl(folder, mesh_box([-300, -300, -300], [300, 300, 300]), 'big.stl')
    scene(folder, text)
    assert plan(folder) == 2
    error = capsys.readouterr().err
    assert told in error
    assert len(error.strip().splitlines()) == 1, error


def test_without_a_scene_nothing_of_it_is_loaded(folder):
    script = (
        'import sys\nfrom cnc_interp.commands.cli import main\n'
        f'main(["plan", {str(folder / "part.ngc")!r}, "--out", {str(folder / "plan")!r}])\n'
        'print([name for name in sys.modules if "cnc_interp.collision" in name])'
    )
    done = subprocess.run([sys.executable, '-c', script], capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == '[]', done.stderr


def test_a_scene_changes_no_setpoint(folder):
    scene(folder, CLEAR)
    assert plan(folder) == 0
    with np.load(folder / 'plan' / 'setpoints.npz') as archive:
        watched = archive['position']
    words = ['plan', str(folder / 'part.ngc'), '--out', str(folder / 'alone')]
    assert main(words) == 0
    with np.load(folder / 'alone' / 'setpoints.npz') as archive:
        np.testing.assert_array_equal(watched, archive['position'])


def test_a_bundled_scene_is_found_by_its_name(folder):
    words = ['plan', str(folder / 'part.ngc'), '--out', str(folder / 'plan')]
    assert main([*words, '--scene', 'xyzac']) == 0


def test_bundled_scenes_fit_their_machines():
    bundled = [*machines_directory().glob('*.yaml'), *arms_directory().glob('*.yaml')]
    assert {file.stem for file in bundled} == {f.stem for f in scenes_directory().glob('*.yaml')}
    for file in bundled:
        placed = Placed.of(read_scene(file.stem), Machine.load(file))
        assert len(placed.pairs) > 3


def test_the_report_shows_the_smallest_distances_and_every_hit(folder, capsys):
    scene(folder, HIT)
    assert plan(folder, '--collision', 'warn') == 1
    machine, made = Machine.load('xyzac'), read_plan(folder / 'plan').in_memory()
    page = clearance_section(made, machine, series_of(made, machine))
    assert page.count('<script') == 1 + int(made.collision['hit'].sum()), 'the curve and the hits'
    assert 'holder and wall' in page and 'line 5' in page
    placed = Placed.of(read_scene(folder / 'scene.yaml'), machine)
    rows = np.arange(0, len(made.position), 97)
    bodies = placed.scene.bodies
    found = distances(placed, machine, made, list(placed.pairs), rows)
    for k, (a, b) in enumerate(placed.pairs):
        links = bodies[a].link, bodies[b].link
        for row, told in zip(rows, found[:, k], strict=True):
            q = made.position[row]
            own = min(
                distance(machine, (one, other), links, q)
                for one in bodies[a].pieces
                for other in bodies[b].pieces
            )
            assert max(told, 0.0) == pytest.approx(own, abs=1e-8)
    cutter = bodies[1].pieces[0]
    points = rim_points(cutter.discs, cutter.along, cutter.round)
    assert np.hypot(points[:, 0], points[:, 1]).max() == pytest.approx(3e-3)
    assert points[:, 2].min() == pytest.approx(0.0, abs=1e-9)


def test_bodies_are_drawn_as_closed_surfaces_as_large_as_they_are(folder):
    mesh = '  - {name: block, link: workpiece, mesh: mesh.stl}\n'
    ball = '  - {name: ball, link: workpiece, sphere_mm: {radius: 10}, at_mm: [90, 0, 0]}\n'
    scene(folder, CLEAR.replace(TOOL, mesh + ball + TOOL))
    stl(folder, mesh_box([100, -20, -20], [120, 20, 15]))
    drawn = {
        b.name: b for b in drawn_bodies(read_scene(folder / 'scene.yaml'), Machine.load('xyzac'))
    }
    volume = {
        name: np.einsum('ij,ij->', t[:, 0], np.cross(t[:, 1], t[:, 2])) / 6e-9
        for name, t in ((name, body.triangles) for name, body in drawn.items())
    }
    assert [volume['wall'], volume['block']] == pytest.approx([20 * 40 * 35] * 2)
    # The holder: a cone of 5 to 15 mm in radius, 20 mm high; the rims are polygons.
    cone = np.pi * 20 / 3 * (25 + 75 + 225)
    assert 0.97 * cone < volume['holder'] < cone
    assert 0.9 * 4188 < volume['ball'] < 4189
    assert drawn['holder'].link == 'tool_tip' and drawn['holder'].tool == 1
    (folder / 'wall.stl').write_bytes(drawn['wall'].stl())
    again = triangles_of(folder / 'wall.stl', 1.0, 1e-5)
    np.testing.assert_allclose(again, drawn['wall'].triangles, atol=1e-8)


def test_a_changed_scene_or_mesh_is_another_task_of_a_batch(folder):
    file = scene(folder, 'bodies:\n  - {name: wall, link: workpiece, mesh: mesh.stl}\n' + TOOL)

    def key():
        jobs = Jobs([folder / 'part.ngc'], ['xyzac'], Settings(scene=file))
        return jobs.task(next(iter(jobs))).key

    stl(folder, mesh_box([50, -20, -20], [70, 20, 15]))
    keys = {key(), key()}
    stl(folder, mesh_box([50, -20, -20], [70, 20, 16]))
    keys.add(key())
    file.write_text(file.read_text() + 'clearance_mm: {default: 0.2}\n')
    keys.add(key())
    assert len(keys) == 3


def test_a_step_file_becomes_a_closed_mesh_within_its_chord(folder):
    """A plate of 40 x 40 x 10 mm with a bore of 16 mm."""
    pytest.importorskip('OCP')
    from OCP.BRepAlgoAPI import BRepAlgoAPI_Cut
    from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder
    from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt
    from OCP.STEPControl import STEPControl_StepModelType, STEPControl_Writer

    plate = BRepPrimAPI_MakeBox(gp_Pnt(-20, -20, 0), gp_Pnt(20, 20, 10)).Shape()
    bore = gp_Ax2(gp_Pnt(0, 0, -1), gp_Dir(0, 0, 1))
    part = BRepAlgoAPI_Cut(plate, BRepPrimAPI_MakeCylinder(bore, 8.0, 12.0).Shape()).Shape()
    writer = STEPControl_Writer()
    writer.Transfer(part, STEPControl_StepModelType.STEPControl_AsIs)
    writer.Write(str(folder / 'plate.step'))
    chord = 1e-5
    mesh = triangles_of(folder / 'plate.step', 1e-3, chord)
    volume = np.einsum('ij,ij->', mesh[:, 0], np.cross(mesh[:, 1], mesh[:, 2])) / 6.0
    assert volume == pytest.approx((1600 - np.pi * 64) * 10e-9, rel=1e-3)
    middles = mesh.mean(axis=1)
    wall = np.hypot(middles[:, 0], middles[:, 1])
    inner = (np.abs(wall - 0.008) < 1e-4) & (middles[:, 2] > 1e-4) & (middles[:, 2] < 9.9e-3)
    assert inner.any() and (wall[inner] > 0.008 - chord).all(), 'flat pieces of the bore'
